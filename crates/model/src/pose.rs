//! Rigid transforms, and the two conversions from the aircraft conventions.

use std::f64::consts::FRAC_1_SQRT_2;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// A rigid transform, bound under a name that states its frames:
/// `point_in_world = world_from_sensor * point_in_sensor`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Origin of the inner frame in the outer one, metres.
    pub translation_m: DVec3,
}

impl Pose {
    /// Both frames the same.
    pub const IDENTITY: Self = Self {
        rotation: DQuat::IDENTITY,
        translation_m: DVec3::ZERO,
    };

    /// From parts; `None` unless all is finite and the quaternion has a length to normalise by.
    #[must_use]
    pub fn checked(rotation: DQuat, translation_m: DVec3) -> Option<Self> {
        let length = rotation.length();
        let usable = length > 1e-6 && length.is_finite() && translation_m.is_finite();
        usable.then(|| Self {
            rotation: rotation / length,
            translation_m,
        })
    }

    /// From yaw about z, then pitch about the new y, then roll about the new x (REP 103: positive
    /// pitch lowers the nose).
    #[must_use]
    pub fn from_yaw_pitch_roll(
        yaw_rad: f64,
        pitch_rad: f64,
        roll_rad: f64,
        translation_m: DVec3,
    ) -> Self {
        Self {
            rotation: DQuat::from_rotation_z(yaw_rad)
                * DQuat::from_rotation_y(pitch_rad)
                * DQuat::from_rotation_x(roll_rad),
            translation_m,
        }
    }

    /// `inner_from_outer` of an `outer_from_inner`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self {
            rotation,
            translation_m: -(rotation * self.translation_m),
        }
    }

    /// Between `self` at `fraction` 0 and `other` at 1: translation linear, rotation slerp.
    #[must_use]
    pub fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        Self {
            rotation: self.rotation.slerp(other.rotation, fraction),
            translation_m: self.translation_m.lerp(other.translation_m, fraction),
        }
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation_m.is_finite()
    }
}

impl std::ops::Mul for Pose {
    type Output = Self;

    /// `a_from_b * b_from_c` is `a_from_c`.
    fn mul(self, inner: Self) -> Self {
        Self {
            rotation: (self.rotation * inner.rotation).normalize(),
            translation_m: self * inner.translation_m,
        }
    }
}

impl std::ops::Mul<DVec3> for Pose {
    type Output = DVec3;

    /// A point of the inner frame in the outer one.
    fn mul(self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation_m
    }
}

/// Motion of a frame, in its own axes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Twist {
    /// Velocity of the origin.
    pub linear_mps: DVec3,
    /// Rate of turn.
    pub angular_radps: DVec3,
}

/// World axes: north-east-down to east-north-up. Applied to a `ned_from_frd` rotation together
/// with [`flu_from_frd`] it gives the `enu_from_flu` that the rest of the program uses.
#[must_use]
pub fn enu_from_ned(vector: DVec3) -> DVec3 {
    DVec3::new(vector.y, vector.x, -vector.z)
}

/// Body axes: forward-right-down to forward-left-up. Also of a world with x anywhere level, y to
/// its right and z down, to x, left and up.
#[must_use]
pub fn flu_from_frd(vector: DVec3) -> DVec3 {
    DVec3::new(vector.x, -vector.y, -vector.z)
}

/// The rotation of the vehicle as this program uses it, from that of an autopilot: [`enu_from_ned`]
/// after `ned_from_frd` after the inverse of [`flu_from_frd`], which is its own inverse.
#[must_use]
pub fn enu_from_flu(ned_from_frd: DQuat) -> DQuat {
    // Half a turn about the level diagonal swaps x and y and turns z round.
    let enu_from_ned = DQuat::from_xyzw(FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0, 0.0);
    enu_from_ned * ned_from_frd * HALF_TURN_ABOUT_X
}

/// The same for a world that is forward-right-down too: a local frame without north.
#[must_use]
pub fn flu_from_flu(frd_from_frd: DQuat) -> DQuat {
    HALF_TURN_ABOUT_X * frd_from_frd * HALF_TURN_ABOUT_X
}

