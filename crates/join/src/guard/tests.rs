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
    assert_eq!(guard.report().epoch, 0, "no map was begun by one pose");
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
    push_many(&mut guard, 0..100);
    let mut taken = Vec::new();
    for i in 100..150 {
        let mut after = pose(i);
        after.pose.epoch = 7;
        taken.extend(push(&mut guard, after));
        let is_told = guard.report().epoch == 1;
        assert!(is_told || i < 106, "nearly at once");
    }
    let poses = poses_of(&taken);
    assert!(poses.len() == 50 && poses.iter().all(|pose| pose.epoch == 1));
    let reason = guard.report().epoch_reason.clone().unwrap();
    assert!(reason.contains("reset"), "{reason}");
}

/// Strays among the poses of a live source; how often one comes says `is_stray`.
fn with_strays(
    clock: StampClock,
    is_stray: impl Fn(u32) -> bool,
    change: impl Fn(&mut ArrivedPose),
) -> (Vec<StampedPose>, GuardReport) {
    let mut guard = PoseGuard::new(clock);
    let mut taken = Vec::new();
    for i in 0..2_000 {
        let mut next = pose(i);
        if is_stray(i) {
            change(&mut next);
        }
        if clock == StampClock::Data {
            next.arrived = next.pose.time;
        }
        taken.extend(push(&mut guard, next));
    }
    guard.finish(&mut |guarded| taken.push(guarded));
    (poses_of(&taken), guard.report().clone())
}

/// In any order, as often as asked for.
fn at_random(share: f64) -> impl Fn(u32) -> bool {
    move |index| {
        let mut state = u64::from(index + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        state = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        state = (state ^ (state >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (((state ^ (state >> 31)) >> 11) as f64) < share * (1_u64 << 53) as f64
    }
}

/// How many of the poses stand where the vehicle was then, and the longest time without.
fn right(poses: &[StampedPose]) -> (usize, f64) {
    let is_right = |found: &&StampedPose| {
        let since_s = found.time.seconds_since(pose(0).pose.time);
        (found.world_from_vehicle.translation_m.x - 0.5 * since_s).abs() < 0.01
    };
    let right: Vec<Timestamp> = poses.iter().filter(is_right).map(|p| p.time).collect();
    let gaps = right.windows(2).map(|two| two[1].seconds_since(two[0]));
    (right.len(), gaps.fold(0.0, f64::max))
}

#[test]
fn stray_stamps_cost_their_own_poses_alone() {
    for share in [1.0 / 500.0, 1.0 / 50.0, 0.1, 1.0 / 3.0, 0.5] {
        for off_s in [0.2, 1.0, 1.9, 2.5, 100.0, -0.2, -1.0, -1.9, -2.5, -100.0] {
            let change = |next: &mut ArrivedPose| next.pose.time = next.pose.time.offset_by(off_s);
            let every = (1.0 / share) as u32;
            let evenly = with_strays(StampClock::Host, |i| i % every == every - 1, change);
            let randomly = with_strays(StampClock::Host, at_random(share), change);
            for (poses, report) in [evenly, randomly] {
                let said = format!("{share} {off_s}: {report:?}");
                let (count, gap_s) = right(&poses);
                let expected = 2_000.0 * (1.0 - share);
                assert!(count as f64 > 0.93 * expected, "{count} {said}");
                assert!(gap_s < 0.5, "{gap_s} {said}");
                assert!(poses.len() - count < 12, "{} {count} {said}", poses.len());
                assert_eq!(report.epoch, 0, "{said}");
                let refused = report.stamps_far + report.out_of_order;
                assert!(refused > 0, "{said}");
            }
        }
    }
}

#[test]
fn whose_stamps_are_wrong_shows_even_if_the_first_pose_is_a_stray() {
    for share in [0.02, 0.5] {
        for off_s in [0.5, 1.0, -0.5, -1.0] {
            let change = |next: &mut ArrivedPose| next.pose.time = next.pose.time.offset_by(off_s);
            let every = (1.0 / share) as u32;
            let (poses, report) = with_strays(StampClock::Host, |i| i % every == 0, change);
            let (count, _) = right(&poses);
            let said = format!("{share} {off_s}: {count} of {} {report:?}", poses.len());
            assert!(count as f64 > 0.93 * 2_000.0 * (1.0 - share), "{said}");
            assert!(poses.len() - count < 12 && report.epoch == 0, "{said}");
        }
    }
}

#[test]
fn stray_stamps_of_data_cost_their_own_poses_alone() {
    for off_s in [0.5, 1.0, 100.0, -0.5, -100.0] {
        let change = |next: &mut ArrivedPose| next.pose.time = next.pose.time.offset_by(off_s);
        let (poses, report) = with_strays(StampClock::Data, |i| i % 50 == 49, change);
        let (count, gap_s) = right(&poses);
        assert!(
            count >= 1_950 && gap_s < 0.5,
            "{off_s}: {count} {gap_s} {report:?}"
        );
    }
}

#[test]
fn a_gap_in_the_poses_loses_none_of_them() {
    for clock in [StampClock::Host, StampClock::Data] {
        let mut guard = PoseGuard::new(clock);
        let mut taken = Vec::new();
        for i in (0..100).chain(300..303) {
            taken.extend(push(&mut guard, pose(i)));
        }
        guard.finish(&mut |guarded| taken.push(guarded));
        assert_eq!((poses_of(&taken).len(), guard.report().epoch), (103, 0));
    }
}

#[test]
fn a_pose_clock_put_ahead_by_less_than_seconds_goes_on_without_a_new_map() {
    let mut guard = PoseGuard::new(StampClock::Host);
    let mut taken = Vec::new();
    for i in 0..200 {
        let position_m = pose(i).pose.world_from_vehicle.translation_m;
        let ahead_s = if i < 100 { 0.0 } else { 0.7 };
        taken.extend(push(&mut guard, moved(i, position_m, ahead_s)));
    }
    assert_eq!((poses_of(&taken).len(), guard.report().epoch), (200, 0));
}

#[test]
fn stray_epochs_begin_no_map_and_are_told_as_a_second_sender() {
    for share in [1.0 / 500.0, 1.0 / 50.0, 0.1, 1.0 / 3.0, 0.5] {
        for clock in [StampClock::Host, StampClock::Data] {
            let every = (1.0 / share) as u32;
            let change = |next: &mut ArrivedPose| next.pose.epoch = 7;
            let evenly = with_strays(clock, |i| i % every == every - 1, change);
            let randomly = with_strays(clock, at_random(share), change);
            for (poses, report) in [evenly, randomly] {
                let said = format!("{share}: {} {report:?}", poses.len());
                assert_eq!(report.epoch, 0, "{said}");
                assert!(
                    poses.len() as f64 > 0.93 * 2_000.0 * (1.0 - share),
                    "{said}"
                );
                assert_eq!(report.other_epoch, Some(7), "{said}");
                assert!(report.has_other_epochs() || share < 0.01, "{said}");
            }
        }
    }
}

#[test]
fn a_jump_is_followed_while_each_pose_comes_twice() {
    let mut guard = PoseGuard::new(StampClock::Host);
    let mut taken = Vec::new();
    for i in 0..300 {
        let jumped_m = if i < 200 {
            DVec3::ZERO
        } else {
            DVec3::Y * 30.0
        };
        let next = moved(
            i,
            pose(i).pose.world_from_vehicle.translation_m + jumped_m,
            0.0,
        );
        taken.extend(push(&mut guard, next));
        taken.extend(push(&mut guard, next));
    }
    let poses = poses_of(&taken);
    assert_eq!((poses.len(), guard.report().epoch), (300, 1));
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
