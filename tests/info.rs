//! `info` says what files of others hold, several at once, and each name once.

use std::fs;
use std::path::Path;
use std::time::Duration;

use echosplat_model::{Gaussian, Standing, Why};
use serde_json::Value;

use crate::dive::{file, replay};
use crate::harness::{Program, bus_at, free_port};
use crate::python::{python, reader};

const LONG: Duration = Duration::from_secs(120);

/// A bag as ROS 2 writes it: odometry along the dive's poses from its beginning on, a quarter of it as poses too, the
/// frames between world and vehicle, and a temperature.
const BAG: &str = r#"
import sys
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
T = store.types
rows = [[float(word) for word in line.split()] for line in open(sys.argv[1]) if line[0] not in '#-']
with Writer(sys.argv[2], version=9, storage_plugin=StoragePlugin.MCAP) as bag:
    topic = lambda name, kind: (bag.add_connection(name, kind, typestore=store), kind)
    odom = topic("/odom", "nav_msgs/msg/Odometry")
    pose = topic("/fused/pose", "geometry_msgs/msg/PoseStamped")
    frames = topic("/tf", "tf2_msgs/msg/TFMessage")
    imu = topic("/imu/temperature", "sensor_msgs/msg/Temperature")
    put = lambda to, at, message: bag.write(to[0], at, store.serialize_cdr(message, to[1]))
    header = lambda at, frame: T["std_msgs/msg/Header"](
        stamp=T["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9), frame_id=frame)
    import numpy as np
    vector = T["geometry_msgs/msg/Vector3"]
    twist = T["geometry_msgs/msg/TwistWithCovariance"](
        twist=T["geometry_msgs/msg/Twist"](linear=vector(x=0, y=0, z=0), angular=vector(x=0, y=0, z=0)),
        covariance=np.zeros(36))
    for number, (t, x, y, z, *q) in enumerate(rows):
        at = round(t * 1e9)
        place = T["geometry_msgs/msg/Pose"](
            position=T["geometry_msgs/msg/Point"](x=x, y=y, z=z),
            orientation=T["geometry_msgs/msg/Quaternion"](x=q[0], y=q[1], z=q[2], w=q[3]))
        known = T["geometry_msgs/msg/PoseWithCovariance"](pose=place, covariance=np.zeros(36))
        put(odom, at, T["nav_msgs/msg/Odometry"](
            header=header(at, "odom"), child_frame_id="base_link", pose=known, twist=twist))
        if number % 4 == 0:
            put(pose, at, T["geometry_msgs/msg/PoseStamped"](header=header(at, "map"), pose=place))
        put(frames, at, T["tf2_msgs/msg/TFMessage"](transforms=[T["geometry_msgs/msg/TransformStamped"](
            header=header(at, "map"), child_frame_id="base_link", transform=T["geometry_msgs/msg/Transform"](
                translation=vector(x=x, y=y, z=z), rotation=place.orientation))]))
        put(imu, at, T["sensor_msgs/msg/Temperature"](header=header(at, "imu"), temperature=8.5, variance=0.0))
"#;

fn info(files: &[&str]) -> Program {
    let mut info = Program::echosplat(&[&["info"], files].concat());
    info.wait_exit_code(0, LONG);
    info
}

fn info_json(files: &[&str]) -> Value {
    let mut info = Program::echosplat(&[&["info"], files, &["--json"]].concat());
    info.wait_exit_code(0, LONG);
    info.only_json()
}

/// The bag's file in `folder`.
fn bag(folder: &Path) -> String {
    let out = folder.join("bag").display().to_string();
    let mut made = Program::start(python(&["-c", BAG], &[file("dive.tum"), out.clone()]));
    made.wait_exit_code(0, LONG);
    format!("{out}/bag.mcap")
}

fn named<'a>(list: &'a Value, topic: &str) -> &'a Value {
    let list = list.as_array().expect("a list");
    let found = list.iter().find(|entry| entry["topic"] == topic);
    found.unwrap_or_else(|| panic!("no {topic} in {list:?}"))
}

