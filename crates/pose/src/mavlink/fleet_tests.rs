//! Whose poses are taken of those that speak on one link.

use echosplat_join::{ArrivedPose, StampClock};
use echosplat_model::Timestamp;
use echosplat_model::glam::DVec3;

use super::fleet::Fleet;
use super::message::{Message, Sender, Station, ned_from_frd};
use crate::only::Only;
use crate::status::PoseSourceStatus;

const UNIX_MS: i64 = 1_700_000_000_000;

fn sender(system: u32, component: u8) -> Sender {
    Sender { system, component }
}

/// Somebody who sends from and to so many milliseconds, at `x` north.
#[derive(Clone, Copy)]
struct Speaker {
    sender: Sender,
    station: Option<Station>,
    span_ms: (i64, i64),
    north_m: Option<f64>,
    uptime_ms: i64,
}

impl Speaker {
    fn new(system: u32, component: u8, station: Station, north_m: f64) -> Self {
        Self {
            sender: sender(system, component),
            station: Some(station),
            span_ms: (0, i64::MAX),
            north_m: Some(north_m),
            uptime_ms: 50_000 * i64::from(system),
        }
    }

    fn within(self, from_ms: i64, to_ms: i64) -> Self {
        Self {
            span_ms: (from_ms, to_ms),
            ..self
        }
    }

    fn messages(&self, now_ms: i64) -> Vec<Message> {
        let mut messages = Vec::new();
        if !(self.span_ms.0..self.span_ms.1).contains(&now_ms) {
            return messages;
        }
        let boot_ms = (self.uptime_ms + now_ms) as u32;
        if let Some(north_m) = self.north_m {
            messages.push(Message::Position {
                boot_ms,
                position_ned_m: DVec3::new(north_m, now_ms as f64 * 1e-4, 2.0),
                velocity_ned_mps: DVec3::ZERO,
            });
        }
        messages.push(Message::Attitude {
            boot_ms,
            ned_from_frd: ned_from_frd(0.0, 0.0, now_ms as f64 * 1e-5),
            is_quaternion: true,
        });
        if let Some(station) = self.station.filter(|_| now_ms % 1_000 == 500) {
            messages.push(Message::Heartbeat(station));
        }
        messages
    }
}

/// Runs of poses of one speaker, as metres north, epoch, first and last time of arrival; and the status at the end.
type Runs = Vec<(f64, u32, i64, i64)>;

fn heard(speakers: &[Speaker], only: &str, until_ms: i64) -> (Runs, PoseSourceStatus) {
    let mut query = Only::default();
    for part in only.split('&').filter(|part| !part.is_empty()) {
        assert_eq!(query.take(part), Ok(true), "{part}");
    }
    let mut fleet = Fleet::new(StampClock::Host, query, false);
    let mut poses: Vec<ArrivedPose> = Vec::new();
    let at = |now_ms| Timestamp::from_millis(UNIX_MS + now_ms);
    for now_ms in (0..until_ms).step_by(20) {
        for speaker in speakers {
            for message in speaker.messages(now_ms) {
                fleet.take(speaker.sender, message, at(now_ms), |pose| poses.push(pose));
            }
        }
        fleet.settle(at(now_ms), |pose| poses.push(pose));
    }
    let mut runs: Runs = Vec::new();
    for arrived in poses {
        let north_m = arrived.pose.world_from_vehicle.translation_m.y;
        let at_ms = arrived.arrived.nanos() / 1_000_000 - UNIX_MS;
        match runs.last_mut() {
            Some(run) if (run.0, run.1) == (north_m, arrived.pose.epoch) => run.3 = at_ms,
            _ => runs.push((north_m, arrived.pose.epoch, at_ms, at_ms)),
        }
    }
    (runs, fleet.status(at(until_ms)))
}

#[test]
fn a_gimbal_that_speaks_first_is_passed_over() {
    for north_m in [None, Some(9.0)] {
        let gimbal = Speaker {
            north_m,
            ..Speaker::new(1, 154, Station::Gimbal, 0.0)
        };
        let autopilot = Speaker::new(1, 1, Station::Autopilot, 4.0).within(300, i64::MAX);
        let (runs, status) = heard(&[gimbal, autopilot], "", 10_000);
        assert_eq!(runs, [(4.0, 0, 300, 9_980)]);
        assert_eq!((status.missing, status.several), (None, None));
        let told: Vec<_> = status
            .senders
            .iter()
            .map(|s| (s.name.as_str(), s.kind.as_deref(), s.is_used))
            .collect();
        let expected = [
            ("system 1 component 1", Some("autopilot"), true),
            ("system 1 component 154", Some("gimbal"), false),
        ];
        assert_eq!(told, expected);
        assert!(status.other_senders > 100);
    }
}

