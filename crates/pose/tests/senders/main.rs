//! Poses of senders that others wrote (pymavlink, rosbags, zenoh's Python) over real sockets come
//! out as they went in. Needs `python3`.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail with the test")]

mod harness;
#[path = "../../../../tests/python.rs"]
#[expect(dead_code, reason = "the readers of recordings are another crate's")]
mod python;

use std::io::Write;
use std::path::Path;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use echosplat_bus::{Bus, BusConfig};
use echosplat_join::{ArrivedPose, StampClock};
use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Pose, StampedPose, Timestamp};
use echosplat_pose::{PoseSource, poses_of_mcap};
use echosplat_recording::tum;
use tokio::runtime::{Handle, Runtime};

const LONG: Duration = Duration::from_secs(60);
const START_S: i64 = 1_700_000_000;
/// At 50 Hz.
const POSE_COUNT: i64 = 200;

/// A curve at 0.5 m/s that turns, pitches and rolls, every 20 ms.
fn path_at(seconds: f64) -> Pose {
    let along = 0.25 * seconds;
    let place = DVec3::new(
        2.0 * along.sin(),
        1.0 - 2.0 * along.cos(),
        -3.0 + 0.1 * seconds,
    );
    let swing = (0.7 * seconds).sin();
    Pose::from_yaw_pitch_roll(along, 0.1 * swing, -0.2 * swing, place)
}

fn poses() -> Vec<StampedPose> {
    let pose = |i| StampedPose {
        time: Timestamp::from_millis(START_S * 1_000 + i * 20),
        world_from_vehicle: path_at(i as f64 * 0.02),
        uncertainty: None,
        epoch: 0,
    };
    (0..POSE_COUNT).map(pose).collect()
}

fn file(directory: &Path) -> String {
    let path = directory.join("sent.tum");
    let mut text = Vec::new();
    tum::write(&poses(), &mut text).unwrap();
    std::fs::File::create(&path)
        .unwrap()
        .write_all(&text)
        .unwrap();
    path.display().to_string()
}

fn free_port() -> u16 {
    echosplat_bus::free_port().unwrap()
}

/// What a sender sent, and what came of it.
struct Sent {
    poses: Vec<ArrivedPose>,
    status: echosplat_pose::PoseSourceStatus,
    /// Host time minus the file's.
    offset_s: f64,
}

/// Runs the sender against the source until all has been sent and nothing more comes.
fn send(source: &mut PoseSource, arguments: &[&str]) -> Sent {
    let directory = tempfile::tempdir().unwrap();
    let sent = file(directory.path());
    let mut sender = python::tool("send_poses.py", &[arguments, &[sent.as_str()]].concat());
    let mut poses = Vec::new();
    let begin = Instant::now();
    while !sender.has_ended() {
        assert!(begin.elapsed() < LONG, "{}", sender.account());
        poses.extend(source.next_within(Duration::from_millis(20)));
    }
    while let Some(pose) = source.next_within(Duration::from_millis(500)) {
        poses.push(pose);
    }
    let lines = sender.finish();
    let apart = |line: &str| {
        let (wall, stamp) = line.split_once(' ')?;
        Some((wall.parse::<i64>().ok()? - stamp.parse::<i64>().ok()?) as f64 * 1e-9)
    };
    let offset_s = lines
        .lines()
        .filter_map(apart)
        .fold(f64::INFINITY, f64::min);
    let status = source.status();
    Sent {
        poses,
        status,
        offset_s,
    }
}

fn assert_same(found: &Pose, expected: &Pose, within_m: f64, within_rad: f64) {
    let apart = (found.translation_m - expected.translation_m).length();
    assert!(apart <= within_m, "{apart} m: {found:?} {expected:?}");
    let turn = found.rotation.angle_between(expected.rotation);
    assert!(turn <= within_rad, "{turn} rad: {found:?} {expected:?}");
}

