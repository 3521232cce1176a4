use std::f64::consts::FRAC_PI_2;

use super::*;
use echosplat_model::PingSettings;
use glam::{DQuat, DVec3};

/// Ranges 0 to 15 m at 1500 m/s: the middle's echo is 5 ms after transmit.
const MIDDLE_S: f64 = 0.005;

fn ping(sequence: u64, seconds: f64) -> Arc<Ping> {
    let settings = PingSettings {
        range_start_m: 0.0,
        range_length_m: 15.0,
        bin_count: 4,
        speed_of_sound_mps: 1500.0,
        frequency_hz: 0.0,
        pulse_duration_s: 0.0,
        gain_index: 0,
    };
    let time = Timestamp::from_secs_f64(seconds);
    Arc::new(Ping::new(sequence, time, settings, vec![0.0; 4]).unwrap())
}

fn pose(seconds: f64, position_m: DVec3, yaw_rad: f64) -> StampedPose {
    StampedPose {
        time: Timestamp::from_secs_f64(seconds),
        world_from_vehicle: Pose::from_yaw_pitch_roll(yaw_rad, 0.0, 0.0, position_m),
        uncertainty: None,
        epoch: 0,
    }
}

/// Moving east at 1 m/s.
fn eastward(seconds: f64) -> StampedPose {
    pose(seconds, DVec3::X * seconds, 0.0)
}

fn join(change: impl FnOnce(&mut PoseJoinConfig)) -> PoseJoin {
    let mut config = PoseJoinConfig {
        lookahead_s: 0.0,
        ..PoseJoinConfig::default()
    };
    change(&mut config);
    PoseJoin::new(config).unwrap()
}

fn rejection(join: &mut PoseJoin) -> Option<(u64, RejectReason)> {
    match join.poll().map(|verdict| verdict.result) {
        Some(Err(rejected)) => Some((rejected.ping.sequence(), rejected.reason)),
        other => panic!("expected a rejection, got {other:?}"),
    }
}

#[test]
fn the_pose_is_that_of_the_echo_from_the_middle() {
    let mut join = join(|_| {});
    join.push_pose(eastward(1.0)).unwrap();
    join.push_pose(eastward(1.2)).unwrap();
    assert!(join.push_ping(ping(7, 1.1)));
    let posed = join.poll().unwrap().result.unwrap();
    assert_eq!(posed.ping.sequence(), 7);
    assert!((posed.reference_range_m - 7.5).abs() < 1e-12);
    let x = posed.world_from_sensor.translation_m.x;
    assert!((x - (1.1 + MIDDLE_S)).abs() < 1e-9, "{x}");
    assert!((posed.twist.linear_mps - DVec3::X).length() < 1e-9);
    assert!(join.poll().is_none());
}

#[test]
fn mount_and_lever_arm_turn_the_pose_and_the_motion() {
    // The sensor looks to port from 2 m ahead; the vehicle turns to port at 0.5 rad/s on the spot.
    let mount = Pose {
        rotation: DQuat::from_rotation_z(FRAC_PI_2),
        translation_m: DVec3::new(2.0, 0.0, 0.0),
    };
    let mut join = join(|config| config.vehicle_from_sensor = mount);
    let at = |seconds: f64| pose(seconds, DVec3::ZERO, 0.5 * (seconds - 1.0 - MIDDLE_S));
    join.push_pose(at(0.9)).unwrap();
    join.push_pose(at(1.2)).unwrap();
    join.push_ping(ping(0, 1.0));
    let posed = join.poll().unwrap().result.unwrap();
    let sensor = posed.world_from_sensor;
    assert!((sensor.translation_m - DVec3::new(2.0, 0.0, 0.0)).length() < 1e-6);
    assert!((sensor.rotation * DVec3::X - DVec3::Y).length() < 1e-6);
    // It is swung to port, which is where it looks: forward in its own axes.
    assert!((posed.twist.linear_mps - DVec3::X).length() < 1e-6);
    assert!((posed.twist.angular_radps - DVec3::Z * 0.5).length() < 1e-6);
}

#[test]
fn headings_are_freed_from_the_compass_as_poses_come() {
    let east = CompassDeviation {
        b_deg: 3.0,
        c_deg: 0.0,
    };
    let mut deviating = join(|config| config.compass = east);
    deviating.push_pose(eastward(1.0)).unwrap();
    deviating.push_pose(eastward(1.2)).unwrap();
    deviating.push_ping(ping(0, 1.1));
    let posed = deviating.poll().unwrap().result.unwrap();
    let ahead = posed.world_from_sensor.rotation * DVec3::X;
    // Told east, it is 3° further clockwise.
    let yaw_deg = ahead.y.atan2(ahead.x).to_degrees();
    assert!((yaw_deg + 3.0).abs() < 1e-9, "{yaw_deg}");
    let wild = PoseJoinConfig {
        compass: CompassDeviation {
            b_deg: f64::NAN,
            c_deg: 0.0,
        },
        ..PoseJoinConfig::default()
    };
    let error = PoseJoin::new(wild).unwrap_err().to_string();
    assert!(error.contains("pose.compass"), "{error}");
}

