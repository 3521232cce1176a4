//! The plain twin: what a ping hears of Gaussians in f64, Gaussian by Gaussian and bin by bin. Kernels are held to it.
//!
//! It has the kernels' definitions and none of their ways: no lanes, no steps of a bin, no rounded widths, and the polar
//! covariance by its Jacobian in place of axes.

use glam::{DMat3, DVec3};

use crate::constants::{
    BEAM_REACH_SIGMAS, LEAST_FAN, LEAST_VARIANCE_M2, NEAREST_M, RANGE_REACH_SIGMAS, SIDEWAYS,
};
use crate::scene::Element;
use crate::{PingGeometry, SymmetricMat3};

/// Φ(x), the standard normal distribution function, relatively exact in the lower tail.
#[must_use]
pub fn normal_cdf(x: f64) -> f64 {
    0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

/// One Gaussian in one ping.
#[derive(Debug, Clone, Copy)]
pub struct Echo {
    /// Energy over all bins for strength 1: solid angle times sensitivity.
    pub energy: f64,
    /// Strength towards the sensor.
    pub strength: f64,
    /// Mean range on the beam's axis, and one sigma.
    pub range_m: f64,
    /// See `range_m`.
    pub sigma_m: f64,
    /// Azimuth of the mean from the beam's axis.
    pub azimuth_rad: f64,
    /// Variance of azimuth, beam, Gaussian and attitude together.
    pub azimuth_variance_rad2: f64,
    /// Metres per radian of azimuth.
    pub lever_m: f64,
    /// Unit vectors of growing range and azimuth, world axes.
    pub range_axis: DVec3,
    /// See `range_axis`.
    pub azimuth_axis: DVec3,
}

/// Full matrix of six numbers.
fn full(matrix: &SymmetricMat3) -> DMat3 {
    matrix.to_mat3().as_dmat3()
}

impl Echo {
    /// `None` where the ping does not hear it.
    #[must_use]
    pub fn of(geometry: &PingGeometry, element: &Element) -> Option<Self> {
        let (pose, beam) = (&geometry.pose, &geometry.beam);
        let axes = pose.axes.as_dmat3();
        let still = axes.transpose() * (element.mean_m.as_dvec3() - pose.position_m.as_dvec3());
        let (late_m, drift) = (
            still.length() - f64::from(pose.reference_range_m),
            pose.drift_per_m.as_dvec3(),
        );
        let aside = drift.x + drift.y * still.x - drift.z * still.z;
        let q = still - DVec3::Y * late_m * aside;
        let (lever, range) = (q.x.hypot(q.y), q.length());
        if !(range > f64::from(NEAREST_M) && q.x > f64::from(SIDEWAYS) * range) {
            return None;
        }
        let (azimuth, elevation) = (q.y.atan2(q.x), q.z.atan2(lever));
        let fan = (-(elevation / f64::from(beam.elevation_half_width_rad())).powi(8)).exp2();
        // Derivative of range, azimuth and elevation by the place in the beam's frame, by columns.
        let jacobian = DMat3::from_cols(
            DVec3::new(
                q.x / range,
                -q.y / lever.powi(2),
                -q.x * q.z / (range.powi(2) * lever),
            ),
            DVec3::new(
                q.y / range,
                q.x / lever.powi(2),
                -q.y * q.z / (range.powi(2) * lever),
            ),
            DVec3::new(q.z / range, 0.0, lever / range.powi(2)),
        );
        let in_beam = axes.transpose() * full(&element.covariance_m2) * axes;
        let polar = jacobian * in_beam * jacobian.transpose();
        let (rr, rt, tt) = (polar.x_axis.x, polar.x_axis.y, polar.y_axis.y);
        let (tp, pp) = (polar.y_axis.z, polar.z_axis.z);
        let sigma_b = f64::from(beam.azimuth_sigma_rad());
        let total = sigma_b * sigma_b + tt.max(0.0) + f64::from(geometry.azimuth_variance_rad2);
        let off = azimuth * azimuth / total;
        if !(fan > f64::from(LEAST_FAN) && off <= f64::from(BEAM_REACH_SIGMAS).powi(2)) {
            return None;
        }
        let solid_angle =
            std::f64::consts::TAU * elevation.cos() * (tt * pp - tp * tp).max(0.0).sqrt();
        let variance = rr - rt * rt / total + f64::from(geometry.range_variance_m2);
        let range_axis = axes * (q / range);
        let faces = DVec3::select(
            range_axis.cmple(DVec3::ZERO),
            element.ahead.as_dvec3(),
            element.behind.as_dvec3(),
        );
        Some(Self {
            energy: solid_angle * fan * sigma_b / total.sqrt() * (-0.5 * off).exp(),
            strength: faces.dot(range_axis * range_axis),
            range_m: range - azimuth * rt / total,
            sigma_m: variance.max(f64::from(LEAST_VARIANCE_M2)).sqrt(),
            azimuth_rad: azimuth,
            azimuth_variance_rad2: total,
            lever_m: lever,
            range_axis,
            azimuth_axis: axes * (DVec3::new(-q.y, q.x, 0.0) / lever),
        })
    }
}

/// Score and Fisher information of a Gaussian's mean, 1/m and 1/m², world axes.
pub type Score = (DVec3, DMat3);

/// A ping and what it hears.
#[derive(Debug)]
pub struct Twin {
    range_start_m: f64,
    bin_length_m: f64,
    bin_count: usize,
    /// Of each Gaussian, in the order given.
    pub echoes: Vec<Option<Echo>>,
}

impl Twin {
    /// Of Gaussians that are sound ([`Element::is_sound`]); others are not heard.
    #[must_use]
    pub fn of(geometry: &PingGeometry, elements: &[Element]) -> Self {
        let echo = |element: &Element| {
            let sound = element.is_sound().then_some(element);
            sound.and_then(|element| Echo::of(geometry, element))
        };
        Self {
            range_start_m: geometry.range_start_m.into(),
            bin_length_m: geometry.bin_length_m.into(),
            bin_count: geometry.bin_count as usize,
            echoes: elements.iter().map(echo).collect(),
        }
    }

    /// Bins that an echo reaches, each with its share of the energy and its middle in sigmas from the echo.
    pub fn shares(&self, echo: &Echo) -> impl Iterator<Item = (usize, f64, f64)> + use<> {
        let position = (echo.range_m - self.range_start_m) / self.bin_length_m;
        let sigma = echo.sigma_m / self.bin_length_m;
        let reach = (f64::from(RANGE_REACH_SIGMAS) * sigma).ceil().max(1.0);
        let (first, last) = (position.floor() - reach, position.floor() + reach);
        (0..self.bin_count)
            .filter(move |&bin| (first..=last).contains(&(bin as f64)))
            .map(move |bin| {
                let edge = (bin as f64 - position) / sigma;
                let (from, to) = (edge, edge + sigma.recip());
                // From the tail that is small, so that none of it is lost.
                let share = match from > 0.0 {
                    true => normal_cdf(-from) - normal_cdf(-to),
                    false => normal_cdf(to) - normal_cdf(from),
                };
                (bin, share, 0.5 * (from + to))
            })
    }

    /// Power per bin over `noise`: `Î_b = noise + Σ_i A_ib ρ_i`, shape `[bin_count]`.
    #[must_use]
    pub fn predicted(&self, noise: f64) -> Vec<f64> {
        let mut predicted = vec![noise; self.bin_count];
        for echo in self.echoes.iter().flatten() {
            for (bin, share, _) in self.shares(echo) {
                predicted[bin] += echo.energy * echo.strength * share;
            }
        }
        predicted
    }

    /// `Σ_b A_ib I_b/Î_b²` and `Σ_b A_ib/Î_b` of each Gaussian, by which its strength is multiplied: `ρ ← ρ √(N/D)`.
    #[must_use]
    pub fn step_sums(&self, measured: &[f64], predicted: &[f64]) -> Vec<[f64; 2]> {
        let sums = |echo: &Echo| {
            let mut sums = [0.0; 2];
            for (bin, share, _) in self.shares(echo) {
                let a = echo.energy * share;
                sums[0] += a * measured[bin] / predicted[bin].powi(2);
                sums[1] += a / predicted[bin];
            }
            sums
        };
        let each = self.echoes.iter();
        each.map(|echo| echo.as_ref().map_or([0.0; 2], sums))
            .collect()
    }

    /// `Σ_b ε_b ∂Î_b/Î_b` and `Σ_b ∂Î_b ∂Î_bᵀ/Î_b²` by each Gaussian's mean, `ε = I/Î − 1` held within −1 to 3. A mean moves its echo
    /// in range, `z/s` of a bin whose middle is z sigmas away, and across the beam.
    #[must_use]
    pub fn scores(&self, measured: &[f64], predicted: &[f64]) -> Vec<Score> {
        let score = |echo: &Echo| {
            let (mut gradient, mut information) = (DVec3::ZERO, DMat3::ZERO);
            let across = echo.azimuth_axis
                * (-echo.azimuth_rad / (echo.azimuth_variance_rad2 * echo.lever_m));
            for (bin, share, z) in self.shares(echo) {
                let part = echo.energy * echo.strength * share / predicted[bin];
                let slope = part * (echo.range_axis * (z / echo.sigma_m) + across);
                gradient += slope * (measured[bin] / predicted[bin] - 1.0).clamp(-1.0, 3.0);
                information += DMat3::from_cols(slope * slope.x, slope * slope.y, slope * slope.z);
            }
            (gradient, information)
        };
        let each = self.echoes.iter();
        each.map(|echo| echo.as_ref().map_or((DVec3::ZERO, DMat3::ZERO), score))
            .collect()
    }
}
