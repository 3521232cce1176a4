//! What kernels know of a ping, and where its beam hears eight Gaussians' means.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};
use glam::Vec3;

use crate::PingGeometry;
use crate::constants::{BEAM_REACH_SIGMAS, NEAREST_M, RANGE_REACH_SIGMAS, SIDEWAYS};
use crate::lanes;
use crate::triple::{Triple, dot, weighted};

/// A ping's geometry as single numbers, worked out once per ping.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PingView {
    /// Axes of the beam's frame: along, left, up.
    axes: [[f32; 3]; 3],
    position_m: [f32; 3],
    drift_per_m: [f32; 3],
    reference_range_m: f32,
    pub(crate) sigma_b: f32,
    /// Variance in azimuth of beam and attitude.
    pub(crate) beam_variance: f32,
    inverse_half_width: f32,
    pub(crate) range_variance_m2: f32,
    pub(crate) range_start_m: f32,
    bin_length_m: f32,
    pub(crate) bin_count: f32,
}

/// Means of eight Gaussians in the beam's frame.
#[derive(Clone, Copy)]
pub(crate) struct Place<S: Simd> {
    /// After what the sensor drifts until their echo.
    mean: Triple<S>,
    /// Distance from the sensor's z axis: metres per radian of azimuth.
    pub(crate) lever_m: f32x8<S>,
    pub(crate) range_m: f32x8<S>,
    pub(crate) by_lever: f32x8<S>,
    pub(crate) by_range: f32x8<S>,
}

/// What lies between two planes along the beam.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slab {
    left: [f32; 3],
    position_m: [f32; 3],
    middle_m: f32,
    half_m: f32,
}

impl Slab {
    #[inline(always)]
    pub(crate) fn holds<S: Simd>(&self, [mx, my, mz]: Triple<S>) -> mask32x8<S> {
        let [px, py, pz] = self.position_m;
        let side_m = weighted([mx - px, my - py, mz - pz], self.left);
        (side_m - self.middle_m).abs().simd_le(self.half_m)
    }
}

impl PingView {
    pub(crate) fn new(geometry: &PingGeometry) -> Self {
        let sigma_b = geometry.beam.azimuth_sigma_rad();
        Self {
            axes: geometry.pose.axes.to_cols_array_2d(),
            position_m: geometry.pose.position_m.to_array(),
            drift_per_m: geometry.pose.drift_per_m.to_array(),
            reference_range_m: geometry.pose.reference_range_m,
            sigma_b,
            beam_variance: sigma_b * sigma_b + geometry.azimuth_variance_rad2,
            inverse_half_width: 1.0 / geometry.beam.elevation_half_width_rad(),
            range_variance_m2: geometry.range_variance_m2,
            range_start_m: geometry.range_start_m,
            bin_length_m: geometry.bin_length_m,
            bin_count: geometry.bin_count as f32,
        }
    }

    /// The slab about the beam's middle that holds all that it can hear of what lies in a ball; `sigma_m` is the widest there.
    pub(crate) fn slab(&self, center_m: Vec3, radius_m: f32, sigma_m: f32) -> Slab {
        let [along, left, up] = self.axes.map(Vec3::from_array);
        let position_m = Vec3::from_array(self.position_m);
        let still = center_m - position_m;
        let (still_m, [side, turn, roll]) = (still.length(), self.drift_per_m);
        let rate = along.dot(still) * turn - up.dot(still) * roll + side;
        let late_m = still_m - self.reference_range_m;
        let far_m = still_m + radius_m;
        let widest_m2 = (far_m * far_m).mul_add(self.beam_variance, sigma_m * sigma_m);
        // What the sensor drifts differs from the ball's middle to its edge by this at most.
        let turned = turn.abs() + roll.abs();
        let drift_m = radius_m * (rate.abs() + turned * (late_m.abs() + radius_m));
        Slab {
            left: left.to_array(),
            position_m: self.position_m,
            middle_m: late_m * rate,
            half_m: (BEAM_REACH_SIGMAS * widest_m2.sqrt() + drift_m) * (1.0 + 1e-4) + 1e-4,
        }
    }

