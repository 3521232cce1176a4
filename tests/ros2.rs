//! Nodes of ROS 2 with `rmw_zenoh` find the service, hear the map, and steer it: nodes written here
//! from zenoh up, and nodes of `zenoh-ros2-sdk`, which shares nothing with our code.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use echosplat_recording::ply::read_map;
use echosplat_ros::rmw_zenoh::{Attachment, EndpointKind, Gid, NAV_SAT_FIX, Node, ODOMETRY, Topic};
use echosplat_ros::{CdrError, CdrReader, Header, NavSatFix, odometry};
use serde_json::Value;
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

use crate::dive::{file, replay};
use crate::fake_sonar::{FakeSonar, now, pose_at, profile};
use crate::harness::{Program, free_port};
use crate::link::newest_count;
use crate::python::ros2_node;

const LONG: Duration = Duration::from_secs(90);
const DOMAIN: u32 = 7;

/// zenoh as `settings` say, else as it is by default without multicast.
fn session(settings: &[(&str, String)]) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let quiet = ("scouting/multicast/enabled", "false".to_owned());
    for (key, value) in settings.iter().chain([&quiet]) {
        config
            .insert_json5(key, value)
            .expect("zenoh has the setting");
    }
    zenoh::open(config).wait().expect("zenoh opens")
}

/// A router as `rmw_zenohd` is: it tells nodes of one another and passes nothing on between peers.
fn router() -> (zenoh::Session, u16) {
    let port = free_port();
    let router = session(&[
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
        (
            "routing/router/peers_failover_brokering",
            "false".to_owned(),
        ),
    ]);
    (router, port)
}

/// A session as `rmw_zenoh` opens one.
fn node_session(router_port: u16) -> zenoh::Session {
    session(&[
        ("mode", "\"peer\"".to_owned()),
        ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]".to_owned()),
        (
            "connect/endpoints",
            format!("[\"tcp/127.0.0.1:{router_port}\"]"),
        ),
    ])
}

/// A configuration for ROS, and the arguments by which the service finds its nodes.
fn for_ros(folder: &tempfile::TempDir, router_port: u16) -> Vec<String> {
    let path = folder.path().join("ros.toml");
    let text = format!("[bus]\nros_domain_id = {DOMAIN}\n");
    fs::write(&path, text).expect("the folder is writable");
    let manifest = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let zenoh = manifest.join("../../config/zenoh-ros2.json5");
    let connect = format!("connect/endpoints=[\"tcp/127.0.0.1:{router_port}\"]");
    let text = |path: PathBuf| path.display().to_string();
    let config = ["--config".to_owned(), text(path)];
    let zenoh = [
        "--zenoh-config".to_owned(),
        text(zenoh),
        "--zenoh".to_owned(),
        connect,
    ];
    config.into_iter().chain(zenoh).collect()
}

/// Messages under these keys.
fn heard(session: &zenoh::Session, keys: String) -> (Subscriber<()>, Receiver<Sample>) {
    let (sender, samples) = channel();
    let subscriber = session.declare_subscriber(keys);
    let subscriber = subscriber.callback(move |sample| drop(sender.send(sample)));
    (subscriber.wait().expect("zenoh subscribes"), samples)
}

/// Tokens of this kind that are there.
fn tokens(session: &zenoh::Session, kind: &str) -> BTreeSet<String> {
    let asked = session
        .liveliness()
        .get(format!("@ros2_lv/{DOMAIN}/*/*/*/{kind}/**"));
    let replies = asked.wait().expect("zenoh asks");
    let key = |sample: &Sample| sample.key_expr().as_str().to_owned();
    let found = std::iter::from_fn(|| replies.recv().ok());
    found
        .filter_map(|reply| reply.result().ok().map(key))
        .collect()
}

fn until<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let begin = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(begin.elapsed() < LONG, "never: {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn is_of(sample: &Sample, topic: &str) -> bool {
    sample.key_expr().as_str().contains(topic)
}

/// Width of a cloud of x, y, z, intensity and sigma, and the largest sigma.
fn width_and_sigma(sample: &Sample) -> Result<(u64, f32), CdrError> {
    let bytes = sample.payload().to_bytes();
    let mut reader = CdrReader::new(&bytes)?;
    Header::read(&mut reader)?;
    reader.u32("height")?;
    let (width, fields) = (reader.u32("width")?, reader.u32("fields")?);
    let mut names = Vec::new();
    for _ in 0..fields {
        names.push(reader.string("name", 63)?.to_owned());
        reader.u32("offset")?;
        reader.u8("datatype")?;
        reader.u32("count")?;
    }
    assert_eq!(names, ["x", "y", "z", "intensity", "sigma"]);
    reader.u8("is_bigendian")?;
    reader.u32("point_step")?;
    reader.u32("row_step")?;
    let count = reader.count("data", bytes.len())?;
    let data = reader.bytes("data", count)?;
    assert_eq!(count, width as usize * 20);
    let sigmas = data
        .chunks_exact(20)
        .map(|point| f32::from_le_bytes(*point[16..].first_chunk().expect("20 bytes")));
    Ok((u64::from(width), sigmas.fold(0.0, f32::max)))
}

