//! One element of the map.

use glam::{Mat3, Quat, Vec3};
use serde::{Deserialize, Serialize};

use crate::Why;

/// Stable name of a Gaussian within one epoch of a map; never used twice.
pub type GaussianId = u32;

/// What the map says of a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Standing {
    /// Asserted as surface: every other explanation of its echoes was seen dark or explains less.
    Confident,
    /// One of several places its echoes may come from; kept and published as such.
    Ambiguous,
}

/// One element of the map, in physical parameters (limits: [`Gaussian::check`]): a small cloud of surface that stops the
/// fraction `opacity` of the sound at its centre and sends `reflectivity` of that back.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Gaussian {
    /// Stable name.
    pub id: GaussianId,
    /// Centre relative to the map's origin, world axes.
    pub mean_m: Vec3,
    /// Unit quaternion, world from the Gaussian's own axes.
    pub rotation: Quat,
    /// One sigma along each of its own axes, positive.
    pub scale_m: Vec3,
    /// Fraction of the sound stopped at its centre, 0 to 1.
    pub opacity: f32,
    /// What of the stopped sound comes back, linear power, 0 to 1 of the strongest in the map.
    pub reflectivity: f32,
    /// One sigma of its position along the least known direction; infinite if nothing is known.
    pub sigma_m: f32,
    /// Covariance of its position, square metres, world axes: xx, xy, xz, yy, yz, zz. `sigma_m` is the square root of
    /// its largest eigenvalue; infinite on the diagonal if nothing is known.
    pub position_covariance_m2: [f32; 6],
    /// Probability that there is surface within 0.10 m of it, 0 to 1.
    pub probability: f32,
    /// Surface or one of several explanations.
    pub standing: Standing,
    /// Which test said so.
    #[serde(default)]
    pub why: Why,
}

impl Gaussian {
    /// (10): `Σ = R S² Rᵀ`, square metres, world axes.
    #[must_use]
    pub fn covariance_m2(&self) -> Mat3 {
        let axes = Mat3::from_quat(self.rotation);
        let scaled = axes * Mat3::from_diagonal(self.scale_m);
        scaled * scaled.transpose()
    }

    /// `position_covariance_m2` of a place that is known alike in all directions.
    #[must_use]
    pub fn known_alike_m2(sigma_m: f32) -> [f32; 6] {
        let variance_m2 = sigma_m * sigma_m;
        [variance_m2, 0.0, 0.0, variance_m2, 0.0, variance_m2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_covariance_is_long_where_the_scale_is() {
        let gaussian = Gaussian {
            id: 0,
            mean_m: Vec3::ZERO,
            rotation: Quat::from_rotation_z(std::f32::consts::FRAC_PI_2),
            scale_m: Vec3::new(2.0, 1.0, 0.5),
            opacity: 1.0,
            reflectivity: 1.0,
            sigma_m: f32::INFINITY,
            position_covariance_m2: Gaussian::known_alike_m2(f32::INFINITY),
            probability: 1.0,
            standing: Standing::Ambiguous,
            why: Why::default(),
        };
        let covariance = gaussian.covariance_m2();
        let expected = Mat3::from_diagonal(Vec3::new(1.0, 4.0, 0.25));
        assert!(covariance.abs_diff_eq(expected, 1e-5));
        assert!(gaussian.is_sound());
    }
}
