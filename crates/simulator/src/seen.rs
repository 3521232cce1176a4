//! What of a scene a dive can have seen: the truth a map's completeness is measured on.

use std::collections::BTreeMap;

use echosplat_model::Pose;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::beam::{ELEVATION_HALF_WIDTH_RAD, HALF_POWER_AZIMUTH_RAD};
use crate::dive::Dive;
use crate::scene::{Scene, SurfacePoint};

/// Pings that must have hit a place first.
const LEAST_PINGS: usize = 3;
/// The device's ring-down hides what is nearer.
const BLANKING_M: f64 = 0.5;
/// A place counts as hit if nothing lies this much before it.
const TOLERANCE_M: f64 = 0.005;
/// Spacing of the places looked at, widened where a scene is large.
const STRUCTURE_SPACING_M: f64 = 0.02;
const STRUCTURE_COUNT: f64 = 150_000.0;
const SEABED_SPACING_M: f64 = 0.05;
const SEABED_COUNT: f64 = 200_000.0;
const SEED: u64 = 0x5EE9;
/// Edge of the cubes whose places are looked for together.
const CUBE_M: f64 = 0.5;

/// Places of the surface that at least 3 noiseless pings of the dive hit first: inside half power
/// of beam and fan, beyond 0.5 m of blanking and within range. A fixed sample with about 2 cm
/// between places on structure and 5 cm on seabed, wider where a scene is large; the same for the
/// same dive.
#[must_use]
pub fn seen_surface(scene: &Scene, dive: &Dive) -> Vec<SurfacePoint> {
    let pings: Vec<PingGeometry> = (0..dive.pings())
        .map(|index| PingGeometry::of(dive, index))
        .collect();
    let cubes = cubes(candidates(scene, dive));
    let seen: Vec<Vec<SurfacePoint>> = cubes
        .par_iter()
        .map(|places| seen_of_cube(scene, &pings, places))
        .collect();
    seen.into_iter().flatten().collect()
}

/// One ping: where the sensor was at the middle of its listening, and how far it heard.
struct PingGeometry {
    origin: DVec3,
    sensor_from_world: DMat3,
    end_m: f64,
}

impl PingGeometry {
    fn of(dive: &Dive, index: usize) -> Self {
        let settings = dive.settings_at(index);
        let middle_s = 0.5 * settings.range_end_m() / settings.speed_of_sound_mps;
        let Pose {
            rotation,
            translation_m,
        } = dive.pose_during(dive.transmit_s(index), middle_s);
        Self {
            origin: translation_m,
            sensor_from_world: DMat3::from_quat(rotation).transpose(),
            end_m: settings.range_end_m(),
        }
    }

    /// Whether any place of a ball can be in beam and range.
    fn may_see(&self, center: DVec3, radius_m: f64) -> bool {
        let local = self.sensor_from_world * (center - self.origin);
        let reach_m = radius_m * 1.02;
        local.x > -reach_m
            && local.y.abs() < reach_m + local.x.abs() * HALF_POWER_AZIMUTH_RAD * 1.02
            && local.length_squared() < (self.end_m + reach_m).powi(2)
    }

    fn sees(&self, scene: &Scene, place: DVec3) -> bool {
        let offset = place - self.origin;
        let local = self.sensor_from_world * offset;
        let range_m = local.length();
        let across = local.truncate().length();
        let in_beam = local.x > 0.0
            && local.y.atan2(local.x).abs() <= HALF_POWER_AZIMUTH_RAD
            && local.z.atan2(across).abs() <= ELEVATION_HALF_WIDTH_RAD;
        if !(in_beam && range_m >= BLANKING_M && range_m <= self.end_m) {
            return false;
        }
        let before_m = range_m - TOLERANCE_M;
        scene
            .cast(self.origin, offset / range_m, before_m)
            .is_none()
    }
}

fn candidates(scene: &Scene, dive: &Dive) -> Vec<SurfacePoint> {
    let area_m2 = scene.structure_area_m2();
    let spacing_m = STRUCTURE_SPACING_M.max((area_m2 / STRUCTURE_COUNT).sqrt());
    let mut places = scene.sample_structure(spacing_m, SEED);
    if scene.has_seabed() {
        let (low, high) = dive.reach();
        let reach_m = dive
            .settings_at(dive.pings().saturating_sub(1))
            .range_end_m();
        let area = (low - reach_m, high + reach_m);
        let size = area.1 - area.0;
        let spacing_m = SEABED_SPACING_M.max((size.x * size.y / SEABED_COUNT).sqrt());
        places.extend(scene.sample_seabed(spacing_m, SEED, area));
    }
    places
}

/// Places by the cube they lie in, in a fixed order.
fn cubes(places: Vec<SurfacePoint>) -> Vec<Vec<SurfacePoint>> {
    let mut cubes: BTreeMap<[i64; 3], Vec<SurfacePoint>> = BTreeMap::new();
    for place in places {
        let cube = (place.position / CUBE_M).floor().to_array();
        cubes
            .entry(cube.map(|axis| axis as i64))
            .or_default()
            .push(place);
    }
    cubes.into_values().collect()
}

fn seen_of_cube(
    scene: &Scene,
    pings: &[PingGeometry],
    places: &[SurfacePoint],
) -> Vec<SurfacePoint> {
    let sum: DVec3 = places.iter().map(|place| place.position).sum();
    let center = sum / places.len() as f64;
    let from_center = |place: &SurfacePoint| place.position.distance(center);
    let radius_m = places.iter().map(from_center).fold(0.0, f64::max);
    let near: Vec<&PingGeometry> = pings
        .iter()
        .filter(|ping| ping.may_see(center, radius_m))
        .collect();
    let is_seen = |place: &&SurfacePoint| {
        let sees = near.iter().filter(|ping| ping.sees(scene, place.position));
        sees.take(LEAST_PINGS).count() == LEAST_PINGS
    };
    places.iter().filter(is_seen).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DiveKind, DiveOptions, NoiseLevel};

    fn short(kind: DiveKind, scene: &Scene) -> Dive {
        let options = DiveOptions {
            duration_s: 120.0,
            view_share: 0.1,
            ..DiveOptions::default()
        };
        Dive::plan_with(kind, scene, NoiseLevel::None, 1, &options).unwrap()
    }

    #[test]
    fn a_survey_sees_nearly_all_of_the_fence() {
        let scene = Scene::named("fence").unwrap();
        let seen = seen_surface(&scene, &short(DiveKind::Survey, &scene));
        let all = scene.sample_structure(STRUCTURE_SPACING_M, SEED);
        let share = seen.len() as f64 / all.len() as f64;
        assert!(share > 0.9, "{share}");
    }

    #[test]
    fn the_back_of_a_wall_is_not_seen() {
        let scene = Scene::named("wall").unwrap();
        let seen = seen_surface(&scene, &short(DiveKind::Survey, &scene));
        assert!(seen.len() > 10_000);
        assert!(seen.iter().all(|place| place.position.y < 0.99));
        let on_face = seen.iter().filter(|p| p.position.y.abs() < 1e-9).count();
        assert!(on_face > 5_000, "{on_face}");
    }

    #[test]
    fn a_few_still_views_see_something_and_open_water_nothing() {
        let fence = Scene::named("fence").unwrap();
        assert!(!seen_surface(&fence, &short(DiveKind::Viewpoints, &fence)).is_empty());
        let empty = Scene::named("empty").unwrap();
        assert!(seen_surface(&empty, &short(DiveKind::Survey, &empty)).is_empty());
    }
}