#[test]
fn who_never_says_what_it_is_is_used_after_a_while_and_loses_nothing() {
    let silent = Speaker {
        station: None,
        ..Speaker::new(1, 1, Station::Autopilot, 3.0)
    };
    let (runs, status) = heard(&[silent], "", 5_000);
    assert_eq!(runs, [(3.0, 0, 0, 4_980)]);
    assert_eq!((status.accepted, status.other_senders), (250, 0));
    // A companion's own odometry is as good where there is no better.
    let companion = Speaker::new(1, 197, Station::Companion, 5.0);
    let (runs, status) = heard(&[companion], "", 5_000);
    assert_eq!((runs.len(), status.several), (1, None));
}

#[test]
fn a_second_autopilot_is_told_and_the_url_chooses() {
    let one = Speaker::new(1, 1, Station::Autopilot, 1.0);
    let two = Speaker::new(2, 1, Station::Autopilot, 8.0);
    let (runs, status) = heard(&[two, one], "", 6_000);
    assert_eq!(runs, [(8.0, 0, 0, 5_980)]);
    let told = status.several.unwrap().sentence;
    for word in [
        "second autopilot",
        "system 1 component 1",
        "7.0 m",
        "?system=1",
        "?system=2",
    ] {
        assert!(told.contains(word), "{told}");
    }
    for (only, north_m) in [
        ("system=1", 1.0),
        ("system=2", 8.0),
        ("system=1&component=1", 1.0),
    ] {
        let (runs, status) = heard(&[two, one], only, 6_000);
        assert_eq!(runs, [(north_m, 0, 0, 5_980)], "{only}");
        assert_eq!((status.several, status.senders.len()), (None, 2), "{only}");
    }
    let (runs, status) = heard(&[two, one], "system=7", 6_000);
    assert_eq!(runs, []);
    let told = status.missing.unwrap();
    assert!(
        told.contains("system 7") && told.contains("system 2 component 1"),
        "{told}"
    );
}

#[test]
fn a_component_that_the_url_names_is_used_whatever_it_is() {
    let autopilot = Speaker::new(1, 1, Station::Autopilot, 1.0);
    let companion = Speaker::new(1, 197, Station::Companion, 5.0);
    let (runs, status) = heard(&[autopilot, companion], "component=197", 6_000);
    assert_eq!(runs, [(5.0, 0, 0, 5_980)]);
    assert_eq!(status.several, None);
    let (runs, _) = heard(&[companion, autopilot], "system=1", 6_000);
    assert_eq!(runs.last().map(|run| run.0), Some(1.0));
}

#[test]
fn an_autopilot_that_falls_silent_is_stood_in_for_and_taken_back() {
    let one = Speaker::new(1, 1, Station::Autopilot, 1.0);
    let two = Speaker::new(2, 1, Station::Autopilot, 8.0);
    let gone = one.within(0, 4_000);
    let (runs, status) = heard(&[gone, two], "", 20_000);
    assert_eq!(runs, [(1.0, 0, 0, 3_980), (8.0, 1, 3_980, 19_980)]);
    let told = status.several.unwrap().sentence;
    assert!(told.contains("system 1 component 1 fell silent"), "{told}");
    let back = one.within(12_000, i64::MAX);
    let (runs, _) = heard(&[gone, two, back], "", 20_000);
    let of: Vec<_> = runs.iter().map(|run| (run.0, run.1)).collect();
    assert_eq!(of, [(1.0, 0), (8.0, 1), (1.0, 2)]);
    // A moment's silence changes nothing.
    let soon = one.within(7_000, i64::MAX);
    let (runs, _) = heard(&[gone, two, soon], "", 20_000);
    assert_eq!(runs, [(1.0, 0, 0, 19_980)]);
}

#[test]
fn ground_stations_are_no_rivals_but_stand_in_the_status() {
    let autopilot = Speaker::new(1, 1, Station::Autopilot, 1.0);
    let station = Speaker::new(255, 190, Station::Ground, 0.0);
    let (runs, status) = heard(&[station, autopilot], "", 6_000);
    assert_eq!(runs.last().map(|run| run.0), Some(1.0));
    assert_eq!((status.several, status.senders.len()), (None, 2));
}
