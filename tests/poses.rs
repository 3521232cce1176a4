//! Poses as vehicles send them, by senders that others wrote or in Python, put pings into the map.

use std::time::Duration;

use crate::dive::file;
use crate::fake_sonar::{FakeSonar, profile};
use crate::harness::{Program, bus_at, free_port, wait_until_listening};
use crate::link::newest_count;
use crate::python::tool;

const LONG: Duration = Duration::from_secs(60);

/// A service with poses from `pose`, and a vehicle that sends them as `kind` to `to`, where `{bus}` is
/// the bus's endpoint; pings are mapped.
fn mapped(kind: &str, pose: &str, to: &str) {
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let port = free_port();
    let bus = bus_at(port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let url = sonar.url();
    let own = ["run", "--sonar", &url, "--pose", pose, "--verbose"];
    let mut service = Program::echosplat(&[&own[..], &bus].concat());
    wait_until_listening(&mut service, port);
    let to = to.replace("{bus}", &format!("tcp/127.0.0.1:{port}"));
    let poses = file("dive.tum");
    let _vehicle = tool(
        "send_poses.py",
        &["--as", kind, "--to", &to, "--now", &poses],
    );
    service.wait_for("pings in the map", LONG, |service| {
        newest_count(&service.stderr(), "pings_mapped").filter(|&count| count > 40)
    });
    service.interrupt();
    service.wait_exit(Duration::from_secs(10));
}

#[test]
fn a_string_put_on_the_bus_as_the_documents_show() {
    mapped("json", "zenoh://", "{bus}");
}

#[test]
fn odometry_as_rosbags_writes_it() {
    mapped("odometry", "zenoh://", "{bus}");
}

#[test]
fn an_autopilot_over_udp() {
    let port = free_port();
    let url = format!("mavlink+udp://127.0.0.1:{port}");
    mapped("mavlink-udp", &url, &format!("127.0.0.1:{port}"));
}

#[test]
fn an_autopilot_behind_a_mavlink_server() {
    mapped("mavlink-json", "mavlink+zenoh://", "{bus}");
}

#[test]
fn a_dvl_with_dead_reckoning() {
    let port = free_port();
    let url = format!("dvl://127.0.0.1:{port}");
    mapped("dvl", &url, &format!("127.0.0.1:{port}"));
}
