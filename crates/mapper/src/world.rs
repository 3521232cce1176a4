//! The mapper's own axes, and how fine its voxels are.

use echosplat_model::glam::{DMat3, DQuat, DVec3};
use echosplat_model::{Gaussian, Pose, PosedPing};

use crate::MapperConfig;
use crate::accumulate::evidence::Evidence;

/// Metres of finest and coarsest voxels; found.
/// Voxels stay within these bounds.
const VOXEL_LIMITS_M: (f64, f64) = (0.02, 0.5);
/// Beam widths; found.
/// Edge of a voxel in widths of the beam: at the far end of a ping, as coarse as ever, and where the strongest echoes come
/// from.
const AT_FAR_END: f64 = 0.35;
/// Beam widths; found.
const AT_WORKING_RANGE: f64 = 0.8;
/// Fraction; bounds memory.
/// A unit that is set to hear much further than what is there has voxels at most this fraction of those of its far end: noise
/// out there fills room as well.
const FINEST_FRACTION: f64 = 0.5;
/// Ratio; bounds work.
/// Voxels that would be finer or coarser by less stay as they are.
const LEAST_CHANGE: f32 = 1.3;

/// Metres, derived: single precision rounds by 0.5 mm.
/// A map that begins within this distance of the poses' origin is published in the poses' own
/// frame, so that it overlays the track in tools that know nothing of origins. Single precision
/// rounds a place by at most 0.5 mm up to 16 km.
const POSES_FRAME_REACH_M: f64 = 10_000.0;

/// What the first ping fixes: inside the mapper, coordinates start where it was and run along its
/// heading, so that a dive moved and turned as a whole gives the same map, moved and turned.
#[derive(Debug)]
pub(crate) struct World {
    /// Where the first ping was, in the poses' frame, metres.
    pub(crate) origin_m: DVec3,
    /// What published places are relative to: the poses' origin, or far from it the first ping.
    pub(crate) published_origin_m: DVec3,
    /// World from the mapper's own axes, a turn about z.
    heading: DQuat,
    pub(crate) evidence: Evidence,
}

impl World {
    /// Coordinates start at this ping.
    pub(crate) fn begun_by(first: &PosedPing, config: &MapperConfig) -> Self {
        let ahead = first.world_from_sensor.rotation * DVec3::X;
        let origin_m = first.world_from_sensor.translation_m;
        Self {
            origin_m,
            published_origin_m: published_origin_m(origin_m),
            heading: DQuat::from_rotation_z(ahead.y.atan2(ahead.x)),
            evidence: Evidence::new(first_voxel_m(first, config)),
        }
    }

    /// The edge that voxels should have where pings end at `range_end_m` and the strongest echoes come from `working_range_m`,
    /// metres; `None` if those they have will do, or are as configured.
    pub(crate) fn better_voxel_m(
        &self,
        range_end_m: f64,
        working_range_m: f32,
        config: &MapperConfig,
    ) -> Option<f32> {
        let better_m = voxel_m(range_end_m, Some(working_range_m.into()), config);
        let change = better_m / self.evidence.voxel_m();
        (change.max(change.recip()) > LEAST_CHANGE).then_some(better_m)
    }

    /// Voxels of this size with nothing in them.
    pub(crate) fn divide_anew(&mut self, voxel_m: f32) {
        self.evidence = Evidence::new(voxel_m);
    }

    /// The same axes and nothing on them.
    pub(crate) fn emptied(&self) -> Self {
        Self {
            evidence: Evidence::new(self.evidence.voxel_m()),
            ..*self
        }
    }

    /// World from the mapper's own axes, a turn about z.
    pub(crate) fn heading(&self) -> DQuat {
        self.heading
    }

    /// Heading of the mapper's own x axis, from the world's x to y, radians.
    pub(crate) fn axis_rad(&self) -> f64 {
        2.0 * self.heading.z.atan2(self.heading.w)
    }

    /// The ping on the mapper's own axes.
    pub(crate) fn enter(&self, posed: &PosedPing) -> PosedPing {
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

    /// Where the mapper's own axes lie in what is published.
    pub(crate) fn placing(&self) -> Placing {
        Placing {
            heading: self.heading,
            shift_m: self.origin_m - self.published_origin_m,
        }
    }
}

/// Where the mapper's own axes lie.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Placing {
    /// World from the mapper's own axes, a turn about z.
    heading: DQuat,
    /// Of the first ping from the published origin, metres.
    shift_m: DVec3,
}

impl Placing {
    /// A Gaussian on the mapper's own axes, relative to the published origin along the world's.
    /// Its place is rounded once.
    pub(crate) fn leave(&self, gaussian: Gaussian) -> Gaussian {
        let from_first_m = self.heading * gaussian.mean_m.as_dvec3();
        Gaussian {
            mean_m: (from_first_m + self.shift_m).as_vec3(),
            rotation: self.heading.as_quat() * gaussian.rotation,
            position_covariance_m2: turned(self.heading, gaussian.position_covariance_m2),
            ..gaussian
        }
    }
}

/// A covariance on axes that are turned; what is not known in one direction is not known in any.
fn turned(turn: DQuat, covariance_m2: [f32; 6]) -> [f32; 6] {
    let [xx, xy, xz, yy, yz, zz] = covariance_m2.map(f64::from);
    if !(xx + yy + zz).is_finite() {
        return Gaussian::known_alike_m2(f32::INFINITY);
    }
    let columns = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
    let turn = DMat3::from_quat(turn);
    let turned = turn * DMat3::from_cols_array_2d(&columns) * turn.transpose();
    let [x, y, z] = turned.to_cols_array_2d();
    [x[0], x[1], x[2], y[1], y[2], z[2]].map(|value| value as f32)
}

