//! What `--record` keeps is what came, byte for byte, and other programs read it.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use echosplat_bus::point_cloud;
use echosplat_model::glam::{Quat, Vec3};
use echosplat_model::{Gaussian, Pose, StampedPose, Standing, Timestamp};
use echosplat_recording::mcap::{
    Ending, Profile, Record, Recording, RecordingFile, RecordingReader,
};
use echosplat_recording::svlog::SvlogReader;
use echosplat_ros::{CdrWriter, Header};
use serde_json::json;

use crate::dive::{file, replay};
use crate::harness::Program;
use crate::python::reader;

const LONG: Duration = Duration::from_secs(240);

/// The files that a replay with these arguments records into `folder`.
fn recorded(folder: &Path, more: &[&str]) -> Vec<PathBuf> {
    let directory = folder.display().to_string();
    let arguments = [&["--no-publish", "--record", &directory][..], more].concat();
    Program::echosplat(&replay(&arguments)).wait_exit_code(0, LONG);
    let entries = fs::read_dir(folder).expect("the folder is there").flatten();
    let mut files: Vec<_> = entries.map(|entry| entry.path()).collect();
    files.sort();
    files
}

fn pose_count() -> usize {
    let lines = fs::read_to_string(file("dive.tum")).expect("the dive has poses");
    lines.lines().filter(|line| !line.starts_with('#')).count()
}

#[test]
fn a_recording_holds_the_bytes_the_poses_and_the_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let files = recorded(folder.path(), &[]);
    assert_eq!(files.len(), 1, "{files:?}");
    let mut reader = RecordingReader::open(&files).unwrap();
    let mut raw = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if let Record::Raw(bytes) = message.record {
            raw.extend_from_slice(&bytes);
        }
    }
    assert_eq!(reader.ending(), Some(Ending::Complete));
    assert!(raw == fs::read(file("dive.svlog")).unwrap(), "raw bytes");
    let scan = Recording::scan(&files).unwrap();
    assert_eq!(scan.poses.len(), pose_count());
    assert!(scan.settings.unwrap().contains("[session]"));

    let mut info = Program::echosplat(&["info", &files[0].display().to_string(), "--json"]);
    info.wait_exit_code(0, LONG);
    let info = info.only_json();
    assert_eq!(info["poses"], pose_count());
    assert_eq!(info["damage"]["is_cut"], false);
    assert!(info["pings"].as_u64().unwrap() > 0, "{info}");
    assert_eq!(info["replays_without_poses"], true, "{info}");
}

/// The poses of a file begin at 0 s; the bytes of its log were read today.
#[test]
fn a_replay_is_recorded_on_one_clock() {
    let folder = tempfile::tempdir().unwrap();
    let files = recorded(folder.path(), &[]);
    let scan = Recording::scan(&files).unwrap();
    let (first, last) = scan.span.expect("there are records");
    let taken_s = last.seconds_since(first);
    assert!((0.0..LONG.as_secs_f64()).contains(&taken_s), "{taken_s} s");
    assert_eq!(scan.poses.len(), pose_count());
}

#[test]
fn what_is_recorded_for_ros_is_what_a_whole_recording_holds_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, ros] = ["whole", "ros"].map(|name| folder.path().join(name));
    let [whole] = &recorded(&whole, &[])[..] else {
        panic!("one file")
    };
    let [ros] = &recorded(&ros, &["--record-format", "ros"])[..] else {
        panic!("one file")
    };
    let made = whole.with_extension("ros.mcap");
    Program::echosplat(&["recover", "--ros", path(whole)]).wait_exit_code(0, LONG);
    let counts = Recording::scan(&[whole]).unwrap().counts;
    for file in [ros, &made] {
        let start = fs::read(file).unwrap();
        assert_eq!(start[21..25], *b"ros2", "profile of {}", file.display());
        let found = Recording::scan(&[file]).unwrap();
        assert_eq!(found.counts.raw_bytes, counts.raw_bytes);
        assert_eq!(found.counts.poses, counts.poses);
        assert_eq!(found.counts.statuses + found.counts.events, 0);
        assert_eq!((found.undecodable_count, found.is_cut), (0, false));
    }
}

#[test]
fn other_programs_read_every_channel_and_every_ping() {
    let folder = tempfile::tempdir().unwrap();
    let files = recorded(folder.path(), &["--record-format", "both"]);
    let [mcap, svlog] = &files[..] else {
        panic!("{files:?}");
    };
    assert!(svlog.extension().is_some_and(|ending| ending == "svlog"));
    let mut log = SvlogReader::new(fs::File::open(svlog).unwrap()).unwrap();
    while log.next_piece().unwrap().is_some() {}
    // All frames but the session's packet.
    let pings = (log.frame_count() - 1).to_string();
    let poses = pose_count().to_string();
    let arguments = [path(mcap), &poses, path(svlog), &pings];
    let mut python = reader("read_recording.py", &arguments);
    python.wait_exit_code(0, LONG);
    assert!(python.stdout().contains("all read"), "{}", python.account());
}

fn path(path: &Path) -> &str {
    path.to_str().expect("a path in words")
}

/// CDR of a static transform from `map` to `dive`.
fn static_transform() -> Arc<[u8]> {
    let mut writer = CdrWriter::with_capacity(200);
    writer.count(1);
    let stamp = Timestamp::ZERO;
    Header {
        stamp,
        frame_id: "map",
    }
    .write(&mut writer);
    writer.string("dive");
    writer.f64s(&[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
    writer.finish().into()
}

/// Every kind of record, as the service writes it.
fn one_of_each() -> Vec<Record> {
    let gaussian = Gaussian {
        id: 7,
        mean_m: Vec3::new(1.0, 2.0, 3.0),
        rotation: Quat::IDENTITY,
        scale_m: Vec3::splat(0.1),
        opacity: 0.5,
        reflectivity: 0.25,
        sigma_m: f32::INFINITY,
        position_covariance_m2: Gaussian::known_alike_m2(f32::INFINITY),
        probability: 1.0,
        standing: Standing::Confident,
        why: echosplat_model::Why::default(),
    };
    let pose = StampedPose {
        time: Timestamp::from_millis(1_700_000_000_000),
        world_from_vehicle: Pose::IDENTITY,
        uncertainty: None,
        epoch: 1,
    };
    vec![
        Record::Settings("[sonar]".to_owned()),
        Record::StaticTransform(static_transform()),
        Record::LinkUp,
        Record::Raw(b"BR"[..].into()),
        Record::Pose(pose),
        Record::HalfFrameExpired,
        Record::Status(json!({"rate_hz": 1.5, "link": null})),
        Record::Delta {
            cloud: point_cloud::encode(&[gaussian], pose.time, "map").into(),
            info: Arc::from(&br#"{"epoch":1,"sequence":2,"removed":[3]}"#[..]),
        },
        Record::LinkDown,
    ]
}

#[test]
fn other_programs_read_one_of_each() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("each.mcap");
    let mut recording = RecordingFile::create(&file, "map", Profile::Full).unwrap();
    for record in one_of_each() {
        recording
            .writer()
            .write(Timestamp::from_millis(1_700_000_000_000), &record)
            .unwrap();
    }
    recording.finish().unwrap();
    let mut python = reader("read_recording.py", &[path(&file), "1"]);
    python.wait_exit_code(0, LONG);
    for topic in [
        "/sonar/link': 3",
        "/events': 1",
        "/map/delta': 1",
        "/map/delta_info': 1",
        "/tf_static': 1",
    ] {
        assert!(python.stdout().contains(topic), "{}", python.account());
    }
}
