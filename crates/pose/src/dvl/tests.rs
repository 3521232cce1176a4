use echosplat_model::Timestamp;
use echosplat_model::glam::DVec3;

use super::report::Report;
use super::track::Track;
use super::*;
use echosplat_join::ArrivedPose;

const UNIX: i64 = 1_700_000_000;

/// As the vendor's documentation shows it.
const POSITION: &str = r#"{"ts": 49056.809, "x": 12.43563613697886467, "y": 64.617631152402609587,
    "z": 1.767641898933798075, "std": 0.001959984190762043, "roll": 0.6173566579818726,
    "pitch": 0.6173566579818726, "yaw": 0.6173566579818726, "type": "position_local", "status": 0,
    "format": "json_v3.1"}"#;
const VELOCITY: &str = r#"{"time": 106.3935775756836, "vx": -3.713480691658333e-05,
    "vy": 5.703703573090024e-05, "vz": 2.4990416932269e-05, "fom": 0.00016016385052353144,
    "covariance": [[1e-8, 0, 0], [0, 1e-8, 0], [0, 0, 1e-9]], "altitude": 0.4949815273284912,
    "transducers": [{"id": 0, "velocity": 0.0001, "distance": 0.55, "rssi": -30.4, "nsd": -88.7,
    "beam_valid": true}], "velocity_valid": true, "status": 0, "format": "json_v3.1",
    "type": "velocity", "time_of_validity": 1638191471563017,
    "time_of_transmission": 1638191471752336}"#;

fn position(ts: f64, xyz: [f64; 3], yaw_deg: f64, status: i64) -> String {
    let [x, y, z] = xyz;
    format!(
        r#"{{"ts":{ts},"x":{x},"y":{y},"z":{z},"std":0.01,"roll":0,"pitch":0,"yaw":{yaw_deg},"type":"position_local","status":{status},"format":"json_v3.1"}}"#
    )
}

fn velocity(at_s: f64, v: [f64; 3]) -> String {
    let [x, y, z] = v;
    let us = (at_s * 1e6) as i64;
    format!(
        r#"{{"vx":{x},"vy":{y},"vz":{z},"velocity_valid":true,"status":0,"type":"velocity","time_of_validity":{us},"time_of_transmission":{us}}}"#
    )
}

/// Feeds a line that arrived so many seconds after the first.
fn take(track: &mut Track, line: &str, after_s: f64) -> Vec<ArrivedPose> {
    let arrived = Timestamp::from_nanos(UNIX * 1_000_000_000).offset_by(after_s);
    track.take(Report::parse(line.as_bytes()), arrived)
}

#[test]
fn the_documented_reports_are_read() {
    let read = |text: &str| Report::parse(text.as_bytes()).unwrap().unwrap();
    let Report::Position {
        stamp_s,
        position_m,
        ..
    } = read(POSITION)
    else {
        panic!("no position");
    };
    assert!((stamp_s - 49056.809).abs() < 1e-9);
    assert!((position_m - DVec3::new(12.4356361, 64.6176312, 1.7676419)).length() < 1e-6);
    let Report::Velocity {
        valid_us,
        sent_us,
        is_valid,
        ..
    } = read(VELOCITY)
    else {
        panic!("no velocity");
    };
    assert_eq!(
        (valid_us, sent_us),
        (1_638_191_471_563_017, 1_638_191_471_752_336)
    );
    assert!(is_valid);
    let response = br#"{"response_to":"get_config","success":true,"type":"response"}"#;
    assert_eq!(Report::parse(response), Ok(None));
}

#[test]
fn down_becomes_up_and_right_becomes_left() {
    let mut track = Track::new(StampClock::Host);
    let poses = take(&mut track, &position(10.0, [1.0, 2.0, 3.0], 90.0, 0), 0.0);
    let [ArrivedPose { pose, .. }] = poses[..] else {
        panic!("{poses:?}");
    };
    let at = pose.world_from_vehicle;
    assert_eq!(at.translation_m, DVec3::new(1.0, -2.0, -3.0));
    // Turned right by a quarter: the nose points along -y of a world with z up.
    assert!((at.rotation * DVec3::X - DVec3::NEG_Y).length() < 1e-12);
    assert!((at.rotation * DVec3::Z - DVec3::Z).length() < 1e-12);
    // Since power-up: taken as sent when it came.
    assert_eq!(pose.time, Timestamp::from_nanos(UNIX * 1_000_000_000));
    let status = track.status(pose.time);
    assert_eq!(status.clock_method.as_deref(), Some("arrival"));
}

