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

/// Without a service, before one, beside it and after it: each is said, the map is kept meanwhile, and
/// the end is told in words.
#[test]
fn whoever_watches_is_told_how_the_map_stands_and_that_the_service_ended() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("copy.ply");
    let file = map.display().to_string();
    let port = free_port();
    let bus = bus_at(port);
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let watch = ["watch", "--node", "replay", "--map", &file];
    let mut watch = Program::echosplat(&[&watch[..], &bus].concat());
    watch.wait_for_text("no service under echosplat/replay", LONG);

    let mut service =
        Program::echosplat(&replay(&[&["--rate", "1", "--publish"][..], &bus].concat()));
    watch.wait_for_text("echosplat/replay is there", LONG);
    watch.wait_for_text(" Gaussians, the newest came ", LONG);
    watch.wait_for("map while it runs", LONG, |_| map.is_file().then_some(()));
    service.kill();
    watch.wait_for_text("its token echosplat/replay/alive is gone", LONG);
    watch.terminate();
    watch.wait_exit_code(0, LONG);
    let said = watch.stdout();
    assert!(
        said.contains("not its last") && said.contains("is gone"),
        "{}",
        watch.account()
    );
    let counters = ["messages_received", "counters", "queries"];
    let all = watch.stdout() + &watch.stderr();
    assert!(
        counters.iter().all(|name| !all.contains(name)),
        "{}",
        watch.account()
    );
    assert!(
        echosplat_recording::ply::read_map(&map)
            .unwrap()
            .refused
            .count
            == 0
    );
}

#[test]
fn a_watch_that_saw_no_map_says_so_and_ends_with_3() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("none.ply").display().to_string();
    let connect = format!("connect/endpoints=[\"tcp/127.0.0.1:{}\"]", free_port());
    let watch = [
        "watch",
        "--duration",
        "1",
        "--map",
        &map,
        "--zenoh",
        &connect,
    ];
    let mut watch = Program::echosplat(&watch);
    watch.wait_exit_code(3, LONG);
    assert!(
        watch.stdout().contains("no map came"),
        "{}",
        watch.account()
    );
    assert!(!std::path::Path::new(&map).exists());
}