/// One for one, as good as single precision.
fn assert_all_came(found: &[ArrivedPose]) {
    assert_eq!(found.len(), poses().len());
    for (found, sent) in found.iter().zip(poses()) {
        assert_same(
            &found.pose.world_from_vehicle,
            &sent.world_from_vehicle,
            2e-3,
            2e-3,
        );
    }
}

/// Where the vehicle was at the times that the poses bear, on the sender's path.
fn assert_on_time(sent: &Sent, within_s: f64) {
    for pose in &sent.poses {
        let host_s = pose
            .pose
            .time
            .seconds_since(Timestamp::from_millis(START_S * 1_000));
        let expected = path_at(host_s - sent.offset_s);
        assert_same(
            &pose.pose.world_from_vehicle,
            &expected,
            0.5 * within_s + 0.01,
            within_s,
        );
    }
}

/// Of all tests; never ended, as that of the program.
fn runtime() -> &'static Handle {
    static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().unwrap());
    RUNTIME.handle()
}

fn open(url: &str, stamps: StampClock) -> PoseSource {
    PoseSource::open(runtime(), &url.parse().unwrap(), None, stamps).unwrap()
}

#[test]
fn pymavlink_over_udp_with_a_clock_that_drifts() {
    let address = format!("127.0.0.1:{}", free_port());
    let mut source = open(&format!("mavlink+udp://{address}"), StampClock::Host);
    let arguments = [
        "--as",
        "mavlink-udp",
        "--to",
        &address,
        "--drift-ppm",
        "50",
        "--boot-s",
        "3",
    ];
    let sent = send(&mut source, &[&arguments[..], &["--check-asked"]].concat());
    assert!(
        sent.poses.len() as i64 > POSE_COUNT * 9 / 10,
        "{:?}",
        sent.status
    );
    assert_eq!(sent.status.clock_method.as_deref(), Some("timesync"));
    assert_on_time(&sent, 0.1);
    assert_eq!((sent.status.epoch, sent.status.malformed), (0, 0));
}

#[test]
fn pymavlink_over_tcp_comes_out_as_it_went_in() {
    let address = format!("127.0.0.1:{}", free_port());
    let mut source = open(&format!("mavlink+tcp://{address}"), StampClock::Data);
    let arguments = [
        "--as",
        "mavlink-tcp",
        "--to",
        &address,
        "--rate",
        "4",
        "--system-time",
    ];
    let sent = send(&mut source, &arguments);
    assert_all_came(&sent.poses);
    assert_eq!(sent.status.clock_method.as_deref(), Some("system_time"));
    for (found, expected) in sent.poses.iter().zip(poses()) {
        let apart_s = found.pose.time.seconds_since(expected.time);
        assert!(apart_s.abs() <= 0.002, "{apart_s}");
    }
    assert_eq!(sent.status.missing, None);
}

#[test]
fn odometry_over_tcp_begins_an_epoch_at_each_reset() {
    let address = format!("127.0.0.1:{}", free_port());
    let mut source = open(&format!("mavlink+tcp://{address}"), StampClock::Host);
    let arguments = [
        "--as",
        "mavlink-tcp",
        "--to",
        &address,
        "--odometry",
        "--rate",
        "4",
    ];
    let resets = ["--reset-at-s", "1", "--reset-at-s", "3"];
    let sent = send(&mut source, &[&arguments[..], &resets[..]].concat());
    assert_all_came(&sent.poses);
    let epochs = sent.poses.iter().map(|pose| pose.pose.epoch);
    let expected = (0..POSE_COUNT).map(|i| u32::from(i >= 50) + u32::from(i >= 150));
    assert!(epochs.eq(expected));
    assert_eq!(sent.status.epoch, 2);
}

