//! The plane of a ping's fan over the ground.

use echosplat_acoustics::{Beam, PingGeometry};
use echosplat_model::glam::Vec3;

/// Steps of the table of the fan's sensitivity.
const STEPS: usize = 256;
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
}

impl FanPlane {
    pub(crate) fn of(geometry: &PingGeometry) -> Self {
        let axes = geometry.pose.axes;
        Self {
            position_m: geometry.pose.position_m,
            along: axes.x_axis,
            // A sonar mounted upside down sees the same ground.
            up: axes.z_axis * if axes.z_axis.z < 0.0 { -1.0 } else { 1.0 },
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
        let steepest = self.along.z.hypot(self.up.z);
        let straight_down = self.up.z.atan2(self.along.z) - std::f32::consts::PI;
        straight_down + (depth_m / (range_m * steepest)).clamp(-1.0, 1.0).acos()
    }
}
