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

#[test]
fn late_poses_are_told_in_the_status_and_as_a_notice() {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("late-dive");
    let out = directory.display().to_string();
    let late = ["simulate", "--duration", "125", "--out", &out];
    let late = [&late[..], &["--disturb", "pose_latency_s=0.06"]].concat();
    Program::echosplat(&late).wait_exit_code(0, LONG);
    let of = |name: &str| directory.join(name).display().to_string();
    let (log, poses) = (of("dive.svlog"), of("dive.tum"));
    let mut program = Program::echosplat(&["replay", &log, "--poses", &poses, "--json"]);
    program.wait_exit_code(0, LONG);
    let said = program.only_json();
    let found = &said["calibration"];
    let late_ms = found["time_offset_ms"]["value"].as_f64();
    let is_near = |late_ms: f64| (late_ms - 60.0).abs() < 15.0;
    assert!(late_ms.is_some_and(is_near), "{found}");
    assert_eq!(found["mount_yaw_deg"]["is_believed"], false, "{found}");
    let notices = said["notices"].as_array().expect("notices");
    let sentence = notices.iter().find(|notice| notice["code"] == "pose-clock");
    let sentence = sentence.and_then(|notice| notice["sentence"].as_str());
    assert!(
        sentence.is_some_and(|said| said.contains("pose.time_offset_s = 0.0")),
        "{notices:?}"
    );
}
