use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{PoseCovariance, Timestamp};
use mavlink::MavHeader;
use mavlink::dialects::ardupilotmega as dialect;
use mavlink::dialects::ardupilotmega::MavMessage;

use super::fleet::Fleet;
use super::frames::{Frames, frame};
use super::json;
use super::message::{Message, Odometry, Sender, Station, ned_from_frd};
use super::requests::Requests;
use super::vehicle::Vehicle;
use crate::only::Only;
use echosplat_join::{ArrivedPose, StampClock};

const UNIX: i64 = 1_700_000_000_000;
const ROV: Sender = Sender {
    system: 1,
    component: 1,
};

/// Milliseconds after the vehicle booted, on the host.
fn at(boot_ms: u32) -> Timestamp {
    Timestamp::from_millis(UNIX + i64::from(boot_ms))
}

fn attitude(boot_ms: u32, yaw_rad: f64) -> Message {
    Message::Attitude {
        boot_ms,
        ned_from_frd: ned_from_frd(0.0, 0.0, yaw_rad),
        is_quaternion: true,
    }
}

fn position(boot_ms: u32, ned: [f64; 3], velocity: [f64; 3]) -> Message {
    Message::Position {
        boot_ms,
        position_ned_m: DVec3::from_array(ned),
        velocity_ned_mps: DVec3::from_array(velocity),
    }
}

fn odometry(boot_ms: u32, frame: u32, child_frame: u32, reset_counter: u8) -> Message {
    Message::Odometry(Box::new(Odometry {
        time_us: u64::from(boot_ms) * 1_000,
        frame,
        child_frame,
        position_m: DVec3::new(1.0, 2.0, 3.0),
        frame_from_body: DQuat::IDENTITY,
        velocity_mps: DVec3::ZERO,
        covariance: [f64::NAN; 21],
        reset_counter,
        quality: 0,
    }))
}

/// Each message arrives 2 ms after its time since boot.
fn feed(vehicle: &mut Vehicle, messages: &[(u32, Message)]) -> Vec<ArrivedPose> {
    let mut poses = Vec::new();
    for (boot_ms, message) in messages {
        poses.extend(vehicle.take(message.clone(), at(boot_ms + 2)));
    }
    poses
}

#[test]
fn an_attitude_becomes_a_pose_where_the_velocity_has_brought_it() {
    let mut vehicle = Vehicle::new(StampClock::Host);
    let messages = [
        (990, attitude(990, 0.0)),
        (1_000, position(1_000, [10.0, 20.0, 5.0], [1.0, 0.0, -0.5])),
        (1_200, attitude(1_200, std::f64::consts::FRAC_PI_2)),
        (1_501, attitude(1_501, 0.0)),
    ];
    let poses = feed(&mut vehicle, &messages);
    // The first has no position yet; the last is more than half a second from it.
    let [ArrivedPose { pose, arrived }] = poses[..] else {
        panic!("{poses:?}");
    };
    let place = pose.world_from_vehicle;
    let expected = DVec3::new(20.0, 10.2, -4.9);
    assert!(
        (place.translation_m - expected).length() < 1e-12,
        "{place:?}"
    );
    // Heading east.
    assert!((place.rotation * DVec3::X - DVec3::X).length() < 1e-12);
    assert_eq!(arrived, at(1_202));
    // By arrival: two milliseconds late, as all of them.
    assert!(pose.time.seconds_since(at(1_202)).abs() < 1e-6);
    let status = vehicle.status(at(1_502));
    assert_eq!(status.clock_method.as_deref(), Some("arrival"));
    assert_eq!((status.received, status.accepted, status.epoch), (4, 1, 0));
}

#[test]
fn a_plain_attitude_gives_way_to_the_quaternion() {
    let plain = |boot_ms| Message::Attitude {
        boot_ms,
        ned_from_frd: DQuat::IDENTITY,
        is_quaternion: false,
    };
    let mut vehicle = Vehicle::new(StampClock::Host);
    let messages = [
        (0, position(0, [0.0; 3], [0.0; 3])),
        (20, plain(20)),
        (40, attitude(40, 0.0)),
        (60, plain(60)),
        (80, attitude(80, 0.0)),
    ];
    assert_eq!(feed(&mut vehicle, &messages).len(), 3);
}

