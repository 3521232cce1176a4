use super::*;
use echosplat_model::{Pose, StampedPose, TrajectoryLimits};

const RATE_HZ: f64 = 50.0;

/// Poses of so many seconds that say of themselves what `told` does at each time.
fn judged(
    judge: &mut CovarianceJudge,
    seconds: f64,
    told: impl Fn(f64) -> PoseCovariance,
) -> Trajectory {
    let mut poses = Trajectory::new(TrajectoryLimits {
        capacity: 65_536,
        max_pose_gap_s: 0.5,
    });
    for index in 0..=(seconds * RATE_HZ) as u32 {
        let at_s = f64::from(index) / RATE_HZ;
        let pose = StampedPose {
            time: Timestamp::from_secs_f64(at_s),
            world_from_vehicle: Pose::IDENTITY,
            uncertainty: judge.usable(Some(told(at_s))),
            epoch: 0,
        };
        poses.push(pose).unwrap();
    }
    poses
}

fn view(at_s: f64) -> View {
    View {
        time: Timestamp::from_secs_f64(at_s),
        world_from_beam: DQuat::IDENTITY,
        range_m: 5.0,
        jitter: None,
    }
}

fn diagonal(variances: [f64; 6]) -> PoseCovariance {
    let [x, y, z, roll, pitch, yaw] = variances;
    PoseCovariance {
        position_m2: [x, 0.0, 0.0, y, 0.0, z],
        attitude_rad2: [roll, pitch, yaw],
    }
}

/// What the pose of the last ping of so many seconds may be off by.
fn found(
    seconds: f64,
    told: impl Fn(f64) -> PoseCovariance,
) -> (PoseUncertainty, CovarianceCounters) {
    let mut judge = CovarianceJudge::new(CovarianceRule::default());
    let poses = judged(&mut judge, seconds, told);
    let found = judge.of_ping(&poses, &view(seconds)).unwrap();
    (found, judge.counters())
}

fn prior() -> PoseUncertainty {
    CovarianceRule::default().prior
}

#[test]
fn what_is_there_all_along_smears_no_more_than_poses_scatter_anyway() {
    for variance in [1e-3, 0.01, 0.25, 1.0, 600.0] {
        let (found, counters) = found(90.0, |_| diagonal([variance; 6].map(|v: f64| v.min(3.0))));
        assert_eq!((found, counters.pings_smeared), (prior(), 0));
    }
    let (surer, _) = found(90.0, |_| diagonal([1e-6; 6]));
    assert!((surer.position_m - 1e-3).abs() < 1e-9);
    assert!((surer.attitude_rad - 1e-3).abs() < 1e-9);
}

#[test]
fn what_grows_all_along_is_drift_that_pings_share() {
    for growth in [0.001, 0.02, 0.05, 0.1] {
        for seconds in [10.0, 60.0, 200.0] {
            let (found, counters) = found(seconds, |at_s| {
                let xy = growth * at_s + 1e-4;
                diagonal([xy, xy, 1e-4, 1e-5, 1e-5, 1e-5])
            });
            assert!((found.position_m - 0.02).abs() < 1e-4, "{found:?}");
            assert!(
                (found.attitude_rad - prior().attitude_rad).abs() < 1e-3,
                "{found:?}"
            );
            assert_eq!(counters.pings_smeared, 0);
        }
    }
}

#[test]
fn what_rises_for_some_seconds_smears_meanwhile_and_not_afterwards() {
    let told = |at_s: f64| {
        let risen = (40.0..45.0).contains(&at_s);
        diagonal([if risen { 1.0 } else { 1e-4 }; 6])
    };
    assert!((found(39.0, told).0.position_m - 0.01).abs() < 1e-9);
    let (during, counters) = found(44.0, told);
    assert!(during.position_m > 0.9 && counters.pings_smeared == 1);
    let (after, _) = found(46.0, told);
    assert!((after.position_m - 0.01).abs() < 1e-9);
}

#[test]
fn what_stays_risen_is_shared_again_once_errors_have_faded() {
    let told = |at_s: f64| diagonal([if at_s < 40.0 { 1e-4 } else { 1.0 }; 6]);
    let smear_m = |at_s: f64| found(at_s, told).0.position_m;
    assert!(smear_m(41.0) > 0.9);
    assert!(smear_m(70.0) < smear_m(41.0));
    assert!((smear_m(102.0) - 0.02).abs() < 1e-6);
}

