//! What nodes of ROS 2 find and hear, and how their odometry comes in.

use std::collections::BTreeSet;

use echosplat_model::{Ping, PingSettings, PoseUncertainty, PosedPing, Twist};
use echosplat_ros::rmw_zenoh::{Attachment, Gid};
use echosplat_ros::{CdrReader, Header, odometry};
use zenoh::pubsub::Publisher;
use zenoh::sample::{Sample, SampleKind};

use super::*;
use crate::{PoseSubscription, ReceivedPose};

const ODOMETRY_TYPE: &str = "nav_msgs::msg::dds_::Odometry_";
const HASHED: &str = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0";

/// A vehicle with ROS, and a session beside it.
fn with_ros() -> (Bus, Bus) {
    let endpoints = format!("['tcp/127.0.0.1:{}']", free_port());
    let vehicle = BusConfig {
        node: "rov-1".to_owned(),
        ros_domain_id: Some(7),
        ..config(&endpoints, &endpoints)
    };
    let other = Bus::open(config(&endpoints, &endpoints)).unwrap();
    (Bus::open(vehicle).unwrap(), other)
}

/// Tokens that are there.
fn tokens(bus: &Bus) -> BTreeSet<String> {
    let liveliness = bus.session_for_tests().liveliness();
    let replies = liveliness.get("@ros2_lv/7/**").wait().unwrap();
    let key = |sample: &Sample| sample.key_expr().as_str().to_owned();
    let keys = std::iter::from_fn(|| replies.recv().ok());
    keys.filter_map(|reply| reply.result().ok().map(key))
        .collect()
}

fn posed(mount: Pose) -> PosedPing {
    let settings = PingSettings {
        range_start_m: 0.0,
        range_length_m: 10.0,
        bin_count: 1,
        speed_of_sound_mps: 1500.0,
        frequency_hz: 0.0,
        pulse_duration_s: 0.0,
        gain_index: 0,
    };
    let sigma = PoseUncertainty {
        position_m: 0.5,
        attitude_rad: 0.25,
    };
    let ping = Ping::new(1, Timestamp::from_millis(5000), settings, vec![0.0]).unwrap();
    PosedPing {
        ping: Arc::new(ping),
        world_from_sensor: pose(0).world_from_vehicle * mount,
        twist: Twist::default(),
        reference_range_m: 0.0,
        uncertainty: Some(sigma),
        jitter: None,
    }
}

#[test]
fn a_node_is_there_with_its_topics_while_it_publishes() {
    let (vehicle, other) = with_ros();
    assert_eq!(tokens(&other), BTreeSet::new());
    let publisher = vehicle.publish_ros(Pose::IDENTITY).unwrap().unwrap();
    let taken = vehicle.subscribe_poses_of_ros("odom").unwrap();
    let of_node = format!("@ros2_lv/7/{}/0", vehicle.zenoh_id());
    let node = "%/%echosplat%rov_1/echosplat";
    let mut ends = Vec::new();
    until("all tokens are there", || {
        let found = tokens(&other);
        ends = found
            .iter()
            .map(|token| token.strip_prefix(&of_node).unwrap().to_owned())
            .collect();
        ends.len() == 5
    });
    assert_eq!(ends[0], format!("/0/NN/{node}"));
    let topics = [
        "%tf/",
        "%echosplat%rov_1%points/",
        "%echosplat%rov_1%odometry/",
    ];
    for (id, topic) in (1..).zip(topics) {
        let begin = format!("/{id}/MP/{node}/{topic}");
        assert!(
            ends.iter().any(|end| end.starts_with(&begin)),
            "{begin} is none of {ends:?}"
        );
    }
    let subscription = format!("/4/MS/{node}/%odom/{ODOMETRY_TYPE}/{HASHED}/::,10:,:,:,,");
    assert!(ends.contains(&subscription), "{ends:?}");
    drop(taken);
    until("the subscription's token is gone", || {
        tokens(&other).len() == 4
    });
    drop(publisher);
    close(vehicle);
    until("the node is gone", || tokens(&other).is_empty());
}