#[test]
fn the_twist_agrees_with_the_sensors_own_track() {
    let mount = Pose::from_yaw_pitch_roll(0.4, -0.3, 1.1, DVec3::new(0.5, -0.2, 0.3));
    let vehicle = |t: f64| {
        let turned =
            Pose::from_yaw_pitch_roll(0.2 * t, 0.0, 0.0, DVec3::new(0.3 * t, 0.1 * t, 0.0));
        StampedPose {
            time: Timestamp::from_secs_f64(t),
            world_from_vehicle: turned,
            uncertainty: None,
            epoch: 0,
        }
    };
    let mut join = join(|config| config.vehicle_from_sensor = mount);
    for t in [1.0, 1.01, 1.02] {
        join.push_pose(vehicle(t)).unwrap();
    }
    join.push_ping(ping(0, 1.01 - MIDDLE_S));
    let posed = join.poll().unwrap().result.unwrap();
    let h = 1e-5;
    let track = |t: f64| vehicle(t).world_from_vehicle * mount;
    let velocity = (track(1.01 + h).translation_m - track(1.01 - h).translation_m) / (2.0 * h);
    let in_sensor = posed.world_from_sensor.rotation.conjugate() * velocity;
    assert!((posed.twist.linear_mps - in_sensor).length() < 1e-3);
}

#[test]
fn a_ping_waits_for_its_pose_and_order_is_kept() {
    let mut join = join(|_| {});
    for sequence in 0..3 {
        join.push_ping(ping(sequence, 1.0 + 0.1 * sequence as f64));
    }
    assert!(join.poll().is_none());
    join.push_pose(eastward(0.9)).unwrap();
    assert!(join.poll().is_none());
    join.push_pose(eastward(1.15)).unwrap();
    assert_eq!(join.poll().unwrap().result.unwrap().ping.sequence(), 0);
    assert_eq!(join.poll().unwrap().result.unwrap().ping.sequence(), 1);
    assert!(join.poll().is_none());
    assert_eq!(join.waiting_len(), 1);
}

#[test]
fn a_ping_waits_for_the_poses_that_tell_jitter_from_motion() {
    let mut join = join(|config| config.lookahead_s = 0.1);
    let jitter = |step: i32| if step % 2 == 0 { 0.1 } else { -0.1 };
    let jittery = |step: i32| {
        let seconds = 0.02 * f64::from(step);
        pose(seconds, DVec3::new(seconds, jitter(step), 0.0), 0.0)
    };
    for step in 0..=52 {
        join.push_pose(jittery(step)).unwrap();
    }
    join.push_ping(ping(0, 1.0 - MIDDLE_S));
    assert!(join.poll().is_none());
    for step in 53..=56 {
        join.push_pose(jittery(step)).unwrap();
    }
    let posed = join.poll().unwrap().result.unwrap();
    assert!(posed.world_from_sensor.translation_m.y.abs() < 0.04);
    assert!((posed.world_from_sensor.translation_m.x - 1.0).abs() < 1e-6);
}

#[test]
fn nothing_is_extrapolated_at_either_end_or_across_a_gap() {
    let mut join = join(|_| {});
    for (sequence, seconds) in [0.5, 1.05, 2.0, 5.0].into_iter().enumerate() {
        join.push_ping(ping(sequence as u64, seconds));
    }
    for seconds in [1.0, 1.1, 3.0, 3.1] {
        join.push_pose(eastward(seconds)).unwrap();
    }
    assert_eq!(rejection(&mut join), Some((0, RejectReason::TooEarly)));
    assert!(join.poll().unwrap().result.is_ok());
    assert_eq!(rejection(&mut join), Some((2, RejectReason::Gap)));
    assert!(join.poll().is_none());
    join.finish();
    assert_eq!(rejection(&mut join), Some((3, RejectReason::NeverCame)));
    let counters = join.counters();
    assert_eq!(counters.pings_received, 4);
    assert_eq!(counters.pings_joined + counters.pings_without_pose(), 4);
}

#[test]
fn back_within_one_ping_after_a_gap() {
    let mut join = join(|_| {});
    let outage = 1.0..61.0;
    for step in 0..1300 {
        let seconds = 0.05 * f64::from(step);
        if !outage.contains(&seconds) {
            join.push_pose(eastward(seconds)).unwrap();
        }
    }
    for step in 1..1290_u64 {
        join.push_ping(ping(step, 0.05 * step as f64));
    }
    let mut joined = Vec::new();
    while let Some(verdict) = join.poll() {
        joined.extend(
            verdict
                .result
                .ok()
                .map(|posed| posed.ping.transmit_time().as_secs_f64()),
        );
    }
    assert!(joined.iter().all(|t| !(0.95..61.0 - MIDDLE_S).contains(t)));
    let first_after = joined.iter().find(|&&t| t > 1.0).unwrap();
    assert!(*first_after < 61.06, "{first_after}");
}