#[test]
fn what_cannot_be_used_stands_for_the_configured_sigma_of_its_axis_and_is_counted() {
    for odd in [
        1e6,
        1.79e308,
        f64::INFINITY,
        f64::NAN,
        -1.0,
        0.0,
        9999.0,
        1e9,
    ] {
        let (x_alone, counters) = found(10.0, |_| diagonal([4e-6, odd, odd, odd, odd, odd]));
        let all = counters.given;
        assert_eq!(
            (
                counters.unusable_x,
                counters.unusable_z,
                counters.unusable_yaw
            ),
            (0, all, all)
        );
        // Along the beam it is as told, upwards and about the fan's normal as configured.
        let position_m = x_alone.position_m;
        assert!(
            position_m > 0.002 && position_m < 0.02,
            "{odd} {position_m}"
        );
        let attitude = x_alone.attitude_rad / prior().attitude_rad;
        assert!((attitude - 1.0).abs() < 1e-3, "{odd} {attitude}");
        let mut judge = CovarianceJudge::default();
        let nothing = judge.usable(Some(diagonal([odd; 6])));
        assert_eq!((nothing, judge.counters().unusable_x), (None, 1));
    }
}

#[test]
fn an_error_counts_as_it_moves_echoes() {
    let of = |told: PoseCovariance, yaw_rad: f64| {
        let judge = CovarianceJudge::default();
        let world_from_beam = DQuat::from_rotation_z(yaw_rad);
        judge.moved(
            &told,
            &View {
                world_from_beam,
                ..view(0.0)
            },
        )
    };
    let ahead = of(diagonal([0.01, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6]), 0.0);
    assert!((ahead.range_m2 - 0.01).abs() < 1e-3 && ahead.azimuth_rad2 < 2e-6);
    let aside = of(diagonal([1e-6, 0.01, 1e-6, 1e-6, 1e-6, 1e-6]), 0.0);
    assert!(aside.range_m2 < 2e-6 && (aside.azimuth_rad2 - 0.01 / 25.0).abs() < 2e-6);
    // Ahead and aside together, as of a vehicle whose error lies along the diagonal it looks along, or across it.
    let mut tilted = diagonal([0.01, 0.01, 1e-6, 1e-6, 1e-6, 1e-6]);
    tilted.position_m2[1] = 0.0099;
    let quarter = std::f64::consts::FRAC_PI_4;
    assert!((of(tilted, quarter).range_m2 - 0.0199).abs() < 2e-3);
    assert!(of(tilted, -quarter).range_m2 < 2e-4);
    // What is alike in all directions is what it is from anywhere.
    let alike = of(PoseCovariance::alike(0.3, 0.1), 1.0);
    assert!((alike.range_m2 - 0.09).abs() < 1e-12 && (alike.azimuth_rad2 - 0.01).abs() < 1e-12);
}

#[test]
fn a_matrix_that_is_none_keeps_its_diagonal() {
    let mut judge = CovarianceJudge::default();
    let mut odd = diagonal([0.01, 0.04, 0.01, 1e-4, 1e-4, 1e-4]);
    for mixed in [f64::NAN, f64::INFINITY, 0.03, -0.03] {
        odd.position_m2[1] = mixed;
        let usable = judge.usable(Some(odd)).unwrap();
        assert_eq!(usable, diagonal([0.01, 0.04, 0.01, 1e-4, 1e-4, 1e-4]));
    }
    odd.position_m2[1] = 0.015;
    assert_eq!(judge.usable(Some(odd)), Some(odd));
}

#[test]
fn poses_that_jitter_are_weighed_by_what_smoothing_leaves() {
    let mut judge = CovarianceJudge::default();
    let poses = judged(&mut judge, 10.0, |_| PoseCovariance::alike(0.1, 0.02));
    let jitter = Some(PoseUncertainty {
        position_m: 0.1,
        attitude_rad: 0.02,
    });
    let found = judge
        .of_ping(
            &poses,
            &View {
                jitter,
                ..view(10.0)
            },
        )
        .unwrap();
    assert!((found.position_m - 0.03).abs() < 1e-12);
    assert!((found.attitude_rad - 0.006).abs() < 1e-12);
}

#[test]
fn ignored_covariances_are_counted_and_say_nothing() {
    let mut judge = CovarianceJudge::new(CovarianceRule {
        covariances: Covariances::Ignore,
        ..CovarianceRule::default()
    });
    let poses = judged(&mut judge, 1.0, |_| PoseCovariance::alike(0.1, 0.02));
    assert_eq!(judge.of_ping(&poses, &view(1.0)), None);
    assert_eq!((judge.counters().given, judge.counters().ignored), (51, 51));
}
