//! Records as bytes, and over real sessions.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use echosplat_model::{Pose, PoseCovariance, StampedPose, Timestamp};
use glam::DVec3;
use proptest::prelude::*;
use serde_json::json;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::query::{Query, Queryable};

use super::message::{decode, encode};
use super::*;
use crate::test_support::{bus_pair, bus_with};
use crate::{Bus, BusConfig};

const LONG: Duration = Duration::from_secs(30);
const SHORT: Duration = Duration::from_millis(50);

fn at(seconds: i64, entry: TapeEntry) -> TapeRecord {
    let host_time = Timestamp::from_millis(1000 * seconds);
    TapeRecord { host_time, entry }
}

fn pose(uncertainty: Option<PoseCovariance>) -> StampedPose {
    StampedPose {
        time: Timestamp::from_millis(-7),
        world_from_vehicle: Pose::from_yaw_pitch_roll(0.1, 0.2, 0.3, DVec3::new(0.1, -2e5, 3.3)),
        uncertainty,
        epoch: 4_000_000_000,
    }
}

fn one_of_each() -> Vec<TapeRecord> {
    let odd = PoseCovariance {
        position_m2: [f64::INFINITY, -1.0, 0.0, 1e6, 2.0, 0.1],
        attitude_rad2: [0.0, 9999.0, 1e-5],
    };
    vec![
        at(1, TapeEntry::LinkUp),
        at(2, TapeEntry::Bytes(Bytes::from_static(b"BR\x01"))),
        at(-3, TapeEntry::Pose(pose(None))),
        at(4, TapeEntry::Pose(pose(Some(odd)))),
        at(5, TapeEntry::HalfFrameExpired),
        at(6, TapeEntry::Bytes(Bytes::new())),
        at(7, TapeEntry::LinkDown),
        at(8, TapeEntry::End),
    ]
}

fn encoded(records: &[TapeRecord]) -> Bytes {
    records.iter().flat_map(encode).collect::<Vec<u8>>().into()
}

#[test]
fn every_record_comes_back_bit_for_bit() {
    let records = one_of_each();
    assert_eq!(decode(&encoded(&records), 8).unwrap(), records);
}

#[test]
fn sigmas_that_drivers_of_earlier_versions_tell_are_read() {
    let mut bytes = encode(&at(3, TapeEntry::Pose(pose(None))));
    let flag = bytes.len() - 4 - 17;
    bytes[flag] = 1;
    bytes[flag + 1..flag + 9].copy_from_slice(&0.5_f64.to_le_bytes());
    bytes[flag + 9..flag + 17].copy_from_slice(&0.1_f64.to_le_bytes());
    let expected = pose(Some(PoseCovariance::alike(0.5, 0.1)));
    assert_eq!(
        decode(&bytes.into(), 1).unwrap(),
        [at(3, TapeEntry::Pose(expected))]
    );
}

#[test]
fn what_is_no_answer_is_refused_by_name() {
    let payload = encoded(&one_of_each());
    let cut = payload.slice(..payload.len() - 1);
    assert_eq!(decode(&cut, 8), Err(TapeMessageError::Cut(7)));
    assert_eq!(decode(&payload, 7), Err(TapeMessageError::Rest(9)));
    assert_eq!(decode(&payload, u64::MAX), Err(TapeMessageError::Cut(8)));
    let mut odd = payload.to_vec();
    odd[0] = 9;
    let kind = TapeMessageError::Kind { number: 0, kind: 9 };
    assert_eq!(decode(&odd.into(), 8), Err(kind));
    let mut no_rotation = pose(None);
    no_rotation.world_from_vehicle.rotation *= 0.5;
    let payload = encoded(&[at(0, TapeEntry::Pose(no_rotation))]);
    assert_eq!(decode(&payload, 1), Err(TapeMessageError::Pose(0)));
}

proptest! {
    #[test]
    fn damage_never_panics(at in 0_usize..400, value: u8, count in 0_u64..20, cut in 0_usize..400) {
        let mut payload = encoded(&one_of_each()).to_vec();
        payload.truncate(cut.max(1));
        let place = at % payload.len();
        payload[place] = value;
        let _ = decode(&payload.into(), count);
    }
}

/// Hears until there are so many records, or no more within the bound.
fn heard(follower: &mut TapeFollower, count: usize) -> Vec<TapeRecord> {
    let begin = Instant::now();
    let mut records = Vec::new();
    while records.len() < count {
        assert!(
            begin.elapsed() < LONG,
            "{} of {count} records",
            records.len()
        );
        let heard = follower.hear(SHORT).unwrap();
        records.extend(heard.into_iter().flat_map(|heard| heard.records));
    }
    records
}

