//! What notices advise is taken literally, through the real command line and configuration, and then
//! they are gone: dives in small, with the real guard, join and diagnosis, on a clock of the test's own.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use echosplat_driver::DriverStatus;
use echosplat_join::{ArrivedPose, StampClock};
use echosplat_model::glam::DVec3;
use echosplat_model::{Ping, PingSettings, Pose, StampedPose, Timestamp};
use echosplat_pose::{PoseSource, PoseSourceStatus};

use super::*;
use crate::advised::{configured, taken};
use crate::config::Config;
use crate::pipeline::poses::{Patience, Poses};
use crate::pipeline::shared::MapperReport;

const BEGIN_S: f64 = 1.795e9;
const PINGS_PER_S: f64 = 50.0;
const DIVE_S: f64 = 14.0;

type Stamp = fn(i64, u64) -> i64;

/// How poses are sent.
#[derive(Clone, Copy)]
struct World {
    poses_per_s: f64,
    /// From a pose's time to its arrival.
    delay_s: f64,
    /// The stamp of a pose of this time, nanoseconds; the number of the pose.
    stamp: Stamp,
    /// By what the clock that stamps is ahead, seconds.
    ahead_s: f64,
    /// Of each so many poses one is none, and says so.
    unusable_every: u64,
}

const SOUND: World = World {
    poses_per_s: 20.0,
    delay_s: 0.02,
    stamp: |nanos, _| nanos,
    ahead_s: 0.0,
    unusable_every: u64::MAX,
};

impl World {
    fn poses(&self) -> Vec<ArrivedPose> {
        let count = ((DIVE_S + 1.0) * self.poses_per_s) as u64;
        let pose = |index: u64| {
            let since_s = index as f64 / self.poses_per_s - 0.5;
            let time = Timestamp::from_secs_f64(BEGIN_S).offset_by(since_s);
            let stamp = (self.stamp)(time.offset_by(self.ahead_s).nanos(), index);
            let position_m = DVec3::new(0.4 * since_s, (0.7 * since_s).sin(), -3.0);
            ArrivedPose {
                pose: StampedPose {
                    time: Timestamp::from_nanos(stamp),
                    world_from_vehicle: Pose::from_yaw_pitch_roll(
                        0.1 * since_s,
                        0.0,
                        0.0,
                        position_m,
                    ),
                    uncertainty: None,
                    epoch: 0,
                },
                arrived: time.offset_by(self.delay_s),
            }
        };
        let usable = (0..count).filter(|index| (index + 1) % self.unusable_every != 0);
        usable.map(pose).collect()
    }

    /// All that is told in a dive with these settings, by code, and the share of pings that got their pose.
    fn dive(&self, config: &Config) -> (BTreeMap<String, String>, f64) {
        let all = self.poses();
        let (sent, begin) = (all.clone(), Instant::now());
        let source = PoseSource::recorded(all);
        let poses = Poses::new(config, source, Patience::LetGo, None).unwrap();
        let mut poses = poses.of_recording(StampClock::Host, Default::default());
        let mut diagnosis = Diagnosis::new(live(), &config.pose, begin);
        let mut told = BTreeMap::new();
        let pings = (DIVE_S * PINGS_PER_S) as u64;
        for index in 0..pings {
            let since_s = index as f64 / PINGS_PER_S;
            let now = Timestamp::from_secs_f64(BEGIN_S).offset_by(since_s);
            let came = sent.partition_point(|pose| pose.arrived <= now);
            poses.take_through(came as u64);
            poses.push(ping(index, now), begin);
            while poses.pop().is_some() {}
            if index % 12 == 0 {
                let mut report = MapperReport::default();
                report.poses = poses.report();
                report.poses.source = self.source(came as u64);
                let status = status_of(report);
                let at = begin + Duration::from_secs_f64(since_s);
                for finding in diagnosis.findings(&status, at) {
                    told.insert(finding.code.into_owned(), finding.sentence);
                }
            }
        }
        let joined = poses.report().join.pings_joined;
        (told, joined as f64 / pings as f64)
    }

