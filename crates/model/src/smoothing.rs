//! Poses freed from their own jitter: a parabola through the poses around a time, as long a piece of
//! them as one fits.
//!
//! Jitter shows in third differences, which motion hardly enters at the rate of a navigation
//! filter. A piece is used if what it leaves over is no more than that, so that a turn is never cut
//! and poses without jitter are only interpolated. White errors of one sigma come out as [`LEFT_OF_JITTER`] of it.
//!
//! Cost: per ping one pass over about 30 poses for each length tried.

use glam::{DMat3, DQuat, DVec3};

use crate::{Pose, PoseUncertainty, StampedPose, Timestamp, Twist};

/// Of white errors of one sigma so much is left by the longest piece at 50 poses a second.
pub const LEFT_OF_JITTER: f64 = 0.3;
/// How far back pieces reach, longest first, seconds.
const REACHES_S: [f64; 3] = [LONGEST_REACH_S, 0.25, 0.12];
/// How far back poses are of use, seconds.
pub(crate) const LONGEST_REACH_S: f64 = 0.45;
/// Fewest poses of a piece.
const LEAST_POSES: usize = 8;
/// What a piece may leave over, as a ratio of variances to the jitter.
const MOST_LEFT_OVER: f64 = 1.4;
/// Jitter below this is not worth it, metres and radians.
const LEAST_JITTER: f64 = 1e-4;

/// What moves less from one pose to the next rests, metres and radians.
const STILL: f64 = 1e-6;

/// Value and rate of a quantity at time 0 of its samples.
#[derive(Debug, Clone, Copy)]
struct Fitted {
    value: DVec3,
    rate: DVec3,
}

/// The pose and motion at `time` from the `poses` around it, in order of time and of one piece,
/// if they jitter or `always`: position and attitude each on its own; and their jitter, 0 of too few
/// poses. `interpolated` is what holds otherwise.
pub(crate) fn smoothed(
    poses: &[StampedPose],
    time: Timestamp,
    interpolated: (Pose, Twist),
    always: bool,
) -> (Pose, Twist, PoseUncertainty) {
    let (pose, twist) = interpolated;
    let at = |index: usize| poses[index].time.seconds_since(time);
    let positions: Vec<(f64, DVec3)> = (0..poses.len())
        .map(|i| {
            let place_m = poses[i].world_from_vehicle.translation_m;
            (at(i), place_m - pose.translation_m)
        })
        .collect();
    let turns: Vec<(f64, DVec3)> = (0..poses.len())
        .map(|i| {
            let turned = pose.rotation.conjugate() * poses[i].world_from_vehicle.rotation;
            let turned = if turned.w < 0.0 { -turned } else { turned };
            (at(i), turned.to_scaled_axis())
        })
        .collect();
    let turn = longest_fit(&turns, always);
    let rotation = turn.map_or(pose.rotation, |turn| {
        (pose.rotation * DQuat::from_scaled_axis(turn.value)).normalize()
    });
    let angular_radps = turn.map_or(twist.angular_radps, |turn| turn.rate);
    let (translation_m, linear_mps) = match longest_fit(&positions, always) {
        Some(fitted) => (
            pose.translation_m + fitted.value,
            rotation.conjugate() * fitted.rate,
        ),
        None => (pose.translation_m, twist.linear_mps),
    };
    let smooth = Pose {
        rotation,
        translation_m,
    };
    let motion = Twist {
        linear_mps,
        angular_radps,
    };
    let sigma = |samples: &[(f64, DVec3)]| match samples.len() < LEAST_POSES {
        true => 0.0,
        false => jitter2(samples).sqrt(),
    };
    let jitter = PoseUncertainty {
        position_m: sigma(&positions),
        attitude_rad: sigma(&turns),
    };
    (smooth, motion, jitter)
}

fn longest_fit(samples: &[(f64, DVec3)], always: bool) -> Option<Fitted> {
    REACHES_S.into_iter().find_map(|reach_s| {
        let first = samples.partition_point(|&(at_s, _)| at_s < -reach_s);
        fit(&samples[first..], always)
    })
}

/// Least squares of a parabola, if it leaves over no more than jitter or is wanted `always`.
fn fit(samples: &[(f64, DVec3)], always: bool) -> Option<Fitted> {
    if samples.len() < LEAST_POSES {
        return None;
    }
    let jitter2 = jitter2(samples);
    if !(always || jitter2 > LEAST_JITTER * LEAST_JITTER) {
        return None;
    }
    // Times in units of the longest, so that the normal equations are of one size.
    let unit_s = samples
        .iter()
        .map(|(at_s, _)| at_s.abs())
        .fold(0.0, f64::max);
    let powers = |at_s: f64| {
        let u = at_s / unit_s;
        DVec3::new(1.0, u, u * u)
    };
    let mut normal = DMat3::ZERO;
    let mut right = [DVec3::ZERO; 3];
    for &(at_s, value) in samples {
        let p = powers(at_s);
        normal += DMat3::from_cols(p * p.x, p * p.y, p * p.z);
        for (axis, right) in right.iter_mut().enumerate() {
            *right += p * value[axis];
        }
    }
    let inverse = normal.inverse();
    if !inverse.is_finite() {
        return None;
    }
    let [x, y, z] = right.map(|right| inverse * right);
    let left_over: f64 = samples
        .iter()
        .map(|&(at_s, value)| {
            let p = powers(at_s);
            (value - DVec3::new(x.dot(p), y.dot(p), z.dot(p))).length_squared()
        })
        .sum();
    let variance = left_over / (3 * (samples.len() - 3)) as f64;
    (always || variance <= MOST_LEFT_OVER * jitter2).then(|| Fitted {
        value: DVec3::new(x.x, y.x, z.x),
        rate: DVec3::new(x.y, y.y, z.y) / unit_s,
    })
}