#[test]
fn the_cloud_that_nodes_hear_is_what_the_map_asserts() {
    let folder = tempfile::tempdir().unwrap();
    let (_router, port) = router();
    let node = node_session(port);
    let (_subscriber, samples) = heard(&node, format!("{DOMAIN}/echosplat/replay/points/**"));
    let mut arguments = replay(&["--rate", "5", "--publish", "--json"]);
    arguments.extend(for_ros(&folder, port));
    let mut service = Program::echosplat(&arguments);
    let published = until("three publishers", || {
        let found = tokens(&node, "MP");
        (found.len() == 3).then_some(found)
    });
    until("its node", || {
        (tokens(&node, "NN").len() == 1).then_some(())
    });
    service.wait_exit_code(0, LONG);
    until("their tokens are gone", || {
        tokens(&node, "*").is_empty().then_some(())
    });

    let clouds: Vec<Sample> = samples.try_iter().collect();
    let asserted = service.only_json()["gaussians"].as_u64();
    let (width, sigma_m) = width_and_sigma(clouds.last().expect("a cloud")).unwrap();
    assert!(width > 0 && Some(width) == asserted, "{width} {asserted:?}");
    assert!(sigma_m > 0.001 && sigma_m < 10.0, "{sigma_m}");
    let token = published.iter().find(|token| token.contains("%points/"));
    let gid = Gid::of_token(token.expect("the cloud's publisher has a token"));
    let mut before = 0;
    for cloud in &clouds {
        let bytes = cloud
            .attachment()
            .expect("every message has one")
            .to_bytes();
        let attachment = Attachment::from_bytes(&bytes).expect("33 bytes");
        assert_eq!(attachment.gid, gid);
        assert!(
            attachment.sequence > before,
            "{attachment:?} after {before}"
        );
        before = attachment.sequence;
    }
}

#[test]
fn odometry_of_a_node_drives_the_map_and_the_vehicle_is_told_of() {
    let folder = tempfile::tempdir().unwrap();
    let (_router, port) = router();
    let node = node_session(port);
    let odom = Topic {
        name: "/rov/odom".to_owned(),
        message: ODOMETRY,
        depth: 10,
    };
    let (_subscriber, samples) = heard(&node, format!("{DOMAIN}/**"));
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let url = sonar.url();
    let own = [
        "run",
        "--sonar",
        &url,
        "--pose",
        "ros2:///rov/odom",
        "--verbose",
    ];
    let mut arguments: Vec<String> = own.map(ToOwned::to_owned).into();
    arguments.extend(for_ros(&folder, port));
    let mut service = Program::echosplat(&arguments);
    let taker = until("a subscription", || tokens(&node, "MS").pop_first());
    let zenoh_id = taker.split('/').nth(2).unwrap().to_owned();
    let of_service = Node {
        domain_id: DOMAIN,
        zenoh_id,
        namespace: "/echosplat/vehicle".to_owned(),
        name: "echosplat".to_owned(),
    };
    let expected = of_service.endpoint_token(EndpointKind::Subscription, 1, &odom);
    assert_eq!(taker, expected);

    let publisher = node.declare_publisher(odom.key(DOMAIN)).wait().unwrap();
    let begin = Instant::now();
    let put = || {
        let seconds = begin.elapsed().as_secs_f64();
        let message = odometry::encode(&pose_at(now(), seconds), "odom", "base_link");
        publisher.put(message).wait().unwrap();
        std::thread::sleep(Duration::from_millis(20));
    };
    service.wait_for("pings in the map", LONG, |service| {
        put();
        newest_count(&service.stderr(), "pings_mapped").filter(|&count| count > 40)
    });
    let (mut vehicle, mut frames, mut cloud) = (None, None, None);
    until("all three topics", || {
        put();
        for sample in samples.try_iter() {
            if is_of(&sample, "/echosplat/vehicle/odometry/") {
                vehicle = Some(odometry::decode(&sample.payload().to_bytes()).unwrap());
            } else if is_of(&sample, "/tf/") {
                frames = Some(sample);
            } else if is_of(&sample, "/points/") {
                cloud = Some(sample);
            }
        }
        (vehicle.is_some() && frames.is_some() && cloud.is_some()).then_some(())
    });
    let vehicle = vehicle.expect("it was waited for");
    let age_s = now().seconds_since(vehicle.time);
    assert!(age_s > 0.0 && age_s < 90.0, "{age_s}");
    let place_m = vehicle.world_from_vehicle.translation_m;
    assert!(
        place_m.y > 0.0 && place_m.x.abs() < 1e-6,
        "it moves along y: {place_m}"
    );
    service.interrupt();
    service.wait_exit(Duration::from_secs(10));
}

