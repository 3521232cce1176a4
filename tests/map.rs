//! The Python subscriber receives the map of a running service.

use std::fs;
use std::time::Duration;

use crate::harness::{Program, bus_at, free_port, wait_until_listening};
use crate::python::tool;

const LONG: Duration = Duration::from_secs(120);

#[test]
fn the_python_subscriber_ends_with_the_map_of_the_service() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let simulate = [
        "simulate",
        "--scene",
        "fence",
        "--duration",
        "40",
        "--out",
        &path(""),
    ];
    Program::echosplat(&simulate).wait_exit_code(0, LONG);

    let port = free_port();
    let (log, poses) = (path("dive.svlog"), path("dive.tum"));
    let mut replay = vec!["replay", &log, "--poses", &poses, "--rate", "5", "--json"];
    // Under the name that the subscriber looks for.
    replay.extend(["--publish", "--node", "vehicle"]);
    let bus = bus_at(port);
    replay.extend(bus.iter().map(String::as_str));
    let mut service = Program::echosplat(&replay);
    wait_until_listening(&mut service, port);
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
