//! The mapper's own axes, and how fine its voxels are.

use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Gaussian, Pose, PosedPing};

use crate::MapperConfig;
use crate::evidence::Evidence;

/// Half the beam's width at the far end is resolved; voxels stay within these bounds.
const VOXEL_LIMITS_M: (f64, f64) = (0.02, 0.5);

/// What the first ping fixes: inside the mapper, coordinates start where it was and run along its
/// heading, so that a dive moved and turned as a whole gives the same map, moved and turned.
#[derive(Debug)]
pub(super) struct World {
    pub(super) origin_m: DVec3,
    /// World from the mapper's own axes, a turn about z.
    heading: DQuat,
    pub(super) evidence: Evidence,
}

impl World {
    /// Coordinates start at this ping.
    pub(super) fn begun_by(first: &PosedPing, config: &MapperConfig) -> Self {
        let ahead = first.world_from_sensor.rotation * DVec3::X;
        Self {
            origin_m: first.world_from_sensor.translation_m,
            heading: DQuat::from_rotation_z(ahead.y.atan2(ahead.x)),
            evidence: Evidence::new(voxel_m(first, config)),
        }
    }

    /// The ping on the mapper's own axes.
    pub(super) fn enter(&self, posed: &PosedPing) -> PosedPing {
        let into = self.heading.conjugate();
        let pose = &posed.world_from_sensor;
        PosedPing {
            world_from_sensor: Pose {
                translation_m: into * (pose.translation_m - self.origin_m),
                rotation: (into * pose.rotation).normalize(),
            },
            ..posed.clone()
        }
    }

    /// A Gaussian on the mapper's own axes, relative to the origin along the world's.
    pub(super) fn leave(&self, gaussian: Gaussian) -> Gaussian {
        Gaussian {
            mean_m: (self.heading * gaussian.mean_m.as_dvec3()).as_vec3(),
            rotation: self.heading.as_quat() * gaussian.rotation,
            ..gaussian
        }
    }
}

/// Edge of a voxel, metres: as configured, or by the beam and the first ping's range.
pub(super) fn voxel_m(first: &PosedPing, config: &MapperConfig) -> f32 {
    if config.resolution_m > 0.0 {
        return config.resolution_m as f32;
    }
    let width = f64::from(config.beam.azimuth_width_deg.to_radians());
    let resolved_m = 0.35 * width * first.ping.settings().range_end_m();
    resolved_m.clamp(VOXEL_LIMITS_M.0, VOXEL_LIMITS_M.1) as f32
}
