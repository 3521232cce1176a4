//! Several units in one log or behind one address, and devices that are none of ours.

use std::fs;
use std::path::Path;
use std::time::Duration;

use echosplat_firmware_protocol::{
    Decoder, DeviceInformation, Event, Message, OsMonoProfile, PowerResults,
};

use crate::dive::{PING_COUNT, file};
use crate::fake_sonar::{FakeSonar, FakeVehicle, encoded, now, pose_at, profile};
use crate::harness::{Program, bus_at, free_port, wait_until_listening};

const LONG: Duration = Duration::from_secs(120);
/// The second unit's echoes lie so much farther, 1 m.
const FARTHER_BINS: usize = 60;

/// The dive's log with a second unit between: each of its profiles a moment after the dive's, with
/// echoes of another place, after `change`.
fn with_second_unit(change: impl Fn(&mut OsMonoProfile<'_>) -> u8) -> Vec<u8> {
    let whole = fs::read(file("dive.svlog")).expect("it was made");
    let mut mixed = Vec::new();
    let mut take = |event: Event<'_>| {
        let Event::Frame(frame) = event else { return };
        mixed.extend_from_slice(frame.bytes());
        let Ok(Message::OsMonoProfile(mut second)) = Message::parse(&frame) else {
            return;
        };
        let mut results: Vec<u16> = second.pwr_results.iter().collect();
        results.rotate_right(FARTHER_BINS);
        let moved: Vec<u8> = results.iter().flat_map(|raw| raw.to_le_bytes()).collect();
        second.pwr_results = PowerResults::from_bytes(&moved).expect("two bytes a bin");
        let source = change(&mut second);
        let message = Message::OsMonoProfile(second);
        let mut bytes = vec![0; message.encoded_byte_count()];
        message.encode(source, 0, &mut bytes).expect("it fits");
        mixed.extend(bytes);
    };
    let mut decoder = Box::<Decoder>::default();
    decoder.feed(&whole, &mut take);
    mixed
}

/// Replays a log with the dive's poses; the program, ended, and the map's bytes.
fn replayed(folder: &Path, log: &str, config: &str) -> (Program, Vec<u8>) {
    let path = |name: &str| folder.join(name).display().to_string();
    fs::write(path("own.toml"), config).expect("it can be written");
    let (map, settings, poses) = (path("map.ply"), path("own.toml"), file("dive.tum"));
    let arguments = [
        "replay", log, "--poses", &poses, "--map", &map, "--config", &settings, "--json",
    ];
    let mut program = Program::echosplat(&arguments);
    program.wait_exit(LONG);
    let bytes = fs::read(map).unwrap_or_default();
    (program, bytes)
}

#[test]
fn of_two_units_in_a_log_one_makes_the_map_alone_and_a_key_chooses() {
    let folder = tempfile::tempdir().expect("temporary directories can be made");
    let log = folder.path().join("two.svlog");
    let name = log.display().to_string();
    let (mut single, alone) = replayed(folder.path(), &file("dive.svlog"), "");
    single.wait_exit_code(0, LONG);
    // Another source, its count begun earlier.
    let by_source = with_second_unit(|second| {
        second.ping_number += 70_000;
        second.timestamp_ms += 900_011;
        2
    });
    fs::write(&log, by_source).expect("it can be written");
    let (mut told, map) = replayed(folder.path(), &name, "");
    told.wait_exit_code(3, LONG);
    assert!(
        map == alone,
        "the map is the first unit's\n{}",
        told.account()
    );
    let said = told.only_json();
    assert_eq!(said["pings_mapped"], PING_COUNT, "{said}");
    assert_eq!(
        said["sonar"]["units"].as_array().map(Vec::len),
        Some(2),
        "{said}"
    );
    assert!(
        said["lossy"]
            .as_str()
            .is_some_and(|words| words.contains("several units")),
        "{said}"
    );
    let (mut chosen, map) = replayed(folder.path(), &name, "[session]\nsource = 1\n");
    chosen.wait_exit_code(0, LONG);
    assert!(map == alone, "{}", chosen.account());
    let (other, map) = replayed(folder.path(), &name, "[session]\nsource = 2\n");
    assert_eq!(
        other.only_json()["sonar"]["session"]["profiles_rejected"]["other_unit"],
        PING_COUNT
    );
    assert!(map != alone);
    let (mut nobody, _) = replayed(folder.path(), &name, "[session]\nsource = 9\n");
    nobody.wait_exit_code(3, LONG);
    assert!(
        nobody.stderr().contains("session.source"),
        "{}",
        nobody.account()
    );

    let mut info = Program::echosplat(&["info", &name]);
    info.wait_exit_code(0, LONG);
    let words = info.stdout();
    assert!(
        words.contains("source 2") && words.contains("left out"),
        "{words}"
    );
    // In step, and told by where it looks alone.
    let by_heading = with_second_unit(|second| {
        second.transducer_heading_deg += 90.0;
        1
    });
    fs::write(&log, by_heading).expect("it can be written");
    let (mut told, map) = replayed(folder.path(), &name, "");
    told.wait_exit_code(3, LONG);
    assert!(map == alone, "{}", told.account());
    let (mut chosen, map) = replayed(folder.path(), &name, "[session]\nheading_deg = 10.0\n");
    chosen.wait_exit_code(0, LONG);
    assert!(map == alone, "{}", chosen.account());
}