    /// Whether a ball's means may be in the slab, and near enough for an echo within the ping.
    pub(crate) fn may_hear(&self, center_m: Vec3, radius_m: f32, sigma_m: f32) -> bool {
        let slab = self.slab(center_m, radius_m, sigma_m);
        let still = center_m - Vec3::from_array(self.position_m);
        let aside_m = (still.dot(Vec3::from_array(slab.left)) - slab.middle_m).abs();
        let end_m = self.range_start_m + self.bin_count * self.bin_length_m;
        // What the beam bends of a range is less than its reach across.
        let echo_m = RANGE_REACH_SIGMAS * (sigma_m + self.range_variance_m2.sqrt());
        let reach_m = end_m + echo_m + slab.half_m + self.bin_length_m;
        // Written so that what is no number is looked at more closely.
        !(aside_m > slab.half_m + radius_m || still.length() - radius_m > reach_m)
    }

    /// `R v`.
    #[inline(always)]
    pub(crate) fn in_world_frame<S: Simd>(&self, v: Triple<S>) -> Triple<S> {
        let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = self.axes;
        [
            weighted(v, [xx, yx, zx]),
            weighted(v, [xy, yy, zy]),
            weighted(v, [xz, yz, zz]),
        ]
    }

    /// `Rᵀ v`.
    #[inline(always)]
    fn in_beam_frame<S: Simd>(&self, v: Triple<S>) -> Triple<S> {
        let [along, left, up] = self.axes;
        [weighted(v, along), weighted(v, left), weighted(v, up)]
    }

    /// [`PingGeometry::in_beam`] of means on the map's coordinates.
    #[inline(always)]
    pub(crate) fn place<S: Simd>(&self, [mx, my, mz]: Triple<S>) -> Place<S> {
        let [px, py, pz] = self.position_m;
        let still = self.in_beam_frame([mx - px, my - py, mz - pz]);
        let still_m = dot(still, still).sqrt();
        let [left, turn, roll] = self.drift_per_m;
        let rate = still[0] * turn - still[2] * roll + left;
        let mean = [
            still[0],
            still[1] - (still_m - self.reference_range_m) * rate,
            still[2],
        ];
        let [x, y, z] = mean;
        let one = f32x8::splat(x.simd, 1.0);
        let lever2 = x.mul_add(x, y * y);
        let lever_m = lever2.sqrt();
        let range_m = z.mul_add(z, lever2).sqrt();
        Place {
            mean,
            lever_m,
            range_m,
            by_lever: one / lever_m,
            by_range: one / range_m,
        }
    }

    /// Unit vectors of growing range, world axes.
    #[inline(always)]
    pub(crate) fn range_axis<S: Simd>(&self, place: &Place<S>) -> Triple<S> {
        let [x, y, z] = place.mean;
        let by_range = place.by_range;
        self.in_world_frame([x * by_range, y * by_range, z * by_range])
    }

    /// Unit vectors of growing azimuth, world axes.
    #[inline(always)]
    pub(crate) fn azimuth_axis<S: Simd>(&self, place: &Place<S>) -> Triple<S> {
        let [x, y, _] = place.mean;
        let zero = f32x8::splat(x.simd, 0.0);
        self.in_world_frame([-y * place.by_lever, x * place.by_lever, zero])
    }

    /// Sensitivity along: `g(φ)`.
    #[inline(always)]
    pub(crate) fn fan<S: Simd>(&self, elevation: f32x8<S>) -> f32x8<S> {
        let x = elevation * self.inverse_half_width;
        let x2 = x * x;
        let x4 = x2 * x2;
        lanes::exp(x4 * x4 * -std::f32::consts::LN_2)
    }
}

impl<S: Simd> Place<S> {
    /// Where the mean is neither too near nor too far aside.
    #[inline(always)]
    pub(crate) fn in_front(&self) -> mask32x8<S> {
        self.range_m.simd_gt(NEAREST_M) & self.mean[0].simd_gt(self.range_m * SIDEWAYS)
    }

    /// Azimuth from the beam's axis, radians.
    #[inline(always)]
    pub(crate) fn azimuth(&self) -> f32x8<S> {
        lanes::ratio_atan(self.mean[1], self.mean[0])
    }

    /// Elevation, radians.
    #[inline(always)]
    pub(crate) fn elevation(&self) -> f32x8<S> {
        lanes::ratio_atan(self.mean[2], self.lever_m)
    }
}
