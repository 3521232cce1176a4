//! What is drawn, pixel by pixel: the live page's renderer against a picture that is kept, and the view of
//! the map in a report that is opened from a disk.

use std::path::Path;
use std::time::Duration;

use serde_json::json;

use crate::browser::{Browser, chromium, say, serve};
use crate::dive::replay;
use crate::harness::{Program, free_port};

const LONG: Duration = Duration::from_secs(120);
const REFERENCE: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../tests/page-reference.txt"
);
/// Names the file anew in place of comparing with it.
const RENEW: &str = "ECHOSPLAT_RENEW_REFERENCE";
/// Of 255, between two means of 8 × 8 pixels: cards and drivers round differently.
const CELL_TOLERANCE: i32 = 12;
/// Share of cells that may be further off: edges of ellipsoids.
const MOST_OFF: f64 = 0.01;

/// Sixty ellipsoids on a winding line, every fourth ambiguous, beside a grid; means of 8 × 8 pixels as hex,
/// a line for each row.
const FIXED_SCENE: &str = r#"(async () => {
  const e = echosplat;
  const { Tile } = await import("./map.js");
  const tiles = new Map();
  const points = new Float32Array(16);
  const words = new Uint32Array(points.buffer);
  for (let i = 0; i < 60; i += 1) {
    const place = [2 * Math.cos(i * 0.3), 2 * Math.sin(i * 0.3), i * 0.05 - 1.5];
    const turn = [Math.cos(i * 0.2), 0, Math.sin(i * 0.2), 0];
    points.set([...place, 0, i, 0.8, 0.25, 0.12, 0.05, ...turn, 0.1 + i / 100, 0.02 + i / 1000, 0]);
    words[15] = i % 4 ? 1 : 0;
    const name = place.map((x) => Math.floor(x / 4)).join("_");
    if (!tiles.has(name)) tiles.set(name, new Tile(name));
    tiles.get(name).put(i, points, 0, 0);
  }
  e.past.keep = () => {};
  e.state.at = 1e9;
  e.past.moments = [{ diveS: 0, tiles: [...tiles.values()], originM: [0, 0, 0] }];
  e.past.poses = [];
  Object.assign(e.state, { pose: null, hasFitted: true, extent: 1.6, mode: "height", summary: null, summaryAt: 0 });
  Object.assign(e.state.shows, { ambiguous: true, track: false, fan: false, grid: true, lighting: true });
  e.renderer.scale = 1;
  Object.assign(e.camera, { targetM: [0, 0, 0], yaw: -1.1, pitch: 0.45, distanceM: 9, goal: null });
  e.renderer.canvas.style.cssText = "position: fixed; width: 640px; height: 480px";
  e.lit();
  const { width, height, bytes } = e.renderer.pixels();
  const rows = [];
  for (let y = height / 8 - 1; y >= 0; y -= 1) {
    let row = "";
    for (let x = 0; x < width / 8; x += 1) {
      for (let c = 0; c < 3; c += 1) {
        let sum = 0;
        for (let p = 0; p < 64; p += 1) sum += bytes[4 * ((8 * y + (p >> 3)) * width + 8 * x + (p & 7)) + c];
        row += Math.round(sum / 64).toString(16).padStart(2, "0");
      }
    }
    rows.push(row);
  }
  return rows.join("\n") + "\n";
})()"#;

fn bytes_of(picture: &str) -> Vec<i32> {
    let rows = picture.lines();
    let byte = |row: &str, at: usize| i32::from_str_radix(&row[at..at + 2], 16).expect("it is hex");
    let values = rows.flat_map(|row| (0..row.len()).step_by(2).map(move |at| byte(row, at)));
    values.collect()
}