fn bytes(number: u32) -> TapeEntry {
    TapeEntry::Bytes(number.to_le_bytes().repeat(300).into())
}

#[test]
fn a_mapper_hears_what_was_and_what_comes_in_order_and_once() {
    let (vehicle, shore) = bus_pair();
    let keeper = vehicle.keep_tape(7, json!({"a": 1})).unwrap();
    for number in 0..500 {
        keeper.append(Timestamp::ZERO, bytes(number));
    }
    let mut follower = shore.follow_tape();
    let first = heard(&mut follower, 500);
    for number in 500..520 {
        keeper.append(Timestamp::ZERO, bytes(number));
    }
    let rest = heard(&mut follower, 20);
    let numbers = first.iter().chain(&rest).map(|record| &record.entry);
    assert!(numbers.eq((0..520).map(bytes).collect::<Vec<_>>().iter()));
    assert_eq!(keeper.append(Timestamp::ZERO, TapeEntry::End), 521);
    assert_eq!(heard(&mut follower, 1)[0].entry, TapeEntry::End);
    follower.acknowledge().unwrap();
    assert!(keeper.wait_taken(LONG, LONG), "{:?}", keeper.counters());
    let counters = follower.counters();
    assert_eq!((counters.records, counters.missing), (521, 0));
    assert_eq!(keeper.counters().missed, 0);
}

#[test]
fn what_is_no_longer_kept_is_counted_at_both_ends() {
    let endpoints = crate::test_support::endpoints();
    let vehicle = bus_with(&endpoints, |config| config.history_bytes = 1 << 20);
    let shore = bus_with(&endpoints, |_| {});
    let keeper = vehicle.keep_tape(7, json!({})).unwrap();
    for number in 0..2000 {
        keeper.append(Timestamp::ZERO, bytes(number));
    }
    let kept = keeper.counters();
    assert!(kept.oldest > 0 && kept.kept_bytes <= 1 << 20, "{kept:?}");
    let mut follower = shore.follow_tape();
    let records = heard(&mut follower, (2000 - kept.oldest) as usize);
    assert_eq!(records[0].entry, bytes(kept.oldest as u32));
    assert_eq!(follower.counters().missing, kept.oldest);
    assert_eq!(keeper.counters().missed, kept.oldest);
}

#[test]
fn a_driver_that_was_restarted_is_followed_from_its_beginning() {
    let (vehicle, shore) = bus_pair();
    let mut follower = shore.follow_tape();
    let first = vehicle.keep_tape(7, json!({"run": 1})).unwrap();
    first.append(Timestamp::ZERO, bytes(1));
    heard(&mut follower, 1);
    drop(first);
    let second = vehicle.keep_tape(8, json!({"run": 2})).unwrap();
    second.append(Timestamp::ZERO, bytes(2));
    let begin = Instant::now();
    let heard = loop {
        assert!(begin.elapsed() < LONG);
        let heard = follower.hear(SHORT).unwrap();
        if let Some(heard) = heard.filter(|heard| !heard.records.is_empty()) {
            break heard;
        }
    };
    assert_eq!((heard.driver, heard.first, heard.missing), (8, 0, 0));
    assert_eq!(heard.begin, Some(json!({"run": 2})));
    assert_eq!(follower.counters().restarts, 1);
}

#[test]
fn a_question_in_other_words_is_answered_with_what_would_be_right() {
    let (vehicle, shore) = bus_pair();
    let _keeper = vehicle.keep_tape(7, json!({})).unwrap();
    let ask = |shore: &Bus| {
        let selector = format!("{}?driver=7;from=x", shore.keys().tape());
        let replies = shore.session_for_tests().get(selector).wait().unwrap();
        replies.recv_timeout(LONG).ok().flatten()
    };
    let begin = Instant::now();
    let reply = loop {
        assert!(begin.elapsed() < LONG);
        if let Some(reply) = ask(&shore) {
            break reply;
        }
    };
    let error = reply.into_result().unwrap_err();
    let words = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
    assert!(words.contains("whole number"), "{words}");
}

