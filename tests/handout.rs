//! What a client is handed of a dive: its pages on A4, with scales that are right, and what changed between two maps.

use std::fs;
use std::path::Path;
use std::time::Duration;

use echosplat_model::glam::{DVec3, Quat, Vec3};
use echosplat_model::{Gaussian, Standing};
use echosplat_recording::ply::{MapNotes, write_map};
use serde_json::{Value, json};

use crate::browser::{Browser, chromium, say};
use crate::harness::Program;

const LONG: Duration = Duration::from_secs(120);
const SAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/sample-dive/");

fn done(arguments: &[&str]) -> Program {
    let mut program = Program::echosplat(arguments);
    program.wait_exit_code(0, LONG);
    program
}

fn open(browser: &mut Browser, page: &Path) {
    browser.call(
        "Page.navigate",
        &json!({ "url": format!("file://{}", page.display()) }),
    );
    browser.wait(
        "the viewer",
        "viewer.tiles.length > 0 && viewer.renderer !== null",
    );
}

/// Width of the page between its margins, and of each scale bar as drawn and as it says at the scale of its drawing, mm.
const SCALES: &str = r#"[...document.querySelectorAll("svg[data-scale]")].map((svg) => {
  const bar = svg.querySelector(".scalebar");
  const mm = bar.querySelector(".bar").getBBox().width * svg.getBoundingClientRect().width / svg.viewBox.baseVal.width * 25.4 / 96;
  return { width: svg.getBoundingClientRect().width * 25.4 / 96, mm, wanted: 1000 * Number(bar.dataset.m) / Number(svg.dataset.scale) };
})"#;

/// Pages of a PDF of Chromium, which writes their objects in the open.
fn page_count(pdf: &[u8]) -> usize {
    let text = String::from_utf8_lossy(pdf);
    text.matches("/Type /Page\n").count()
}

#[test]
fn a_dive_is_handed_over_on_pages_of_paper() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let map = path("map.ply");
    done(&[
        "replay",
        &format!("{SAMPLE}dive.svlog"),
        "--poses",
        &format!("{SAMPLE}poses.tum"),
        "--map",
        &map,
        "--hold-out",
        "20",
        "--record",
        &path("records"),
    ]);
    done(&[
        "georeference",
        &map,
        "--origin",
        "60.17,24.94,-0.5",
        "--heading",
        "37",
    ]);
    let record = fs::read_dir(path("records"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap();
    let record = record.path().display().to_string();
    let near = echosplat_recording::ply::read_map(map.as_ref()).unwrap();
    let near = near.origin_m + near.gaussians[0].mean_m.as_dvec3();
    let near = format!("{:.3},{:.3},{:.3}", near.x, near.y, near.z);
    fs::write(
        path("measures.txt"),
        format!("--profile -3,0,0 3,0,0  # along the fence\n--pile {near}\n--plane 900,900,0 # not there\n"),
    )
    .unwrap();
    let out = path("report.html");
    done(&[
        "report",
        &map,
        "--dive",
        &record,
        "--measures",
        &path("measures.txt"),
        "--distance",
        &near,
        &near,
        "--title",
        "Fence <north>",
        "--about",
        "Client=Harbour & Sons",
        "--out",
        &out,
    ]);
    let html = fs::read_to_string(&out).unwrap();
    for part in [
        "<h1>Fence &lt;north&gt;</h1>",
        "Harbour &amp; Sons",
        "<h2>Plan</h2>",
        "<h2>Elevations</h2>",
        "<h2>Trajectory</h2>",
        "<h2>Measures</h2>",
        "class=\"north\" data-heading=\"37\"",
        "depth below the water&#39;s surface, m",
        "nats a bin above noise",
        "nats a bin above a constant",
        "EPSG:32635",
        "speed of sound",
        "along the fence (profile)",
        "not there (not measured)",
        env!("CARGO_PKG_VERSION"),
    ] {
        let part = part.replace("&#39;", "'");
        assert!(html.contains(&part), "{part}");
    }
    let Some(program) = chromium() else {
        return say("passed over: pages of a report, since no Chromium was found");
    };
    let mut browser = Browser::start(&program);
    browser.size(1280, 800);
    open(&mut browser, out.as_ref());
    browser.call("Emulation.setEmulatedMedia", &json!({ "media": "print" }));
    let scales = browser.evaluate(SCALES);
    let scales = scales.as_array().unwrap();
    assert!(scales.len() >= 4, "{scales:?}");
    for scale in scales {
        let number = |name: &str| scale[name].as_f64().unwrap();
        assert!((number("width") - 180.0).abs() < 0.2, "{scale}");
        assert!(
            (number("mm") / number("wanted") - 1.0).abs() < 2e-3,
            "{scale}"
        );
    }
    let pdf = pdf(&mut browser);
    let pages = page_count(&pdf);
    assert!((6..=8).contains(&pages), "{pages} pages");
}

fn pdf(browser: &mut Browser) -> Vec<u8> {
    use base64::Engine as _;
    let printed = browser.call(
        "Page.printToPDF",
        &json!({ "preferCSSPageSize": true, "printBackground": true }),
    );
    let text = printed["data"].as_str().expect("a PDF");
    base64::engine::general_purpose::STANDARD
        .decode(text)
        .expect("base64")
}

#[test]
fn what_cannot_be_reported_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    write(&path("map.ply"), &scene(true, false));
    fs::write(path("measures.txt"), "--pile 1,2,3\n--pyle 1,2,3\n").unwrap();
    fs::write(path("run.json"), "{}").unwrap();
    for (arguments, says) in [
        (["--measures", &path("measures.txt")], "line 2"),
        (["--dive", &path("run.json")], "printed with --json"),
        (["--dive", &path("map.ply")], "it is no recording"),
        (["--out", &path("none/none/x.html")], ""),
    ] {
        let map = path("map.ply");
        let all = [&["report", &map][..], &arguments].concat();
        let mut program = Program::echosplat(&all);
        let code = program.wait_exit(LONG).code();
        if !says.is_empty() {
            assert_eq!(code, Some(2), "{}", program.account());
            assert!(
                program.stderr().contains(says),
                "{says}: {}",
                program.account()
            );
        }
    }
    // Of the map alone there is a report too, which says what it does not know.
    done(&["report", &path("map.ply")]);
    let html = fs::read_to_string(path("map.html")).unwrap();
    assert!(html.contains("This is a map of") && html.contains("not told"));
    assert!(!html.contains("class=\"north\""));
}

