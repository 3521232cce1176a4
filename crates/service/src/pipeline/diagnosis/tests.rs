use std::time::Duration;

use echosplat_driver::{DriverStatus, LinkState};

use super::*;
use crate::pipeline::poses::Span;
use crate::pipeline::shared::MapperReport;
use crate::split::TapeReport;

fn diagnosis(begin: Instant) -> Diagnosis {
    let expectations = Expectations {
        sonar: "tcp://127.0.0.1:51200".to_owned(),
        pace: Pace::Live,
        ping_interval_s: 0.017,
        range_m: [0.0, 40.0],
    };
    Diagnosis::new(expectations, &PoseConfig::default(), begin)
}

/// Codes found two seconds into a run in this state.
fn codes(report: MapperReport, sonar: DriverStatus) -> Vec<String> {
    let begin = Instant::now();
    let status = Status::of(report, sonar);
    let found = diagnosis(begin).findings(&status, begin + Duration::from_secs(2));
    found
        .into_iter()
        .map(|finding| finding.code.into_owned())
        .collect()
}

fn healthy() -> (MapperReport, DriverStatus) {
    let mut report = MapperReport::default();
    report.poses.source.accepted = 100;
    report.poses.source.age_s = Some(0.02);
    let sonar = DriverStatus {
        link: LinkState::Up,
        since_byte_s: Some(0.01),
        since_frame_s: Some(0.01),
        since_profile_s: Some(0.01),
        since_ping_s: Some(0.01),
        ..DriverStatus::default()
    };
    (report, sonar)
}

#[test]
fn a_healthy_run_has_nothing_to_tell() {
    let (report, sonar) = healthy();
    assert_eq!(codes(report, sonar), [""; 0]);
}

#[test]
fn a_unit_that_hears_much_further_than_what_is_there_is_told_of() {
    let of = |range_end_m: f32, useful_range_m: Option<f32>| {
        let (mut report, sonar) = healthy();
        report.mapper.range_end_m = range_end_m;
        report.mapper.working_range_m = Some(6.5);
        report.mapper.useful_range_m = useful_range_m;
        codes(report, sonar)
    };
    assert_eq!(of(40.0, Some(29.7)), ["long-range"]);
    assert_eq!(of(20.0, Some(29.7)), [""; 0]);
    assert_eq!(of(40.0, None), [""; 0], "voxels as configured");
}

#[test]
fn what_goes_with_the_vehicle_is_told() {
    let (mut report, sonar) = healthy();
    report.mapper.own_vehicle_m = Some(1.08);
    assert_eq!(codes(report, sonar), ["own-vehicle"]);
}

#[test]
fn silence_is_told_by_the_first_link_of_the_chain_that_is_broken() {
    let after = |change: &dyn Fn(&mut DriverStatus)| {
        let (report, mut sonar) = healthy();
        change(&mut sonar);
        codes(report, sonar)
    };
    let quiet = Some(2.0);
    assert_eq!(after(&|s| s.since_ping_s = quiet), ["no-new-pings"]);
    assert_eq!(
        after(&|s| (s.since_ping_s, s.since_profile_s) = (None, quiet)),
        ["no-profiles"]
    );
    assert_eq!(
        after(&|s| (s.since_ping_s, s.since_profile_s, s.since_frame_s) = (None, None, quiet)),
        ["no-frames"]
    );
    assert_eq!(
        after(&|s| {
            (s.since_ping_s, s.since_profile_s) = (None, None);
            (s.since_frame_s, s.since_byte_s) = (None, None);
        }),
        ["no-bytes"]
    );
    assert_eq!(
        after(&|s| (s.link, s.since_ping_s) = (LinkState::Down, None)),
        ["no-link"]
    );
}