/// Variance of white errors along one axis, from what a parabola through three samples leaves over
/// at the fourth: `20 σ²` where steps are even. The median of them, lest a kink in the motion passes
/// for jitter.
fn jitter2(samples: &[(f64, DVec3)]) -> f64 {
    /// Of χ² with three degrees of freedom.
    const MEDIAN: f64 = 2.366;
    let stands = samples.windows(2).filter(|two| {
        let [(_, before), (_, after)] = [two[0], two[1]];
        before.distance(after) < STILL
    });
    // Steps with rests between, as of a scan or of poses told twice, are no jitter.
    if 4 * stands.count() > samples.len() {
        return 0.0;
    }
    let mut squares: Vec<f64> = samples
        .windows(4)
        .map(|four| {
            let [(t0, p0), (t1, p1), (t2, p2), (t, p)] = [four[0], four[1], four[2], four[3]];
            let lagrange = DVec3::new(
                (t - t1) * (t - t2) / ((t0 - t1) * (t0 - t2)),
                (t - t0) * (t - t2) / ((t1 - t0) * (t1 - t2)),
                (t - t0) * (t - t1) / ((t2 - t0) * (t2 - t1)),
            );
            let off = p - p0 * lagrange.x - p1 * lagrange.y - p2 * lagrange.z;
            off.length_squared() / (1.0 + lagrange.length_squared())
        })
        .collect();
    let middle = squares.len() / 2;
    let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
    *median / MEDIAN
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.02;

    /// Poses from −0.45 s to 0.1 s; white errors from a fixed table of a linear congruence.
    fn poses(truth: impl Fn(f64) -> Pose, sigma_m: f64, sigma_rad: f64) -> Vec<StampedPose> {
        let mut state = 7_u64;
        let mut uniform = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut normal = move || (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        let mut normal3 = move || DVec3::new(normal(), normal(), normal());
        (-22..=5)
            .map(|step| {
                let at_s = f64::from(step) * PERIOD_S;
                let pose = truth(at_s);
                StampedPose {
                    time: Timestamp::from_secs_f64(1.0 + at_s),
                    world_from_vehicle: Pose {
                        rotation: pose.rotation * DQuat::from_scaled_axis(normal3() * sigma_rad),
                        translation_m: pose.translation_m + normal3() * sigma_m,
                    },
                    uncertainty: None,
                    epoch: 0,
                }
            })
            .collect()
    }

    fn motion(at_s: f64) -> Pose {
        let place_m = DVec3::new(0.3 * at_s, 0.1 * at_s * at_s, -0.2 * at_s);
        Pose::from_yaw_pitch_roll(0.3 * at_s, 0.02, 0.1 * at_s, place_m)
    }

    fn now() -> Timestamp {
        Timestamp::from_secs_f64(1.0)
    }

    #[test]
    fn jitter_goes_and_motion_stays() {
        let noisy = poses(motion, 0.1, 0.02);
        let raw = (noisy[22].world_from_vehicle, Twist::default());
        let (pose, twist, jitter) = smoothed(&noisy, now(), raw, false);
        assert!((0.05..0.2).contains(&jitter.position_m), "{jitter:?}");
        assert!((0.01..0.04).contains(&jitter.attitude_rad), "{jitter:?}");
        assert!(pose.translation_m.length() < 0.06, "{}", pose.translation_m);
        assert!(pose.rotation.angle_between(motion(0.0).rotation) < 0.012);
        assert!((twist.angular_radps.z - 0.3).abs() < 0.15);
    }

    #[test]
    fn poses_without_jitter_are_left_as_they_are() {
        let clean = poses(motion, 0.0, 0.0);
        let raw = (clean[22].world_from_vehicle, Twist::default());
        let (pose, twist, jitter) = smoothed(&clean, now(), raw, false);
        assert!(jitter.position_m < LEAST_JITTER && jitter.attitude_rad < LEAST_JITTER);
        assert_eq!(pose, raw.0);
        assert_eq!(twist, raw.1);
    }

    #[test]
    fn a_scan_in_steps_is_left_as_it_is() {
        let steps = |at_s: f64| {
            let step = (at_s / (2.0 * PERIOD_S) + 100.01).floor() - 100.0;
            Pose::from_yaw_pitch_roll(0.01 * step, 0.0, 0.0, DVec3::ZERO)
        };
        let scan = poses(steps, 0.0, 0.0);
        let raw = (scan[22].world_from_vehicle, Twist::default());
        let (pose, twist, _) = smoothed(&scan, now(), raw, false);
        assert_eq!((pose, twist), raw);
    }

    #[test]
    fn a_jump_is_not_smoothed_over() {
        let jump = |at_s: f64| {
            let x = if at_s > -0.09 { 5.0 } else { 0.0 };
            Pose::from_yaw_pitch_roll(0.0, 0.0, 0.0, DVec3::new(x, 0.0, 0.0))
        };
        let noisy = poses(jump, 0.01, 0.0);
        let raw = (noisy[22].world_from_vehicle, Twist::default());
        let (pose, _, _) = smoothed(&noisy, now(), raw, false);
        assert!((pose.translation_m.x - 5.0).abs() < 0.05);
    }
}