#[test]
fn a_bag_of_ros_is_named_with_its_poses_and_the_option_that_uses_each() {
    let folder = tempfile::tempdir().unwrap();
    let bag = bag(folder.path());
    let poses = fs::read_to_string(file("dive.tum")).unwrap();
    let count = poses
        .lines()
        .filter(|line| !line.starts_with(['#', '-']))
        .count();
    let found = info_json(&[&bag]);
    assert_eq!(found["kind"], "bag of another program (mcap)");
    assert_eq!(found["profile"], "ros2", "{found}");
    assert!(found["library"].is_string(), "{found}");
    let odom = named(&found["topics"], "/odom");
    assert_eq!(odom["schema"], "nav_msgs/msg/Odometry");
    assert_eq!(odom["messages"], count);
    assert!(odom["seconds"].as_f64() > Some(20.0), "{odom}");
    let temperature = named(&found["topics"], "/imu/temperature");
    assert_eq!(temperature["messages"], count);
    let ways = found["pose_topics"].as_array().unwrap();
    let topics: Vec<_> = ways
        .iter()
        .map(|way| way["topic"].as_str().unwrap())
        .collect();
    assert_eq!(topics, ["/odom", "/fused/pose", "/tf"]);
    assert_eq!(ways[0]["poses"], count);
    assert_eq!(ways[1]["poses"], count.div_ceil(4));
    assert_eq!(ways[2]["frames"], "map → base_link");
    // The option that is told is taken literally.
    for way in ways {
        let option = way["option"].as_str().unwrap();
        let file = option.strip_prefix("--poses ").unwrap().trim_matches('\'');
        let log = crate::dive::file("dive.svlog");
        let mut replay = Program::echosplat(&["replay", &log, "--poses", file, "--json"]);
        replay.wait_exit(LONG);
        // The last poses may come after the last ping.
        let taken = replay.only_json()["poses"]["poses_taken"].as_u64().unwrap();
        let told = way["poses"].as_u64().unwrap();
        let is_it = taken <= told && taken > told * 9 / 10;
        assert!(is_it, "{taken} of {told}\n{}", replay.account());
    }
    let text = info(&[&bag]).stdout();
    for words in ["topic /odom, ", "--poses ", "replay LOG.svlog"] {
        assert!(text.contains(words), "{text}");
    }
    let none = format!("{bag}#/none");
    let log = file("dive.svlog");
    let mut replay = Program::echosplat(&["replay", &log, "--poses", &none]);
    replay.wait_exit_code(2, LONG);
    assert!(
        replay.stderr().contains("on topic \"/none\""),
        "{}",
        replay.account()
    );
}

/// A recording of a short dive at `scene`.
fn recorded(folder: &Path, scene: &str) -> String {
    let directory = folder.join(scene).display().to_string();
    let sonar = format!("sim://{scene}");
    let own = [
        "run",
        "--sonar",
        &sonar,
        "--duration",
        "2",
        "--record",
        &directory,
    ];
    let own = own.iter().map(ToString::to_string);
    let arguments: Vec<String> = own.chain(bus_at(free_port())).collect();
    Program::echosplat(&arguments).wait_exit_code(0, LONG);
    let mut entries = fs::read_dir(&directory).expect("it was recorded").flatten();
    entries.next().expect("a file").path().display().to_string()
}

#[test]
fn several_files_are_told_each_with_its_name_once_and_a_dive_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let [fence, wall] = ["fence", "wall"].map(|scene| recorded(folder.path(), scene));
    // One dive in two files.
    let bytes = fs::read(&fence).unwrap();
    let (first, rest) = (path("first.mcap"), path("rest.mcap"));
    fs::write(&first, &bytes[..bytes.len() / 2]).unwrap();
    reader("rewrite_mcap.py", &[&fence, &rest, "--from", "0.8"]).wait_exit_code(0, LONG);
    let map = path("map.ply");
    Program::echosplat(&replay(&["--map", &map])).wait_exit_code(0, LONG);
    let (log, poses) = (file("dive.svlog"), file("dive.tum"));
    let json_poses = path("json.mcap");
    let without = ["--without", "/sonar/raw", "--without", "/pose"];
    reader(
        "rewrite_mcap.py",
        &[&[wall.as_str(), json_poses.as_str()][..], &without].concat(),
    )
    .wait_exit_code(0, LONG);

    let files: [&str; 7] = [&map, &first, &wall, &log, &rest, &poses, &json_poses];
    let found = info_json(&files);
    let found = found["found"].as_array().expect("several");
    let names: Vec<_> = found.iter().map(|facts| facts["name"].clone()).collect();
    let dive = serde_json::json!([first, rest]);
    let expected = [
        map.as_str().into(),
        dive,
        wall.as_str().into(),
        log.as_str().into(),
    ];
    assert_eq!(names[..4], expected);
    assert_eq!(names[4..], [poses.as_str(), json_poses.as_str()]);
    assert_eq!(found[1]["pings"], found[2]["pings"]);
    let of_another = &found[5];
    assert_eq!(of_another["kind"], "bag of another program (mcap)");
    assert_eq!(of_another["pose_topics"], serde_json::json!([]));
    assert_eq!(of_another["use_with"], "none of its topics gives poses");
    let text = info(&files).stdout();
    for file in files {
        assert_eq!(text.matches(file).count(), 1, "{file}\n{text}");
    }
    assert_eq!(text.matches("\n\n").count(), found.len() - 1, "{text}");
}

