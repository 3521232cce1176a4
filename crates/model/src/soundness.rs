//! What numbers a Gaussian can have: one rule for all that takes Gaussians in, holds them or hands
//! them on.

use std::ops::RangeInclusive;

use glam::{DVec3, Vec3};

use crate::Gaussian;

/// Furthest from the map's origin along an axis, metres: single precision keeps a centimetre up to
/// there.
pub const MAX_PLACE_M: f32 = 1e5;

/// Furthest that a map's origin is from the world's, metres: as far as a pose may be.
pub const MAX_ORIGIN_M: f64 = 1e8;

/// One sigma along an axis, metres: from where its square is a normal number of single precision, so
/// that it can be divided by, up to the furthest place.
pub const SCALE_LIMITS_M: RangeInclusive<f32> = 1e-18..=MAX_PLACE_M;

/// Most reflectivity. 1 is the strongest of its map; a million times as much leaves room for what is
/// beside a map and counts in another unit.
pub const MAX_REFLECTIVITY: f32 = 1e6;

/// Intensity units: those of which products and quotients stay within single precision.
pub const INTENSITY_UNITS: RangeInclusive<f32> = 1e-30..=1e30;

/// A quaternion's length may be off 1 by so much: more than single precision does by itself, less than
/// anybody sees.
const UNIT_TOLERANCE: f32 = 1e-4;

/// A quaternion shorter than this has no direction.
const LEAST_LENGTH: f32 = 1e-6;

/// Why a Gaussian is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Unsound {
    /// Its mean.
    #[error("its place is not finite, or more than {MAX_PLACE_M} m from the map's origin")]
    Place,
    /// Its quaternion.
    #[error("its rotation is no quaternion with a length")]
    Rotation,
    /// Its sigmas along its own axes.
    #[error("its scales are not all within {} to {} m", SCALE_LIMITS_M.start(), SCALE_LIMITS_M.end())]
    Scale,
    /// Its opacity.
    #[error("its opacity is not within 0 to 1")]
    Opacity,
    /// Its reflectivity.
    #[error("its reflectivity is not within 0 to {MAX_REFLECTIVITY}")]
    Reflectivity,
    /// The sigma of its place.
    #[error("the sigma of its place is negative, or not a number")]
    Sigma,
    /// The covariance of its place.
    #[error("the covariance of its place has a negative variance, or a number that is none")]
    Covariance,
    /// Its probability.
    #[error("its probability is not within 0 to 1")]
    Probability,
    /// What the map says of it.
    #[error("it is neither confident (1) nor ambiguous (0)")]
    Standing,
}

impl Gaussian {
    /// Whether it can be: everything is finite and within its limits; only `sigma_m` and the variances
    /// of the place may be infinite.
    ///
    /// # Errors
    /// The first that cannot be.
    pub fn check(&self) -> Result<(), Unsound> {
        let within_1 = |value: f32| (0.0..=1.0).contains(&value);
        let scales = self.scale_m.to_array();
        let holds = [
            // NaN is within nothing.
            (
                self.mean_m.abs().cmple(Vec3::splat(MAX_PLACE_M)).all(),
                Unsound::Place,
            ),
            (is_unit(self.rotation.length()), Unsound::Rotation),
            (
                scales.iter().all(|scale| SCALE_LIMITS_M.contains(scale)),
                Unsound::Scale,
            ),
            (within_1(self.opacity), Unsound::Opacity),
            (
                (0.0..=MAX_REFLECTIVITY).contains(&self.reflectivity),
                Unsound::Reflectivity,
            ),
            (self.sigma_m >= 0.0, Unsound::Sigma),
            (
                is_covariance(&self.position_covariance_m2),
                Unsound::Covariance,
            ),
            (within_1(self.probability), Unsound::Probability),
        ];
        let broken = holds.into_iter().find(|(holds, _)| !holds);
        broken.map_or(Ok(()), |(_, why)| Err(why))
    }

    /// Whether [`Gaussian::check`] finds nothing.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.check().is_ok()
    }

    /// As it is let in from outside: a quaternion of another length than 1 is taken for the rotation
    /// that it is a multiple of; all else comes bit for bit.
    ///
    /// # Errors
    /// What cannot be, if it is not sound.
    pub fn admitted(mut self) -> Result<Self, Unsound> {
        let length = self.rotation.length();
        let has_direction = length > LEAST_LENGTH && length.is_finite();
        if has_direction && !is_unit(length) {
            self.rotation /= length;
        }
        self.check().map(|()| self)
    }
}

fn is_unit(length: f32) -> bool {
    (length - 1.0).abs() <= UNIT_TOLERANCE
}

/// Of xx, xy, xz, yy, yz, zz.
fn is_covariance([xx, xy, xz, yy, yz, zz]: &[f32; 6]) -> bool {
    let are_variances = [xx, yy, zz].iter().all(|variance| **variance >= 0.0);
    are_variances && [xy, xz, yz].iter().all(|between| between.is_finite())
}

