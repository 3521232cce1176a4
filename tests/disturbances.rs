//! What the water adds to a simulated dive, from the command line to a replay.

use std::fs;
use std::path::Path;
use std::time::Duration;

use crate::dive::PING_COUNT;
use crate::harness::Program;

const LONG: Duration = Duration::from_secs(120);

const ALL: [&str; 13] = [
    "copy_offset_m=1.3",
    "multiple_ratio=1.7",
    "spikes=3",
    "walker_mps=0.5",
    "fish=3",
    "surface_m=4",
    "saturated_share=0.2",
    "sound_error=0.01",
    "sound_drift=0.005",
    "pose_latency_s=0.03",
    "mount_yaw_deg=2",
    "mount_roll_deg=-1",
    "compass_b_deg=2",
];

fn simulate(out: &Path, pairs: &[&str]) {
    let out = out.display().to_string();
    let disturb = pairs.iter().flat_map(|pair| ["--disturb", pair]);
    let own = ["simulate", "--duration", "24", "--out", &out];
    let arguments: Vec<&str> = own.into_iter().chain(disturb).collect();
    Program::echosplat(&arguments).wait_exit_code(0, LONG);
}

#[test]
fn a_dive_with_all_of_them_says_so_and_replays() {
    let folder = tempfile::tempdir().unwrap();
    let (one, again) = (folder.path().join("one"), folder.path().join("again"));
    simulate(&one, &ALL);
    simulate(&again, &ALL);
    for file in ["dive.svlog", "dive.tum", "dive.toml"] {
        let bytes = |dive: &Path| fs::read(dive.join(file)).unwrap();
        assert!(bytes(&one) == bytes(&again), "{file}");
        let plain = crate::dive::dive().join(file);
        assert!(bytes(&one) != fs::read(plain).unwrap(), "{file}");
    }
    let text = fs::read_to_string(one.join("dive.toml")).unwrap();
    let told = |key: &str| {
        let mut lines = text.lines().filter_map(|line| line.split_once(" = "));
        let (_, value) = lines.find(|(name, _)| *name == key)?;
        value.split(" #").next()
    };
    assert_eq!(told("scene"), Some("\"fence\""));
    let number = |text: &str| text.parse::<f64>().ok();
    for pair in ALL {
        let (key, value) = pair.split_once('=').unwrap();
        assert_eq!(told(key).and_then(number), number(value), "{pair}: {text}");
    }

    let file = |name: &str| one.join(name).display().to_string();
    let (log, poses) = (file("dive.svlog"), file("dive.tum"));
    let replay = ["replay", &log, "--poses", &poses, "--json", "--no-publish"];
    let mut program = Program::echosplat(&replay);
    program.wait_exit_code(0, LONG);
    let summary = program.only_json();
    assert_eq!(summary["pings_received"], PING_COUNT, "{summary}");
    assert_eq!(summary["frames_bad"], 0, "{summary}");
}
