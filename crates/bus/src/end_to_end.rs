//! Real sessions over loopback.

mod epochs;
mod frames;
mod frozen;
mod guarded;
mod ros;
mod routers;
mod schedules;
mod services;

use std::net::TcpListener;
use std::sync::Arc;
use std::time::{Duration, Instant};

use echosplat_model::{Delta, Pose, PoseCovariance, Snapshot, StampedPose, TileKey, Timestamp};
use glam::{DVec3, Vec3};
use zenoh::Wait;
use zenoh::qos::CongestionControl;
use zenoh::query::ConsolidationMode;

use crate::map_message::{Cut, MapMessage};
use crate::test_support::{gaussian, same, snapshot};
use crate::{Bus, BusConfig, BusError, Liveliness};

const LONG: Duration = Duration::from_secs(30);

fn free_port() -> u16 {
    crate::free_port().unwrap()
}

fn config(connect: &str, listen: &str) -> BusConfig {
    let setting = |key: &str, value: &str| (key.to_owned(), value.to_owned());
    BusConfig {
        node: "test".to_owned(),
        zenoh: vec![
            setting("connect/endpoints", connect),
            setting("listen/endpoints", listen),
        ],
        publish_interval_s: 0.02,
        idle_check_s: 0.2,
        // A machine that does much else takes its time.
        open_timeout_s: 60.0,
        close_timeout_s: 30.0,
        ..BusConfig::default()
    }
}

/// Zenoh itself waits no longer than 10 s for a session's tasks to end, which is too short for a
/// machine that stands still now and then. What the session had declared is gone all the same.
fn close(bus: Bus) {
    if let Err(error) = bus.close() {
        let words = error.to_string();
        let is_late = matches!(error, BusError::TimedOut { .. }) || words.contains("timed out");
        assert!(is_late, "{words}");
    }
}

/// Two sessions on one port, each told to listen there and to connect there, as by default.
fn pair() -> (Bus, Bus) {
    let endpoints = format!("['tcp/127.0.0.1:{}']", free_port());
    let open = || Bus::open(config(&endpoints, &endpoints)).unwrap();
    let (first, mut second) = (open(), open());
    until("one that opens has met the other", || {
        let met = second.endpoints().connected_count == 1;
        if !met {
            second = open();
        }
        met
    });
    (first, second)
}

fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !holds() {
        assert!(begin.elapsed() < LONG, "never: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Round `n` of a map that grows, moves and loses members.
fn round(n: u32) -> Arc<Snapshot> {
    let member = |id: u32| {
        let mut g = gaussian(id);
        g.mean_m += Vec3::splat(0.3) * ((id + n) % 11) as f32;
        g
    };
    let members = (0..400 + 40 * n).filter(|id| !(id + n).is_multiple_of(13));
    snapshot(7, u64::from(n), members.map(member).collect())
}

fn pose(seconds: i64) -> StampedPose {
    StampedPose {
        time: Timestamp::from_millis(seconds * 1000),
        world_from_vehicle: Pose::from_yaw_pitch_roll(0.1, 0.2, 0.3, DVec3::new(0.1, 2.0, -3.3)),
        uncertainty: Some(PoseCovariance::alike(0.5, 0.25)),
        epoch: 2,
    }
}

#[test]
fn a_port_held_by_no_zenoh_is_told() {
    let stranger = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", stranger.local_addr().unwrap());
    let endpoints = format!("['{endpoint}']");
    let bus = Bus::open(config(&endpoints, &endpoints)).unwrap();
    let warnings = &bus.endpoints().warnings;
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].contains(&endpoint), "{warnings:?}");
    // While it is there, the next try to connect to it waits for its answer.
    drop(stranger);
    close(bus);

    let (first, second) = pair();
    for bus in [&first, &second] {
        assert_eq!(bus.endpoints().warnings, Vec::<String>::new());
    }
}

