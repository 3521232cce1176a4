use std::f64::consts::{FRAC_PI_2, PI};

use echosplat_model::Timestamp;
use echosplat_model::glam::{DQuat, DVec3};

use super::*;

fn at(seconds: f64) -> Timestamp {
    Timestamp::from_millis(1_000_000).offset_by(seconds)
}

/// Heading, from east to north.
fn level(heading_rad: f64) -> DQuat {
    DQuat::from_rotation_z(heading_rad)
}

/// A dive: 50 attitudes a second, and 8 velocities that come a tenth of a second late.
struct Dive {
    heading_rad: fn(f64) -> f64,
    /// Along the vehicle's axes.
    mps: fn(f64) -> DVec3,
    /// Whether the bottom is seen.
    is_locked: fn(f64) -> bool,
    /// Height by a depth sensor.
    z_m: Option<fn(f64) -> f64>,
}

const STRAIGHT: Dive = Dive {
    heading_rad: |_| 0.0,
    mps: |_| DVec3::X,
    is_locked: |_| true,
    z_m: None,
};

impl Dive {
    fn reckoned(&self, reckoner: &mut Reckoner, seconds: f64) -> Vec<Reckoned> {
        let mut poses = Vec::new();
        for step in 0..(seconds * 50.0) as u32 {
            let now_s = f64::from(step) * 0.02;
            reckoner.attitude(at(now_s), level((self.heading_rad)(now_s)));
            if let Some(z_m) = self.z_m.filter(|_| step.is_multiple_of(5)) {
                reckoner.height("z", at(now_s), z_m(now_s)).unwrap();
            }
            let valid_s = now_s - 0.1;
            if step.is_multiple_of(6) && valid_s >= 0.0 && (self.is_locked)(valid_s) {
                let velocity = told(valid_s, (self.mps)(valid_s));
                reckoner.velocity("v", velocity).unwrap();
            }
            poses.extend(reckoner.take());
        }
        poses
    }

    fn live(&self, seconds: f64) -> Vec<Reckoned> {
        self.reckoned(&mut Reckoner::new(LIVE_PATIENCE_S), seconds)
    }

    fn logged(&self, seconds: f64) -> Vec<Reckoned> {
        self.reckoned(&mut Reckoner::new(LOG_PATIENCE_S), seconds)
    }
}

fn told(seconds: f64, mps: DVec3) -> Velocity {
    Velocity {
        time: at(seconds),
        axes: Axes::Vehicle,
        mps,
    }
}

fn place_m(pose: &Reckoned) -> DVec3 {
    pose.world_from_vehicle.translation_m
}

fn since_s(pose: &Reckoned) -> f64 {
    pose.time.seconds_since(at(0.0))
}

#[test]
fn a_velocity_is_turned_by_the_attitude_at_its_time() {
    // A circle of 1 m radius, forward all the while, its attitudes 60 ms apart: with the one before or behind a velocity it
    // would be off by a tenth of a degree to 3.
    let mut reckoner = Reckoner::new(LIVE_PATIENCE_S);
    let mut poses = Vec::new();
    for step in 0..2_000 {
        let now_s = f64::from(step) * 0.06;
        reckoner.attitude(at(now_s), level(now_s));
        reckoner
            .velocity("v", told(now_s - 0.037, DVec3::X))
            .unwrap();
        poses.extend(reckoner.take());
    }
    let circle_m = |pose: &Reckoned| DVec3::new(since_s(pose).sin(), -since_s(pose).cos(), 0.0);
    let first_m = place_m(&poses[0]) - circle_m(&poses[0]);
    for pose in &poses {
        let off_m = (place_m(pose) - first_m - circle_m(pose)).length();
        assert!(off_m < 2e-3, "{}: {off_m}", since_s(pose));
    }
    assert!(poses.len() > 1_990);
}

#[test]
fn forward_left_up_are_turned_into_east_north_up() {
    let moved_m = |heading_rad, mps: DVec3| {
        let mut reckoner = Reckoner::new(LIVE_PATIENCE_S);
        for step in 0..=10 {
            let now_s = f64::from(step) * 0.1;
            reckoner.attitude(at(now_s), level(heading_rad));
            reckoner.velocity("v", told(now_s, mps)).unwrap();
        }
        let last = reckoner.take().last().unwrap();
        place_m(&last)
    };
    for (heading_rad, mps, expected_m) in [
        (0.0, DVec3::X, DVec3::X),
        (FRAC_PI_2, DVec3::X, DVec3::Y),
        (FRAC_PI_2, DVec3::Y, DVec3::NEG_X),
        (PI, DVec3::new(1.0, 0.0, 0.5), DVec3::new(-1.0, 0.0, 0.5)),
    ] {
        let moved_m = moved_m(heading_rad, mps);
        assert!(
            (moved_m - expected_m).length() < 1e-9,
            "{heading_rad}: {moved_m}"
        );
    }
    // Pitched down by 30 degrees, forward is downwards too.
    let mut reckoner = Reckoner::new(LIVE_PATIENCE_S);
    for step in 0..=10 {
        let now_s = f64::from(step) * 0.1;
        reckoner.attitude(at(now_s), DQuat::from_rotation_y(PI / 6.0));
        reckoner.velocity("v", told(now_s, DVec3::X)).unwrap();
    }
    let last = reckoner.take().last().unwrap();
    assert!((place_m(&last).z + 0.5).abs() < 1e-9);
}