#[test]
fn odometry_is_preferred_and_its_resets_are_epochs() {
    let mut vehicle = Vehicle::new(StampClock::Host);
    let messages = [
        (0, position(0, [0.0; 3], [0.0; 3])),
        (20, attitude(20, 0.0)),
        (40, odometry(40, 1, 12, 7)),
        (60, attitude(60, 0.0)),
        (80, odometry(80, 1, 12, 7)),
        (100, odometry(100, 1, 12, 8)),
    ];
    let poses = feed(&mut vehicle, &messages);
    let epochs: Vec<_> = poses.iter().map(|pose| pose.pose.epoch).collect();
    assert_eq!(epochs, [0, 1, 1, 2]);
    assert_eq!(vehicle.status(at(100)).epoch, 2);
}

#[test]
fn a_stray_counter_of_resets_is_an_epoch_of_its_own_and_those_after_it_are_not() {
    let mut vehicle = Vehicle::new(StampClock::Host);
    let counters = [254, 254, 3, 254, 255, 0, 0];
    let messages: Vec<_> = (0..)
        .zip(counters)
        .map(|(index, counter)| (20 * index, odometry(20 * index, 1, 12, counter)))
        .collect();
    let poses = feed(&mut vehicle, &messages);
    let epochs: Vec<_> = poses.iter().map(|pose| pose.pose.epoch).collect();
    assert_eq!(epochs, [0, 0, 5, 0, 1, 2, 2]);
}

#[test]
fn covariances_of_odometry_are_turned_with_its_frame() {
    let mut covariance = [0.0; 21];
    for (index, value) in [
        (0, 1.0),
        (1, 0.5),
        (2, 0.25),
        (6, 2.0),
        (7, 0.125),
        (11, 1e6),
    ] {
        covariance[index] = value;
    }
    (covariance[15], covariance[18], covariance[20]) = (1e-4, f64::INFINITY, 9999.0);
    let told = |frame: u32, covariance: [f64; 21]| {
        let Message::Odometry(mut message) = odometry(40, frame, 12, 0) else {
            unreachable!()
        };
        message.covariance = covariance;
        let mut vehicle = Vehicle::new(StampClock::Host);
        let poses = feed(&mut vehicle, &[(40, Message::Odometry(message))]);
        poses[0].pose.uncertainty
    };
    for (frame, position_m2) in [
        (1, [2.0, 0.5, -0.125, 1.0, -0.25, 1e6]),
        (20, [1.0, -0.5, -0.25, 2.0, 0.125, 1e6]),
        (4, [1.0, 0.5, 0.25, 2.0, 0.125, 1e6]),
    ] {
        let expected = PoseCovariance {
            position_m2,
            attitude_rad2: [1e-4, f64::INFINITY, 9999.0],
        };
        assert_eq!(told(frame, covariance), Some(expected));
    }
    assert_eq!(told(1, [0.0; 21]), None);
    covariance[0] = f64::NAN;
    assert_eq!(told(1, covariance), None, "as MAVLink has it");
}

#[test]
fn each_frame_of_odometry_is_turned_up() {
    let (ned, enu, frd, flu) = (1, 4, 20, 21);
    let (body_frd, body_ned) = (12, 8);
    for (frame, child, place, nose) in [
        (ned, body_frd, DVec3::new(2.0, 1.0, -3.0), DVec3::Y),
        (ned, body_ned, DVec3::new(2.0, 1.0, -3.0), DVec3::Y),
        (ned, ned, DVec3::new(2.0, 1.0, -3.0), DVec3::Y),
        (frd, body_frd, DVec3::new(1.0, -2.0, -3.0), DVec3::X),
        (enu, enu, DVec3::new(1.0, 2.0, 3.0), DVec3::X),
        (flu, flu, DVec3::new(1.0, 2.0, 3.0), DVec3::X),
    ] {
        let mut vehicle = Vehicle::new(StampClock::Host);
        let poses = feed(&mut vehicle, &[(0, odometry(0, frame, child, 0))]);
        let found = poses[0].pose.world_from_vehicle;
        assert!(
            (found.translation_m - place).length() < 1e-12,
            "{frame} {child}"
        );
        assert!(
            (found.rotation * DVec3::X - nose).length() < 1e-12,
            "{frame} {child}"
        );
        let up = found.rotation * DVec3::Z;
        assert!((up - DVec3::Z).length() < 1e-12, "{frame} {child}: {up}");
    }
    let mut vehicle = Vehicle::new(StampClock::Host);
    assert!(feed(&mut vehicle, &[(0, odometry(0, 0, 12, 0))]).is_empty());
    let status = vehicle.status(at(0));
    assert_eq!(status.malformed, 1);
    assert!(status.first_fault.unwrap().contains("LOCAL_NED (1)"));
}

