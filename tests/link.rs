//! A sonar that goes away and comes back, and one that is told to stop.

use std::time::Duration;

use crate::harness::{Program, bus_at, free_port, wait_until_listening};

const LONG: Duration = Duration::from_secs(120);

/// The newest `name=NUMBER` in a log.
pub(crate) fn newest_count(log: &str, name: &str) -> Option<u64> {
    let (_, rest) = log.rsplit_once(&format!("{name}="))?;
    let digits = rest.split(|c: char| !c.is_ascii_digit()).next()?;
    digits.parse().ok()
}

fn emulate(sonar: &str, bus_port: u16) -> Program {
    let connect = format!("connect/endpoints=[\"tcp/127.0.0.1:{bus_port}\"]");
    let mut emulated = Program::echosplat(&[
        "emulate",
        "--listen",
        sonar,
        "--publish-poses",
        "--zenoh",
        &connect,
    ]);
    emulated.wait_for_text("listening on", LONG);
    emulated
}

fn wait_mapped_beyond(service: &mut Program, count: u64) -> u64 {
    service.wait_for("more pings in the map", LONG, |service| {
        newest_count(&service.stderr(), "pings_mapped").filter(|&mapped| mapped > count)
    })
}

#[test]
fn mapping_goes_on_after_the_sonar_was_away_and_an_end_tells_it_to_stop() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply");
    let map_name = map.display().to_string();
    let (bus_port, sonar_port) = (free_port(), free_port());
    let sonar = format!("tcp://127.0.0.1:{sonar_port}");
    let own = ["run", "--sonar", &sonar, "--map", &map_name, "--verbose"];
    let bus = bus_at(bus_port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let mut service = Program::echosplat(&[&own[..], bus.as_slice()].concat());
    wait_until_listening(&mut service, bus_port);

    let first = emulate(&sonar, bus_port);
    let mapped = wait_mapped_beyond(&mut service, 20);
    drop(first);
    service.wait_for_text("link is down", LONG);
    service.wait_for_text("link=Lost", LONG);

    let mut second = emulate(&sonar, bus_port);
    wait_mapped_beyond(&mut service, mapped + 20);

    service.terminate();
    let status = service.wait_exit(LONG);
    assert!(
        matches!(status.code(), Some(0 | 3)),
        "{}",
        service.account()
    );
    assert!(map.exists(), "{}", service.account());
    second.terminate();
    second.wait_exit_code(0, LONG);
    let seen = second.json();
    assert_eq!(seen["is_pinging"], false, "{}", second.account());
    assert!(seen["disables"].as_u64().unwrap() > 0, "{seen}");
}