#[test]
fn map_odometry_and_transforms_arrive_with_their_attachments() {
    let (vehicle, other) = with_ros();
    let (sender, received) = std::sync::mpsc::channel();
    let subscriber = other.session_for_tests().declare_subscriber("7/**");
    let _subscriber = subscriber
        .callback(move |sample| drop(sender.send(sample)))
        .wait()
        .unwrap();
    let mount = Pose::from_yaw_pitch_roll(0.5, 0.0, 0.0, DVec3::new(0.3, 0.0, -0.1));
    let publisher = vehicle.publish_ros(mount).unwrap().unwrap();
    publisher.offer(round(2));
    publisher.posed(&posed(mount));
    assert!(publisher.flush(LONG));

    let mut by_topic = std::collections::BTreeMap::new();
    while by_topic.len() < 3 {
        assert!(publisher.flush(LONG));
        while let Ok(sample) = received.recv_timeout(Duration::from_millis(200)) {
            let topic = sample
                .key_expr()
                .as_str()
                .split("/RIHS01_")
                .next()
                .unwrap()
                .to_owned();
            let of_topic: &mut Vec<Sample> = by_topic.entry(topic).or_default();
            of_topic.push(sample);
        }
    }
    let topics: Vec<&str> = by_topic.keys().map(String::as_str).collect();
    let own = "7/echosplat/rov_1";
    assert_eq!(
        topics,
        [
            format!("{own}/odometry/{ODOMETRY_TYPE}"),
            format!("{own}/points/sensor_msgs::msg::dds_::PointCloud2_"),
            "7/tf/tf2_msgs::msg::dds_::TFMessage_".to_owned(),
        ]
    );
    let tokens = tokens(&other);
    for samples in by_topic.values() {
        attachments_count_and_name_their_publisher(samples, &tokens);
    }
    let bytes = |index: usize| {
        by_topic.values().nth(index).unwrap()[0]
            .payload()
            .to_bytes()
    };
    let found = odometry::decode(&bytes(0)).unwrap();
    assert_eq!(found.time, Timestamp::from_millis(5000));
    let off = found.world_from_vehicle.inverse() * pose(0).world_from_vehicle;
    assert!(
        off.translation_m.length() < 1e-9 && off.rotation.w.abs() > 1.0 - 1e-12,
        "{off:?}"
    );
    let cloud = bytes(1);
    let mut reader = CdrReader::new(&cloud).unwrap();
    let header = Header::read(&mut reader).unwrap();
    assert_eq!(
        (header.stamp, header.frame_id),
        (round(2).time, "map_local")
    );
    let counters = publisher.counters();
    assert!(counters.clouds >= 1 && counters.odometries >= 1 && counters.transforms >= 1);
    assert_eq!((counters.failed, counters.points_left_out), (0, 0));
}

/// In the order of sending, and by a gid that is made of a token that is there.
fn attachments_count_and_name_their_publisher(samples: &[Sample], tokens: &BTreeSet<String>) {
    let read = |sample: &Sample| {
        assert_eq!(sample.kind(), SampleKind::Put);
        Attachment::from_bytes(&sample.attachment().unwrap().to_bytes()).unwrap()
    };
    let attachments: Vec<Attachment> = samples.iter().map(read).collect();
    for pair in attachments.windows(2) {
        assert_eq!(pair[1].sequence, pair[0].sequence + 1);
        assert!(pair[1].source_time_ns >= pair[0].source_time_ns);
    }
    let topic = samples[0].key_expr().as_str().split('/').skip(1);
    let (topic, _) = topic
        .collect::<Vec<_>>()
        .join("/")
        .split_once("/RIHS01_")
        .map(|(t, h)| (t.to_owned(), h.len()))
        .unwrap();
    let (name, message) = topic.rsplit_once('/').unwrap();
    let part = format!("/%{}/{message}/", name.replace('/', "%"));
    let token = tokens.iter().find(|token| token.contains(&part)).unwrap();
    assert_eq!(attachments[0].gid, Gid::of_token(token));
    assert!(attachments[0].sequence >= 1);
}

/// A message is said again until the pose in it is taken, as a vehicle does: a link that broke and is there anew has
/// lost what was on it.
fn say_until_taken(
    publisher: &Publisher<'_>,
    message: &[u8],
    taken: &PoseSubscription,
    sent: &StampedPose,
) {
    let is_sent = |received: ReceivedPose| {
        let found = received.pose;
        found.time == sent.time && found.world_from_vehicle == sent.world_from_vehicle
    };
    until("it is taken", || {
        publisher.put(message).wait().unwrap();
        let mut new = std::iter::from_fn(|| taken.next_within(Duration::from_millis(100)));
        new.any(is_sent)
    });
}