/// Answers as a driver does, in whatever way: the `n`th question with attachment, payload and encoding.
fn answers_as(
    vehicle: &Bus,
    answer: impl Fn(u64) -> (Vec<u8>, Vec<u8>, Encoding) + Send + Sync + 'static,
) -> Queryable<()> {
    let (key, asked) = (vehicle.keys().tape(), AtomicU64::new(0));
    let queryable = vehicle.session_for_tests().declare_queryable(key.clone());
    let reply = move |query: Query| {
        let (attachment, payload, encoding) = answer(asked.fetch_add(1, Ordering::Relaxed));
        let reply = query.reply(key.clone(), payload).encoding(encoding);
        match attachment.is_empty() {
            true => reply.wait().unwrap(),
            false => reply.attachment(attachment).wait().unwrap(),
        }
    };
    queryable.callback(reply).wait().unwrap()
}

/// Hears until there is some trouble.
fn trouble(follower: &mut TapeFollower) -> TapeTrouble {
    let begin = Instant::now();
    loop {
        assert!(begin.elapsed() < LONG, "{:?}", follower.counters());
        follower.hear(SHORT).unwrap();
        if let Some(trouble) = follower.trouble() {
            return trouble.clone();
        }
    }
}

#[test]
fn an_answer_that_cannot_be_read_is_named_as_what_it_is() {
    let head = |change: &dyn Fn(&mut serde_json::Value)| {
        let mut head = json!({"driver": 7, "first": 0, "count": 1, "next": 1, "begin": {}});
        change(&mut head);
        head.to_string().into_bytes()
    };
    let one = || encode(&at(1, TapeEntry::LinkUp));
    let octets = || Encoding::APPLICATION_OCTET_STREAM;
    let as_it_is = |_: &mut serde_json::Value| {};
    let mut no_rotation = pose(None);
    no_rotation.world_from_vehicle.rotation *= 0.5;
    let no_rotation = encode(&at(0, TapeEntry::Pose(no_rotation)));
    let (mut odd, mut twice) = (one(), one());
    odd[0] = 9;
    twice.extend(one());
    let cases: Vec<(Vec<u8>, Vec<u8>, Encoding, &str)> = vec![
        (vec![], one(), octets(), "no attachment"),
        (b"tape".to_vec(), one(), octets(), "no JSON object"),
        (
            head(&|h| h["count"] = json!(-1)),
            one(),
            octets(),
            "no JSON object",
        ),
        (vec![b' '; 70_000], one(), octets(), "at most 65536"),
        (
            head(&|h| h["version"] = json!(2)),
            one(),
            octets(),
            "of version 2",
        ),
        (
            head(&|h| h["first"] = json!(u64::MAX)),
            one(),
            octets(),
            "too large",
        ),
        (
            head(&|h| h["next"] = json!(0)),
            one(),
            octets(),
            "before the last",
        ),
        (
            head(&|h| h["begin"] = json!(null)),
            one(),
            octets(),
            "without `begin`",
        ),
        (head(&as_it_is), vec![], octets(), "ends within record 0"),
        (
            head(&|h| h["count"] = json!(0)),
            one(),
            octets(),
            "bytes follow",
        ),
        (head(&as_it_is), twice, octets(), "bytes follow"),
        (head(&as_it_is), odd, octets(), "kind 9"),
        (head(&as_it_is), no_rotation, octets(), "no rotation"),
        (
            head(&as_it_is),
            b"hello".to_vec(),
            Encoding::TEXT_PLAIN,
            "text/plain",
        ),
    ];
    let (vehicle, shore) = bus_pair();
    for (attachment, payload, encoding, words) in cases {
        let answer = move |_| (attachment.clone(), payload.clone(), encoding.clone());
        let _driver = answers_as(&vehicle, answer);
        let mut follower = shore.follow_tape();
        let trouble = trouble(&mut follower);
        assert!(matches!(trouble, TapeTrouble::Unreadable(_)), "{trouble}");
        assert!(
            trouble.to_string().contains(words),
            "no {words:?} in {trouble}"
        );
        assert_eq!(follower.counters().answers, 0, "{trouble}");
    }
}