#[test]
fn only_what_is_open_is_said_to_be_listened_on() {
    let (first, second) = pair();
    let (first, second) = (first.endpoints(), second.endpoints());
    assert_eq!(first.listen, first.connect);
    assert_eq!(first.not_listening, vec![]);
    assert_eq!(second.listen, Vec::<String>::new());
    assert_eq!(second.not_listening[0].endpoint, first.listen[0]);
    assert_eq!(second.not_listening[0].reason, "in use by another program");
    let words = second.to_string();
    assert!(
        words.contains("could not listen on tcp/127.0.0.1:"),
        "{words}"
    );
    assert!(words.contains("connected to 1 other program"), "{words}");
    assert!(!words.contains("listening on"), "{words}");

    // TEST-NET-3 of RFC 5737: nobody has it.
    let nowhere = Bus::open(config("[]", "['tcp/203.0.113.9:7447']")).unwrap();
    assert_eq!(nowhere.endpoints().listen, Vec::<String>::new());
    let warnings = nowhere.endpoints().warnings.join("\n");
    let words = "could not listen on tcp/203.0.113.9:7447 (no interface of this machine has";
    assert!(warnings.contains(words), "{warnings}");
}

#[test]
fn who_was_not_there_at_first_is_met_once_it_is() {
    let here = format!("['tcp/127.0.0.1:{}']", free_port());
    let early = Bus::open(config(&here, "[]")).unwrap();
    let subscriber = early.subscribe_map().unwrap();
    let late = Bus::open(config("[]", &here)).unwrap();
    let publisher = late.publish_map().unwrap();
    publisher.offer(round(0));
    until("the map arrives", || subscriber.gaussian_count() > 0);
}

#[test]
fn a_status_that_no_subscriber_takes_is_refused_and_counted() {
    let bus = Bus::open(config("[]", "[]")).unwrap();
    let long = serde_json::json!({ "words": "x".repeat(300_000) });
    let refused = bus.publish_status(&long).unwrap_err().to_string();
    assert!(refused.contains("status has 3000"), "{refused}");
    bus.publish_status(&serde_json::json!({ "words": "x".repeat(200_000) }))
        .unwrap();
    let counters = bus.counters();
    assert_eq!((counters.statuses_sent, counters.statuses_failed), (1, 1));
}

#[test]
fn a_late_subscriber_ends_with_exactly_the_final_gaussians() {
    for publisher_first in [true, false] {
        let (first, second) = pair();
        let (sender, receiver) = match publisher_first {
            true => (first, second),
            false => (second, first),
        };
        let publisher = sender.publish_map().unwrap();
        let early = receiver.subscribe_map().unwrap();
        for n in 0..5 {
            publisher.offer(round(n));
            let seen = publisher.counters().deltas;
            until("the first deltas go", || publisher.counters().deltas > seen);
        }
        let late = receiver.subscribe_map().unwrap();
        for n in 5..8 {
            publisher.offer(round(n));
            let begin = late.position();
            let _ = late.wait_beyond(begin, Duration::from_millis(100));
        }
        let report = publisher.flush(LONG).unwrap();
        for subscriber in [&early, &late] {
            let map = subscriber.wait_final(LONG).unwrap();
            assert_eq!(
                (Some(map.epoch), map.sequence),
                (report.epoch, report.sequence)
            );
            assert!(same(&map.gaussians, &round(7).gaussians));
            assert_eq!(map.origin_m, round(7).origin_m);
            assert_eq!(map.through_ping, round(7).through_ping);
            assert_eq!(subscriber.counters().messages_malformed, 0);
        }
        assert_eq!(publisher.counters().messages_failed, 0);
        drop((early, late, publisher));
        close(sender);
        close(receiver);
    }
}

#[test]
fn who_joins_after_the_end_gets_the_final_map_and_a_new_one_after_it() {
    let (sender, receiver) = pair();
    let publisher = sender.publish_map().unwrap();
    publisher.offer(round(3));
    publisher.flush(LONG).unwrap();
    let subscriber = receiver.subscribe_map().unwrap();
    let map = subscriber.wait_final(LONG).unwrap();
    assert!(same(&map.gaussians, &round(3).gaussians));

    let mut next = (*round(1)).clone();
    next.epoch = 8;
    publisher.offer(Arc::new(next.clone()));
    until("the new epoch arrives", || {
        subscriber.position().is_some_and(|(epoch, _)| epoch == 8)
    });
    publisher.flush(LONG).unwrap();
    let map = subscriber.wait_final(LONG).unwrap();
    assert!(same(&map.gaussians, &next.gaussians));
}