#[test]
fn odometry_of_others_comes_in_whatever_its_types_hash() {
    let (vehicle, other) = with_ros();
    let taken = vehicle.subscribe_poses_of_ros("/rov/odom").unwrap();
    for (second, hash) in [(3, HASHED), (4, "TypeHashNotSupported")] {
        let sent = pose(second);
        let message = odometry::encode(&sent, "odom", "base_link");
        let key = format!("7/rov/odom/{ODOMETRY_TYPE}/{hash}");
        let publisher = other
            .session_for_tests()
            .declare_publisher(key)
            .congestion_control(CongestionControl::Block)
            .wait()
            .unwrap();
        say_until_taken(&publisher, &message, &taken, &sent);
        let malformed = taken.counters().malformed;
        until("what is cut is counted", || {
            publisher.put(&message[..100]).wait().unwrap();
            taken.counters().malformed > malformed
        });
    }
    until("each is counted once", || {
        let counters = taken.counters();
        counters.received == counters.accepted + counters.malformed
    });
}

/// Tokens of what `bus` takes of a topic, without what they begin and end with.
fn subscribed(bus: &Bus, topic: &str) -> Vec<String> {
    let found = tokens(bus).into_iter();
    let of_topic =
        found.filter(|token| token.contains(&format!("/MS/%/%echosplat%rov_1/echosplat/{topic}/")));
    let message = |token: String| token.split('/').nth(10).map(str::to_owned);
    of_topic.filter_map(message).collect()
}

#[test]
fn poses_of_other_messages_come_in_and_nodes_are_told_which() {
    let (vehicle, other) = with_ros();
    let sent = pose(3);
    let odometry = odometry::encode(&sent, "odom", "base_link");
    // Header and pose; with the covariance between.
    let mut header = CdrReader::new(&odometry).unwrap();
    Header::read(&mut header).unwrap();
    let of_pose = |extra: usize| {
        let mut writer = echosplat_ros::CdrWriter::with_capacity(400);
        let (stamp, frame_id) = (sent.time, "odom");
        Header { stamp, frame_id }.write(&mut writer);
        writer.f64s(&sent.world_from_vehicle.translation_m.to_array());
        writer.f64s(&sent.world_from_vehicle.rotation.to_array());
        writer.f64s(&vec![0.0; extra]);
        writer.finish()
    };
    let node = "@ros2_lv/7/abc/0/9/MP/%/%/driver";
    let session = other.session_for_tests();
    for (name, message) in [
        ("PoseStamped", of_pose(0)),
        ("PoseWithCovarianceStamped", of_pose(36)),
    ] {
        let taken = vehicle.subscribe_poses_of_ros("/rov/pose").unwrap();
        let dds = format!("geometry_msgs::msg::dds_::{name}_");
        // As of July 2026 a token may bear one field more.
        let token = format!("{node}/%rov%pose/{dds}/RIHS01_ab/::,10:,:,:,,/more");
        let token = session.liveliness().declare_token(token).wait().unwrap();
        until("nodes are told of that message alone", || {
            subscribed(&other, "%rov%pose") == [dds.clone()]
        });
        let publisher = session
            .declare_publisher(format!("7/rov/pose/{dds}/RIHS01_ab"))
            .congestion_control(CongestionControl::Block)
            .wait()
            .unwrap();
        say_until_taken(&publisher, &message, &taken, &sent);
        assert_eq!(taken.unfit(), None);
        token.undeclare().wait().unwrap();
        drop(taken);
        until("it is over", || subscribed(&other, "%rov%pose").is_empty());
    }
}

#[test]
fn a_topic_without_poses_is_named_as_what_it_is() {
    let (vehicle, other) = with_ros();
    let taken = vehicle.subscribe_poses_of_ros("/rov/points").unwrap();
    let token = "@ros2_lv/7/abc/0/9/MP/%/%/driver/%rov%points/sensor_msgs::msg::dds_::PointCloud2_/\
                 RIHS01_ab/::,10:,:,:,,";
    let session = other.session_for_tests();
    let token = session.liveliness().declare_token(token).wait().unwrap();
    until("it is told", || {
        let told = taken.unfit().unwrap_or_default();
        told.contains("/rov/points carries sensor_msgs/msg/PointCloud2")
    });
    token.undeclare().wait().unwrap();
    until("it is over", || taken.unfit().is_none());
}

