//! The paper's data collection: still images from planes at the four sides of the structure.

use echosplat_model::Pose;
use glam::DVec3;

use super::survey::{CLEARANCE_M, structure_or_default};
use super::{DiveError, Motion};
use crate::beam::direction;
use crate::random::{Purpose, Random};
use crate::scene::Scene;

/// Beams of one image.
pub const BEAMS_PER_VIEW: usize = 64;
/// Azimuth between the outer edges of the first and the last beam.
const IMAGE_WIDTH_RAD: f64 = 60.0 * DEGREE;
/// One sigma of the perturbation about each axis.
const PERTURBATION_RAD: f64 = 3.0 * DEGREE;
/// Positions reach this far beyond the structure's box, sideways and in height.
const SPREAD_M: f64 = 1.5;
/// A view with fewer beams that meet anything is dropped as sparse.
const LEAST_BEAMS_WITH_ECHOES: usize = 6;
const ATTEMPTS_PER_VIEW: usize = 50;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// One pose per beam, and the range to listen to.
pub(super) fn plan(scene: &Scene, seed: u64, view_share: f64) -> Result<(Motion, f64), DiveError> {
    let hints = scene.viewpoint_hints();
    let (low, high) = structure_or_default(scene);
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let standoff_m = hints.standoff_m.unwrap_or(4.5);
    let across_m = standoff_m + 2.0 * half.truncate().max_element();
    let range_m = across_m.hypot(half.z + SPREAD_M).ceil();
    let wanted = (hints.count as f64 * view_share).ceil().max(1.0) as usize;
    let mut random = Random::new(seed, Purpose::Plan, 1);
    let mut views = Vec::with_capacity(wanted);
    for _ in 0..wanted * ATTEMPTS_PER_VIEW {
        if views.len() == wanted {
            break;
        }
        let position = position(middle, half, standoff_m, &mut random);
        let view = facing(position, middle, &mut random);
        let is_clear = scene.distance(position) >= CLEARANCE_M && scene.is_open_water(position);
        if is_clear && (scene.is_empty() || !is_sparse(scene, &view, range_m)) {
            views.push(view);
        }
    }
    if views.len() < wanted {
        return Err(DiveError::SparseViews {
            scene: scene.name().to_owned(),
            found: views.len(),
            wanted,
        });
    }
    let beams = views
        .iter()
        .flat_map(|view| (0..BEAMS_PER_VIEW).map(|beam| beam_of(view, beam)));
    Ok((Motion::Still(beams.collect()), range_m))
}

/// On one of four planes beside the structure, anywhere within its outline and a bit more.
fn position(middle: DVec3, half: DVec3, standoff_m: f64, random: &mut Random) -> DVec3 {
    let side = (random.unit() * 4.0) as usize;
    let (normal_axis, along_axis) = if side < 2 { (0, 1) } else { (1, 0) };
    let sign = if side.is_multiple_of(2) { -1.0 } else { 1.0 };
    let mut position = middle;
    position[normal_axis] += sign * (half[normal_axis] + standoff_m);
    for axis in [along_axis, 2] {
        let reach_m = half[axis] + SPREAD_M;
        position[axis] += random.between(-reach_m, reach_m);
    }
    position
}

/// Looking at the middle, a little off.
fn facing(position: DVec3, middle: DVec3, random: &mut Random) -> Pose {
    let look = middle - position;
    let yaw_rad = look.y.atan2(look.x);
    let pitch_rad = -look.z.atan2(look.truncate().length());
    let mut off = || PERTURBATION_RAD * random.normal();
    Pose::from_yaw_pitch_roll(yaw_rad + off(), pitch_rad + off(), off(), position)
}

/// The view's pose turned so that beam `beam`'s axis lies at azimuth 0, right to left.
fn beam_of(view: &Pose, beam: usize) -> Pose {
    *view * Pose::from_yaw_pitch_roll(beam_azimuth_rad(beam), 0.0, 0.0, DVec3::ZERO)
}

fn beam_azimuth_rad(beam: usize) -> f64 {
    ((beam as f64 + 0.5) / BEAMS_PER_VIEW as f64 - 0.5) * IMAGE_WIDTH_RAD
}

fn is_sparse(scene: &Scene, view: &Pose, range_m: f64) -> bool {
    const ELEVATIONS: i32 = 8;
    let meets = |azimuth_rad: f64| {
        (-ELEVATIONS..=ELEVATIONS).any(|step| {
            let elevation_rad = f64::from(step) / f64::from(ELEVATIONS) * 24.0 * DEGREE;
            let ray = view.rotation * direction(azimuth_rad, elevation_rad);
            scene.cast(view.translation_m, ray, range_m).is_some()
        })
    };
    let lit = (0..BEAMS_PER_VIEW).filter(|&beam| meets(beam_azimuth_rad(beam)));
    lit.take(LEAST_BEAMS_WITH_ECHOES).count() < LEAST_BEAMS_WITH_ECHOES
}