/// Puts odometry fifty times a second as a node does, `x_m` aside, until dropped.
struct SteeringNode {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl SteeringNode {
    fn start(router_port: u16, name: &str, token_end: &'static str, x_m: f64) -> Self {
        let session = node_session(router_port);
        let topic = Topic {
            name: "/rov/odom".to_owned(),
            message: ODOMETRY,
            depth: 10,
        };
        let node = Node {
            domain_id: DOMAIN,
            zenoh_id: session.zid().to_string(),
            namespace: "/rov".to_owned(),
            name: name.to_owned(),
        };
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let token = node.endpoint_token(EndpointKind::Publisher, 1, &topic) + token_end;
            let gid = Gid::of_token(&token);
            let liveliness = session.liveliness().declare_token(&token);
            let _token = liveliness.wait().expect("zenoh declares");
            let begin = Instant::now();
            for sequence in 1.. {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                let mut pose = pose_at(now(), begin.elapsed().as_secs_f64());
                pose.world_from_vehicle.translation_m.x += x_m;
                let attachment = Attachment {
                    sequence,
                    source_time_ns: now().nanos(),
                    gid,
                };
                let message = odometry::encode(&pose, "odom", "base_link");
                let put = session.put(topic.key(DOMAIN), message);
                let put = put.attachment(attachment.to_bytes().to_vec());
                put.wait().expect("the session is open");
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        Self {
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for SteeringNode {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic in it has been printed.
            let _ = thread.join();
        }
    }
}

#[test]
fn two_nodes_on_one_topic_are_told_by_name_and_one_of_them_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let (_router, port) = router();
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let url = sonar.url();
    let own = [
        "run",
        "--sonar",
        &url,
        "--pose",
        "ros2:///rov/odom",
        "--verbose",
    ];
    let mut arguments: Vec<String> = own.map(ToOwned::to_owned).into();
    arguments.extend(for_ros(&folder, port));
    let mut service = Program::echosplat(&arguments);
    // As Lyrical writes tokens since July 2026.
    let _first = SteeringNode::start(port, "ekf", "/backends:cpu", 0.0);
    service.wait_for("pings in the map", LONG, |service| {
        newest_count(&service.stderr(), "pings_mapped").filter(|&count| count > 20)
    });
    let _second = SteeringNode::start(port, "slam", "", 5.0);
    for words in [
        "a second source sends poses 5.",
        "poses of node /rov/ekf are used",
        "those of node /rov/slam",
    ] {
        service.wait_for_text(words, LONG);
    }
    service.terminate();
    service.wait_exit_code(3, Duration::from_secs(20));
    let log = service.stderr();
    assert!(!log.contains("a new map begins"), "{log}");
}

#[test]
fn nav_sat_fix_of_a_node_places_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let (_router, port) = router();
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let (url, map) = (sonar.url(), folder.path().join("map.ply"));
    let map_name = map.display().to_string();
    let own = [
        "run",
        "--sonar",
        &url,
        "--pose",
        "ros2:///rov/odom",
        "--map",
        &map_name,
    ];
    let mut arguments: Vec<String> = own.map(ToOwned::to_owned).into();
    arguments.extend(for_ros(&folder, port));
    let config = folder.path().join("ros.toml");
    let text =
        fs::read_to_string(&config).unwrap() + "[georeference]\ngnss = \"ros2:///gps/fix\"\n";
    fs::write(&config, text).unwrap();
    let mut service = Program::echosplat(&arguments);
    let begin = Instant::now();
    let _vehicle = SteeringNode::start(port, "ekf", "", 0.0);
    let session = node_session(port);
    let topic = Topic {
        name: "/gps/fix".to_owned(),
        message: NAV_SAT_FIX,
        depth: 10,
    };
    let put = |message: Vec<u8>| drop(session.put(topic.key(DOMAIN), message).wait());
    service.wait_for("a place by 30 fixes", LONG, |service| {
        let there_m = 0.3 * begin.elapsed().as_secs_f64();
        let fix = NavSatFix {
            stamp: now(),
            status: 0,
            // 111,415 m a degree.
            latitude_deg: 60.17 + there_m / 111_415.0,
            longitude_deg: 24.94,
            altitude_m: f64::NAN,
            covariance_m2: [0.0; 9],
            covariance_type: 0,
        };
        put(fix.encode("gps"));
        put(NavSatFix {
            status: -1,
            latitude_deg: 0.0,
            ..fix
        }
        .encode("gps"));
        put(NavSatFix {
            latitude_deg: 95.0,
            ..fix
        }
        .encode("gps"));
        put(vec![0, 1, 0]);
        let is_placed = service.stderr().contains("30 GNSS fixes beside poses");
        is_placed.then_some(())
    });
    service.terminate();
    service.wait_exit(Duration::from_secs(30));
    let place = read_map(&map).unwrap().notes.georeference;
    let place = place.expect("it was told");
    assert!(
        (place.place.latitude_deg - 60.17).abs() * 111_415.0 < 1.0,
        "{place:?}"
    );
    assert_eq!(place.datum.name(), "surface");
}

fn said(program: &Program, topic: &str) -> Vec<Value> {
    let lines = program.stdout();
    let said = lines
        .lines()
        .filter_map(|line| serde_json::from_str(line).ok());
    said.filter(|value: &Value| value["topic"] == topic)
        .collect()
}

#[test]
fn nodes_of_the_sdk_discover_and_decode_map_odometry_and_frames() {
    let folder = tempfile::tempdir().unwrap();
    let (_router, port) = router();
    let (router_port, domain) = (port.to_string(), DOMAIN.to_string());
    let where_ = ["--router", &router_port, "--domain", &domain];
    let mut node = ros2_node(&[&["hear"][..], &where_, &["/echosplat/replay"]].concat());
    let mut arguments = replay(&["--rate", "2", "--publish", "--json"]);
    arguments.extend(for_ros(&folder, port));
    let mut service = Program::echosplat(&arguments);
    service.wait_exit_code(0, LONG);
    let asserted = &service.only_json()["gaussians"];
    let is_whole = |cloud: &Value| &cloud["count"] == asserted;
    let last = node.wait_for("the whole map", LONG, |node| {
        said(node, "points").pop().filter(is_whole)
    });

    let topic = |leaf: &str| said(&node, &format!("/echosplat/replay/{leaf}"));
    for (leaf, kind) in [
        ("points", "sensor_msgs/msg/PointCloud2"),
        ("odometry", "nav_msgs/msg/Odometry"),
    ] {
        let [info] = &topic(leaf)[..] else {
            panic!("{leaf}\n{}", node.account())
        };
        assert_eq!(info["node"], "echosplat", "{info}");
        assert_eq!(info["types"], serde_json::json!([kind]), "{info}");
        assert_eq!(info["namespace"], "/echosplat/replay", "{info}");
        assert_eq!(info["qos"], "::,10:,:,:,,", "{info}");
    }
    assert_eq!(
        last["fields"],
        serde_json::json!(["x", "y", "z", "intensity", "sigma"])
    );
    assert_eq!(last["frame"], "map");
    let largest = |field: &str| last["spread"][field][1].as_f64().unwrap();
    assert!(
        largest("sigma") > 0.001 && largest("sigma") < 10.0,
        "{last}"
    );
    assert!(
        largest("x").abs() < 100.0 && largest("intensity") > 0.0,
        "{last}"
    );
    let odometry = said(&node, "odometry");
    assert!(
        odometry.iter().any(|told| told["child"] == "base_link"),
        "{}",
        node.account()
    );
    let frames = said(&node, "tf").pop().expect("transforms")["frames"].clone();
    let expected = serde_json::json!([["map", "base_link"], ["base_link", "sonar_link"]]);
    assert_eq!(frames, expected);
}

#[test]
fn odometry_of_the_sdk_drives_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let (_router, port) = router();
    let sonar = FakeSonar::start(|i| profile(i, |_| {}));
    let url = sonar.url();
    let own = [
        "run",
        "--sonar",
        &url,
        "--pose",
        "ros2://rov/odom",
        "--verbose",
    ];
    let mut arguments: Vec<String> = own.map(ToOwned::to_owned).into();
    arguments.extend(for_ros(&folder, port));
    let mut service = Program::echosplat(&arguments);
    let (router_port, domain, poses) = (port.to_string(), DOMAIN.to_string(), file("dive.tum"));
    let _vehicle = ros2_node(&[
        "steer",
        "--router",
        &router_port,
        "--domain",
        &domain,
        "/rov/odom",
        &poses,
    ]);
    service.wait_for("pings in the map", LONG, |service| {
        newest_count(&service.stderr(), "pings_mapped").filter(|&count| count > 40)
    });
    service.interrupt();
    service.wait_exit(Duration::from_secs(10));
}