#[test]
fn a_tape_that_flips_its_run_is_told_as_two_drivers_and_followed_as_one() {
    for is_always_new in [false, true] {
        let (vehicle, shore) = bus_pair();
        let answer = move |asked: u64| {
            let driver = 1 + if is_always_new { asked } else { asked % 2 };
            let head = json!({"driver": driver, "first": 0, "count": 1, "next": 1, "begin": {}});
            let payload = encode(&at(1, TapeEntry::LinkUp));
            let octets = Encoding::APPLICATION_OCTET_STREAM;
            (head.to_string().into_bytes(), payload, octets)
        };
        let _driver = answers_as(&vehicle, answer);
        let mut follower = shore.follow_tape();
        let begin = Instant::now();
        while follower.counters().queries < 40 {
            assert!(begin.elapsed() < LONG);
            follower.hear(SHORT).unwrap();
        }
        let trouble = trouble(&mut follower);
        assert!(trouble.to_string().contains("two drivers"), "{trouble}");
        // A driver that is started again takes two seconds, and forty questions that are not
        // answered a tenth each.
        let most = begin.elapsed().as_secs() / 2 + 1;
        let restarts = follower.counters().restarts;
        assert!(restarts <= most, "{restarts} restarts, {most} at most");
    }
}

#[test]
fn of_two_drivers_the_first_is_followed_until_it_is_gone() {
    let endpoints = crate::test_support::endpoints();
    let [shore, one, two] = [(); 3].map(|()| bus_with(&endpoints, |_| {}));
    let first = one.keep_tape(1, json!({})).unwrap();
    let mut follower = shore.follow_tape();
    first.append(Timestamp::ZERO, bytes(0));
    assert_eq!(heard(&mut follower, 1)[0].entry, bytes(0));
    let second = two.keep_tape(2, json!({})).unwrap();
    second.append(Timestamp::ZERO, bytes(99));
    let told = trouble(&mut follower);
    let (followed, other) = (1, 2);
    assert_eq!(told, TapeTrouble::OtherDriver { followed, other });
    for number in 1..5 {
        first.append(Timestamp::ZERO, bytes(number));
        assert_eq!(heard(&mut follower, 1)[0].entry, bytes(number));
    }
    assert_eq!(follower.counters().restarts, 0);
    drop(first);
    assert_eq!(heard(&mut follower, 1)[0].entry, bytes(99));
    assert_eq!(follower.counters().restarts, 1);
}

#[test]
fn a_run_that_is_turned_away_leaves_the_one_before() {
    let (vehicle, shore) = bus_pair();
    let mut follower = shore.follow_tape();
    let first = vehicle.keep_tape(1, json!({})).unwrap();
    first.append(Timestamp::ZERO, bytes(0));
    heard(&mut follower, 1);
    drop(first);
    let odd = vehicle.keep_tape(2, json!({})).unwrap();
    odd.append(Timestamp::ZERO, bytes(9));
    assert_eq!(heard(&mut follower, 1)[0].entry, bytes(9));
    follower.refuse("it begins with nothing".to_owned());
    let told = follower.trouble().map(ToString::to_string);
    assert!(told.is_some_and(|told| told.contains("begins with nothing")));
    drop(odd);
    let back = vehicle.keep_tape(1, json!({})).unwrap();
    for number in 0..3 {
        back.append(Timestamp::ZERO, bytes(number));
    }
    let numbers = heard(&mut follower, 2)
        .into_iter()
        .map(|record| record.entry);
    assert!(numbers.eq([bytes(1), bytes(2)]));
    assert_eq!(follower.counters().restarts, 0);
}

#[test]
fn a_tape_that_goes_back_is_told() {
    let (vehicle, shore) = bus_pair();
    let mut follower = shore.follow_tape();
    follower.go_on_from(7, 900);
    let keeper = vehicle.keep_tape(7, json!({})).unwrap();
    keeper.append(Timestamp::ZERO, bytes(0));
    let told = trouble(&mut follower).to_string();
    assert!(told.contains("before record 900"), "{told}");
}

#[test]
fn vehicles_of_two_names_do_not_mix() {
    let endpoints = crate::test_support::endpoints();
    let named = |name: &'static str| {
        let named = move |config: &mut BusConfig| name.clone_into(&mut config.node);
        bus_with(&endpoints, named)
    };
    let (a, both) = (named("a"), named("b"));
    let keepers = [(&a, 1), (&both, 2)].map(|(bus, driver)| {
        let keeper = bus.keep_tape(u64::from(driver), json!({})).unwrap();
        keeper.append(Timestamp::ZERO, bytes(driver));
        keeper
    });
    assert_eq!(heard(&mut a.follow_tape(), 1)[0].entry, bytes(1));
    assert_eq!(heard(&mut both.follow_tape(), 1)[0].entry, bytes(2));
    assert!(keepers.iter().all(|keeper| keeper.counters().missed == 0));
}