#[test]
fn topics_that_poses_cannot_come_from_are_refused_in_words() {
    let (vehicle, other) = with_ros();
    let refused = |bus: &Bus, topic| bus.subscribe_poses_of_ros(topic).unwrap_err().to_string();
    let own = refused(&vehicle, "/echosplat/rov_1/odometry");
    assert!(own.contains("publishes itself"), "{own}");
    let illegal = refused(&vehicle, "rov-1/odom");
    assert!(
        illegal.contains("\"rov-1/odom\" is no ROS topic"),
        "{illegal}"
    );
    let unasked = refused(&other, "/odom");
    assert!(unasked.contains("bus.ros_domain_id"), "{unasked}");
    assert!(other.publish_ros(Pose::IDENTITY).unwrap().is_none());
}

/// A node's publisher of odometry: its token, and what it signs messages with.
fn publisher_token(bus: &Bus, node: &str, topic: &str, more: &str) -> String {
    let (zenoh_id, topic) = (bus.zenoh_id(), topic.replace('/', "%"));
    format!(
        "@ros2_lv/7/{zenoh_id}/0/1/MP/%/%{node}/ekf/{topic}/{ODOMETRY_TYPE}/{HASHED}/::,10:,:,:,,{more}"
    )
}

#[test]
fn publishers_of_a_topic_are_known_by_their_nodes_whatever_their_tokens_end_in() {
    let (vehicle, other) = with_ros();
    let taken = vehicle.subscribe_poses_of_ros("/rov/odom").unwrap();
    let session = other.session_for_tests();
    let declared = ["", "/backends:cuda,cpu"].map(|more| {
        let node = if more.is_empty() { "old" } else { "new" };
        let token = publisher_token(&other, node, "/rov/odom", more);
        let kept = session.liveliness().declare_token(&token).wait().unwrap();
        (node, Gid::of_token(&token), kept)
    });
    let elsewhere = publisher_token(&other, "rov2", "/rov2/odom", "/backends:cpu");
    let elsewhere = session
        .liveliness()
        .declare_token(&elsewhere)
        .wait()
        .unwrap();
    let message = odometry::encode(&pose(3), "odom", "base_link");
    for (node, gid, _) in &declared {
        let attachment = Attachment {
            sequence: 1,
            source_time_ns: 0,
            gid: *gid,
        };
        let name = format!("node /{node}/ekf");
        until("its poses bear its name", || {
            let key = format!("7/rov/odom/{ODOMETRY_TYPE}/{HASHED}");
            let put = session.put(&key, message.clone());
            put.attachment(attachment.to_bytes().to_vec())
                .wait()
                .unwrap();
            // What is put before the sessions know of each other is lost.
            let received = taken.next_within(Duration::from_millis(100));
            received.and_then(|pose| taken.name_of(pose.publisher)) == Some(name.clone())
        });
    }
    until("the other topic is seen", || {
        taken.other_topics().len() == 1
    });
    let [found] = &taken.other_topics()[..] else {
        panic!("{:?}", taken.other_topics())
    };
    assert_eq!(
        (found.topic.as_str(), found.node.as_str()),
        ("/rov2/odom", "/rov2/ekf")
    );
    drop(elsewhere);
    until("it is gone", || taken.other_topics().is_empty());
}

#[test]
fn sessions_that_stamp_what_they_put_are_told_apart() {
    let (vehicle, other) = with_ros();
    let poses = vehicle.subscribe_poses_on("rov/pose").unwrap();
    let session = other.session_for_tests();
    let json = crate::pose_message::encode_json(&pose(1), "map", "base_link");
    let mut found = None;
    until("a pose comes", || {
        session.put("rov/pose", json.clone()).wait().unwrap();
        found = poses.try_next();
        found.is_some()
    });
    let name = poses.name_of(found.unwrap().publisher);
    assert_eq!(name, Some(format!("zenoh session {}", other.zenoh_id())));
}