#[test]
fn velocities_between_positions_give_poses_that_meet_both() {
    for unix in [false, true] {
        let base = if unix { UNIX as f64 } else { 500.0 };
        let mut track = Track::new(StampClock::Host);
        take(&mut track, &position(base, [0.0; 3], 0.0, 0), 0.0);
        // 1 m/s forward at first, then still; heading turns right all the while.
        for (at_s, mps) in [(0.05, 1.0), (0.1, 1.0), (0.15, 0.0)] {
            let none = take(&mut track, &velocity(base + at_s, [mps, 0.0, 0.0]), at_s);
            assert!(none.is_empty());
        }
        let poses = take(
            &mut track,
            &position(base + 0.2, [0.125, 0.0, 0.0], 20.0, 0),
            0.2,
        );
        let places: Vec<_> = poses
            .iter()
            .map(|pose| pose.pose.world_from_vehicle)
            .collect();
        assert_eq!(places.len(), 4);
        for (place, x) in places.iter().zip([0.05, 0.1, 0.125, 0.125]) {
            assert!((place.translation_m.x - x).abs() < 5e-3, "{place:?} {x}");
        }
        assert_eq!(places[3].translation_m, DVec3::new(0.125, 0.0, 0.0));
        let forward = places[1].rotation * DVec3::X;
        let expected_rad = -10_f64.to_radians();
        assert!((forward.y.atan2(forward.x) - expected_rad).abs() < 1e-6);
        let method = track.status(Timestamp::ZERO).clock_method;
        assert_eq!(
            method.as_deref(),
            Some(if unix { "unix" } else { "arrival" })
        );
        let times: Vec<_> = poses.iter().map(|pose| pose.pose.time).collect();
        assert!(times.is_sorted());
    }
}

#[test]
fn nothing_is_invented_across_a_gap() {
    let mut track = Track::new(StampClock::Host);
    take(&mut track, &position(0.0, [0.0; 3], 0.0, 0), 0.0);
    for i in 1..=10 {
        let at_s = f64::from(i) * 0.05;
        take(&mut track, &velocity(at_s, [1.0, 0.0, 0.0]), at_s);
    }
    let poses = take(&mut track, &position(0.6, [0.6, 0.0, 0.0], 0.0, 0), 0.6);
    assert_eq!(poses.len(), 1);
}