    fn source(&self, came: u64) -> PoseSourceStatus {
        let unusable = came / (self.unusable_every - 1).max(1);
        let is_odd = self.unusable_every < u64::MAX;
        PoseSourceStatus {
            source: "zenoh://".to_owned(),
            received: came,
            accepted: came,
            not_finite: if is_odd { unusable } else { 0 },
            first_fault: is_odd.then(|| "pose: position is not finite".to_owned()),
            rate_hz: self.poses_per_s,
            age_s: Some(0.5 / self.poses_per_s),
            ..PoseSourceStatus::default()
        }
    }
}

fn ping(index: u64, time: Timestamp) -> Arc<Ping> {
    let settings = PingSettings {
        range_start_m: 0.0,
        range_length_m: 10.0,
        bin_count: 10,
        speed_of_sound_mps: 1500.0,
        frequency_hz: 0.0,
        pulse_duration_s: 0.0,
        gain_index: 0,
    };
    Arc::new(Ping::new(index, time, settings, vec![0.0; 10]).unwrap())
}

fn live() -> Expectations {
    Expectations {
        sonar: "tcp://192.168.2.92:51200".to_owned(),
        pace: Pace::Live,
        ping_interval_s: 1.0 / PINGS_PER_S,
        range_m: [0.0, 10.0],
    }
}

fn status_of(report: MapperReport) -> Status {
    let sonar = DriverStatus {
        link: echosplat_driver::LinkState::Up,
        since_byte_s: Some(0.01),
        since_frame_s: Some(0.01),
        since_profile_s: Some(0.01),
        since_ping_s: Some(0.01),
        ..DriverStatus::default()
    };
    let mut status = Status::of(report, sonar);
    status.rates.pings_per_s = PINGS_PER_S;
    status
}

/// A dive in which `code` is told, and not any more once its advice is taken.
fn advice_works(name: &str, world: &World, before: &[(&str, &str)], code: &str) -> Config {
    let owned = |(key, value): &(&str, &str)| ((*key).to_owned(), (*value).to_owned());
    let before: BTreeMap<String, String> = before.iter().map(owned).collect();
    let (told, _) = world.dive(&configured(&before));
    let sentence = told
        .get(code)
        .unwrap_or_else(|| panic!("{name}: {code} is not told: {told:?}"));
    let (config, _) = taken(sentence, &before);
    let (after, share) = world.dive(&config);
    assert!(
        !after.contains_key(code),
        "{name}: {sentence}\nstill told: {after:?}"
    );
    assert!(
        share > 0.9,
        "{name}: {share} of the pings joined: {after:?}"
    );
    config
}

#[test]
fn a_sound_dive_is_told_nothing_of() {
    let (told, share) = SOUND.dive(&Config::default());
    assert!(told.is_empty(), "{told:?}");
    assert!(share > 0.9, "{share}");
}

#[test]
fn the_offset_that_is_advised_joins_poses_of_any_clock() {
    // An hour and a day off, the epochs of GPS and of NTP, a clock that began with the dive, a century ahead.
    for ahead_s in [
        3600.0,
        -86_400.0,
        -315_964_782.0,
        2.2e9,
        10.0 - BEGIN_S,
        3e9,
    ] {
        let world = World { ahead_s, ..SOUND };
        let name = format!("{ahead_s} s ahead");
        let config = advice_works(&name, &world, &[], "pose-times");
        let (after, _) = world.dive(&config);
        assert!(after.is_empty(), "{name}: {after:?}");
    }
    // One that is wrong beside an offset that was set before.
    let world = World {
        ahead_s: -500.0,
        ..SOUND
    };
    let before = [("pose.time_offset_s", "1234.5")];
    advice_works("on top of another", &world, &before, "pose-times");
}

#[test]
fn the_offset_that_is_advised_puts_a_clock_right_that_is_a_little_off() {
    for (ahead_s, delay_s) in [(0.8, 0.02), (5.2, 0.02), (-0.7, 0.1), (-1.5, 0.02)] {
        let world = World {
            ahead_s,
            delay_s,
            ..SOUND
        };
        let config = advice_works(&format!("{ahead_s} s ahead"), &world, &[], "pose-clock");
        assert!((config.pose.time_offset_s - ahead_s + delay_s).abs() < 2e-3);
        let (after, _) = world.dive(&config);
        assert!(after.is_empty(), "{after:?}");
    }
    let (right, _) = SOUND.dive(&configured(
        &[("pose.time_offset_s".to_owned(), "3.0".to_owned())].into(),
    ));
    assert!(
        right.contains_key("pose-clock"),
        "an offset that is wrong: {right:?}"
    );
}