/// Whether a map can have this origin, world coordinates, metres.
#[must_use]
pub fn is_origin(origin_m: DVec3) -> bool {
    origin_m.abs().cmple(DVec3::splat(MAX_ORIGIN_M)).all()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Standing;
    use glam::Quat;

    fn sound() -> Gaussian {
        Gaussian {
            id: 1,
            mean_m: Vec3::new(1.0, -2.0, 3.0),
            rotation: Quat::from_rotation_y(0.3),
            scale_m: Vec3::new(0.1, 0.02, 0.3),
            opacity: 0.7,
            reflectivity: 0.01,
            sigma_m: 0.05,
            position_covariance_m2: [4e-4, 1e-5, -1e-5, 9e-4, 2e-5, 25e-4],
            probability: 0.75,
            standing: Standing::Confident,
            why: crate::Why::default(),
        }
    }

    type Field = (Unsound, fn(&mut Gaussian, f32), RangeInclusive<f32>);

    /// Every number of a Gaussian but the quaternion's, and what it may be.
    const FIELDS: [Field; 17] = [
        (
            Unsound::Place,
            |g, v| g.mean_m.x = v,
            -MAX_PLACE_M..=MAX_PLACE_M,
        ),
        (
            Unsound::Place,
            |g, v| g.mean_m.y = v,
            -MAX_PLACE_M..=MAX_PLACE_M,
        ),
        (
            Unsound::Place,
            |g, v| g.mean_m.z = v,
            -MAX_PLACE_M..=MAX_PLACE_M,
        ),
        (Unsound::Scale, |g, v| g.scale_m.x = v, SCALE_LIMITS_M),
        (Unsound::Scale, |g, v| g.scale_m.y = v, SCALE_LIMITS_M),
        (Unsound::Scale, |g, v| g.scale_m.z = v, SCALE_LIMITS_M),
        (Unsound::Opacity, |g, v| g.opacity = v, 0.0..=1.0),
        (
            Unsound::Reflectivity,
            |g, v| g.reflectivity = v,
            0.0..=MAX_REFLECTIVITY,
        ),
        (Unsound::Sigma, |g, v| g.sigma_m = v, 0.0..=f32::INFINITY),
        (Unsound::Probability, |g, v| g.probability = v, 0.0..=1.0),
        (
            Unsound::Covariance,
            |g, v| g.position_covariance_m2[0] = v,
            0.0..=f32::INFINITY,
        ),
        (
            Unsound::Covariance,
            |g, v| g.position_covariance_m2[3] = v,
            0.0..=f32::INFINITY,
        ),
        (
            Unsound::Covariance,
            |g, v| g.position_covariance_m2[5] = v,
            0.0..=f32::INFINITY,
        ),
        (
            Unsound::Covariance,
            |g, v| g.position_covariance_m2[1] = v,
            f32::MIN..=f32::MAX,
        ),
        (
            Unsound::Covariance,
            |g, v| g.position_covariance_m2[2] = v,
            f32::MIN..=f32::MAX,
        ),
        (
            Unsound::Covariance,
            |g, v| g.position_covariance_m2[4] = v,
            f32::MIN..=f32::MAX,
        ),
        (
            Unsound::Scale,
            |g, v| g.scale_m = Vec3::splat(v),
            SCALE_LIMITS_M,
        ),
    ];

    #[test]
    fn every_number_is_held_to_its_limits_and_all_else_is_refused_by_name() {
        assert_eq!(sound().check(), Ok(()));
        let subnormal = f32::MIN_POSITIVE / 4.0;
        let values = [
            f32::NAN,
            f32::INFINITY,
            f32::MAX,
            3e38,
            1e20,
            2.0,
            1.0,
            subnormal,
            0.0,
        ];
        for (unsound, set, allowed) in FIELDS {
            for value in values.into_iter().flat_map(|value| [value, -value]) {
                let mut gaussian = sound();
                set(&mut gaussian, value);
                let expected = match allowed.contains(&value) {
                    true => Ok(()),
                    false => Err(unsound),
                };
                assert_eq!(gaussian.check(), expected, "{unsound:?} {value}");
                assert_eq!(gaussian.admitted().is_ok(), gaussian.is_sound(), "{value}");
            }
            for edge in [*allowed.start(), *allowed.end()] {
                let mut gaussian = sound();
                set(&mut gaussian, edge);
                assert_eq!(gaussian.check(), Ok(()), "{unsound:?} {edge}");
            }
        }
    }

    #[test]
    fn a_quaternion_is_taken_for_the_rotation_it_is_a_multiple_of() {
        let with = |rotation| Gaussian {
            rotation,
            ..sound()
        };
        let unit = sound().rotation;
        for factor in [1e-5, 0.5, 1.01, 3.0, 1e10, -2.0] {
            let multiple = with(unit * factor);
            assert_eq!(multiple.check(), Err(Unsound::Rotation), "{factor}");
            let admitted = multiple.admitted().expect("it has a direction");
            assert!(admitted.is_sound());
            assert!(admitted.rotation.angle_between(unit) < 1e-3, "{factor}");
        }
        for factor in [0.0, 1e-7, 1e30, f32::NAN, f32::INFINITY] {
            let none = with(Quat::from_xyzw(factor, factor, 0.0, factor));
            assert_eq!(none.admitted(), Err(Unsound::Rotation), "{factor}");
        }
        // What single precision does to a unit stays as it is, bit for bit.
        let rounded = with(Quat::from_xyzw(unit.x, unit.y, unit.z, unit.w + 3e-7));
        assert_eq!(rounded.admitted(), Ok(rounded));
    }

    #[test]
    fn a_place_of_which_nothing_is_known_is_sound() {
        let mut unknown = sound();
        unknown.sigma_m = f32::INFINITY;
        unknown.position_covariance_m2 = Gaussian::known_alike_m2(f32::INFINITY);
        assert_eq!(unknown.check(), Ok(()));
        unknown.position_covariance_m2[1] = f32::INFINITY;
        assert_eq!(unknown.check(), Err(Unsound::Covariance));
    }

    #[test]
    fn an_origin_is_as_near_as_poses_are() {
        assert!(is_origin(DVec3::new(5e5, -1e8, 0.0)));
        assert!(!is_origin(DVec3::new(0.0, 1.1e8, 0.0)));
        assert!(!is_origin(DVec3::new(0.0, 0.0, f64::NAN)));
    }
}
