//! `echosplat emulate` is the device for the vendor's public client, over each kind of link.

use std::time::Duration;

use crate::harness::{Program, free_port};
use crate::python::tool;

const READY: Duration = Duration::from_secs(60);
const PROFILE_COUNT: u64 = 1000;

/// As fast as the client takes it; a dive little longer than it wants, since it takes all.
const FAST: [&str; 4] = ["--rate", "0", "--duration", "20"];
/// UDP tells nothing of a client that is behind: at the pace of a real unit.
const REAL_TIME: [&str; 2] = ["--rate", "1"];

/// Emulates with these arguments behind `url` and lets the vendor's client judge.
fn drive(url: &str, pace: &[&str]) {
    let mut emulated = Program::echosplat(&[&["emulate", "--listen", url], pace].concat());
    emulated.wait_for_text("listening", READY);
    let count = PROFILE_COUNT.to_string();
    let arguments = [url, "--count", &count, "--timeout", "100"];
    let mut client = tool("drive_emulate.py", &arguments);
    client.wait_exit(Duration::from_secs(150));
    let result = client.json();
    assert_eq!(
        result["passed"],
        true,
        "{}\n{}",
        client.account(),
        emulated.account()
    );
    assert_eq!(result["profiles"], PROFILE_COUNT);
    assert_eq!(result["profiles_missing"], 0);
    emulated.terminate();
    emulated.wait_exit_code(0, Duration::from_secs(10));
    let seen = emulated.only_json();
    assert_eq!(
        (&seen["enables"], &seen["disables"]),
        (&1.into(), &1.into())
    );
    assert_eq!(seen["is_pinging"], false);
}

#[test]
fn the_vendors_client_loses_nothing_over_tcp() {
    drive(&format!("tcp://127.0.0.1:{}", free_port()), &FAST);
}

#[test]
fn the_vendors_client_loses_nothing_over_udp() {
    drive(&format!("udp://127.0.0.1:{}", free_port()), &REAL_TIME);
}

#[test]
fn the_vendors_client_loses_nothing_over_a_serial_line() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("sonar");
    drive(&format!("serial://{}", link.display()), &FAST);
}