#[test]
fn the_wait_that_is_advised_is_long_enough_for_a_slow_link() {
    for delay_s in [2.4, 4.0, 7.0] {
        let world = World { delay_s, ..SOUND };
        let before = [("pose.max_wait_s", "2.0")];
        let (told, _) = world.dive(&configured(&[].into()));
        let (config, _) = taken(&told["poses-late"], &[].into());
        let (after, share) = world.dive(&config);
        assert!(
            !after.contains_key("poses-late"),
            "{delay_s} {before:?}: {after:?}"
        );
        assert!(!after.contains_key("queue-drops"), "{delay_s}: {after:?}");
        // The last of them still wait.
        let arrived = 1.0 - (delay_s + 0.3) / DIVE_S;
        assert!(share > arrived - 0.05, "{delay_s}: {share}");
    }
}

#[test]
fn the_rate_that_is_advised_is_enough() {
    for (poses_per_s, gap) in [(1.0, "0.5"), (1.7, "0.5"), (3.0, "0.2"), (0.9, "1.0")] {
        let world = World {
            poses_per_s,
            ..SOUND
        };
        let config = configured(&[("pose.max_pose_gap_s".to_owned(), gap.to_owned())].into());
        let (told, _) = world.dive(&config);
        let sentence = &told["poses-rare"];
        let rate = sentence
            .split("at least ")
            .nth(1)
            .and_then(|rest| rest.split(' ').next());
        let poses_per_s: f64 = rate.unwrap().parse().unwrap();
        let (after, share) = World {
            poses_per_s,
            ..world
        }
        .dive(&config);
        assert!(after.is_empty(), "{sentence}\n{after:?}");
        assert!(share > 0.9, "{share}");
    }
}

#[test]
fn poses_that_are_refused_are_not_asked_for_more_often() {
    let refused: [(World, &str); 4] = [
        (
            World {
                unusable_every: 2,
                poses_per_s: 1.8,
                ..SOUND
            },
            "poses-malformed",
        ),
        (
            World {
                stamp: |_, _| 0,
                ..SOUND
            },
            "pose-stamps-zero",
        ),
        // The clock stands still for the first of each twenty.
        (
            World {
                stamp: |nanos, index| {
                    if index > 60 {
                        1_795_000_003_000_000_000
                    } else {
                        nanos
                    }
                },
                ..SOUND
            },
            "pose-stamps-repeat",
        ),
        (
            World {
                stamp: |nanos, index| if index % 12 == 0 { nanos } else { 0 },
                ..SOUND
            },
            "pose-stamps-zero",
        ),
    ];
    for (world, code) in refused {
        let (told, _) = world.dive(&Config::default());
        assert!(told.contains_key(code), "{code}: {told:?}");
        for wrong in ["poses-rare", "poses-late", "no-poses"] {
            assert!(!told.contains_key(wrong), "{code}: {told:?}");
        }
    }
}

#[test]
fn stamps_that_are_all_zero_are_told_as_that_alone() {
    let world = World {
        stamp: |_, _| 0,
        ..SOUND
    };
    let (told, _) = world.dive(&Config::default());
    assert_eq!(told.keys().collect::<Vec<_>>(), ["pose-stamps-zero"]);
    let sentence = &told["pose-stamps-zero"];
    assert!(
        sentence.starts_with("all ") && sentence.contains("stamped 0"),
        "{sentence}"
    );
}

