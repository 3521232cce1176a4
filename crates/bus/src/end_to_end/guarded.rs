//! The configuration that lets users in by name and password, each for its own part.

use std::io::Write;

use super::*;

const GUARDED: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../config/zenoh-guarded.json5"
);

fn setting(key: &str, value: &str) -> (String, String) {
    (key.to_owned(), format!("'{value}'"))
}

/// A session as the file says, but for its mode, on a port of its own and with users of its own.
fn guarded(port: u16, mode: &str) -> (Bus, tempfile::NamedTempFile) {
    let mut users = tempfile::NamedTempFile::new().unwrap();
    users
        .write_all(b"viewer:look\nautopilot:steer\nmapper:map\ndriver:hear\n")
        .unwrap();
    let endpoint = format!("['tcp/127.0.0.1:{port}']");
    let path = users.path().display().to_string();
    let bus = Bus::open(BusConfig {
        zenoh_config_file: Some(GUARDED.into()),
        zenoh: vec![
            setting("mode", mode),
            ("listen/endpoints".to_owned(), endpoint),
            setting("transport/auth/usrpwd/dictionary_file", &path),
        ],
        ..config("[]", "[]")
    });
    (bus.unwrap(), users)
}

fn user(port: u16, credentials: Option<(&str, &str)>) -> Bus {
    user_as("peer", port, credentials)
}

fn user_as(mode: &str, port: u16, credentials: Option<(&str, &str)>) -> Bus {
    let mut config = config(&format!("['tcp/127.0.0.1:{port}']"), "[]");
    config.zenoh.push(setting("mode", mode));
    if let Some((name, password)) = credentials {
        let credentials = [("user", name), ("password", password)];
        config.zenoh.extend(
            credentials.map(|(key, value)| setting(&format!("transport/auth/usrpwd/{key}"), value)),
        );
    }
    Bus::open(config).unwrap()
}

#[test]
fn a_user_gets_its_own_part_and_a_stranger_nothing() {
    let port = free_port();
    let (service, _users) = guarded(port, "peer");
    let publisher = service.publish_map().unwrap();
    let taken = service.subscribe_poses().unwrap();
    let _alive = service.declare_alive("mapper").unwrap();
    let viewer = user(port, Some(("viewer", "look")));
    let autopilot = user(port, Some(("autopilot", "steer")));
    let strangers = [user(port, None), user(port, Some(("viewer", "guess")))];

    let followed = viewer.subscribe_map().unwrap();
    let outsiders = [&autopilot, &strangers[0], &strangers[1]];
    let denied = outsiders.map(|bus| bus.subscribe_map().unwrap());
    let last = round(3);
    publisher.offer(Arc::clone(&last));
    publisher.flush(LONG).unwrap();
    let map = followed.wait_final(LONG).unwrap();
    assert!(same(&map.gaussians, &last.gaussians));
    assert_eq!(followed.liveliness(), Liveliness::Alive);

    // The autopilot's come through, and before them nobody else's did.
    until("the autopilot is told that poses are taken", || {
        autopilot.has_pose_subscriber()
    });
    for bus in [&viewer, &strangers[0], &strangers[1]] {
        bus.publish_pose(&pose(1)).unwrap();
    }
    autopilot.publish_pose(&pose(2)).unwrap();
    let first = taken.next_within(LONG).unwrap();
    assert_eq!(first.pose.time, pose(2).time);
    assert_eq!(taken.next_within(Duration::from_millis(300)), None);
    for map in &denied {
        assert_eq!(map.position(), None);
    }
}

/// The first records of the driver's tape; `None` if they do not come in so long.
fn hear(bus: &Bus, limit: Duration) -> Option<crate::Heard> {
    let mut tape = bus.follow_tape();
    let begin = Instant::now();
    while begin.elapsed() < limit {
        let heard = tape.hear(Duration::from_millis(100)).unwrap();
        if let Some(heard) = heard.filter(|heard| !heard.records.is_empty()) {
            return Some(heard);
        }
    }
    None
}

#[test]
fn a_mapper_hears_the_driver_that_it_connects_to_and_nobody_else_does() {
    let port = free_port();
    let (driver, _users) = guarded(port, "peer");
    let keeper = driver.keep_tape(1, serde_json::json!({})).unwrap();
    keeper.append(Timestamp::ZERO, crate::TapeEntry::LinkUp);
    let mapper = user(port, Some(("mapper", "map")));
    let others = [
        user(port, Some(("viewer", "look"))),
        user(port, Some(("autopilot", "steer"))),
        user(port, None),
    ];
    assert!(hear(&mapper, LONG).is_some());
    for other in &others {
        assert!(hear(other, Duration::from_millis(300)).is_none());
    }
}

#[test]
fn each_has_its_own_part_under_a_router() {
    let port = free_port();
    let (_router, _users) = guarded(port, "router");
    let client = |name, password| user_as("client", port, Some((name, password)));
    let driver = client("driver", "hear");
    let mapper = client("mapper", "map");
    let viewer = client("viewer", "look");
    let autopilot = client("autopilot", "steer");

    let keeper = driver.keep_tape(1, serde_json::json!({})).unwrap();
    keeper.append(Timestamp::ZERO, crate::TapeEntry::LinkUp);
    let _there = driver.declare_alive(crate::DRIVER_ROLE).unwrap();
    assert!(hear(&mapper, LONG).is_some());
    for other in [&viewer, &autopilot] {
        assert!(hear(other, Duration::from_millis(300)).is_none());
    }

    let publisher = mapper.publish_map().unwrap();
    let _alive = mapper.declare_alive(crate::MAPPER_ROLE).unwrap();
    let followed = viewer.subscribe_map().unwrap();
    let denied = [&driver, &autopilot].map(|bus| bus.subscribe_map().unwrap());
    // What another autopilot publishes as the map gets nowhere.
    let forger = client("autopilot", "steer");
    let forged = forger.publish_map().unwrap();
    forged.offer(round(1));
    forged.flush(LONG).unwrap();
    let last = round(3);
    publisher.offer(Arc::clone(&last));
    publisher.flush(LONG).unwrap();
    let map = followed.wait_final(LONG).unwrap();
    assert!(same(&map.gaussians, &last.gaussians));
    until("the mapper is seen", || {
        followed.liveliness() == Liveliness::Alive
    });
    for map in &denied {
        assert_eq!(map.position(), None);
    }

    let taken = driver.subscribe_poses().unwrap();
    until("the autopilot is told that poses are taken", || {
        autopilot.has_pose_subscriber()
    });
    for bus in [&viewer, &mapper] {
        bus.publish_pose(&pose(1)).unwrap();
    }
    autopilot.publish_pose(&pose(2)).unwrap();
    let first = taken.next_within(LONG).unwrap();
    assert_eq!(first.pose.time, pose(2).time);
    // No two drivers, and no two mappers, of one node.
    let second = client("driver", "hear");
    for role in [crate::DRIVER_ROLE, crate::MAPPER_ROLE] {
        let other = second.service_alive_elsewhere(&[role], LONG).unwrap();
        assert!(other.is_some(), "{role}");
    }
}