#[test]
fn a_velocity_in_the_world_is_taken_as_it_is() {
    let mut reckoner = Reckoner::new(LIVE_PATIENCE_S);
    for step in 0..=10 {
        let now_s = f64::from(step) * 0.1;
        reckoner.attitude(at(now_s), level(1.0));
        let velocity = Velocity {
            axes: Axes::World,
            ..told(now_s, DVec3::Y)
        };
        reckoner.velocity("v", velocity).unwrap();
    }
    let last = reckoner.take().last().unwrap();
    assert!((place_m(&last) - DVec3::Y).length() < 1e-9);
}

#[test]
fn a_gap_of_five_seconds_is_bridged_live_with_a_sigma_that_grows() {
    let dive = Dive {
        // Slower and slower: carried on, it gets too far.
        mps: |s| DVec3::X * (1.0 - 0.02 * s),
        is_locked: |s| !(10.0..15.0).contains(&s),
        ..STRAIGHT
    };
    let poses = dive.live(30.0);
    let true_m = |s: f64| s - 0.01 * s * s;
    let begin_m = true_m(since_s(&poses[0]));
    let error_m = |pose: &Reckoned| place_m(pose).x - (true_m(since_s(pose)) - begin_m);
    let gaps = poses
        .windows(2)
        .map(|two| since_s(&two[1]) - since_s(&two[0]));
    assert!(gaps.fold(0.0, f64::max) < 0.021, "no pose lacks");
    assert!(poses.iter().all(|pose| pose.epoch == 0));
    let near = |s: f64| poses.iter().find(|pose| since_s(pose) >= s).unwrap();
    let sigma_m = |pose: &Reckoned| pose.covariance.position_m2[0].sqrt();
    let (before, late, behind) = (near(9.5), near(14.9), near(16.0));
    assert!(error_m(before).abs() < 1e-3);
    assert!((0.1..0.3).contains(&error_m(late)), "{}", error_m(late));
    assert!(error_m(late) < 1.5 * sigma_m(late));
    // The way between both ends is nearer, and surer.
    assert!(error_m(behind).abs() < 0.02, "{}", error_m(behind));
    assert!(sigma_m(behind) < 0.7 * sigma_m(late));
    assert!(sigma_m(near(12.0)) < sigma_m(late) && sigma_m(before) < sigma_m(behind));
}

#[test]
fn in_a_log_a_gap_is_bridged_from_both_ends() {
    let dive = Dive {
        mps: |s| DVec3::new((0.2 * s).cos(), (0.2 * s).sin(), 0.0),
        is_locked: |s| !(10.0..15.0).contains(&s),
        ..STRAIGHT
    };
    let true_m = |s: f64| 5.0 * DVec3::new((0.2 * s).sin(), -(0.2 * s).cos(), 0.0);
    let worst_m = |poses: &[Reckoned]| {
        let begin_m = true_m(since_s(&poses[0]));
        let errors = poses
            .iter()
            .map(|pose| (place_m(pose) - true_m(since_s(pose)) + begin_m).length());
        errors.fold(0.0, f64::max)
    };
    let (live, logged) = (dive.live(40.0), dive.logged(40.0));
    assert!(worst_m(&logged) < 0.35, "{}", worst_m(&logged));
    assert!(
        worst_m(&live) > 2.0 * worst_m(&logged),
        "{}",
        worst_m(&live)
    );
    let steps = logged
        .windows(2)
        .map(|two| (place_m(&two[1]) - place_m(&two[0])).length());
    assert!(
        steps.fold(0.0, f64::max) < 0.04,
        "it goes on without a jump"
    );
}

#[test]
fn a_gap_that_is_too_long_ends_the_epoch() {
    let dive = Dive {
        is_locked: |s| !(10.0..20.0).contains(&s),
        ..STRAIGHT
    };
    for poses in [dive.live(30.0), dive.logged(40.0)] {
        let last = poses.iter().rfind(|pose| pose.epoch == 0).unwrap();
        assert!((15.0..16.1).contains(&since_s(last)), "{}", since_s(last));
        let first = poses.iter().find(|pose| pose.epoch == 1).unwrap();
        assert!((20.0..20.2).contains(&since_s(first)), "{}", since_s(first));
        assert!(place_m(first).length() < 0.3, "the world begins anew");
        assert!(poses.iter().all(|pose| pose.epoch <= 1));
    }
}