#[test]
fn of_two_units_behind_one_address_one_is_mapped_and_the_other_told() {
    let sonar = FakeSonar::start(|index| {
        let forward = profile(index, |_| {});
        let side = profile(index, |side| {
            side.ping_number = side.ping_number.wrapping_add(31_000);
            side.transducer_heading_deg = -90.0;
        });
        [forward, side].concat()
    });
    let port = free_port();
    let (bus, url) = (bus_at(port), sonar.url());
    let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
    let mut service =
        Program::echosplat(&[&["run", "--sonar", &url, "--verbose"], &bus[..]].concat());
    wait_until_listening(&mut service, port);
    let _vehicle = FakeVehicle::start(port, |seconds| Some(pose_at(now(), seconds)));
    service.wait_for_text("profiles of several units come", LONG);
    service.wait_for_text("heading -90°", LONG);
    service.interrupt();
    service.wait_exit_code(3, LONG);
}

/// A device that says what it is, and one that only sends what it sends.
fn others() -> Vec<(&'static str, Vec<u8>)> {
    let says = |device_type| {
        encoded(&Message::DeviceInformation(DeviceInformation {
            device_type,
            device_revision: 1,
            firmware: [3, 28, 0],
        }))
    };
    let sends = |message_id, byte_count| {
        let payload = vec![7; byte_count];
        let message = Message::Unknown {
            message_id,
            payload: &payload,
        };
        encoded(&message)
    };
    vec![
        ("Ping1D", says(1)),
        ("Ping360", says(2)),
        ("Surveyor", says(103)),
        ("Ping1D", sends(1300, 226)),
        ("Ping360", sends(2300, 1214)),
        ("Surveyor", sends(3009, 4_000)),
        ("Surveyor", sends(3012, 800)),
    ]
}

#[test]
fn a_device_that_is_none_of_ours_is_named_as_what_it_is() {
    for (index, (name, bytes)) in others().into_iter().enumerate() {
        let device = FakeSonar::start(move |_| bytes.clone());
        let url = device.url();
        let mut probed = Program::echosplat(&["probe", "--timeout", "2", "--sonar", &url]);
        probed.wait_exit_code(1, LONG);
        let account = probed.account();
        assert!(probed.stdout().contains(name), "{account}");
        assert!(probed.stdout().contains("no OmniScan 450"), "{account}");
        if index % 2 == 0 {
            continue;
        }
        let bus = bus_at(free_port());
        let bus: Vec<&str> = bus.iter().map(String::as_str).collect();
        let mut service = Program::echosplat(&[&["run", "--sonar", &url], &bus[..]].concat());
        service.wait_for_text("no OmniScan 450, whose profiles are mapped here", LONG);
        assert!(service.stderr().contains(name), "{}", service.account());
        service.interrupt();
        service.wait_exit_code(3, LONG);
    }
}