#[test]
fn a_dvl_gives_poses_at_its_velocities_too() {
    let address = format!("127.0.0.1:{}", free_port());
    let mut source = open(&format!("dvl://{address}"), StampClock::Host);
    let sent = send(&mut source, &["--as", "dvl", "--to", &address]);
    assert!(
        sent.poses.len() as i64 > POSE_COUNT * 9 / 10,
        "{:?}",
        sent.status
    );
    assert_eq!(sent.status.clock_method.as_deref(), Some("arrival"));
    assert_on_time(&sent, 0.1);
}

/// The kinds of sender that speak zenoh.
fn over_zenoh(url: &str, arguments: &[&str]) -> Sent {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let setting = |key: &str, value: String| (key.to_owned(), value);
    let bus = Bus::open(BusConfig {
        zenoh: vec![
            setting("listen/endpoints", format!("['{endpoint}']")),
            setting("connect/endpoints", "[]".to_owned()),
        ],
        ..BusConfig::default()
    });
    let bus = bus.unwrap();
    let url = url.parse().unwrap();
    let mut source = PoseSource::open(runtime(), &url, Some(&bus), StampClock::Data).unwrap();
    let to = ["--to", &endpoint, "--rate", "4"];
    let sent = send(&mut source, &[arguments, &to].concat());
    drop(source);
    bus.close().unwrap();
    sent
}

#[test]
fn json_and_odometry_of_rosbags_over_zenoh_come_out_as_they_went_in() {
    for arguments in [&["--as", "json"][..], &["--as", "odometry"]] {
        let sent = over_zenoh("zenoh://", arguments);
        assert_all_came(&sent.poses);
        let times = sent.poses.iter().map(|pose| pose.pose.time);
        assert!(times.eq(poses().iter().map(|pose| pose.time)));
        assert_eq!((sent.status.malformed, sent.status.first_fault), (0, None));
    }
    let sent = over_zenoh(
        "zenoh://rov/odom",
        &["--as", "odometry", "--key", "rov/odom"],
    );
    assert_all_came(&sent.poses);
}

#[test]
fn a_mavlink_servers_json_and_raw_messages_over_zenoh_come_out_as_they_went_in() {
    for kind in ["mavlink-json", "mavlink-raw"] {
        for more in [&["--system-time"][..], &["--odometry"]] {
            let sent = over_zenoh("mavlink+zenoh://", &[&["--as", kind], more].concat());
            assert_all_came(&sent.poses);
            assert_eq!(sent.status.first_fault, None);
            let [sender] = &sent.status.senders[..] else {
                panic!("{:?}", sent.status)
            };
            assert_eq!(sender.kind.as_deref(), Some("autopilot"));
        }
    }
}

#[test]
fn a_bag_of_rosbags_holds_its_poses() {
    let directory = tempfile::tempdir().unwrap();
    let sent = file(directory.path());
    let bag = directory.path().join("bag").display().to_string();
    let arguments = ["--as", "odometry-mcap", "--to", &bag, &sent];
    python::tool("send_poses.py", &arguments).finish();
    let mcap = directory.path().join("bag/bag.mcap");
    for topic in [None, Some("/odom")] {
        let found = poses_of_mcap(&mcap, topic).unwrap();
        assert_all_came(&found.poses);
        assert_eq!(found.poses[7].arrived, poses()[7].time);
        assert_eq!(found.losses, [""; 0]);
    }
    let frames = directory.path().join("frames").display().to_string();
    let arguments = ["--as", "tf-mcap", "--to", &frames, &sent];
    python::tool("send_poses.py", &arguments).finish();
    let frames = directory.path().join("frames/frames.mcap");
    for topic in [None, Some("/tf")] {
        assert_all_came(&poses_of_mcap(&frames, topic).unwrap().poses);
    }
    let other = poses_of_mcap(&mcap, Some("/other"))
        .unwrap_err()
        .to_string();
    assert!(
        other.contains("/other") && other.contains("/odom"),
        "{other}"
    );
    let turned = DQuat::IDENTITY.angle_between(poses()[50].world_from_vehicle.rotation);
    assert!(turned > 0.2);
}
