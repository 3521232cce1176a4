//! The plane of a ping's fan over the ground.

use echosplat_measurement::lanes::{self, LANES};
use echosplat_measurement::simd_level;
use echosplat_measurement::{Beam, PingGeometry};
use echosplat_model::glam::Vec3;
use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x8};

/// Steps of the table of sensitivity; grid.
const STEPS: usize = 256;
/// Half-widths, derived: sensitivity ends before.
/// The table reaches this many half widths to both sides; sensitivity ends before.
const REACH: f32 = 1.35;

/// Sensitivity along the fan, summed up from its lower edge.
#[derive(Debug, Clone)]
pub(crate) struct FanEnergy {
    half_width_rad: f32,
    /// `∫ g dφ` up to each step, radians.
    below_rad: Vec<f32>,
}

impl FanEnergy {
    pub(crate) fn new(beam: &Beam) -> Self {
        let half_width_rad = beam.elevation_half_width_rad();
        let step_rad = 2.0 * REACH * half_width_rad / STEPS as f32;
        let mut below_rad = vec![0.0; STEPS + 1];
        for step in 0..STEPS {
            let middle = (step as f32 + 0.5) * step_rad - REACH * half_width_rad;
            below_rad[step + 1] = below_rad[step] + beam.elevation_weight(middle) * step_rad;
        }
        Self {
            half_width_rad,
            below_rad,
        }
    }

    pub(crate) fn half_width_rad(&self) -> f32 {
        self.half_width_rad
    }

    /// Lowest elevation of any sensitivity.
    pub(crate) fn lowest_rad(&self) -> f32 {
        -REACH * self.half_width_rad
    }

    /// `∫ g dφ` below an elevation, radians.
    pub(crate) fn below(&self, elevation_rad: f32) -> f32 {
        let position = (elevation_rad / (REACH * self.half_width_rad) + 1.0) * 0.5 * STEPS as f32;
        if !(position > 0.0) {
            return 0.0;
        }
        let step = (position as usize).min(STEPS - 1);
        let fraction = (position - step as f32).min(1.0);
        self.below_rad[step] + fraction * (self.below_rad[step + 1] - self.below_rad[step])
    }
}

/// Directions in the plane of a fan, told by elevation off the beam's axis towards the ground.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FanPlane {
    pub(crate) position_m: Vec3,
    along: Vec3,
    /// The fan's own upward axis, turned so that the ground is below it.
    up: Vec3,
    /// Metres down per metre of range at most, and the elevation at which it is.
    steepest: f32,
    straight_down_rad: f32,
}

impl FanPlane {
    pub(crate) fn of(geometry: &PingGeometry) -> Self {
        let axes = geometry.pose.axes;
        let along = axes.x_axis;
        // A sonar mounted upside down sees the same ground.
        let up = axes.z_axis * if axes.z_axis.z < 0.0 { -1.0 } else { 1.0 };
        Self {
            position_m: geometry.pose.position_m,
            along,
            up,
            steepest: along.z.hypot(up.z),
            straight_down_rad: up.z.atan2(along.z) - std::f32::consts::PI,
        }
    }

    pub(crate) fn direction(&self, elevation_rad: f32) -> Vec3 {
        let (sin, cos) = elevation_rad.sin_cos();
        self.along * cos + self.up * sin
    }

    /// Metres down per metre of range.
    pub(crate) fn descent(&self, elevation_rad: f32) -> f32 {
        -self.direction(elevation_rad).z
    }

    /// Elevation at which flat ground `depth_m` below the sensor is met at `range_m`; the straight
    /// way down where it is nearer than that.
    pub(crate) fn elevation_of_ground(&self, depth_m: f32, range_m: f32) -> f32 {
        let descent = depth_m / (range_m * self.steepest);
        self.straight_down_rad + descent.clamp(-1.0, 1.0).acos()
    }

    /// [`Self::elevation_of_ground`] at each range, for ground below the sensor.
    pub(crate) fn elevations_of_ground(
        &self,
        depth_m: f32,
        ranges_m: &[f32],
        into_rad: &mut [f32],
    ) {
        dispatch!(simd_level::level(), simd => self.elevations(simd, depth_m, ranges_m, into_rad));
    }

    #[inline(always)]
    fn elevations<S: Simd>(&self, simd: S, depth_m: f32, ranges_m: &[f32], into_rad: &mut [f32]) {
        let eights = ranges_m
            .chunks_exact(LANES)
            .zip(into_rad.chunks_exact_mut(LANES));
        for (ranges_m, into_rad) in eights {
            let range_m = f32x8::from_slice(simd, ranges_m);
            let descent = f32x8::splat(simd, depth_m) / (range_m * self.steepest);
            let descent = descent.min(1.0);
            let level = (descent * -descent + 1.0).max(0.0).sqrt();
            let down_rad = lanes::ratio_atan(level, descent);
            (down_rad + self.straight_down_rad).store_slice(into_rad);
        }
        let whole = ranges_m.len() - ranges_m.len() % LANES;
        for (range_m, into_rad) in ranges_m[whole..].iter().zip(&mut into_rad[whole..]) {
            *into_rad = self.elevation_of_ground(depth_m, *range_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_measurement::PingPose;
    use echosplat_model::glam::Mat3;

    #[test]
    fn eight_elevations_at_a_time_are_those_of_each() {
        let ranges_m: Vec<f32> = (1..60).map(|step| 0.17 * step as f32).collect();
        let mut told_rad = vec![0.0; ranges_m.len()];
        for (pitch, depth_m) in [(0.0, 0.2), (0.3, 2.0), (-0.7, 5.0)] {
            let plane = FanPlane::of(&PingGeometry {
                pose: PingPose {
                    position_m: Vec3::ZERO,
                    axes: Mat3::from_rotation_y(pitch),
                    drift_per_m: Vec3::ZERO,
                    reference_range_m: 5.0,
                },
                range_start_m: 0.0,
                bin_length_m: 0.02,
                bin_count: 500,
                range_variance_m2: 0.0,
                azimuth_variance_rad2: 0.0,
                beam: Beam::default(),
            });
            plane.elevations_of_ground(depth_m, &ranges_m, &mut told_rad);
            for (range_m, told_rad) in ranges_m.iter().zip(&told_rad) {
                let each_rad = plane.elevation_of_ground(depth_m, *range_m);
                // Straight down, sine and cosine cannot tell less than the root of their rounding.
                assert!(
                    (told_rad - each_rad).abs() < 5e-4,
                    "{range_m} {told_rad} {each_rad}"
                );
            }
        }
    }
}