fn gaussian(at: DVec3) -> Gaussian {
    Gaussian {
        id: 0,
        mean_m: at.as_vec3(),
        rotation: Quat::IDENTITY,
        scale_m: Vec3::splat(0.04),
        opacity: 0.5,
        reflectivity: 0.1,
        sigma_m: 0.03,
        position_covariance_m2: Gaussian::known_alike_m2(0.03),
        probability: 0.95,
        standing: Standing::Confident,
        why: echosplat_model::Why::default(),
    }
}

/// Ground, a wall, two rods, or one and a crate.
fn scene(has_rod: bool, has_crate: bool) -> Vec<Gaussian> {
    let steps = |count: u32, step: f64| (0..count).map(move |i| f64::from(i) * step);
    let mut places = Vec::new();
    for x in steps(80, 0.1) {
        places.extend(steps(60, 0.1).map(|y| DVec3::new(x, y, -5.0)));
        places.extend(steps(40, 0.08).map(|up| DVec3::new(x, 6.0, up - 5.0)));
    }
    let rods = [2.0, 5.0].iter().take(if has_rod { 2 } else { 1 });
    for x in rods {
        places.extend(steps(120, 0.025).map(|up| DVec3::new(*x, 2.0, up - 5.0)));
    }
    if has_crate {
        for a in steps(12, 0.05) {
            places.extend(steps(12, 0.05).map(|b| DVec3::new(1.0 + a, 4.0 + b, -4.4)));
            places.extend(steps(12, 0.05).map(|b| DVec3::new(1.0, 4.0 + a, -5.0 + b)));
        }
    }
    places.into_iter().map(gaussian).collect()
}

fn write(path: &str, gaussians: &[Gaussian]) {
    let written = write_map(
        path.as_ref(),
        DVec3::ZERO,
        1.0,
        gaussians,
        &MapNotes::default(),
    );
    written.expect("the test's own folder can be written to");
}

/// Pixels of the picture that are much greener, redder, and neither.
const COLORS: &str = r#"(() => {
  viewer.lit();
  const { bytes } = viewer.renderer.pixels();
  const count = { green: 0, red: 0, grey: 0 };
  for (let i = 0; i < bytes.length; i += 4) {
    const [r, g, b] = bytes.subarray(i, i + 3);
    if (g > r + 25 && g > b + 15) count.green += 1;
    else if (r > g + 40 && r > b + 25) count.red += 1;
    else if (Math.max(r, g, b) < 190 && Math.max(r, g, b) - Math.min(r, g, b) < 25) count.grey += 1;
  }
  return count;
})()"#;

#[test]
fn what_changed_is_coloured_on_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    write(&path("before.ply"), &scene(true, false));
    write(&path("after.ply"), &scene(false, true));
    let out = path("changes.html");
    let told = done(&[
        "compare",
        &path("before.ply"),
        &path("after.ply"),
        "--out",
        &out,
        "--json",
    ]);
    let told: Value = told.only_json();
    let kinds: Vec<&str> = told["changes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| c["kind"].as_str().unwrap())
        .collect();
    assert_eq!(kinds, ["came", "went"], "{told}");
    let html = fs::read_to_string(&out).unwrap();
    for part in [
        "<h2>Plan</h2>",
        "moved from here",
        "class=\"number\"",
        ">came<",
        ">went<",
    ] {
        assert!(html.contains(part), "{part}");
    }
    let Some(program) = chromium() else {
        return say("passed over: changes in colours, since no Chromium was found");
    };
    let mut browser = Browser::start(&program);
    browser.size(1280, 800);
    open(&mut browser, out.as_ref());
    assert_eq!(browser.evaluate("viewer.state.mode"), "change");
    let colors = browser.evaluate(COLORS);
    let count = |name: &str| colors[name].as_u64().unwrap();
    assert!(
        count("green") > 50 && count("red") > 20 && count("grey") > 1000,
        "{colors}"
    );
}