#[test]
fn the_page_draws_as_it_did_and_a_ping_reaches_the_screen() {
    let Some(program) = chromium() else {
        return say("passed over: pictures of the page, since no Chromium was found");
    };
    let port = free_port();
    let mut browser = Browser::start(&program);
    let mut service = serve(port, "1");
    browser.size(1280, 800);
    browser.call(
        "Page.navigate",
        &json!({ "url": format!("http://127.0.0.1:{port}/") }),
    );

    browser.wait("the final map", "echosplat.stats().isFinal");
    let stats = browser.evaluate("echosplat.stats()");
    say(&format!(
        "from a ping sent to the page to a map that holds it drawn, ms: {}",
        stats["pingToScreenMs"]
    ));
    assert!(
        stats["pingToScreenMs"]["count"].as_u64() > Some(20),
        "{stats}"
    );

    let drawn = browser.evaluate(FIXED_SCENE);
    let drawn = drawn.as_str().unwrap();
    if std::env::var_os(RENEW).is_some() {
        std::fs::write(REFERENCE, drawn).unwrap();
    }
    let (drawn, kept) = (
        bytes_of(drawn),
        bytes_of(&std::fs::read_to_string(REFERENCE).unwrap()),
    );
    assert_eq!(drawn.len(), kept.len(), "of another size");
    let off = drawn
        .iter()
        .zip(&kept)
        .filter(|(a, b)| (*a - *b).abs() > CELL_TOLERANCE)
        .count();
    let share = off as f64 / drawn.len() as f64;
    assert!(
        share < MOST_OFF,
        "{off} of {} means are off; {RENEW}=1 keeps the new picture",
        drawn.len()
    );
    // What is compared shows something: a hundred cells and more differ from the ground at the first corner.
    let lit = kept
        .chunks(3)
        .filter(|cell| cell.iter().zip(&kept).any(|(a, b)| (a - b).abs() > 40));
    assert!(lit.count() > 100);
    service.interrupt();
    service.wait_exit(LONG);
}

#[test]
fn the_map_in_a_report_is_drawn_from_a_disk() {
    let Some(program) = chromium() else {
        return say("passed over: the map in a report, since no Chromium was found");
    };
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().join("dive.html");
    let arguments = replay(&["--json", "--report", &report.display().to_string()]);
    Program::echosplat(&arguments).wait_exit_code(0, LONG);
    let mut browser = Browser::start(&program);
    browser.size(1280, 800);
    open(&mut browser, &report);
    let drawn = browser.evaluate("viewer.lit()");
    let share = drawn["lit"].as_f64().unwrap() / drawn["total"].as_f64().unwrap();
    assert!((0.005..0.9).contains(&share), "{drawn}");
    let before = browser.evaluate("viewer.camera.yaw");
    browser.evaluate("document.querySelector('[data-view=east]').click()");
    browser.wait(
        "another side",
        &format!("viewer.camera.goal === null && viewer.camera.yaw !== {before}"),
    );
    let size = std::fs::metadata(&report).unwrap().len();
    say(&format!(
        "a report of {size} bytes, {drawn} pixels of its map lit"
    ));
    assert!(size < 2_500_000);

    // On a phone nothing is wider than the screen but what scrolls in its own box.
    browser.size(390, 844);
    browser.wait(
        "a narrow page",
        "innerWidth === 390 && document.documentElement.scrollWidth <= 390",
    );

    // Where nothing can be drawn the flat pictures stand there, and it is said.
    let without = "HTMLCanvasElement.prototype.getContext = () => null";
    browser.call(
        "Page.addScriptToEvaluateOnNewDocument",
        &json!({ "source": without }),
    );
    browser.call("Page.enable", &json!({}));
    browser.call("Page.reload", &json!({}));
    browser.wait(
        "the notice",
        "document.getElementById('no-viewer').innerText.includes('three sides')",
    );
    let flat = browser.evaluate(
        "document.getElementById('viewer').offsetHeight === 0 && document.getElementById('flat').offsetHeight > 200",
    );
    assert_eq!(flat, true);
}

fn open(browser: &mut Browser, report: &Path) {
    browser.call(
        "Page.navigate",
        &json!({ "url": format!("file://{}", report.display()) }),
    );
    browser.wait(
        "the viewer",
        "viewer.tiles.length > 0 && viewer.renderer !== null",
    );
}
