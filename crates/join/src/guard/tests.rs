use super::*;
use echosplat_model::{Pose, Timestamp};
use glam::DVec3;

/// Unix time of the first pose.
const BEGIN_S: f64 = 1.7e9;
const DELAY_S: f64 = 0.01;

/// At 50 Hz along x at 0.5 m/s, arriving 10 ms after its stamp.
fn pose(index: u32) -> ArrivedPose {
    let since_s = f64::from(index) * 0.02;
    moved(index, DVec3::X * 0.5 * since_s, 0.0)
}

/// Another place, and a stamp off by `ahead_s`.
fn moved(index: u32, position_m: DVec3, ahead_s: f64) -> ArrivedPose {
    let time = Timestamp::from_secs_f64(BEGIN_S).offset_by(f64::from(index) * 0.02);
    ArrivedPose {
        pose: StampedPose {
            time: time.offset_by(ahead_s),
            world_from_vehicle: Pose::from_yaw_pitch_roll(0.0, 0.0, 0.0, position_m),
            uncertainty: None,
            epoch: 0,
        },
        arrived: time.offset_by(DELAY_S),
    }
}

fn push(guard: &mut PoseGuard, arrived: ArrivedPose) -> Vec<Guarded> {
    let mut taken = Vec::new();
    guard.push(arrived, &mut |guarded| taken.push(guarded));
    taken
}

fn push_many(guard: &mut PoseGuard, indices: std::ops::Range<u32>) {
    for index in indices {
        push(guard, pose(index));
    }
}

fn poses_of(taken: &[Guarded]) -> Vec<StampedPose> {
    let pose = |guarded: &Guarded| match guarded {
        Guarded::Pose(pose) => Some(*pose),
        Guarded::ClockWentBack => None,
    };
    taken.iter().filter_map(pose).collect()
}

#[test]
fn an_undisturbed_track_is_taken_whole() {
    let mut guard = PoseGuard::new(StampClock::Host);
    let taken: usize = (0..500).map(|i| push(&mut guard, pose(i)).len()).sum();
    assert_eq!(taken, 500);
    let report = guard.report();
    assert!((report.lead_s + DELAY_S).abs() < 1e-6);
    let refused = (report.stamps_far, report.off_track, report.out_of_order);
    assert_eq!((refused, report.epoch), ((0, 0, 0), 0));
}

#[test]
fn one_stamp_an_hour_ahead_is_refused_and_the_next_pose_is_taken() {
    let mut guard = PoseGuard::new(StampClock::Host);
    push_many(&mut guard, 0..50);
    assert!(push(&mut guard, moved(50, DVec3::X * 0.5, 3600.0)).is_empty());
    assert_eq!(push(&mut guard, pose(51)).len(), 1);
    assert_eq!((guard.report().stamps_far, guard.report().epoch), (1, 0));
}

#[test]
fn a_first_stamp_an_hour_ahead_does_not_shut_out_the_rest() {
    let mut guard = PoseGuard::new(StampClock::Host);
    push(&mut guard, moved(0, DVec3::ZERO, 3600.0));
    let taken: usize = (1..20)
        .map(|i| poses_of(&push(&mut guard, pose(i))).len())
        .sum();
    assert_eq!(taken, 19, "those held are handed on once they are believed");
    assert!(guard.report().clock_shift_s.abs() < 1e-9);
}

#[test]
fn a_pose_clock_that_steps_back_is_followed_within_a_second_on_the_old_time() {
    let mut guard = PoseGuard::new(StampClock::Host);
    push_many(&mut guard, 0..100);
    let mut taken = Vec::new();
    for i in 100..150 {
        let position_m = pose(i).pose.world_from_vehicle.translation_m;
        taken.extend(push(&mut guard, moved(i, position_m, -3600.0)));
    }
    let poses = poses_of(&taken);
    assert_eq!(poses.len(), 50);
    for (index, found) in (100..).zip(&poses) {
        let off_s = found.time.seconds_since(pose(index).pose.time);
        assert!(off_s.abs() < 1e-3, "{off_s}");
        assert_eq!(found.epoch, 1);
    }
    let reason = guard.report().epoch_reason.clone().unwrap();
    assert!(reason.contains("-3600.000 s"), "{reason}");
}

#[test]
fn a_second_publisher_is_refused_from_its_first_pose() {
    let mut guard = PoseGuard::new(StampClock::Host);
    let mut taken = Vec::new();
    for i in 0..400 {
        taken.extend(push(&mut guard, pose(i)));
        if i >= 100 {
            let beside_m = pose(i).pose.world_from_vehicle.translation_m + DVec3::Y * 2.0;
            let mut other = moved(i, beside_m, 0.005);
            other.arrived = other.arrived.offset_by(0.005);
            taken.extend(push(&mut guard, other));
        }
    }
    assert!(
        poses_of(&taken)
            .iter()
            .all(|pose| pose.world_from_vehicle.translation_m.y == 0.0)
    );
    let report = guard.report();
    assert!(report.has_second_source() && report.epoch == 0);
    assert!((report.off_track_m - 2.0).abs() < 0.1);
}

#[test]
fn a_jump_begins_a_new_epoch_and_loses_no_pose() {
    let mut guard = PoseGuard::new(StampClock::Host);
    push_many(&mut guard, 0..100);
    let mut taken = Vec::new();
    for i in 100..130 {
        taken.extend(push(&mut guard, moved(i, DVec3::new(40.0, 7.0, -3.0), 0.0)));
    }
    let poses = poses_of(&taken);
    assert!(poses.len() == 30 && poses.iter().all(|pose| pose.epoch == 1));
    assert!(!taken.contains(&Guarded::ClockWentBack));
}