#[test]
fn stamps_in_another_unit_are_told_with_what_makes_them_right() {
    let cases: [(Stamp, &str); 3] = [
        (|nanos, _| nanos / 1_000_000_000, "seconds"),
        (|nanos, _| nanos / 1_000_000, "milliseconds"),
        (|nanos, _| nanos / 1_000, "microseconds"),
    ];
    for (stamp, unit) in cases {
        let world = World { stamp, ..SOUND };
        let (told, _) = world.dive(&Config::default());
        assert_eq!(
            told.keys().collect::<Vec<_>>(),
            ["pose-stamp-unit"],
            "{unit}: {told:?}"
        );
        let sentence = &told["pose-stamp-unit"];
        assert!(
            sentence.contains(&format!("the time in {unit},")),
            "{sentence}"
        );
        // `send 1795…, N times as much`: N makes right what was sent.
        let (before, _) = sentence.split_once(" times as much").unwrap();
        let times: i64 = before.rsplit(' ').next().unwrap().parse().unwrap();
        let sent = (BEGIN_S * 1e9) as i64;
        let right = stamp(sent, 0) * times;
        assert!((right - sent).abs() < 1_000_000_000, "{sentence}");
    }
}

#[test]
fn the_range_that_is_advised_is_short_enough() {
    for useful_m in [0.45_f32, 0.7, 3.27, 9.96, 29.7, 87.5] {
        for (start_m, scale) in [(0.0, 1.0), (0.0, 1.06), (0.2, 0.93), (2.0, 1.0)] {
            let findings = |length_m: f64| {
                let mut report = MapperReport::default();
                report.mapper.range_end_m = (scale * (start_m + length_m)) as f32;
                report.mapper.working_range_m = Some(0.2 * useful_m);
                report.mapper.useful_range_m = Some(useful_m);
                report.poses.source.age_s = Some(0.02);
                let begin = Instant::now();
                let expectations = Expectations {
                    range_m: [start_m, length_m],
                    ..live()
                };
                let pose = Config::default().pose;
                let mut diagnosis = Diagnosis::new(expectations, &pose, begin);
                let found = diagnosis.findings(&status_of(report), begin + Duration::from_secs(2));
                let found = found
                    .into_iter()
                    .filter(|finding| finding.code == "long-range");
                found.map(|finding| finding.sentence).next()
            };
            let sentence = findings(100.0).unwrap();
            if sentence.contains("range_start_m nearer") {
                assert!(f64::from(useful_m) < scale * (start_m + 0.1), "{sentence}");
                continue;
            }
            let (config, _) = taken(&sentence, &[].into());
            let length_m = config.session.range_length_m;
            assert_eq!(findings(length_m), None, "{sentence}");
            let end_m = scale * (start_m + length_m);
            assert!(end_m > 0.7 * f64::from(useful_m) - 0.1, "{sentence}");
        }
    }
}

#[test]
fn the_mount_that_is_advised_is_the_one_that_fits() {
    use echosplat_prediction::frame_check::{FrameReading, FrameVerdict};
    let mut told = 0;
    for angles_deg in [
        [0.0, 0.0, 0.0],
        [270.0, 0.0, 0.0],
        [-200.0, 30.0, 90.0],
        [10.0, -45.0, 20.0],
        [0.0, 90.0, 0.0],
    ] {
        for reading in FrameReading::ALL {
            let mut config = Config::default();
            config.pose.vehicle_from_sensor.yaw_pitch_roll_deg = angles_deg;
            let mount = config.pose.vehicle_from_sensor.pose();
            let Some(wanted) = reading.mount_instead(&mount) else {
                continue;
            };
            let report = MapperReport {
                frames: Some(FrameVerdict {
                    best: reading,
                    gain_nats_per_bin_as_given: 0.0,
                    gain_best: 0.05,
                    error_nats_per_bin: 0.01,
                    pings: 500,
                    turned_deg: 90.0,
                    is_telling: true,
                }),
                ..MapperReport::default()
            };
            let diagnosis = Diagnosis::new(live(), &config.pose, Instant::now());
            let sentence = diagnosis.frames(&status_of(report)).unwrap().sentence;
            let (set, _) = taken(&sentence, &[].into());
            let turned = set
                .pose
                .vehicle_from_sensor
                .pose()
                .rotation
                .angle_between(wanted);
            assert!(
                turned.to_degrees() < 0.2,
                "{angles_deg:?} {reading:?}: {sentence}"
            );
            told += 1;
        }
    }
    assert_eq!(told, 30);
}
