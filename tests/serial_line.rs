//! `echosplat run` reads a device written a second time, over a pseudo-terminal.

use std::time::Duration;

use serde_json::Value;

use crate::harness::{Program, bus_at, free_port, wait_until_listening};
use crate::python::tool;

const PROFILE_COUNT: u64 = 1000;
const LONG: Duration = Duration::from_secs(60);

#[test]
fn every_profile_of_a_serial_line_arrives() {
    let heard = run_against_emulator(&[]);
    assert_eq!(heard.session("frames_bad"), 0, "{}", heard.status);
    assert_eq!(heard.session("bytes_skipped"), 0, "{}", heard.status);
}

#[test]
fn every_profile_arrives_among_stray_bytes() {
    let heard = run_against_emulator(&["--noise", "7"]);
    let strewn = heard.device["noise_bytes_sent"].as_u64();
    assert!(strewn > Some(PROFILE_COUNT), "{}", heard.device);
    assert_eq!(
        Some(heard.session("bytes_skipped")),
        strewn,
        "{}",
        heard.status
    );
}

/// What both ends say when all is over.
struct Heard {
    /// The service's last status.
    status: Value,
    /// The emulator's report.
    device: Value,
}

impl Heard {
    /// One of the session's counters.
    fn session(&self, counter: &str) -> u64 {
        let value = &self.status["sonar"]["session"][counter];
        value
            .as_u64()
            .unwrap_or_else(|| panic!("no {counter} in {}", self.status))
    }
}

/// 1,000 profiles from `emulator.py` to `echosplat run`, which is then asked to end.
fn run_against_emulator(emulator_arguments: &[&str]) -> Heard {
    let folder = tempfile::tempdir().expect("temporary directories can be made");
    let link = folder.path().join("sonar").display().to_string();
    let count = PROFILE_COUNT.to_string();
    let mut arguments = vec![
        "--pty",
        &link,
        "--count",
        &count,
        "--pace-ms",
        "2",
        "--timeout",
        "120",
    ];
    arguments.extend(emulator_arguments);
    let mut emulator = tool("emulator.py", &arguments);
    emulator.wait_for_text("ready", LONG);

    let port = free_port();
    let bus = bus_at(port);
    let url = format!("serial://{link}?baudrate=115200");
    let mut run = vec!["run", "--sonar", &url];
    run.extend(bus.iter().map(String::as_str));
    let mut service = Program::echosplat(&run);
    wait_until_listening(&mut service, port);
    let mut watcher = tool(
        "status.py",
        &["--connect", &format!("tcp/127.0.0.1:{port}")],
    );

    emulator.wait_for_text("sent", LONG);
    let is_complete = |status: &Value| status["pings_received"] == PROFILE_COUNT;
    watcher.wait_for("status with every profile", LONG, |watcher| {
        newest(watcher).filter(is_complete)
    });
    service.interrupt();
    service.wait_exit(LONG);
    emulator.wait_exit_code(0, LONG);
    watcher.wait_exit_code(0, LONG);
    let device = emulator.json();
    assert_eq!(device["profiles_sent"], PROFILE_COUNT);
    assert!(
        device["disables"].as_u64() >= Some(1),
        "told to stop: {device}"
    );
    let status = watcher.json();
    assert_eq!(status["pings_received"], PROFILE_COUNT, "{status}");
    Heard { status, device }
}

/// The newest whole line.
fn newest(watcher: &Program) -> Option<Value> {
    let stdout = watcher.stdout();
    let whole = stdout.rsplit_once('\n')?.0;
    serde_json::from_str(whole.lines().last()?).ok()
}
