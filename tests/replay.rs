//! A replay is the same to the last bit, says what it did, and makes the best of a damaged log.

use std::fs;
use std::time::Duration;

use serde_json::Value;

use crate::dive::{PING_COUNT, file, replay};
use crate::harness::{Program, bus_at, free_port};

const LONG: Duration = Duration::from_secs(120);

/// Replays to the end; what it printed.
fn run(arguments: &[String], code: i32) -> Value {
    let mut program = Program::echosplat(arguments);
    program.wait_exit_code(code, LONG);
    program.only_json()
}

#[test]
fn one_thread_and_two_published_or_not_give_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let map = |name: &str| folder.path().join(name).display().to_string();
    let of = |name: &str, more: &[&str]| {
        let map = map(name);
        let arguments = replay(&[&["--json", "--map", &map], more].concat());
        run(&arguments, 0)
    };
    let first = of("a.ply", &["--threads", "1", "--no-publish"]);
    of("b.ply", &["--threads", "2", "--no-publish"]);
    let bus = bus_at(free_port());
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    of(
        "c.ply",
        &[&["--threads", "2", "--publish"], bus.as_slice()].concat(),
    );
    for kind in ["ply", "ambiguous.ply"] {
        let bytes = |name| fs::read(map(&format!("{name}.{kind}"))).unwrap();
        assert_eq!(bytes("a"), bytes("b"), "threads change {kind}");
        assert_eq!(bytes("a"), bytes("c"), "publishing changes {kind}");
    }
    let published = first["gaussians"].as_u64().unwrap() + first["ambiguous"].as_u64().unwrap();
    assert!(published > 0, "a map of something: {first}");
}

#[test]
fn a_finished_map_alone_is_as_near_for_less_work_and_nothing_else_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let (truth, maps) = (file(""), folder.path().join("maps").display().to_string());
    let judged = |name: &str, more: &[&str]| {
        let map = folder.path().join(name).display().to_string();
        let arguments = ["--json", "--map", &map, "--truth", &truth];
        run(&replay(&[&arguments, more].concat()), 0)
    };
    let (live, finished) = (judged("a.ply", &[]), judged("b.ply", &["--finished-only"]));
    let of = |summary: &Value, key: &str| summary[key].as_f64().unwrap();
    assert!(of(&finished, "gaussians") > 0.8 * of(&live, "gaussians"));
    assert!(of(&finished, "pairs") < 0.9 * of(&live, "pairs"));
    let cd_m = |summary: &Value| of(&summary["metrics"], "cd_m");
    assert!(cd_m(&finished) < 1.1 * cd_m(&live), "{finished}");
    for more in [&["--publish"][..], &["--maps-every", "5", &maps]] {
        let arguments = replay(&[&["--finished-only"], more].concat());
        let mut program = Program::echosplat(&arguments);
        program.wait_exit_code(2, LONG);
        let said = program.stderr();
        assert!(said.contains("cannot be used with"), "{said}");
    }
}

#[test]
fn every_ping_is_accounted_for() {
    let summary = run(&replay(&["--json", "--no-publish"]), 0);
    assert_eq!(summary["pings_received"], PING_COUNT);
    assert_eq!(summary["pings_mapped"], PING_COUNT);
    assert_eq!(summary["pings_without_pose"], 0);
    assert_eq!(summary["frames_bad"], 0);
    assert_eq!(summary["bytes_skipped"], 0);
    for field in ["compute_s", "wall_s", "peak_memory_bytes"] {
        assert!(summary[field].as_f64().unwrap() > 0.0, "{field}: {summary}");
    }
    let part = run(
        &replay(&["--json", "--no-publish", "--start", "2", "--duration", "3"]),
        0,
    );
    assert_eq!(part["pings_mapped"], 120);
    assert_eq!(part["pings_before_start"], 80);
}

#[test]
fn a_part_of_the_log_that_holds_nothing_is_refused() {
    let told = |more: &[&str]| {
        let arguments = replay(&[&["--no-publish"], more].concat());
        let mut program = Program::echosplat(&arguments);
        program.wait_exit_code(2, LONG);
        program.stderr()
    };
    let late = told(&["--start", "1e9"]);
    assert!(late.contains("--start 1000000000: all pings of"), "{late}");
    let turned = told(&["--start", "5", "--end", "5"]);
    assert!(turned.contains("nothing lies between"), "{turned}");
}