fn published_origin_m(first_ping_m: DVec3) -> DVec3 {
    match first_ping_m.length() <= POSES_FRAME_REACH_M {
        true => DVec3::ZERO,
        false => first_ping_m,
    }
}

/// Edge of a voxel before anything is known but a ping's range, metres.
pub(crate) fn first_voxel_m(first: &PosedPing, config: &MapperConfig) -> f32 {
    voxel_m(first.ping.settings().range_end_m(), None, config)
}

/// As configured, or as fine as the beam is narrow: where the strongest echoes come from, if that is known, and at the far end
/// of a ping at most. Units are set to hear further than what is there, and a place near them is told better than one at
/// the far end.
fn voxel_m(range_end_m: f64, working_range_m: Option<f64>, config: &MapperConfig) -> f32 {
    if config.resolution_m > 0.0 {
        return config.resolution_m as f32;
    }
    let coarsest_m = AT_FAR_END * beam_width_rad(config) * range_end_m;
    let resolved_m = working_range_m.map_or(coarsest_m, |range_m| {
        let there_m = AT_WORKING_RANGE * beam_width_rad(config) * range_m;
        there_m.min(coarsest_m).max(FINEST_FRACTION * coarsest_m)
    });
    resolved_m.clamp(VOXEL_LIMITS_M.0, VOXEL_LIMITS_M.1) as f32
}

fn beam_width_rad(config: &MapperConfig) -> f64 {
    config.beam.azimuth_width_deg.to_radians().into()
}

impl MapperConfig {
    /// The finest voxels that pings which end at `range_end_m` can bring about, metres: what memory is to be reckoned with.
    #[must_use]
    pub fn finest_voxel_m(&self, range_end_m: f64) -> f64 {
        voxel_m(range_end_m, Some(0.0), self).into()
    }
}

/// The furthest that a unit should be set to hear where the strongest echoes come from `working_range_m`, metres: up to there
/// voxels are as fine as the beam resolves. `None` if they are as configured.
pub(crate) fn useful_range_m(working_range_m: f32, config: &MapperConfig) -> Option<f32> {
    let times = (AT_WORKING_RANGE / (FINEST_FRACTION * AT_FAR_END)) as f32;
    (config.resolution_m <= 0.0).then_some(times * working_range_m)
}

#[cfg(test)]
mod tests {
    use echosplat_model::Standing;
    use echosplat_model::glam::{Quat, Vec3};

    use super::*;

    #[test]
    fn voxels_are_as_fine_as_the_beam_where_the_echoes_come_from_and_no_coarser_than_at_the_far_end()
     {
        let config = MapperConfig::default();
        let width = f64::from(config.beam.azimuth_width_deg.to_radians());
        let of = |range_end_m: f64, working_range_m: Option<f64>| {
            f64::from(voxel_m(range_end_m, working_range_m, &config)) / width
        };
        let is =
            |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-4, "{found}");
        is(of(10.0, None), 3.5);
        is(of(10.0, Some(6.0)), 3.5);
        is(of(20.0, Some(6.0)), 4.8);
        is(of(40.0, Some(6.0)), 7.0);
        let useful_m = f64::from(useful_range_m(6.0, &config).unwrap());
        is(of(useful_m, Some(6.0)), 4.8);
        assert!(of(1.1 * useful_m, Some(6.0)) > 4.8 * 1.05);
        let fixed = MapperConfig {
            resolution_m: 0.07,
            ..config
        };
        is(voxel_m(40.0, Some(6.0), &fixed).into(), 0.07);
        assert_eq!(useful_range_m(6.0, &fixed), None);
        assert!((fixed.finest_voxel_m(40.0) - 0.07).abs() < 1e-6);
    }

    #[test]
    fn a_map_is_published_in_the_poses_frame_as_far_as_single_precision_reaches() {
        let near_m = DVec3::new(-6000.0, 8000.0, 0.0);
        assert_eq!(published_origin_m(near_m), DVec3::ZERO);
        let far_m = DVec3::new(6000.0, -8000.0, 0.1);
        assert_eq!(published_origin_m(far_m), far_m);
    }

    #[test]
    fn a_published_place_is_off_by_a_rounding_at_most() {
        let away_m = DVec3::new(7000.1, -7000.3, 12.7);
        for origin_m in [DVec3::ZERO, away_m, 1e3 * away_m] {
            let world = World {
                origin_m,
                published_origin_m: published_origin_m(origin_m),
                heading: DQuat::from_rotation_z(0.3),
                evidence: Evidence::new(0.05),
            };
            let inside = Gaussian {
                id: 1,
                mean_m: Vec3::new(1.1, -20.3, 0.7),
                rotation: Quat::IDENTITY,
                scale_m: Vec3::splat(0.05),
                opacity: 0.5,
                reflectivity: 0.5,
                sigma_m: 0.1,
                position_covariance_m2: Gaussian::known_alike_m2(0.1),
                probability: 1.0,
                standing: Standing::Confident,
                why: echosplat_model::Why::default(),
            };
            let expected_m = origin_m + world.heading * inside.mean_m.as_dvec3();
            let told_m = world.published_origin_m + world.placing().leave(inside).mean_m.as_dvec3();
            let off_m = told_m.distance(expected_m);
            assert!(off_m < 0.0005, "{off_m} m off at {origin_m}");
        }
    }
}
