//! Geometry: (14) to (19) for one ping, and the splat that it makes of one Gaussian.

use crate::Beam;
use crate::constants::{BEAM_REACH_SIGMAS, LEAST_FAN, LEAST_VARIANCE_M2, NEAREST_M, SIDEWAYS};
use echosplat_model::glam::{Mat3, Vec3};

/// A covariance as its six different numbers, square metres, world axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SymmetricMat3 {
    /// Diagonal: xx, yy, zz.
    pub diagonal: Vec3,
    /// Off the diagonal: yz, xz, xy.
    pub mixed: Vec3,
}

impl SymmetricMat3 {
    /// The symmetric part of `matrix`.
    #[must_use]
    pub fn of(matrix: Mat3) -> Self {
        Self {
            diagonal: Vec3::new(matrix.x_axis.x, matrix.y_axis.y, matrix.z_axis.z),
            mixed: Vec3::new(matrix.y_axis.z, matrix.x_axis.z, matrix.x_axis.y),
        }
    }

    /// The same along every direction.
    #[must_use]
    pub fn isotropic(sigma_m: f32) -> Self {
        Self {
            diagonal: Vec3::splat(sigma_m * sigma_m),
            mixed: Vec3::ZERO,
        }
    }

    /// `M v`.
    #[inline]
    #[must_use]
    pub fn times(&self, v: Vec3) -> Vec3 {
        let (d, m) = (self.diagonal, self.mixed);
        Vec3::new(
            d.x * v.x + m.z * v.y + m.y * v.z,
            m.z * v.x + d.y * v.y + m.x * v.z,
            m.y * v.x + m.x * v.y + d.z * v.z,
        )
    }

    /// As a full matrix.
    #[must_use]
    pub fn to_mat3(&self) -> Mat3 {
        let (d, m) = (self.diagonal, self.mixed);
        Mat3::from_cols(
            Vec3::new(d.x, m.z, m.y),
            Vec3::new(m.z, d.y, m.x),
            Vec3::new(m.y, m.x, d.z),
        )
    }
}

/// atan, by its series where that is exact to f32: beams are narrow.
#[inline]
fn small_atan(tangent: f32) -> f32 {
    let t2 = tangent * tangent;
    if t2 < 0.01 {
        tangent * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 * (1.0 / 7.0 - t2 / 9.0))))
    } else {
        tangent.atan()
    }
}

/// Where a beam was and how it moved, on the map's local coordinates. Its frame is the sensor's,
/// turned about z so that the beam's axis is x: azimuth is measured from the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PingPose {
    /// Origin of the sensor relative to the map's origin.
    pub position_m: Vec3,
    /// Axes of the beam's frame in world coordinates, as columns: along, left, up.
    pub axes: Mat3,
    /// How azimuth drifts while the ping listens: velocity to the left (x), and rates of turn
    /// about up (y) and along (z), per metre of range beyond `reference_range_m`.
    pub drift_per_m: Vec3,
    /// Range at which the pose is exact.
    pub reference_range_m: f32,
}

/// What is known of a ping before anything of the map: pose, bins, and how sharp it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PingGeometry {
    /// Pose of the beam.
    pub pose: PingPose,
    /// Near edge of bin 0.
    pub range_start_m: f32,
    /// Length of a bin.
    pub bin_length_m: f32,
    /// Number of bins.
    pub bin_count: u32,
    /// Variance in range beside the Gaussian's own: pulse and position of the sensor, m².
    pub range_variance_m2: f32,
    /// Variance in azimuth beside beam and Gaussian: attitude of the sensor, rad².
    pub azimuth_variance_rad2: f32,
    /// Directional sensitivity.
    pub beam: Beam,
}

