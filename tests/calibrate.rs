//! A time offset that is off is found from a log and its poses alone.

use std::fs;
use std::path::Path;
use std::time::Duration;

use crate::dive::file;
use crate::harness::Program;

const LONG: Duration = Duration::from_secs(240);

fn calibrate(more: &[&str]) -> Program {
    let (log, poses) = (file("dive.svlog"), file("dive.tum"));
    let mut arguments = vec!["calibrate", &log, "--poses", &poses, "--only", "time"];
    arguments.extend(more);
    Program::echosplat(&arguments)
}

#[test]
fn a_time_offset_that_is_off_is_found() {
    let config = Path::new(env!("CARGO_TARGET_TMPDIR")).join("calibrate.toml");
    fs::write(&config, "[pose]\ntime_offset_s = -0.25\n").expect("a file of ours");
    let config = config.display().to_string();
    let mut program = calibrate(&["--config", &config, "--json"]);
    program.wait_exit_code(0, LONG);
    let said = program.only_json();
    let found = &said["parameters"][0];
    assert_eq!(found["parameter"], "time");
    assert_eq!(found["configured"], -0.25);
    assert_eq!(found["verdict"], "off", "{found}");
    // So short a dive tells no better.
    let fits_s = found["fits"].as_f64();
    assert!(fits_s.is_some_and(|fits_s| fits_s.abs() < 0.1), "{found}");
}

#[test]
fn poses_of_another_time_are_no_verdict() {
    let config = Path::new(env!("CARGO_TARGET_TMPDIR")).join("calibrate-late.toml");
    fs::write(&config, "[pose]\ntime_offset_s = 5000.0\n").expect("a file of ours");
    let mut program = calibrate(&["--config", &config.display().to_string()]);
    program.wait_exit_code(2, LONG);
    let error = program.stderr();
    assert!(error.contains("have a pose"), "{error}");
}

/// What a replay says of two minutes of a simulated dive in which this is off.
fn told(name: &str, disturbance: &str) -> serde_json::Value {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let out = directory.display().to_string();
    let dive = ["simulate", "--duration", "125", "--out", &out];
    let dive = [&dive[..], &["--disturb", disturbance]].concat();
    Program::echosplat(&dive).wait_exit_code(0, LONG);
    let of = |name: &str| directory.join(name).display().to_string();
    let (log, poses) = (of("dive.svlog"), of("dive.tum"));
    let mut program = Program::echosplat(&["replay", &log, "--poses", &poses, "--json"]);
    program.wait_exit_code(0, LONG);
    program.only_json()
}

/// Whether a notice of this code has these words.
fn has_notice(said: &serde_json::Value, code: &str, words: &str) -> bool {
    let notices = said["notices"].as_array().expect("notices");
    let notice = notices.iter().find(|notice| notice["code"] == code);
    let sentence = notice.and_then(|notice| notice["sentence"].as_str());
    sentence.is_some_and(|sentence| sentence.contains(words))
}

#[test]
fn late_poses_are_told_in_the_status_and_as_a_notice() {
    let said = told("late-dive", "pose_latency_s=0.06");
    let found = &said["calibration"];
    let late_ms = found["time_offset_ms"]["value"].as_f64();
    let is_near = |late_ms: f64| (late_ms - 60.0).abs() < 15.0;
    assert!(late_ms.is_some_and(is_near), "{found}");
    assert_eq!(found["mount_yaw_deg"]["is_believed"], false, "{found}");
    let words = "pose.time_offset_s = 0.0";
    assert!(has_notice(&said, "pose-clock", words), "{said}");
}

#[test]
fn a_compass_that_deviates_is_told_in_the_status_and_as_a_notice() {
    let said = told("compass-dive", "compass_b_deg=4");
    let found = &said["calibration"];
    let cosine_deg = found["compass_cosine_deg"]["value"].as_f64();
    let is_near = |cosine_deg: f64| (cosine_deg + 4.0).abs() < 1.0;
    assert!(cosine_deg.is_some_and(is_near), "{found}");
    assert_eq!(
        found["sound_speed_percent"]["is_believed"], false,
        "{found}"
    );
    let words = "pose.compass_deviation_deg = [";
    assert!(has_notice(&said, "pose-compass", words), "{said}");
}

/// A configuration file with the sonar mounted so.
fn mounted(name: &str, yaw_pitch_roll_deg: [f64; 3]) -> String {
    let config = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let mount =
        format!("[pose.vehicle_from_sensor]\nyaw_pitch_roll_deg = {yaw_pitch_roll_deg:?}\n");
    fs::write(&config, mount).expect("a file of ours");
    config.display().to_string()
}

#[test]
fn a_mount_that_is_off_by_tens_of_degrees_is_found_whole() {
    let config = mounted("calibrate-yaw.toml", [20.0, 0.0, 0.0]);
    let (log, poses) = (file("dive.svlog"), file("dive.tum"));
    let asked = ["calibrate", &log, "--poses", &poses, "--config", &config];
    let mut program = Program::echosplat(&[&asked[..], &["--only", "yaw", "--json"]].concat());
    program.wait_exit_code(0, LONG);
    let said = program.only_json();
    let found = &said["parameters"][0];
    assert_eq!(found["verdict"], "off", "{found}");
    let fits_deg = found["fits"].as_f64();
    assert!(
        fits_deg.is_some_and(|fits_deg| fits_deg.abs() < 1.0),
        "{found}"
    );
    assert!(
        found["sigma"].as_f64().is_some_and(|sigma| sigma < 1.0),
        "{found}"
    );
}

#[test]
fn a_mount_that_is_tilted_by_20_degrees_is_told_while_the_dive_is_mapped() {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("tilted-dive");
    let out = directory.display().to_string();
    let dive = ["simulate", "--duration", "90", "--out", &out];
    Program::echosplat(&dive).wait_exit_code(0, LONG);
    let of = |name: &str| directory.join(name).display().to_string();
    let (log, poses) = (of("dive.svlog"), of("dive.tum"));
    let config = mounted("tilted.toml", [0.0, 20.0, 0.0]);
    let asked = [
        "replay", &log, "--poses", &poses, "--config", &config, "--json",
    ];
    let mut program = Program::echosplat(&asked);
    program.wait_exit_code(3, LONG);
    let said = program.only_json();
    assert!(
        has_notice(&said, "pose-mount", "echosplat calibrate"),
        "{said}"
    );
}
