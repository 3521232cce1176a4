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

/// A service as the file says, on a port of its own and with users of its own.
fn guarded(port: u16) -> (Bus, tempfile::NamedTempFile) {
    let mut users = tempfile::NamedTempFile::new().unwrap();
    users.write_all(b"viewer:look\nautopilot:steer\n").unwrap();
    let endpoint = format!("['tcp/127.0.0.1:{port}']");
    let path = users.path().display().to_string();
    let bus = Bus::open(BusConfig {
        zenoh_config_file: Some(GUARDED.into()),
        zenoh: vec![
            ("listen/endpoints".to_owned(), endpoint),
            setting("transport/auth/usrpwd/dictionary_file", &path),
        ],
        ..config("[]", "[]")
    });
    (bus.unwrap(), users)
}

fn user(port: u16, credentials: Option<(&str, &str)>) -> Bus {
    let mut config = config(&format!("['tcp/127.0.0.1:{port}']"), "[]");
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
    let (service, _users) = guarded(port);
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