#[test]
fn jumps_of_the_data_are_its_own() {
    let mut guard = PoseGuard::new(StampClock::Data);
    let mut taken = Vec::new();
    for i in 0..128 {
        let view = DVec3::Y * f64::from(i / 64) * 6.0;
        taken.extend(push(&mut guard, moved(i, view, 0.0)));
    }
    assert_eq!(poses_of(&taken).len(), 128);
    assert_eq!(guard.report().epoch, 0);
}

#[test]
fn a_reset_of_the_source_is_a_new_epoch_at_once() {
    let mut guard = PoseGuard::new(StampClock::Host);
    push(&mut guard, pose(0));
    let mut after = pose(1);
    after.pose.epoch = 7;
    assert_eq!(poses_of(&push(&mut guard, after))[0].epoch, 1);
}

#[test]
fn noise_of_ten_centimetres_is_no_second_publisher() {
    let mut guard = PoseGuard::new(StampClock::Host);
    let mut state = 1_u64;
    let mut random = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 40) as f64 / f64::from(1 << 24) - 0.5
    };
    for i in 0..5_000 {
        // Uniform with the spread of one sigma of 10 cm.
        let noise_m = DVec3::new(random(), random(), random()) * 0.35;
        let steady_m = pose(i).pose.world_from_vehicle.translation_m;
        push(&mut guard, moved(i, steady_m + noise_m, 0.0));
    }
    assert_eq!((guard.report().off_track, guard.report().epoch), (0, 0));
}

#[test]
fn a_frozen_estimator_shows() {
    let mut guard = PoseGuard::new(StampClock::Host);
    push_many(&mut guard, 0..50);
    let held_m = pose(49).pose.world_from_vehicle.translation_m;
    for i in 50..200 {
        push(&mut guard, moved(i, held_m, 0.0));
    }
    assert!((guard.report().still_s - 3.0).abs() < 1e-6);
    push(&mut guard, pose(200));
    assert!(guard.report().still_s < 1e-9);
}

#[test]
fn a_host_clock_that_steps_alone_finds_the_poses_again() {
    for (host_s, poses_s) in [
        (3600.0, 0.0),
        (-3600.0, 0.0),
        (3600.0, 3600.0),
        (-3600.0, -3600.0),
    ] {
        let mut guard = PoseGuard::new(StampClock::Host);
        push_many(&mut guard, 0..100);
        guard.clock_stepped();
        let mut taken = Vec::new();
        for i in 100..150 {
            let mut next = pose(i);
            next.arrived = next.arrived.offset_by(host_s);
            next.pose.time = next.pose.time.offset_by(poses_s);
            taken.extend(push(&mut guard, next));
        }
        let poses = poses_of(&taken);
        assert_eq!(poses.len(), 50);
        let off_s = poses[49].time.seconds_since(pose(149).pose.time) - host_s;
        assert!(off_s.abs() < 1e-3, "{host_s} {poses_s}: {off_s}");
    }
}

#[test]
fn a_second_publisher_with_the_same_stamps_shows_too() {
    let mut guard = PoseGuard::new(StampClock::Host);
    for i in 0..100 {
        push(&mut guard, pose(i));
        let beside_m = pose(i).pose.world_from_vehicle.translation_m + DVec3::Y * 2.0;
        push(&mut guard, moved(i, beside_m, 0.0));
    }
    assert!(guard.report().has_second_source());
}

#[test]
fn a_backlog_after_a_stalled_link_is_taken() {
    let mut guard = PoseGuard::new(StampClock::Host);
    push_many(&mut guard, 0..50);
    let late = pose(350).arrived;
    let taken: usize = (50..350)
        .map(|i| {
            let arrived = ArrivedPose {
                arrived: late,
                ..pose(i)
            };
            push(&mut guard, arrived).len()
        })
        .sum();
    assert_eq!((taken, guard.report().stamps_far), (300, 0));
}

#[test]
fn poses_without_a_stamp_are_counted_as_such_and_as_nothing_else() {
    let unstamped = |index: u32| {
        let mut arrived = pose(index);
        arrived.pose.time = Timestamp::ZERO;
        arrived
    };
    let mut guard = PoseGuard::new(StampClock::Host);
    let taken: usize = (0..100).map(|i| push(&mut guard, unstamped(i)).len()).sum();
    let report = guard.report();
    assert_eq!((taken, report.stamps_zero, report.epoch), (0, 100, 0));
    let refused = (report.stamps_far, report.off_track, report.out_of_order);
    assert_eq!((refused, report.lead_s.abs() > 0.0), ((0, 0, 0), false));

    // One in ten of an otherwise sound source.
    let mut guard = PoseGuard::new(StampClock::Host);
    let sent = |i: u32| if i % 10 == 3 { unstamped(i) } else { pose(i) };
    let taken: usize = (0..100).map(|i| push(&mut guard, sent(i)).len()).sum();
    assert_eq!((taken, guard.report().stamps_zero), (90, 10));
}

#[test]
fn a_clock_of_the_datas_own_may_begin_at_nothing() {
    let at = |seconds: f64| {
        let mut arrived = pose(0);
        arrived.pose.time = Timestamp::from_secs_f64(seconds);
        arrived
    };
    let mut guard = PoseGuard::new(StampClock::Data);
    let taken: usize = [0.0, 0.02, 0.04]
        .map(|s| push(&mut guard, at(s)).len())
        .iter()
        .sum();
    assert_eq!((taken, guard.report().stamps_zero), (3, 0));
    let mut guard = PoseGuard::new(StampClock::Data);
    let taken: usize = [0.0, 0.0, 0.0]
        .map(|s| push(&mut guard, at(s)).len())
        .iter()
        .sum();
    assert_eq!((taken, guard.report().stamps_zero), (1, 2));
}
