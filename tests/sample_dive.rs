//! The dive in `examples/sample-dive` gives the map that its page tells of, loosely.

use std::path::PathBuf;
use std::time::Duration;

use crate::harness::Program;

const LONG: Duration = Duration::from_secs(300);
/// Of the folder, so that it stays worth a place in the repository.
const MOST_BYTES: u64 = 2_000_000;

fn folder() -> PathBuf {
    PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../examples/sample-dive"
    ))
}

#[test]
fn the_sample_dive_becomes_a_map_near_its_truth() {
    let path = |name: &str| folder().join(name).display().to_string();
    let out = tempfile::tempdir().unwrap();
    let map = out.path().join("map.ply").display().to_string();
    let mut program = Program::echosplat(&[
        "replay",
        &path("dive.svlog"),
        "--poses",
        &path("poses.tum"),
        "--rate",
        "0",
        "--no-publish",
        "--finished-only",
        "--map",
        &map,
        "--truth",
        &path(""),
        "--json",
    ]);
    program.wait_exit_code(0, LONG);
    let summary = program.only_json();
    assert_eq!(summary["pings_mapped"], 1200);
    assert_eq!(summary["frames_bad"], 0);
    let of = |key: &str| summary["metrics"][key].as_f64().unwrap();
    // 0.044 m, 77 %, none and 1,494 when the dive was made.
    assert!(of("cd_m") < 0.07, "{}", of("cd_m"));
    assert!(of("recall_10cm") > 0.6, "{}", of("recall_10cm"));
    assert!(of("confident_false_share") < 0.01);
    assert!(summary["gaussians"].as_u64().unwrap() > 800, "{summary}");
}

#[test]
fn the_sample_dive_is_small() {
    let sizes = [folder(), folder().join("truth")].map(|folder| {
        let files = std::fs::read_dir(folder).unwrap();
        files
            .map(|file| file.unwrap().metadata().unwrap().len())
            .sum::<u64>()
    });
    assert!(sizes.iter().sum::<u64>() <= MOST_BYTES, "{sizes:?}");
}
