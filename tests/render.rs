//! What a map says a ping measures: held to a second renderer, and to pings kept from the map.

use std::fs;
use std::path::Path;
use std::sync::OnceLock;
use std::time::Duration;

use serde_json::Value;

use crate::dive::{PING_COUNT, file, replay};
use crate::harness::Program;
use crate::python::tool;

const LONG: Duration = Duration::from_secs(120);

/// Every so many-th ping is kept from the map.
const HELD_OUT: u64 = 20;

fn json(arguments: &[&str]) -> Value {
    let mut program = Program::echosplat(arguments);
    program.wait_exit_code(0, LONG);
    program.only_json()
}

/// A map of the short dive, made once.
fn map() -> &'static str {
    static MAP: OnceLock<String> = OnceLock::new();
    MAP.get_or_init(|| {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("render.ply");
        let path = path.display().to_string();
        let more = [
            "--json",
            "--no-publish",
            "--hold-back",
            "20",
            "--map",
            &path,
        ];
        let arguments = replay(&more);
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let summary = json(&arguments);
        let held_out = PING_COUNT / HELD_OUT;
        assert_eq!(summary["pings_held_back"], held_out);
        assert_eq!(summary["pings_mapped"], PING_COUNT - held_out);
        assert_eq!(summary["lossy"], Value::Null);
        // Without a truth, the run itself says how well its map predicts what was kept from it.
        let prediction = &summary["prediction"];
        let gain = prediction["gain_per_bin"].as_f64();
        assert!(gain.is_some_and(|gain| gain > 0.1), "{prediction}");
        path
    })
}

fn intensities(ping: &Value) -> Vec<f64> {
    let bins = ping.as_array().expect("bins");
    bins.iter()
        .map(|bin| bin.as_f64().expect("a number"))
        .collect()
}

fn largest(bins: &[f64]) -> f64 {
    bins.iter().copied().fold(0.0, f64::max)
}

#[test]
fn a_second_renderer_written_from_the_formulas_agrees() {
    let poses = file("dive.tum");
    let all = json(&["render", map(), "--poses", &poses, "--json"]);
    let all = all["pings"].as_array().expect("pings");
    let total = |ping: &Value| intensities(&ping["predicted"]).iter().sum::<f64>();
    let mut loudest: Vec<(usize, f64)> = all.iter().map(total).enumerate().collect();
    loudest.sort_by(|a, b| b.1.total_cmp(&a.1));
    // Loud ones, and some way apart.
    let mut chosen: Vec<usize> = Vec::new();
    for (index, _) in loudest {
        let is_apart = |other: &usize| index.abs_diff(*other) >= 10;
        if chosen.len() < 3 && chosen.iter().all(is_apart) {
            chosen.push(index);
        }
    }
    chosen.sort_unstable();
    let number = |&index: &usize| all[index]["number"].to_string();
    let numbers: Vec<String> = chosen.iter().map(number).collect();
    let numbers: Vec<&str> = numbers.iter().map(String::as_str).collect();
    for more in [&[][..], &["--bins", "200", "--range-m", "12"]] {
        let asked = [&["--poses", &poses, "--ping"], &numbers[..], more].concat();
        let ours = json(&[&["render", map(), "--json"], &asked[..]].concat());
        let mut second = tool("render_ply.py", &[&[map()], &asked[..]].concat());
        second.wait_exit_code(0, LONG);
        let theirs = second.only_json();
        for (index, number) in numbers.iter().enumerate() {
            let ours = intensities(&ours["pings"][index]["predicted"]);
            let theirs = intensities(&theirs["pings"][index]);
            let peak = largest(&theirs);
            assert!(peak > 0.0, "pose {number} sees nothing");
            assert_eq!(ours.len(), theirs.len());
            let errors = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs() / peak);
            let worst = largest(&errors.collect::<Vec<_>>());
            // Kernels round the width of what has a shape to powers of 1.1.
            assert!(
                worst < 0.06,
                "pose {number} {more:?}: {worst:.2e} of the largest"
            );
        }
    }
}

#[test]
fn held_out_pings_are_told_better_by_the_map_than_by_a_constant() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("held.svg").display().to_string();
    let (log, poses, every) = (file("dive.svlog"), file("dive.tum"), HELD_OUT.to_string());
    let dive = ["--log", &log, "--poses", &poses];
    let asked = ["--held-back", &every, "--picture", &picture, "--json"];
    let said = json(&[&["evaluate", map()], &dive[..], &asked].concat());
    let score = &said["held_back"];
    assert_eq!(score["ping_count"], PING_COUNT / HELD_OUT);
    assert_eq!(score["fit_ping_count"], PING_COUNT / HELD_OUT);
    // Little of the fence is known after half a minute: where it is not, L1 says nothing yet.
    assert!(score["gain_per_bin"].as_f64().unwrap() > 0.1, "{score}");
    let drawn = fs::read_to_string(&picture).unwrap();
    assert_eq!(drawn.matches("<image").count(), 2);
    assert!(drawn.contains("measured") && drawn.contains("predicted"));

    let truth = file("");
    let both = [&["evaluate", map(), "--truth", &truth], &dive[..], &asked].concat();
    let both = json(&both);
    assert_eq!(both["held_back"], *score);
    assert!(both["accuracy_m"].is_number());
}

#[test]
fn pings_of_a_log_and_sweeps_become_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (log, poses) = (file("dive.svlog"), file("dive.tum"));
    let (png, svg) = (path("run.png"), path("sweep.svg"));
    let all = ["render", map(), "--poses", &poses, "--json"];
    let run = json(&[&all[..], &["--log", &log, "--out", &png]].concat());
    let pings = run["pings"].as_array().unwrap();
    assert_eq!(pings.len() as u64, PING_COUNT);
    assert!(pings.iter().all(|ping| ping["measured"].is_array()));
    assert_eq!(fs::read(&png).unwrap()[..8], *b"\x89PNG\r\n\x1a\n");
    let swept = [
        "--at",
        "4",
        "--sweep-deg",
        "60",
        "--beams",
        "9",
        "--out",
        &svg,
    ];
    let sweep = json(&[&all[..], &swept].concat());
    let azimuths = sweep["pings"].as_array().unwrap().iter();
    let azimuths: Vec<f64> = azimuths.map(|p| p["across"].as_f64().unwrap()).collect();
    assert_eq!(azimuths.len(), 9);
    assert!((azimuths[0] + azimuths[8]).abs() < 1e-9 && azimuths[0] > azimuths[8]);
    assert!(fs::read_to_string(&svg).unwrap().contains("azimuth"));
    let lonely = [
        "render",
        map(),
        "--poses",
        &poses,
        "--sweep-deg",
        "60",
        "--json",
    ];
    Program::echosplat(&lonely).wait_exit_code(2, LONG);
}