#[test]
fn an_estimators_reset_is_a_gap() {
    let mut join = join(|_| {});
    join.push_pose(eastward(1.0)).unwrap();
    join.push_pose(StampedPose {
        epoch: 1,
        ..eastward(1.1)
    })
    .unwrap();
    join.push_ping(ping(0, 1.05));
    assert_eq!(rejection(&mut join), Some((0, RejectReason::Gap)));
}

#[test]
fn on_a_live_stream_a_pose_has_only_so_long_to_come() {
    let mut join = join(|config| config.max_wait_s = Some(1.0));
    join.push_ping(ping(0, 1.0));
    join.push_ping(ping(1, 1.9));
    assert!(join.poll().is_none());
    join.push_ping(ping(2, 2.1));
    assert_eq!(rejection(&mut join), Some((0, RejectReason::NeverCame)));
    assert!(join.poll().is_none());
    join.push_pose(eastward(1.85)).unwrap();
    join.push_pose(eastward(2.0)).unwrap();
    assert_eq!(join.poll().unwrap().result.unwrap().ping.sequence(), 1);
}

#[test]
fn a_ping_let_go_says_when_and_is_let_go_again_at_that_moment() {
    let live = || {
        let mut join = join(|config| config.max_wait_s = Some(1.0));
        join.push_pose(eastward(0.9)).unwrap();
        join.push_ping(ping(0, 1.0));
        join.push_ping(ping(1, 2.1));
        join.poll().unwrap()
    };
    let let_go_at = live().let_go_at.unwrap();
    assert_eq!(let_go_at, Timestamp::from_secs_f64(0.9));
    let mut replayed = join(|_| {});
    replayed.let_go_again(HashMap::from([(0, let_go_at)]));
    replayed.push_ping(ping(0, 1.0));
    assert!(replayed.poll().is_none());
    replayed.push_pose(eastward(0.9)).unwrap();
    assert_eq!(rejection(&mut replayed), Some((0, RejectReason::NeverCame)));
}

#[test]
fn after_a_restart_earlier_poses_are_taken_and_old_ones_forgotten() {
    let mut join = join(|_| {});
    join.push_pose(eastward(3601.0)).unwrap();
    join.push_pose(eastward(3601.2)).unwrap();
    join.push_ping(ping(0, 3601.1));
    join.finish();
    assert!(join.poll().unwrap().result.is_ok());
    join.restart();
    join.push_ping(ping(1, 1.1));
    assert!(join.poll().is_none());
    join.push_pose(eastward(1.0)).unwrap();
    join.push_pose(eastward(1.2)).unwrap();
    assert_eq!(join.poll().unwrap().result.unwrap().ping.sequence(), 1);
}

#[test]
fn beyond_the_limit_the_newest_ping_is_dropped_and_counted() {
    let mut join = join(|config| config.waiting_capacity = 2);
    assert!(join.push_ping(ping(0, 1.0)));
    assert!(!join.is_full());
    assert!(join.push_ping(ping(1, 1.1)));
    assert!(join.is_full());
    assert!(!join.push_ping(ping(2, 1.2)));
    assert_eq!(join.counters().pings_dropped_full, 1);
    join.push_pose(eastward(0.9)).unwrap();
    join.push_pose(eastward(1.3)).unwrap();
    assert_eq!(join.poll().unwrap().result.unwrap().ping.sequence(), 0);
}

#[test]
fn a_time_offset_moves_the_pings_against_the_poses() {
    let mut join = join(|config| config.time_offset_s = 100.0);
    join.push_pose(eastward(101.0)).unwrap();
    join.push_pose(eastward(101.2)).unwrap();
    join.push_ping(ping(0, 1.1));
    let x = join
        .poll()
        .unwrap()
        .result
        .unwrap()
        .world_from_sensor
        .translation_m
        .x;
    assert!((x - (101.1 + MIDDLE_S)).abs() < 1e-6);
}

#[test]
fn bad_poses_are_counted_and_change_nothing() {
    let mut join = join(|_| {});
    join.push_pose(eastward(1.0)).unwrap();
    assert!(join.push_pose(eastward(0.5)).is_err());
    assert!(join.push_pose(pose(2.0, DVec3::NAN, 0.0)).is_err());
    let counters = join.counters();
    let bad = (counters.poses_out_of_order, counters.poses_not_finite);
    assert_eq!((counters.poses_taken, bad), (1, (1, 1)));
    assert_eq!(join.trajectory().len(), 1);
}

#[test]
fn settings_out_of_range_are_named() {
    let refusal = |change: &dyn Fn(&mut PoseJoinConfig)| {
        let mut config = PoseJoinConfig::default();
        change(&mut config);
        PoseJoin::new(config).unwrap_err().to_string()
    };
    assert!(refusal(&|c| c.max_pose_gap_s = f64::NAN).contains("max_pose_gap_s"));
    assert!(refusal(&|c| c.max_wait_s = Some(0.0)).contains("max_wait_s"));
    assert!(refusal(&|c| c.waiting_capacity = 0).contains("waiting_capacity"));
    let nowhere = Pose {
        rotation: DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0),
        translation_m: DVec3::ZERO,
    };
    assert!(refusal(&|c| c.vehicle_from_sensor = nowhere).contains("vehicle_from_sensor"));
}