#[test]
fn reports_that_the_dvl_calls_invalid_are_counted_and_what_is_missing_is_told() {
    let mut track = Track::new(StampClock::Host);
    assert!(take(&mut track, &position(0.0, [0.0; 3], 0.0, 1), 0.0).is_empty());
    assert!(take(&mut track, r#"{"type":"position_local","ts":1}"#, 0.1).is_empty());
    assert!(take(&mut track, "not json", 0.2).is_empty());
    assert!(take(&mut track, &position(5.9, [0.0; 3], 0.0, 1), 5.9).is_empty());
    let later = Timestamp::from_nanos((UNIX + 6) * 1_000_000_000);
    let status = track.status(later);
    assert_eq!(
        (status.received, status.malformed, status.accepted),
        (4, 4, 0)
    );
    assert!(status.first_fault.unwrap().contains("status 1"));
    assert!(status.missing.unwrap().contains("bottom"));
}

/// One of two devices: how far its clock and its place lie from the other's, and its age.
#[derive(Debug, Clone, Copy)]
struct Second {
    clock_s: f64,
    north_m: f64,
}

#[test]
fn of_two_devices_on_one_connection_the_first_is_used_and_both_are_told() {
    for clock_s in [0.0, 0.07, 300.0, -300.0, UNIX as f64] {
        for north_m in [2.0, 40.0] {
            let second = Second { clock_s, north_m };
            let mut track = Track::new(StampClock::Host);
            let mut poses = Vec::new();
            for i in 0..150 {
                let at_s = f64::from(i) * 0.2;
                let x = 0.2 * at_s;
                let own = position(1_000.0 + at_s, [x, 0.0, 1.0], 0.0, 0);
                poses.extend(take(&mut track, &own, at_s));
                let place = [second.north_m + x, 0.0, 1.0];
                let other = position(1_000.0 + second.clock_s + at_s, place, 90.0, 0);
                poses.extend(take(&mut track, &other, at_s + 0.05));
                let own = velocity(1_000.1 + at_s, [0.2, 0.0, 0.0]);
                poses.extend(take(&mut track, &own, at_s + 0.1));
            }
            // After the first reports each pose is the first device's, at the time it was sent.
            let begin = Timestamp::from_nanos(UNIX * 1_000_000_000);
            let later = poses
                .iter()
                .filter(|p| p.arrived.seconds_since(begin) > 3.0);
            let mut count = 0;
            for ArrivedPose { pose, arrived } in later {
                let at_s = arrived.seconds_since(begin);
                let place_m = pose.world_from_vehicle.translation_m;
                assert!(
                    (place_m.x - 0.2 * at_s).abs() < 1e-6,
                    "{second:?}: {place_m}"
                );
                assert!(pose.time.seconds_since(*arrived).abs() < 0.01, "{second:?}");
                count += 1;
            }
            assert!(count > 120, "{second:?}: {count}");
            let status = track.status(begin.offset_by(30.0));
            let told = status.several.unwrap().sentence;
            assert!(
                told.contains("two DVLs") && told.contains("dvl://"),
                "{told}"
            );
            assert_eq!(status.senders.len(), 2);
            assert!(status.other_senders > 120, "{second:?}");
        }
    }
}

#[test]
fn a_reset_a_boot_a_clock_that_is_set_and_a_gap_are_no_second_device() {
    for (jump_s, jump_m, away_s) in [
        (0.0, 30.0, 0.2),
        (UNIX as f64, 0.0, 0.2),
        (-990.0, 30.0, 8.0),
        (0.0, 0.0, 20.0),
    ] {
        let mut track = Track::new(StampClock::Host);
        let mut count = 0;
        for i in 0..100 {
            let at_s = f64::from(i) * 0.2;
            let line = position(1_000.0 + at_s, [0.1 * at_s, 0.0, 1.0], 0.0, 0);
            count += take(&mut track, &line, at_s).len();
        }
        for i in 0..100 {
            let at_s = 20.0 + away_s + f64::from(i) * 0.2;
            let place = [0.1 * at_s + jump_m, 0.0, 1.0];
            let line = position(1_000.0 + jump_s + at_s, place, 0.0, 0);
            count += take(&mut track, &line, at_s).len();
        }
        assert_eq!(count, 200, "{jump_s} {jump_m}");
        let status = track.status(Timestamp::from_nanos(UNIX * 1_000_000_000));
        assert_eq!((status.several, status.senders.len()), (None, 0));
    }
}

#[test]
fn a_dvl_that_falls_silent_is_not_told_to_see_the_bottom() {
    for is_valid in [true, false] {
        let mut track = Track::new(StampClock::Host);
        for i in 0..40 {
            let at_s = f64::from(i) * 0.2;
            let line = position(at_s, [0.0; 3], 0.0, i64::from(!is_valid));
            take(&mut track, &line, at_s);
        }
        let after = |seconds: f64| Timestamp::from_nanos(UNIX * 1_000_000_000).offset_by(seconds);
        assert_eq!(track.status(after(7.9)).missing.is_some(), !is_valid);
        assert_eq!(track.silent_s(after(8.0)), None);
        assert_eq!(track.status(after(14.8)).missing, None);
        let silent_s = track.silent_s(after(14.8)).unwrap();
        assert!((silent_s - 7.0).abs() < 1e-6, "{silent_s}");
    }
}

#[test]
fn lines_come_whole_from_any_pieces_and_long_ones_are_bounded() {
    let text = format!("{}\r\n\n{}\n", "a".repeat(MAX_LINE_BYTES + 100), "b");
    for size in [1, 7, 4096] {
        let mut lines = Lines::default();
        let mut lengths = Vec::new();
        for piece in text.as_bytes().chunks(size) {
            lines.feed(piece, |line| lengths.push(line.len()));
        }
        assert_eq!(lengths, [MAX_LINE_BYTES, 1]);
    }
}

#[test]
fn beside_an_autopilot_valid_velocities_alone_are_told() {
    let told = |line: &str| told_of(&Report::parse(line.as_bytes()).unwrap().unwrap());
    let found = told(&velocity(10.0, [1.0, 2.0, 3.0])).unwrap();
    assert_eq!(found.mps, DVec3::new(1.0, -2.0, -3.0));
    assert_eq!(
        (found.axes, found.stamp),
        (Axes::Vehicle, Stamp::Own(10_000_000_000))
    );
    // As the vendor's documentation shows it: sent 189 ms after it was true.
    let documented = told(VELOCITY).unwrap();
    assert!((documented.before_s - 0.189_319).abs() < 1e-9);
    let blind = velocity(10.0, [0.0; 3]).replace("true", "false");
    assert_eq!(told(&blind), None);
    assert_eq!(told(&position(10.0, [0.0; 3], 0.0, 0)), None);
}