#[test]
fn height_is_by_the_depth_sensor_where_there_is_one() {
    let dive = Dive {
        // Its vertical velocity is wrong, and its depth sensor is silent for some seconds.
        mps: |_| DVec3::new(1.0, 0.0, 0.1),
        z_m: Some(|s| -5.0 - 0.05 * s),
        ..STRAIGHT
    };
    let poses = dive.live(30.0);
    for pose in &poses {
        let off_m = place_m(pose).z + 5.0 + 0.05 * since_s(pose);
        assert!(off_m.abs() < 0.03, "{off_m}");
    }
    let [.., up_m2] = poses.last().unwrap().covariance.position_m2;
    assert!((up_m2.sqrt() - 0.02).abs() < 1e-12, "it does not grow");
    let without = Dive { z_m: None, ..dive }.live(30.0);
    let last = without.last().unwrap();
    let way_s = since_s(last) - since_s(&without[0]);
    assert!((place_m(last).z - 0.1 * way_s).abs() < 0.01);
    assert!(last.covariance.position_m2[5] > 0.05_f64.powi(2));
}

#[test]
fn a_depth_sensor_that_is_heard_late_goes_on_from_there() {
    let mut reckoner = Reckoner::new(LIVE_PATIENCE_S);
    let mut poses = STRAIGHT.reckoned(&mut reckoner, 5.0);
    for step in 250..500 {
        let now_s = f64::from(step) * 0.02;
        reckoner.attitude(at(now_s), level(0.0));
        reckoner.velocity("v", told(now_s, DVec3::X)).unwrap();
        reckoner
            .height("z", at(now_s), -8.0 - 0.1 * (now_s - 5.0))
            .unwrap();
        poses.extend(reckoner.take());
    }
    let steps = poses
        .windows(2)
        .map(|two| (place_m(&two[1]).z - place_m(&two[0]).z).abs());
    assert!(steps.fold(0.0, f64::max) < 0.01);
    let last_m = place_m(poses.last().unwrap());
    assert!((last_m.z + 0.5).abs() < 0.02, "{last_m}");
}

#[test]
fn what_comes_out_of_order_again_or_far_ahead_changes_nothing() {
    let mut twice = Reckoner::new(LIVE_PATIENCE_S);
    let mut once = Reckoner::new(LIVE_PATIENCE_S);
    for step in 0..200 {
        let now_s = f64::from(step) * 0.02;
        let velocity = told(now_s - 0.05, DVec3::X);
        for reckoner in [&mut once, &mut twice] {
            reckoner.attitude(at(now_s), level(0.0));
            reckoner.velocity("v", velocity).unwrap();
        }
        let wrong = DVec3::new(-3.0, 2.0, 1.0);
        for stamp_s in [now_s - 0.05, now_s - 1.0, now_s + 300.0] {
            twice.velocity("v", told(stamp_s, wrong)).unwrap();
        }
        twice.attitude(at(now_s - 0.5), level(2.0));
        twice.attitude(at(now_s), level(2.0));
    }
    let (once, twice): (Vec<_>, Vec<_>) = (once.take().collect(), twice.take().collect());
    assert!(!once.is_empty());
    assert_eq!(once, twice);
}

#[test]
fn what_no_vehicle_does_is_refused_in_words() {
    let mut reckoner = Reckoner::new(LIVE_PATIENCE_S);
    reckoner.attitude(at(0.0), level(0.0));
    let mut refused = |x: f64| {
        let fault = reckoner
            .velocity("the DVL", told(0.0, DVec3::X * x))
            .unwrap_err();
        fault.to_string()
    };
    assert_eq!(refused(f64::NAN), "the DVL is not finite");
    assert_eq!(refused(f64::INFINITY), "the DVL is not finite");
    assert!(refused(-32.768).contains("32.8 m/s"));
    let mut refused = |z_m| {
        reckoner
            .height("alt", at(0.0), z_m)
            .unwrap_err()
            .to_string()
    };
    assert_eq!(refused(f64::NAN), "alt is not finite");
    assert!(refused(-1e6).contains("no sea"));
}

#[test]
fn memory_is_bounded_whatever_lacks() {
    let mut reckoner = Reckoner::new(LOG_PATIENCE_S);
    for step in 0..100_000 {
        let now_s = f64::from(step) * 0.002;
        reckoner.attitude(at(now_s), level(0.0));
        reckoner.height("z", at(now_s), -1.0).unwrap();
    }
    assert!(reckoner.waiting.len() < 6_000);
    for step in 0..100_000 {
        let now_s = 200.0 + f64::from(step) * 0.001;
        reckoner.attitude(at(now_s), level(0.0));
        // Ahead of all attitudes, so that each waits.
        reckoner.velocity("v", told(now_s + 1.9, DVec3::X)).unwrap();
    }
    assert!(reckoner.velocities.len() <= VELOCITY_COUNT && reckoner.turned.len() <= VELOCITY_COUNT);
    assert!(reckoner.made.len() <= MADE_COUNT);
}
