//! (11) to (13) by themselves, for pings of any dive: support from `M` views.
//!
//! Pings that come in images are taken as the paper takes them. Of a dive that moves, a view is as
//! many pings in a row as an image has beams, and a beam's width is the sonar's own.

use echosplat_model::{Gaussian, GaussianId, PosedPing};
use glam::{DMat3, DVec3};

use crate::candidates::{self, CandidateCounts, Candidates, Merged, Ray};
use crate::images::{ImageError, Images};
use crate::{Choices, asserted, start};

/// Pings of one view of a dive that moves.
const PINGS_PER_VIEW: usize = 64;
/// Nearer than this the transducer still rings, metres.
const BLANKING_M: f64 = 0.5;
/// Full width at half maximum across, radians.
const BEAM_WIDTH_RAD: f32 = 0.8 * std::f32::consts::PI / 180.0;

/// What several views agree on.
#[derive(Debug, Clone)]
pub struct Support {
    /// Added to every mean gives the world's coordinates, metres.
    pub origin_m: DVec3,
    /// One sphere per place, in order of id; all asserted.
    pub gaussians: Vec<Gaussian>,
    /// How many places there were.
    pub counts: CandidateCounts,
}

/// The first Gaussians of the paper's method, of all pings together. Uses rayon's current pool.
///
/// # Errors
/// If a choice is out of range, no ping shows anything, or beams that came in images are none.
pub fn support(pings: &[PosedPing], choices: &Choices) -> Result<Support, ImageError> {
    if pings.iter().any(|posed| posed.ping.view().is_some()) {
        let images = Images::from_pings(pings, choices)?;
        let width_m = candidates::beam_width_m(&images, choices);
        let (found, counts) = candidates::find(&images, width_m, choices);
        return Ok(Support::of(
            images.origin_m,
            &found,
            counts,
            width_m,
            choices,
        ));
    }
    choices.check()?;
    let nothing = ImageError::Nothing {
        ping_count: pings.len(),
        left_out_count: 0,
    };
    let Some(first) = pings.first() else {
        return Err(nothing);
    };
    let unit = intensity_unit(pings);
    if !(unit > 0.0) {
        return Err(nothing);
    }
    let origin_m = first.world_from_sensor.translation_m;
    let of_ping = |posed| active_bins(posed, unit, choices).map(|(range_m, _)| range_m);
    let ranges_m: Vec<f32> = pings.iter().flat_map(of_ping).collect();
    let width_m = candidates::width_at_middle_m(ranges_m, BEAM_WIDTH_RAD);
    let views = pings.len().div_ceil(PINGS_PER_VIEW);
    let mut merged = Merged::new(choices.merge_beams * width_m, views);
    for (index, posed) in pings.iter().enumerate() {
        let ray = ray(posed, origin_m);
        for (range_m, value) in active_bins(posed, unit, choices) {
            let points = ray.arc(range_m, BEAM_WIDTH_RAD, choices);
            merged.add_arc(index / PINGS_PER_VIEW, points, value);
        }
    }
    let (found, counts) = merged.supported(views, width_m, choices);
    Ok(Support::of(origin_m, &found, counts, width_m, choices))
}

impl Support {
    /// (13).
    fn of(
        origin_m: DVec3,
        found: &Candidates,
        counts: CandidateCounts,
        beam_width_m: f32,
        choices: &Choices,
    ) -> Self {
        let arrays = start::gaussians(found, beam_width_m, choices);
        let ids: Vec<GaussianId> = (0..arrays.len() as GaussianId).collect();
        Self {
            origin_m,
            gaussians: asserted::asserted(&arrays, &ids, 0.0),
            counts,
        }
    }
}