/// A Gaussian as one ping sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Splat {
    /// Mean range on the beam's axis: r′.
    pub range_m: f32,
    /// One sigma in range: s.
    pub range_sigma_m: f32,
    /// Azimuth of the mean from the beam's axis: ΔΘ.
    pub azimuth_rad: f32,
    /// Elevation of the mean: φ̄.
    pub elevation_rad: f32,
    /// Variance of azimuth, beam, Gaussian and attitude together.
    pub azimuth_variance_rad2: f32,
    /// Energy summed over all bins for αρT = 1: solid angle times sensitivity.
    pub energy: f32,
    /// Unit vectors of growing range and azimuth at the mean, world axes.
    pub range_axis: Vec3,
    /// See `range_axis`.
    pub azimuth_axis: Vec3,
    /// Distance from the sensor's z axis: metres per radian of azimuth.
    pub lever_m: f32,
}

impl PingGeometry {
    /// The mean of a Gaussian in the beam's frame, moved by what the sensor drifts until its echo.
    #[inline]
    #[must_use]
    pub fn in_beam(&self, mean_m: Vec3) -> Vec3 {
        let pose = &self.pose;
        let mut q = pose.axes.transpose() * (mean_m - pose.position_m);
        let late_m = q.length() - pose.reference_range_m;
        let drift = pose.drift_per_m;
        q.y -= late_m * (drift.x + drift.y * q.x - drift.z * q.z);
        q
    }

    /// Projects a Gaussian; `None` where the ping cannot see it: behind the sensor, nearer than
    /// 5 cm, off the beam by more than 2.8 sigma or outside the fan's soft edge.
    #[inline]
    #[must_use]
    pub fn project(&self, mean_m: Vec3, covariance_m2: &SymmetricMat3) -> Option<Splat> {
        let q = self.in_beam(mean_m);
        let lever_m = (q.x * q.x + q.y * q.y).sqrt();
        let range_m = (lever_m * lever_m + q.z * q.z).sqrt();
        if !(range_m > NEAREST_M && q.x > SIDEWAYS * range_m) {
            return None;
        }
        // The beam is narrow: a cheap test with the Gaussian's widest sigma rules most of them out.
        let sigma_b = self.beam.azimuth_sigma_rad();
        let pattern_variance = sigma_b * sigma_b + self.azimuth_variance_rad2;
        let widest_m2 = covariance_m2.diagonal.element_sum();
        let reach_m2 = pattern_variance * lever_m * lever_m + widest_m2;
        if q.y * q.y > BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS * reach_m2 {
            return None;
        }
        let azimuth_rad = small_atan(q.y / q.x);
        let elevation_rad = (q.z / lever_m).atan();
        let fan = self.beam.elevation_weight(elevation_rad);
        if !(fan > LEAST_FAN) {
            return None;
        }
        let splat = self.splat(
            q,
            lever_m,
            range_m,
            azimuth_rad,
            elevation_rad,
            fan,
            covariance_m2,
        );
        let reach_rad2 = BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS * splat.azimuth_variance_rad2;
        (azimuth_rad * azimuth_rad <= reach_rad2).then_some(splat)
    }