/// A session that sends whatever it is told to.
fn stranger(bus: &Bus) -> zenoh::Session {
    let mut plain = zenoh::Config::default();
    let endpoints = serde_json::to_string(&bus.endpoints().connect).unwrap();
    for (key, value) in [
        ("scouting/multicast/enabled", "false"),
        ("listen/endpoints", "[]"),
        ("connect/endpoints", endpoints.as_str()),
    ] {
        plain.insert_json5(key, value).unwrap();
    }
    zenoh::open(plain).wait().unwrap()
}

#[test]
fn a_gap_is_fetched_and_nonsense_is_counted() {
    let (receiver, sender) = pair();
    let publisher = sender.publish_map().unwrap();
    let subscriber = receiver.subscribe_map().unwrap();
    publisher.offer(round(0));
    publisher.flush(LONG).unwrap();
    subscriber.wait_final(LONG).unwrap();

    let (epoch, sequence) = subscriber.position().unwrap();
    let ahead = Delta {
        epoch,
        sequence: sequence + 5,
        time: Timestamp::ZERO,
        through_ping: 0,
        origin_m: DVec3::ZERO,
        intensity_unit: 1.0,
        tile: TileKey::default(),
        gaussians: vec![gaussian(1)],
        removed: vec![],
    };
    let cut = Cut {
        max_message_bytes: 64_000,
        frame_id: "map",
    };
    let message = &cut.delta(&ahead, false)[0];
    let session = stranger(&receiver);
    let key = receiver.keys().delta(message.tile);
    let matching = session.declare_publisher(key.clone()).wait().unwrap();
    until("what it puts has a way", || {
        matching.matching_status().wait().unwrap().matching()
    });
    let put = |payload: &[u8], attachment: &[u8]| {
        let put = session.put(&key, payload).attachment(attachment);
        put.congestion_control(CongestionControl::Block)
            .wait()
            .unwrap();
    };
    put(b"nonsense", &message.attachment);
    put(&message.payload, b"{}");
    put(&vec![7; 900_000], &[b'['; 100_000]);
    put(&message.payload, &message.attachment);
    until("the gap is seen", || {
        subscriber.counters().assembler.gaps == 1
    });
    until("the answer came", || {
        subscriber.counters().assembler.snapshots_applied >= 2
    });
    assert_eq!(subscriber.counters().messages_malformed, 3);
    // What was forged lies beyond what the publisher ever sent and never gets in.
    let map = subscriber.newest().unwrap();
    assert!(same(&map.gaussians, &round(0).gaussians));
}

#[test]
fn poses_pings_and_status_arrive_and_bad_ones_are_counted() {
    let (receiver, sender) = pair();
    let poses = receiver.subscribe_poses().unwrap();
    let pings = receiver.subscribe_pings().unwrap();
    let status = receiver.subscribe_status().unwrap();
    until("the subscription is known", || sender.has_pose_subscriber());
    for seconds in 0..100 {
        sender.publish_pose(&pose(seconds)).unwrap();
    }
    for seconds in 0..100 {
        let received = poses.next_within(LONG).unwrap();
        assert_eq!(received.pose, pose(seconds));
    }
    let time = Timestamp::from_nanos(1_700_000_000_000_000_123);
    sender.publish_ping(b"BR frame"[..].into(), time);
    let ping = pings.next_within(LONG).unwrap();
    assert_eq!(
        (ping.frame.as_slice(), ping.host_time),
        (&b"BR frame"[..], time)
    );
    let sent = serde_json::json!({ "pings": 3 });
    sender.publish_status(&sent).unwrap();
    until("the status arrives", || {
        status.take_newest() == Some(sent.clone())
    });

    let session = stranger(&receiver);
    let put = |payload: &str, encoding: &'static str| {
        let put = session
            .put(receiver.keys().pose(), payload)
            .encoding(encoding);
        put.congestion_control(CongestionControl::Block)
            .wait()
            .unwrap();
    };
    let json =
        |w: &str| format!(r#"{{"stamp_ns":1,"position":[0,0,0],"orientation_xyzw":[0,0,0,{w}]}}"#);
    put(&json("0"), "application/json");
    put(&json("1e999"), "application/json");
    put(&json("1"), "text/plain");
    put("x", "application/cdr;nav_msgs/msg/Odometry");
    put(&json("1"), "application/json");
    assert_eq!(
        poses.next_within(LONG).unwrap().pose.time,
        Timestamp::from_nanos(1)
    );
    // A pose is handed on first and counted then. JSON is taken whatever its encoding.
    until("all are counted", || poses.counters().accepted >= 102);
    let counters = poses.counters();
    assert_eq!((counters.received, counters.accepted), (105, 102));
    assert_eq!((counters.bad_quaternion, counters.malformed), (1, 2));
    let fault = poses.first_fault().unwrap();
    assert!(fault.contains("quaternion has length 0"), "{fault}");
}