/// The median over the views of their strongest bin, as for images.
fn intensity_unit(pings: &[PosedPing]) -> f32 {
    let peak = |view: &[PosedPing]| {
        let powers = view
            .iter()
            .flat_map(|posed| open_bins(posed).map(|(_, power)| power));
        powers.fold(0.0, f32::max)
    };
    let mut peaks: Vec<f32> = pings.chunks(PINGS_PER_VIEW).map(peak).collect();
    peaks.retain(|peak| *peak > 0.0);
    peaks.sort_unstable_by(f32::total_cmp);
    peaks.get(peaks.len() / 2).copied().unwrap_or(0.0)
}

/// Range, metres, and power of the bins beyond the blanking.
fn open_bins(posed: &PosedPing) -> impl Iterator<Item = (f32, f32)> {
    let settings = posed.ping.settings();
    let bins = posed.ping.intensity().iter().enumerate();
    let bins = bins.map(|(bin, power)| (settings.bin_center_m(bin), *power));
    bins.filter(|(range_m, _)| *range_m >= BLANKING_M)
        .map(|(range_m, power)| (range_m as f32, power))
}

/// Range, metres, and value, 0 to 1, of the bins at or above the threshold.
fn active_bins<'a>(
    posed: &'a PosedPing,
    unit: f32,
    choices: &'a Choices,
) -> impl Iterator<Item = (f32, f32)> + use<'a> {
    let valued = move |(range_m, power): (f32, f32)| {
        (range_m, (power / unit).min(1.0).powf(choices.image_power))
    };
    let bins = open_bins(posed).map(valued);
    bins.filter(|(_, value)| *value >= choices.active_value)
}

fn ray(posed: &PosedPing, origin_m: DVec3) -> Ray {
    let pose = posed.world_from_sensor;
    Ray {
        position_m: (pose.translation_m - origin_m).as_vec3(),
        axes: DMat3::from_quat(pose.rotation).as_mat3(),
        azimuth_rad: posed.ping.beam_azimuth_rad(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_simulator::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene, SimulatedSonar};
    use std::sync::Arc;

    fn pings(kind: DiveKind, options: &DiveOptions) -> Vec<PosedPing> {
        let scene = Arc::new(Scene::named("fence").unwrap());
        let noise = NoiseLevel::None;
        let dive = Arc::new(Dive::plan_with(kind, &scene, noise, 1, options).unwrap());
        let trajectory = dive.trajectory(0.5);
        let sonar = SimulatedSonar::new(scene, Arc::clone(&dive), noise, 1);
        let pings = (0..dive.pings()).filter_map(|index| sonar.posed_ping(index, &trajectory));
        pings.collect()
    }

    #[test]
    fn images_give_the_first_gaussians_of_the_whole_method() {
        let options = DiveOptions {
            view_share: 0.05,
            ..DiveOptions::default()
        };
        let pings = pings(DiveKind::Viewpoints, &options);
        let choices = Choices::default();
        let alone = support(&pings, &choices).unwrap();
        let images = Images::from_pings(&pings, &choices).unwrap();
        let method = crate::PaperMethod::new(images, choices);
        assert!(!alone.gaussians.is_empty());
        assert_eq!(alone.counts, method.candidate_counts());
        assert_eq!(alone.gaussians, method.gaussians_above(0.0));
    }

    #[test]
    fn places_of_a_moving_dive_are_near_what_it_saw() {
        let options = DiveOptions {
            duration_s: 20.0,
            ..DiveOptions::default()
        };
        let pings = pings(DiveKind::Survey, &options);
        let support = support(&pings, &Choices::default()).unwrap();
        assert_eq!(support.counts.views_needed, 3);
        assert!(support.counts.kept > 0 && support.counts.kept < support.counts.candidates);
        let scene = Scene::named("fence").unwrap();
        let near = support.gaussians.iter().filter(|gaussian| {
            let place = support.origin_m + gaussian.mean_m.as_dvec3();
            scene.nearest(place).0 < 0.1
        });
        assert!(near.count() > 0);
    }

    #[test]
    fn silence_is_an_error_that_counts_its_pings() {
        let error = support(&[], &Choices::default()).unwrap_err();
        assert!(error.to_string().contains("of 0 pings"), "{error}");
    }
}