#[test]
fn poses_that_are_missing_stopped_frozen_or_elsewhere_in_time_are_told() {
    let after = |change: &dyn Fn(&mut MapperReport)| {
        let (mut report, mut sonar) = healthy();
        sonar.session.profiles = 100;
        change(&mut report);
        codes(report, sonar)
    };
    assert_eq!(
        after(&|r| (r.poses.source.age_s, r.poses.source.accepted) = (None, 0)),
        ["no-poses"]
    );
    assert_eq!(
        after(&|r| r.poses.source.age_s = Some(1.6)),
        ["poses-stopped"]
    );
    assert_eq!(
        after(&|r| {
            r.poses.guard.still_s = 1.2;
            r.listening.view_changes = true;
        }),
        ["poses-frozen"]
    );
    assert_eq!(after(&|r| r.poses.guard.still_s = 60.0), [""; 0], "at rest");
    let hour_ns = 3_600_000_000_000;
    assert_eq!(
        after(&|r| {
            let (first_ns, last_ns) = (0, 1_000_000_000);
            r.poses.pose_times = Some(Span { first_ns, last_ns });
            let (first_ns, last_ns) = (hour_ns, hour_ns + last_ns);
            r.poses.ping_times = Some(Span { first_ns, last_ns });
            r.poses.waiting = 40;
        }),
        ["pose-times"]
    );
    assert_eq!(after(&|r| r.poses.guard.lead_s = -3.0), ["pose-clock"]);
}

#[test]
fn growth_of_a_counter_is_news_for_a_while() {
    let begin = Instant::now();
    let mut diagnosis = diagnosis(begin);
    let status = || {
        let (report, mut sonar) = healthy();
        sonar.session.profiles_rejected.scale = 3;
        Status::of(report, sonar)
    };
    let mut found = |after: f64| {
        let at = begin + Duration::from_secs_f64(after);
        diagnosis.findings(&status(), at).len()
    };
    assert_eq!((found(1.0), found(2.0), found(2.5)), (1, 1, 0));
}

#[test]
fn a_driver_that_answers_again_has_time_to_tell_what_it_kept() {
    let begin = Instant::now();
    let mut diagnosis = diagnosis(begin);
    let mut codes_after = |after_s: u64, silent_s: f64| -> Vec<String> {
        let (report, mut sonar) = healthy();
        sonar.since_ping_s = Some(3.0);
        let mut status = Status::of(report, sonar);
        status.tape = Some(TapeReport {
            silent_s: Some(silent_s),
            ..TapeReport::default()
        });
        let found = diagnosis.findings(&status, begin + Duration::from_secs(after_s));
        found
            .into_iter()
            .map(|finding| finding.code.into_owned())
            .collect()
    };
    assert_eq!(codes_after(10, 3.0), ["no-driver"]);
    assert_eq!(codes_after(11, 0.1), [""; 0]);
    assert_eq!(codes_after(13, 0.1), ["no-new-pings"]);
}

#[test]
fn a_pause_of_poses_is_told_as_that_and_not_as_poses_that_come_rarely_or_late() {
    let begin = Instant::now();
    let mut diagnosis = diagnosis(begin);
    let mut told = |age_s: f64, lost: u64, after_s: f64| {
        let (mut report, sonar) = healthy();
        report.poses.source.age_s = Some(age_s);
        report.poses.source.rate_hz = 20.0;
        report.poses.join.pings_in_gap = lost;
        report.poses.join.pings_pose_never_came = lost;
        let status = Status::of(report, sonar);
        let found = diagnosis.findings(&status, begin + Duration::from_secs_f64(after_s));
        let codes = found.into_iter().map(|finding| finding.code.into_owned());
        codes.collect::<Vec<_>>()
    };
    assert_eq!(told(0.02, 0, 2.0), [""; 0]);
    assert_eq!(told(4.0, 60, 6.0), ["poses-stopped"]);
    // They are back, and the pings of the pause are given up.
    assert_eq!(told(0.02, 160, 7.0), [""; 0]);
    assert_eq!(told(0.02, 240, 8.0), [""; 0]);
    // Long after it poses are missing again and again.
    assert_eq!(told(0.02, 260, 20.0), ["poses-rare", "poses-late"]);
}