#[test]
fn a_full_queue_drops_the_newest_pose_and_counts_it() {
    let bus = Bus::open(BusConfig {
        pose_queue_len: 3,
        ..config("[]", "[]")
    });
    let bus = bus.unwrap();
    let poses = bus.subscribe_poses().unwrap();
    for seconds in 0..5 {
        bus.publish_pose(&pose(seconds)).unwrap();
    }
    until("all came", || poses.counters().received == 5);
    assert_eq!(poses.counters().dropped_full, 2);
    assert_eq!(
        poses.try_next().map(|received| received.pose),
        Some(pose(0))
    );
}

#[test]
fn the_publishers_end_is_seen_and_its_return_is_fetched_anew() {
    let port = free_port();
    let here = format!("['tcp/127.0.0.1:{port}']");
    let receiver = Bus::open(config("[]", &here)).unwrap();
    let subscriber = receiver.subscribe_map().unwrap();
    assert_eq!(subscriber.liveliness(), Liveliness::Unknown);
    for n in [4, 2] {
        let sender = Bus::open(config(&here, "[]")).unwrap();
        let publisher = sender.publish_map().unwrap();
        let alive = sender.declare_alive("mapper").unwrap();
        until("it is alive", || {
            subscriber.liveliness() == Liveliness::Alive
        });
        publisher.offer(round(n));
        publisher.flush(LONG).unwrap();
        // The second has the epoch of the first, and a smaller sequence.
        until("the map arrives", || {
            let map = subscriber.wait_final(LONG).unwrap();
            same(&map.gaussians, &round(n).gaussians)
        });
        drop((alive, publisher));
        close(sender);
        until("it is gone", || subscriber.liveliness() == Liveliness::Gone);
    }
}

#[test]
fn a_box_gives_only_the_tiles_it_touches() {
    let bus = Bus::open(config("[]", "[]")).unwrap();
    let publisher = bus.publish_map().unwrap();
    publisher.offer(round(0));
    publisher.flush(LONG).unwrap();
    let session = bus.session_for_tests();
    let ask = |parameters: &str| {
        let selector = format!("{}?{parameters}", bus.keys().snapshot());
        let get = session.get(selector).consolidation(ConsolidationMode::None);
        let replies = get.wait().unwrap();
        let mut messages = Vec::new();
        while let Ok(reply) = replies.recv() {
            let sample = reply.into_result().map_err(|error| error.payload().len())?;
            let attachment = sample.attachment().unwrap().to_bytes().into_owned();
            messages.push(MapMessage::decode(&sample.payload().to_bytes(), &attachment).unwrap());
        }
        Ok::<_, usize>(messages)
    };
    let all = ask("").unwrap();
    let some = ask("bbox=-1,-1,-1,1,1,1").unwrap();
    assert!(some.len() < all.len() && !some.is_empty());
    assert!(some.iter().all(|m| (-1..=0).contains(&m.header.tile.x)));
    let sequence = all[0].header.sequence;
    let nothing = ask(&format!("since={sequence}")).unwrap();
    assert_eq!(nothing.len(), 1);
    assert!(nothing[0].header.is_final && nothing[0].gaussians.is_empty());
    assert!(ask("bbox=1,2").is_err());
    assert_eq!(publisher.counters().queries_refused, 1);
}

#[test]
fn offering_never_waits_and_the_newest_wins() {
    let bus = Bus::open(BusConfig {
        bandwidth_bps: 10_000,
        ..config("[]", "[]")
    });
    let bus = bus.unwrap();
    let publisher = bus.publish_map().unwrap();
    for n in 0..200 {
        publisher.offer(round(n % 20));
    }
    publisher.flush(LONG).unwrap();
    assert!(publisher.counters().snapshots_replaced > 0);
    let subscriber = bus.subscribe_map().unwrap();
    let map = subscriber.wait_final(LONG).unwrap();
    assert!(same(&map.gaussians, &round(19).gaussians));
}