#[test]
fn a_boot_begins_a_new_epoch() {
    let mut vehicle = Vehicle::new(StampClock::Host);
    let mut poses = feed(
        &mut vehicle,
        &[
            (90_000, position(90_000, [0.0; 3], [0.0; 3])),
            (90_020, attitude(90_020, 0.0)),
        ],
    );
    // The autopilot boots; the host's clock goes on.
    for boot_ms in (0..200).step_by(20) {
        let arrived = at(100_000 + boot_ms);
        let both = [
            position(boot_ms, [5.0, 0.0, 0.0], [0.0; 3]),
            attitude(boot_ms, 0.0),
        ];
        for message in both {
            poses.extend(vehicle.take(message, arrived));
        }
    }
    let last = poses.last().unwrap().pose;
    assert_eq!(last.epoch, 1);
    assert!(last.time.seconds_since(at(100_180)).abs() < 0.01);
}

#[test]
fn numbers_that_are_no_pose_are_counted_by_kind() {
    let mut vehicle = Vehicle::new(StampClock::Host);
    let bent = |q| Message::Attitude {
        boot_ms: 20,
        ned_from_frd: q,
        is_quaternion: true,
    };
    let messages = [
        (0, position(0, [f64::NAN, 0.0, 0.0], [0.0; 3])),
        (20, bent(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.5))),
        (20, bent(DQuat::from_xyzw(f64::INFINITY, 0.0, 0.0, 1.0))),
        (20, position(20, [1e12, 0.0, 0.0], [0.0; 3])),
    ];
    assert!(feed(&mut vehicle, &messages).is_empty());
    let status = vehicle.status(at(20));
    let counts = (status.not_finite, status.bad_quaternion, status.malformed);
    assert_eq!(counts, (2, 1, 1));
    assert!(status.first_fault.unwrap().contains("LOCAL_POSITION_NED"));
}

#[test]
fn a_vehicle_without_position_is_told_what_gives_one() {
    let mut vehicle = Vehicle::new(StampClock::Host);
    for boot_ms in (0..6_000).step_by(20) {
        feed(&mut vehicle, &[(boot_ms, attitude(boot_ms, 0.0))]);
        let is_told = vehicle.status(at(boot_ms + 2)).missing.is_some();
        assert_eq!(is_told, boot_ms >= 5_000, "{boot_ms}");
    }
    let missing = vehicle.status(at(6_000)).missing.unwrap();
    assert!(missing.contains("no position") && missing.contains("SET_GPS_GLOBAL_ORIGIN"));
    feed(
        &mut vehicle,
        &[(6_000, position(6_000, [0.0; 3], [0.0; 3]))],
    );
    assert_eq!(vehicle.status(at(6_010)).missing, None);
}

#[test]
fn messages_are_asked_for_until_they_come_and_then_no_more() {
    let mut fleet = Fleet::new(StampClock::Host, Only::default(), false);
    let mut requests = Requests::default();
    let names = |messages: &[MavMessage]| -> Vec<&'static str> {
        messages
            .iter()
            .map(mavlink::Message::message_name)
            .collect()
    };
    assert_eq!(names(&requests.due(&mut fleet, at(0))), ["HEARTBEAT"]);
    let heartbeat = Message::Heartbeat(Station::Autopilot);
    fleet.take(ROV, heartbeat, at(0), |_| {});
    let asked = names(&requests.due(&mut fleet, at(10)));
    assert_eq!(
        asked,
        [
            "TIMESYNC",
            "COMMAND_LONG",
            "COMMAND_LONG",
            "COMMAND_LONG",
            "COMMAND_LONG",
            "COMMAND_LONG"
        ]
    );
    assert!(requests.due(&mut fleet, at(20)).is_empty());
    let mut streams = 0;
    for second in 1..9 {
        let asked = names(&requests.due(&mut fleet, at(second * 1_010)));
        assert!(asked.contains(&"COMMAND_LONG"), "{second}: {asked:?}");
        streams += asked
            .iter()
            .filter(|name| **name == "REQUEST_DATA_STREAM")
            .count();
    }
    assert_eq!(streams, 2);
    for message in [attitude(9_500, 0.0), position(9_500, [0.0; 3], [0.0; 3])] {
        fleet.take(ROV, message, at(9_502), |_| {});
    }
    let asked = names(&requests.due(&mut fleet, at(9_600)));
    assert_eq!(asked, ["HEARTBEAT", "TIMESYNC"]);
}