#[test]
fn what_is_wrong_with_a_file_is_told_with_its_name_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let write = |name: &str, bytes: &[u8]| {
        fs::write(path(name), bytes).unwrap();
        path(name)
    };
    let mut newer = b"\x89MCAP0\r\n\x01\x21\0\0\0\0\0\0\0\0\0\0\0\x19\0\0\0".to_vec();
    newer.extend(b"echosplat recording 99999");
    let newer = write("newer.mcap", &newer);
    let map = write(
        "newer.ply",
        b"ply\nformat ascii 1.0\ncomment echosplat_map 2\nelement vertex 0\nend_header\n",
    );
    let mesh = b"ply\nformat ascii 1.0\ncomment echosplat_mesh 2\nelement vertex 3\nproperty float x\n\
        property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
        0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let mesh = write("newer-mesh.ply", mesh);
    let obj = b"# echosplat_mesh 2\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let obj = write("newer-mesh.obj", obj);
    let broken = write("broken.tum", b"1 2 3\n");
    let garbled = write("garbled.ply", b"ply\nformat ascii 1.0\nend_header\n");
    let good = write("good.ply", GOOD_MAP);
    let log = file("dive.svlog");
    let out = path("out.mcap");
    for (arguments, name, words) in [
        (
            &["info", &newer][..],
            &newer,
            "version 99999 of a recording",
        ),
        (&["replay", &newer], &newer, "version 99999 of a recording"),
        (&["recover", &newer, "--out", &out], &newer, "version 99999"),
        (
            &["replay", &log, "--poses", &newer],
            &newer,
            "version 99999",
        ),
        (&["info", &map], &map, "version 2 of a map"),
        (
            &["export", &map, &path("a.npz")],
            &map,
            "made by a newer EchoSplat",
        ),
        (
            &["evaluate", &good, "--truth", &mesh],
            &mesh,
            "version 2 of a mesh",
        ),
        (
            &["evaluate", &good, "--truth", &obj],
            &obj,
            "version 2 of a mesh",
        ),
        (
            &["evaluate", &good, "--truth", "fence", "--mesh", &broken],
            &broken,
            "mesh",
        ),
        (
            &["evaluate", &good, "--truth", &garbled],
            &garbled,
            "element",
        ),
        (&["info", &broken], &broken, "line 1"),
        (&["info", &garbled], &garbled, "element vertex"),
        (&["info", &good, &broken], &broken, "line 1"),
    ] {
        let mut program = Program::echosplat(arguments);
        program.wait_exit_code(2, LONG);
        let said = program.stderr();
        assert!(said.contains(words), "{}", program.account());
        assert_eq!(
            said.matches(name.as_str()).count(),
            1,
            "{}",
            program.account()
        );
    }
    assert!(!Path::new(&out).exists());
}

/// A map of one Gaussian, as another program writes it.
const GOOD_MAP: &[u8] = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
    property float z\nproperty float opacity\nproperty float scale_0\nproperty float scale_1\nproperty float scale_2\n\
    property float rot_0\nproperty float rot_1\nproperty float rot_2\nproperty float rot_3\nend_header\n\
    1 2 0 0 -3 -3 -3 1 0 0 0\n";

#[test]
fn why_a_place_is_sure_or_not_can_be_asked_of_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply").display().to_string();
    Program::echosplat(&replay(&["--map", &map])).wait_exit_code(0, LONG);
    let found = echosplat_recording::ply::read_map(Path::new(&map)).unwrap();
    for standing in [Standing::Confident, Standing::Ambiguous] {
        let of_standing = |gaussian: &&Gaussian| gaussian.standing == standing;
        let one = found
            .gaussians
            .iter()
            .find(of_standing)
            .expect("the dive has both");
        assert_ne!(one.why, Why::default());
        let place_m = found.origin_m + one.mean_m.as_dvec3();
        let asked = format!("--why={},{},{}", place_m.x, place_m.y, place_m.z);
        let told = info_json(&[&map, &asked]);
        assert!(
            told["gaussians"].is_u64() && told["why"]["lack"].is_null(),
            "{told}"
        );
        let nearest = &told["why"]["gaussians"][0];
        assert_eq!(nearest["reason"], one.why.reason.name(), "{told}");
        assert_eq!(nearest["words"], one.why.to_string());
        assert_eq!(nearest["standing"], serde_json::to_value(standing).unwrap());
        let text = info(&[&map, &asked]).stdout();
        assert!(text.contains(&one.why.to_string()), "{text}");
    }
    let far = info(&[&map, "--why", "-500,0,0"]).stdout();
    assert!(
        far.contains("no Gaussian within 0.30 m of -500 0 0"),
        "{far}"
    );
    for (file, why, words) in [
        (&*file("dive.tum"), "0,0,0", "--why asks a map"),
        (&*map, "0,0", "three numbers"),
    ] {
        let mut refused = Program::echosplat(&["info", file, "--why", why]);
        refused.wait_exit_code(2, LONG);
        assert!(refused.stderr().contains(words), "{}", refused.account());
    }
}
