//! The Python subscriber and Rerun receive the map of a running service.

use std::fs;
use std::path::Path;
use std::time::Duration;

use crate::harness::{Program, bus_at, free_port, wait_until_listening};
use crate::python::{TOOLS, reader, tool};

const LONG: Duration = Duration::from_secs(120);

/// A dive of 40 s being replayed at five times its rate and published under the name that the tools
/// look for.
fn published_dive(folder: &Path, port: u16) -> Program {
    let path = |name: &str| folder.join(name).display().to_string();
    let out = path("");
    let simulate = [
        "simulate",
        "--scene",
        "fence",
        "--duration",
        "40",
        "--out",
        &out,
    ];
    Program::echosplat(&simulate).wait_exit_code(0, LONG);
    let (log, poses) = (path("dive.svlog"), path("dive.tum"));
    let mut replay = vec!["replay", &log, "--poses", &poses, "--rate", "5", "--json"];
    replay.extend(["--publish", "--node", "vehicle"]);
    let bus = bus_at(port);
    replay.extend(bus.iter().map(String::as_str));
    let mut service = Program::echosplat(&replay);
    wait_until_listening(&mut service, port);
    service
}

#[test]
fn rerun_is_shown_the_map_of_the_service() {
    let folder = tempfile::tempdir().unwrap();
    let saved = folder.path().join("live.rrd").display().to_string();
    // Made before the dive begins, which is over in ten seconds.
    reader("-c", &["import rerun, zenoh"]).wait_exit_code(0, LONG);
    let port = free_port();
    let mut service = published_dive(folder.path(), port);
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let mut shown = reader("live_rerun.py", &["--connect", &endpoint, "--save", &saved]);
    service.wait_exit_code(0, LONG);
    shown.wait_exit_code(0, LONG);

    let print = "import pathlib, subprocess, sys\n\
                 rerun = pathlib.Path(sys.executable).with_name('rerun')\n\
                 subprocess.run([rerun, 'rrd', 'print', sys.argv[1]], check=True)";
    let mut printed = reader("-c", &[print, &saved]);
    printed.wait_exit_code(0, LONG);
    let held = printed.stdout() + &printed.stderr();
    for entity in ["/map/confident/", "/map/ambiguous/"] {
        assert!(held.contains(entity), "{entity} is not in {held}");
    }
}

#[test]
fn the_python_subscriber_ends_with_the_map_of_the_service() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let port = free_port();
    let mut service = published_dive(folder.path(), port);
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let saved = path("map.npy");
    let arguments = ["--connect", &endpoint, "--save", &saved];
    let mut subscriber = tool("subscriber.py", &arguments);

    service.wait_exit_code(0, LONG);
    subscriber.wait_exit_code(0, LONG);
    let result = service.only_json();
    let published = count(&result["gaussians"]) + count(&result["ambiguous"]);
    assert!(published > 0, "{}", service.account());
    let received = counts_printed(&subscriber.stdout());
    assert_eq!(
        received.last(),
        Some(&published),
        "{}",
        subscriber.account()
    );
    assert!(
        received.iter().any(|&count| count != published),
        "the map was seen to grow"
    );
    assert!(fs::metadata(saved).unwrap().len() > 64 * published);
}

/// What a tool says where no service is, and where one is under another key.
fn without_a_map(mut alone: Program, mut beside_another: Program) {
    alone.wait_exit_code(1, LONG);
    let said = alone.stderr();
    assert!(
        said.contains("no service answers at"),
        "{}",
        alone.account()
    );
    assert!(
        said.lines().count() == 1,
        "one sentence\n{}",
        alone.account()
    );
    beside_another.wait_for_text("listening to echosplat/elsewhere/map", LONG);
    beside_another.wait_for_text("nothing new from echosplat/elsewhere/map", LONG);
}

#[test]
fn python_tools_say_what_they_listen_to_and_that_nothing_comes() {
    let (nobody, port) = (free_port(), free_port());
    let bus = bus_at(port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let mut service =
        Program::echosplat(&[&["run", "--sonar", "tcp://127.0.0.1:9"][..], &bus].concat());
    wait_until_listening(&mut service, port);
    let at = |port: u16| format!("tcp/127.0.0.1:{port}");
    let (nobody, there) = (at(nobody), at(port));
    let folder = tempfile::tempdir().unwrap();
    let saved = folder.path().join("saved").display().to_string();
    let alone = ["--connect", &nobody, "--save", &saved];
    let beside = [
        "--connect",
        &there,
        "--save",
        &saved,
        "--key",
        "echosplat/elsewhere/map",
    ];
    without_a_map(
        tool("subscriber.py", &alone),
        tool("subscriber.py", &beside),
    );
    without_a_map(
        reader("live_rerun.py", &alone),
        reader("live_rerun.py", &beside),
    );
}

#[test]
fn the_subscriber_is_as_short_as_the_readme_says() {
    let script = fs::read_to_string(format!("{TOOLS}/subscriber.py")).unwrap();
    assert!(script.lines().count() < 60);
}

fn count(value: &serde_json::Value) -> u64 {
    value
        .as_u64()
        .unwrap_or_else(|| panic!("{value} is no count"))
}

/// The first word of each line.
fn counts_printed(stdout: &str) -> Vec<u64> {
    let words = stdout.lines().filter_map(|line| line.split(' ').next());
    words.filter_map(|word| word.parse().ok()).collect()
}