#[test]
fn frames_are_found_in_any_pieces_and_behind_damage() {
    let header = MavHeader {
        system_id: 1,
        component_id: 1,
        sequence: 3,
    };
    let message = MavMessage::LOCAL_POSITION_NED(dialect::LOCAL_POSITION_NED_DATA {
        time_boot_ms: 7,
        x: 1.0,
        y: 2.0,
        z: 3.0,
        vx: 0.5,
        vy: 0.0,
        vz: 0.0,
    });
    let mut bytes = vec![0xFD, 0x20, 0x00, 0x01];
    bytes.extend(frame(header, &message));
    let mut damaged = frame(header, &message);
    damaged[12] ^= 0x40;
    bytes.extend(damaged);
    bytes.extend(frame(header, &message));
    let expected = position(7, [1.0, 2.0, 3.0], [0.5, 0.0, 0.0]);
    for size in [1, 3, 1_000] {
        let mut frames = Frames::new();
        let mut found = Vec::new();
        for piece in bytes.chunks(size) {
            frames.feed(piece, |sender, message| found.push((sender, message)));
        }
        assert_eq!(
            found,
            [(ROV, expected.clone()), (ROV, expected.clone())],
            "{size}"
        );
        assert_eq!(frames.frame_count(), 2);
    }
}

#[test]
fn a_servers_json_is_read_like_the_bytes() {
    let read = |text: &str| json::parse(text.as_bytes()).unwrap().unwrap();
    let (sender, message) = read(
        r#"{"header":{"system_id":1,"component_id":1,"sequence":98,"message_id":32},
        "message":{"type":"LOCAL_POSITION_NED","time_boot_ms":1000,"x":10,"y":20.0,"z":5.0,
        "vx":1.0,"vy":0.0,"vz":-0.5}}"#,
    );
    assert_eq!(sender, ROV);
    assert_eq!(
        message,
        position(1_000, [10.0, 20.0, 5.0], [1.0, 0.0, -0.5])
    );
    let (_, message) = read(
        r#"{"header":{"system_id":1,"component_id":1},"message":{"type":"ATTITUDE_QUATERNION",
        "time_boot_ms":1,"q1":1.0,"q2":0.0,"q3":0.0,"q4":0.0,"rollspeed":0.0}}"#,
    );
    assert_eq!(message, attitude(1, 0.0));
    // JSON5, as the server writes what plain JSON cannot.
    let (_, message) = read(&format!(
        r#"{{"header":{{"system_id":1,"component_id":1}},"message":{{"type":"ODOMETRY",
        "time_usec":40000,"frame_id":{{"type":"MAV_FRAME_LOCAL_NED"}},
        "child_frame_id":{{"type":"MAV_FRAME_BODY_FRD"}},"x":1,"y":2,"z":3,"q":[1,0,0,0],
        "pose_covariance":[{}NaN],"reset_counter":9,"quality":0}}}}"#,
        "NaN,".repeat(20)
    ));
    let Message::Odometry(found) = message else {
        panic!("{message:?}");
    };
    let Message::Odometry(expected) = odometry(40, 1, 12, 9) else {
        unreachable!()
    };
    assert!(found.covariance[0].is_nan());
    assert_eq!(
        (found.frame, found.child_frame),
        (expected.frame, expected.child_frame)
    );
    assert_eq!((found.time_us, found.reset_counter), (40_000, 9));
    assert_eq!(found.position_m, expected.position_m);
}

#[test]
fn odd_json_is_named_and_other_messages_are_passed_over() {
    let parse = |text: &str| json::parse(text.as_bytes());
    assert_eq!(
        parse(r#"{"message":{"type":"VFR_HUD","airspeed":0}}"#),
        Ok(None)
    );
    for (text, told) in [
        ("[]", "message.type"),
        ("{", "no JSON"),
        (
            r#"{"message":{"type":"ATTITUDE","time_boot_ms":1,"roll":0,"pitch":0}}"#,
            "`yaw`",
        ),
        (
            r#"{"message":{"type":"SYSTEM_TIME","time_unix_usec":-1,"time_boot_ms":1}}"#,
            "time_unix",
        ),
    ] {
        let wrong = parse(text).unwrap_err();
        assert!(wrong.contains(told), "{text}: {wrong}");
    }
    assert!(json::parse(&vec![b' '; 20_000]).is_err());
}
