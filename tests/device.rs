//! `echosplat emulate` is the device for the vendor's public client, over each kind of link.

use std::time::Duration;

use crate::harness::{Program, free_port};
use crate::python::tool;

const READY: Duration = Duration::from_secs(60);
const PROFILE_COUNT: u64 = 1000;

/// Emulates at `rate` times real time behind `url` and lets the vendor's client judge.
fn drive(url: &str, rate: &str) {
    let mut emulated = Program::echosplat(&["emulate", "--listen", url, "--rate", rate]);
    emulated.wait_for_text("listening", READY);
    let count = PROFILE_COUNT.to_string();
    let mut client = tool(
        "drive_emulate.py",
        &[url, "--count", &count, "--timeout", "100"],
    );
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
    assert_eq!(result["frames_bad"], 0);
    emulated.terminate();
    emulated.wait_exit_code(0, Duration::from_secs(10));
}

#[test]
fn the_vendors_client_loses_nothing_over_tcp() {
    drive(&format!("tcp://127.0.0.1:{}", free_port()), "0");
}

#[test]
fn the_vendors_client_loses_nothing_over_udp() {
    // UDP has no back-pressure: at a pace that the client keeps up with.
    drive(&format!("udp://127.0.0.1:{}", free_port()), "2");
}

#[test]
fn the_vendors_client_loses_nothing_over_a_serial_line() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("sonar");
    drive(&format!("serial://{}", link.display()), "0");
}