#[test]
fn a_cut_log_is_mapped_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let whole = fs::read(file("dive.svlog")).unwrap();
    let frame_bytes = 62 + 1200;
    let cut = &whole[..whole.len() - 10 * frame_bytes - frame_bytes / 2];
    fs::write(path("cut.svlog"), cut).unwrap();
    let (log, poses, map) = (path("cut.svlog"), file("dive.tum"), path("map.ply"));
    let arguments = ["replay", &log, "--poses", &poses, "--map", &map];
    let arguments = [&arguments[..], &["--json", "--no-publish"]].concat();
    let arguments: Vec<String> = arguments.iter().map(ToString::to_string).collect();
    let summary = run(&arguments, 3);
    assert_eq!(summary["pings_received"], PING_COUNT - 11);
    assert!(summary["bytes_skipped"].as_u64().unwrap() > 0);
    assert!(fs::metadata(map).unwrap().len() > 0);
}

#[test]
fn what_simulate_leaves_is_a_truth_to_evaluate_by() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply").display().to_string();
    let dive = file("");
    run(&replay(&["--json", "--no-publish", "--map", &map]), 0);
    let evaluate = |truth: &str| {
        let mut program = Program::echosplat(&["evaluate", &map, "--truth", truth, "--json"]);
        program.wait_exit_code(0, LONG);
        program.only_json()
    };
    let seen = evaluate(&dive);
    let whole = evaluate("fence");
    let samples = |metrics: &Value| metrics["truth_sample_count"].as_u64().unwrap();
    assert!(samples(&seen) > 0 && samples(&seen) < samples(&whole));
    assert_eq!(seen["accuracy_m"], whole["accuracy_m"]);
}

#[test]
fn errors_are_told_as_the_dive_goes_on_and_drawn_beside_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply").display().to_string();
    let truth = file("");
    let arguments = replay(&["--no-publish", "--map", &map, "--truth", &truth]);
    let mut program = Program::echosplat(&arguments);
    program.wait_exit_code(0, LONG);
    let stdout = program.stdout();
    let rows: Vec<Vec<&str>> = stdout
        .lines()
        .map(|line| line.split_whitespace().collect())
        .skip_while(|cells: &Vec<&str>| cells.first() != Some(&"dive"))
        .skip(1)
        .take_while(|cells: &Vec<&str>| cells.len() >= 7 && cells[1] != "pings")
        .collect();
    let dive_s: Vec<f64> = rows.iter().map(|row| row[0].parse().unwrap()).collect();
    assert!(rows.len() >= 3 && dive_s.is_sorted(), "{stdout}");
    // The first maps assert nothing.
    assert_eq!(rows[0][2], "0", "{stdout}");
    let last: f64 = rows[rows.len() - 1][4].parse().unwrap();
    assert!(last < 1.5, "{stdout}");
    let report = fs::read_to_string(folder.path().join("map.html")).unwrap();
    assert!(report.contains("<svg") && report.contains("distance from the truth, m"));
    assert!(report.contains("from the truth on average"), "the verdict");
    assert!(!report.contains("://"), "self-contained");
}

#[test]
fn a_report_needs_no_truth_and_says_first_what_came_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().join("dive.html").display().to_string();
    let summary = run(&replay(&["--json", "--report", &report]), 0);
    let html = fs::read_to_string(&report).unwrap();
    let (_, verdict) = html.split_once("class=\"verdict\">").unwrap();
    let (verdict, _) = verdict.split_once("</p>").unwrap();
    let count = summary["gaussians"].as_u64().unwrap();
    assert!(
        verdict.contains(&format!("gave a map of {count} Gaussians")),
        "{verdict}"
    );
    assert!(verdict.contains("nothing went wrong"), "{verdict}");
    assert!(!verdict.contains("truth"), "{verdict}");
    for part in [
        "id=\"map-data\"",
        "<h2>Trajectory</h2>",
        "east, m",
        "asserted",
    ] {
        assert!(html.contains(part), "{part}");
    }
    assert!(!html.contains("://"), "it names another host");
}