    /// (18), (19) and the closed forms of the measurement: beam folded in, `Ω`, `r′`, `s²`.
    #[allow(clippy::too_many_arguments)]
    fn splat(
        &self,
        q: Vec3,
        lever_m: f32,
        range_m: f32,
        azimuth_rad: f32,
        elevation_rad: f32,
        fan: f32,
        covariance_m2: &SymmetricMat3,
    ) -> Splat {
        let axes = self.pose.axes;
        let range_axis = axes * (q / range_m);
        let azimuth_axis = axes * (Vec3::new(-q.y, q.x, 0.0) / lever_m);
        let elevation_axis = range_axis.cross(azimuth_axis);
        let along = covariance_m2.times(range_axis);
        let across = covariance_m2.times(azimuth_axis);
        let up = covariance_m2.times(elevation_axis);
        let range_variance = along.dot(range_axis);
        let azimuth_variance = across.dot(azimuth_axis) / (lever_m * lever_m);
        let range_azimuth = along.dot(azimuth_axis) / lever_m;
        // √det of the cross-section by Cholesky; its azimuth in metres keeps it well scaled.
        let width_m = across.dot(azimuth_axis).max(0.0).sqrt();
        let skew = across.dot(elevation_axis) / width_m.max(1e-9);
        let height_m = (up.dot(elevation_axis) - skew * skew).max(0.0).sqrt();
        let solid_angle = std::f32::consts::TAU * width_m * height_m / (range_m * range_m);

        let sigma_b = self.beam.azimuth_sigma_rad();
        let total = sigma_b * sigma_b + azimuth_variance + self.azimuth_variance_rad2;
        let pattern = sigma_b / total.sqrt() * (-0.5 * azimuth_rad * azimuth_rad / total).exp();
        let range_sigma_m = (range_variance + self.range_variance_m2
            - range_azimuth * range_azimuth / total)
            .max(LEAST_VARIANCE_M2)
            .sqrt();
        Splat {
            range_m: range_m - azimuth_rad * range_azimuth / total,
            range_sigma_m,
            azimuth_rad,
            elevation_rad,
            azimuth_variance_rad2: total,
            energy: solid_angle * fan * pattern,
            range_axis,
            azimuth_axis,
            lever_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometry() -> PingGeometry {
        PingGeometry {
            pose: PingPose {
                position_m: Vec3::ZERO,
                axes: Mat3::IDENTITY,
                drift_per_m: Vec3::ZERO,
                reference_range_m: 5.0,
            },
            range_start_m: 0.0,
            bin_length_m: 0.02,
            bin_count: 600,
            range_variance_m2: 1e-4,
            azimuth_variance_rad2: 0.0,
            beam: Beam::default(),
        }
    }

    #[test]
    fn energy_of_a_sphere_goes_as_one_over_range_squared() {
        // Wider than the beam everywhere would not: keep it small against the beam's 2 cm at 2 m.
        let sphere = SymmetricMat3::isotropic(0.002);
        let energy = |range_m| {
            let splat = geometry().project(Vec3::new(range_m, 0.0, 0.0), &sphere);
            splat.unwrap().energy
        };
        let ratio = energy(2.0) * 4.0 / (energy(10.0) * 100.0);
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    }

    #[test]
    fn turning_while_listening_moves_far_echoes_across() {
        let mut geometry = geometry();
        // 30°/s about up, sound at 1500 m/s: 0.1° over 5 m.
        geometry.pose.drift_per_m = Vec3::new(0.0, 30f32.to_radians() / 1500.0, 0.0);
        let q = geometry.in_beam(Vec3::new(10.0, 0.0, 0.0));
        assert!((q.y / q.x + 0.1f32.to_radians()).abs() < 1e-5);
    }

    #[test]
    fn what_cannot_be_seen_is_none() {
        let geometry = geometry();
        let sphere = SymmetricMat3::isotropic(0.02);
        for mean in [
            Vec3::new(-5.0, 0.0, 0.0),
            Vec3::new(5.0, 1.0, 0.0),
            Vec3::new(3.0, 0.0, 4.0),
            Vec3::ZERO,
            Vec3::splat(f32::NAN),
        ] {
            assert!(geometry.project(mean, &sphere).is_none(), "{mean}");
        }
    }

    #[test]
    fn length_along_the_beam_does_not_bring_a_gaussian_into_it() {
        let geometry = geometry();
        let sigma_b = geometry.beam.azimuth_sigma_rad();
        let total = (sigma_b * sigma_b + geometry.azimuth_variance_rad2).sqrt();
        let long = SymmetricMat3 {
            diagonal: Vec3::new(0.04, 1e-8, 1e-8),
            mixed: Vec3::ZERO,
        };
        let seen = |sigmas: f32| {
            let azimuth = sigmas * total;
            let mean_m = Vec3::new(5.0 * azimuth.cos(), 5.0 * azimuth.sin(), 0.0);
            geometry.project(mean_m, &long).is_some()
        };
        assert!(seen(0.95 * BEAM_REACH_SIGMAS) && !seen(1.3 * BEAM_REACH_SIGMAS));
    }
}
