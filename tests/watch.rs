//! Who joins late ends with the very map of the service.

use std::fs;
use std::time::Duration;

use crate::dive::replay;
use crate::harness::{Program, bus_at, free_port, wait_until_listening};

const LONG: Duration = Duration::from_secs(120);

#[test]
fn a_watch_begun_in_mid_dive_ends_with_the_final_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let port = free_port();
    let bus = bus_at(port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let (ours, theirs) = (path("ours.ply"), path("theirs.ply"));

    let own = [
        "--rate",
        "1",
        "--map",
        &ours,
        "--json",
        "--verbose",
        "--publish",
    ];
    let mut service = Program::echosplat(&replay(&[&own[..], bus.as_slice()].concat()));
    wait_until_listening(&mut service, port);
    service.wait_for("some pings in the map", LONG, |service| {
        crate::link::newest_count(&service.stderr(), "pings_mapped").filter(|&count| count > 0)
    });
    let own = [
        "watch",
        "--node",
        "replay",
        "--until-final",
        "--map",
        &theirs,
        "--verbose",
    ];
    let mut watch = Program::echosplat(&[&own[..], bus.as_slice()].concat());

    service.wait_exit_code(0, LONG);
    watch.wait_exit_code(0, LONG);
    let summary = service.only_json();
    assert!(summary["ambiguous"].as_u64().unwrap() > 0, "{summary}");
    for kind in ["ply", "ambiguous.ply"] {
        let bytes = |name| fs::read(path(&format!("{name}.{kind}"))).unwrap();
        assert_eq!(bytes("ours"), bytes("theirs"), "{}", watch.account());
    }
    assert!(watch.stderr().contains("pings_received"), "status was seen");
}