/// [`flu_from_frd`] as a rotation.
pub const HALF_TURN_ABOUT_X: DQuat = DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0);

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn a_pose_times_its_inverse_is_the_identity() {
        let pose = Pose::from_yaw_pitch_roll(0.3, -0.7, 2.0, DVec3::new(1e6, -2.0, 3.0));
        let back = pose * pose.inverse();
        assert!(back.translation_m.length() < 1e-8);
        assert!(back.rotation.angle_between(DQuat::IDENTITY) < 1e-7);
    }

    #[test]
    fn yaw_is_seen_from_above_and_positive_pitch_lowers_the_nose() {
        let yawed = Pose::from_yaw_pitch_roll(FRAC_PI_2, 0.0, 0.0, DVec3::ZERO);
        assert!((yawed * DVec3::X - DVec3::Y).length() < 1e-12);
        let pitched = Pose::from_yaw_pitch_roll(0.0, 0.1, 0.0, DVec3::ZERO);
        assert!((pitched * DVec3::X).z < 0.0);
        let rolled = Pose::from_yaw_pitch_roll(0.0, 0.0, 0.1, DVec3::ZERO);
        assert!((rolled * DVec3::Y).z > 0.0);
    }

    #[test]
    fn interpolation_meets_both_ends_and_halves_the_turn() {
        let a = Pose::IDENTITY;
        let b = Pose::from_yaw_pitch_roll(1.0, 0.0, 0.0, DVec3::X);
        let half = a.interpolate(&b, 0.5);
        let expected = Pose::from_yaw_pitch_roll(0.5, 0.0, 0.0, DVec3::X * 0.5);
        assert!(half.rotation.angle_between(expected.rotation) < 1e-9);
        assert_eq!(half.translation_m, expected.translation_m);
        assert_eq!(a.interpolate(&b, 0.0), a);
    }

    #[test]
    fn useless_quaternions_are_refused() {
        let zero = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
        assert!(Pose::checked(zero, DVec3::ZERO).is_none());
        assert!(Pose::checked(DQuat::IDENTITY, DVec3::new(f64::NAN, 0.0, 0.0)).is_none());
        let long = DQuat::from_xyzw(0.0, 0.0, 0.0, 3.0);
        assert_eq!(
            Pose::checked(long, DVec3::ZERO).map(|p| p.rotation),
            Some(DQuat::IDENTITY)
        );
    }

    #[test]
    fn north_and_right_become_east_north_and_left() {
        assert_eq!(
            enu_from_ned(DVec3::new(1.0, 2.0, 3.0)),
            DVec3::new(2.0, 1.0, -3.0)
        );
        assert_eq!(
            flu_from_frd(DVec3::new(1.0, 2.0, 3.0)),
            DVec3::new(1.0, -2.0, -3.0)
        );
    }

    #[test]
    fn an_autopilots_rotation_becomes_ours() {
        let same = |a: DVec3, b: DVec3| assert!((a - b).length() < 1e-12, "{a} {b}");
        // Level and heading north: the nose points along ENU's y, the left wing along -x.
        let north = enu_from_flu(DQuat::IDENTITY);
        same(north * DVec3::X, DVec3::Y);
        same(north * DVec3::Y, DVec3::NEG_X);
        same(north * DVec3::Z, DVec3::Z);
        // A heading of 90 degrees is east, which is no rotation at all in ENU.
        let east = enu_from_flu(DQuat::from_rotation_z(FRAC_PI_2));
        same(east * DVec3::X, DVec3::X);
        same(east * DVec3::Y, DVec3::Y);
        // Nose up is positive pitch there: it points above the horizon.
        let up = enu_from_flu(DQuat::from_rotation_y(0.1));
        assert!((up * DVec3::X).z > 0.09);
        // Positive roll lowers the right wing there, so the left one rises.
        let rolled = enu_from_flu(DQuat::from_rotation_x(0.1));
        assert!((rolled * DVec3::Y).z > 0.09);
        // Without north the nose keeps x, and a turn to the right is one to -y.
        let right = flu_from_flu(DQuat::from_rotation_z(FRAC_PI_2));
        same(right * DVec3::X, DVec3::NEG_Y);
    }

    #[test]
    fn rotations_agree_with_the_vectors_they_turn() {
        let ned_from_frd = DQuat::from_euler(glam::EulerRot::ZYX, 0.7, -0.3, 0.2);
        let point_frd = DVec3::new(1.0, 2.0, 3.0);
        let ned = enu_from_ned(ned_from_frd * point_frd);
        let enu = enu_from_flu(ned_from_frd) * flu_from_frd(point_frd);
        assert!((ned - enu).length() < 1e-12);
        let flu = flu_from_flu(ned_from_frd) * flu_from_frd(point_frd);
        assert!((flu_from_frd(ned_from_frd * point_frd) - flu).length() < 1e-12);
    }
}
