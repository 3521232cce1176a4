//! Images in the water's surface: of a structure near it, an echo also comes by way of the surface.
//!
//! With P′ the image of a place P in the surface and S the sensor, P is heard at |SP|, once more at (|SP| + |SP′|)/2 (out
//! one way, back the other) and at |SP′|. The height of the surface is learnt from the dive: of all heights that are tried,
//! it is the one at which the images that strong echoes of confident Gaussians have are least likely to be chance. Echoes
//! where a confident Gaussian's image would be heard, weaker than its own, then say nothing.
//!
//! Deliberately absent: waves, tide, bent sound; heights more than 17 m above the first ping; surfaces whose images are
//! never heard by echoes strong enough to ask.
//!
//! Cost: every fourth ping, or every one once a height is told, a distance for each confident Gaussian in reach, a projection for those
//! at the ranges of at most 8 strong echoes, and for each of these 500 heights.

use echosplat_measurement::{PingGeometry, SymmetricMat3};
use echosplat_model::glam::Vec3;

use crate::detect::odds::{LEAST_NATS, nats_over_chance};
use crate::detect::profile::{Profile, greatest};

/// Metres over the first ping, grid.
/// Heights above the first ping, metres, from the first in steps.
const FIRST_M: f32 = -2.0;
/// Metres, grid.
const STEP_M: f32 = 0.04;
/// Heights tried; grid.
const HEIGHTS: usize = 500;
/// Steps either side; found.
/// The surface stands out from what is so many steps above and below it: 0.8 m, since near a surface its images hardly move
/// with it.
const BESIDE: usize = 20;
/// Fraction of strong echoes; found.
/// Beyond the share that is heard at heights beside, structures at a like distance send back at most this share of the rest.
const CHANCE_SHARE: f64 = 0.25;
/// Fraction of strong echoes; assumed.
/// A surface sends back at least this share of the rest: images of strong echoes are 16 dB over the threshold.
const SURFACE_SHARE: f64 = 0.5;
/// Fraction of questions; assumed.
/// The vehicle is below the surface but for so many: poses wander, and there are waves.
const MOST_ABOVE: f64 = 0.25;
/// Ratio of power, physics: 3 dB surface, 13 dB beam.
/// What an image may lose against its source and be heard still: 3 dB at the surface and 13 dB of the beam.
const LOSS: f32 = 40.0;
/// Fraction, found: 15 dB.
/// A strong echo is within 15 dB of the strongest of late.
const STRONG_FRACTION: f32 = 0.03;
/// Strong echoes of a ping asked; bounds work.
const MOST_ASKED: usize = 8;
/// Metres below the surface; found.
/// Sensor and structure are below the surface by this at least.
const LEAST_DEPTH_M: f32 = 0.1;
/// Metres; found.
/// An image is asked for so far behind its source at least, where the structure itself hardly sends echoes.
const ASKED_BEHIND_M: f32 = 0.3;
/// Metres, derived: beyond its pulse.
/// An image is told from its source so far behind it.
const TOLD_BEHIND_M: f32 = 0.15;
/// Metres, derived: errors of surface and source.
/// By how much an image may be off, metres: height of the surface and place of the source.
const TOLERANCE_M: f32 = 0.06;
/// Pings between questions; bounds work.
/// Pings between questions while no height is told, and between decisions.
const ASKING_STRIDE: u32 = 4;
/// Pings between decisions; bounds work.
const DECISION_STRIDE: u32 = 64;

/// A confident Gaussian that may have an image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Source {
    pub(crate) mean_m: Vec3,
    pub(crate) covariance_m2: SymmetricMat3,
    pub(crate) strength: f32,
}

/// What was asked of one height.
#[derive(Debug, Clone, Copy, Default)]
struct Tried {
    asked: f64,
    found: f64,
    /// Not asked, since the vehicle was above it.
    above: f64,
}

impl Tried {
    /// How likely an echo is heard again, by what was found and, before anything was, by evens.
    fn share(&self) -> f64 {
        (self.found + 1.0) / (self.asked + 2.0)
    }
}

/// Learns the height of the water's surface.
#[derive(Debug)]
pub(crate) struct Mirror {
    tried: Vec<Tried>,
    heard: u32,
    sources: Vec<Source>,
    height_m: Option<f32>,
}

impl Default for Mirror {
    fn default() -> Self {
        Self {
            tried: vec![Tried::default(); HEIGHTS],
            heard: 0,
            sources: Vec::new(),
            height_m: None,
        }
    }
}

impl Mirror {
    /// Height of the surface above the first ping, metres; `None` as long as none stands out.
    pub(crate) fn height_m(&self) -> Option<f32> {
        self.height_m
    }

    /// Forgets what was asked.
    pub(crate) fn begin_anew(&mut self) {
        self.tried.fill(Tried::default());
    }

    /// Whether it is time for [`Mirror::set_sources`].
    pub(crate) fn wants_sources(&self) -> bool {
        self.heard.is_multiple_of(DECISION_STRIDE)
    }

    /// The confident Gaussians in reach of the pings to come.
    pub(crate) fn set_sources(&mut self, sources: Vec<Source>) {
        self.sources = sources;
    }

    /// Learns from a ping that counts `weight`; all its echoes have to be in the profile.
    pub(crate) fn listen(
        &mut self,
        geometry: &PingGeometry,
        intensity: &[f32],
        profile: &Profile,
        strongest: f32,
        weight: f32,
    ) {
        self.heard = self.heard.wrapping_add(1);
        if self.heard.is_multiple_of(DECISION_STRIDE) {
            self.decide();
        }
        if !self.heard.is_multiple_of(ASKING_STRIDE) {
            return;
        }
        let thresholds = profile.thresholds(intensity.len());
        let mut peaks = profile.peaks(intensity, STRONG_FRACTION * strongest);
        peaks.retain(|&bin| intensity[bin] > LOSS * thresholds[bin]);
        if peaks.is_empty() {
            return;
        }
        let around = |bin: usize| bin.saturating_sub(1)..(bin + 2).min(intensity.len());
        let asked = peaks.iter().step_by(peaks.len() / MOST_ASKED + 1);
        let mut is_wanted = vec![false; intensity.len()];
        for &bin in asked.clone() {
            is_wanted[around(bin)].fill(true);
        }
        let loudest = self.loudest(geometry, &is_wanted);
        for &bin in asked {
            let around = &loudest[around(bin)];
            let source = around.iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0));
            if let Some(&(_, place_m)) = source {
                let is_image = |power: f32| power > thresholds[bin] && power < intensity[bin];
                self.ask(geometry, intensity, place_m, f64::from(weight), is_image);
            }
        }
    }

    /// The Gaussian whose echo should be the loudest of each bin that is wanted: its energy and place.
    fn loudest(&self, geometry: &PingGeometry, is_wanted: &[bool]) -> Vec<Option<(f32, Vec3)>> {
        let mut loudest = vec![None; is_wanted.len()];
        for source in &self.sources {
            let range_m = source.mean_m.distance(geometry.pose.position_m);
            let bin = bin_at(geometry, range_m).filter(|&bin| is_wanted.get(bin) == Some(&true));
            if let Some(bin) = bin
                && let Some(splat) = geometry.project(source.mean_m, &source.covariance_m2)
            {
                let energy = splat.energy * source.strength;
                if loudest[bin].is_none_or(|(most, _)| energy > most) {
                    loudest[bin] = Some((energy, source.mean_m));
                }
            }
        }
        loudest
    }

    fn ask(
        &mut self,
        geometry: &PingGeometry,
        intensity: &[f32],
        place_m: Vec3,
        weight: f64,
        is_image: impl Fn(f32) -> bool,
    ) {
        for (step, tried) in self.tried.iter_mut().enumerate() {
            if !is_below(geometry.pose.position_m, height_m(step)) {
                tried.above += weight;
                continue;
            }
            let images_m = images_m(geometry, place_m, height_m(step), ASKED_BEHIND_M);
            let Some(bin) = images_m.and_then(|[once_m, _]| bin_at(geometry, once_m)) else {
                continue;
            };
            // The higher the surface, the longer the way.
            let Some(three) = intensity.get(bin.saturating_sub(1)..=bin + 1) else {
                break;
            };
            tried.asked += weight;
            if is_image(greatest(three)) {
                tried.found += weight;
            }
        }
    }

    fn decide(&mut self) {
        let nats = |step: usize| {
            let tried = &self.tried[step];
            if tried.above > MOST_ABOVE * (tried.above + tried.asked) {
                return 0.0;
            }
            let beside = [step - BESIDE, step + BESIDE].map(|beside| self.tried[beside].share());
            let share = beside[0].max(beside[1]);
            let and = |of_rest: f64| share + of_rest * (1.0 - share);
            nats_over_chance(
                tried.asked,
                tried.found,
                and(CHANCE_SHARE),
                and(SURFACE_SHARE),
            )
        };
        let all = (BESIDE..HEIGHTS - BESIDE).map(|step| (step, nats(step)));
        let told = all
            .filter(|&(_, nats)| nats >= LEAST_NATS)
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(step, _)| step);
        self.height_m = told.map(height_m);
    }

    /// Bins of a ping in which images of confident Gaussians would be heard, louder than what is there.
    pub(crate) fn explained(&self, geometry: &PingGeometry, intensity: &[f32]) -> Vec<bool> {
        let mut explained = vec![false; intensity.len()];
        let Some(height_m) = self.height_m else {
            return explained;
        };
        let tolerance = (TOLERANCE_M / geometry.bin_length_m).ceil() as usize;
        for source in &self.sources {
            let Some(images_m) = images_m(geometry, source.mean_m, height_m, TOLD_BEHIND_M) else {
                continue;
            };
            if geometry
                .project(source.mean_m, &source.covariance_m2)
                .is_none()
            {
                continue;
            }
            let range_m = source.mean_m.distance(geometry.pose.position_m);
            let Some(bin) = bin_at(geometry, range_m) else {
                continue;
            };
            let near = bin.saturating_sub(1)..(bin + 2).min(intensity.len());
            let direct = greatest(intensity.get(near).unwrap_or_default());
            for image in images_m.into_iter().filter_map(|m| bin_at(geometry, m)) {
                let first = image.saturating_sub(tolerance);
                for at in first..(image + tolerance + 1).min(intensity.len()) {
                    explained[at] |= intensity[at] < direct;
                }
            }
        }
        explained
    }
}

fn height_m(step: usize) -> f32 {
    FIRST_M + STEP_M * step as f32
}

fn bin_at(geometry: &PingGeometry, range_m: f32) -> Option<usize> {
    let bin = (range_m - geometry.range_start_m) / geometry.bin_length_m;
    (bin >= 0.0).then_some(bin as usize)
}

/// Ranges at which a place is heard by way of a surface at this height, once and there and back, metres.
/// `None` where sensor or place is not below it, or its image less than `behind_m` behind it.
fn images_m(
    geometry: &PingGeometry,
    place_m: Vec3,
    height_m: f32,
    behind_m: f32,
) -> Option<[f32; 2]> {
    let sensor_m = geometry.pose.position_m;
    let image_m = Vec3::new(place_m.x, place_m.y, 2.0 * height_m - place_m.z);
    let (direct, twice) = (place_m.distance(sensor_m), image_m.distance(sensor_m));
    let once = 0.5 * (direct + twice);
    let are_below = is_below(sensor_m, height_m) && is_below(place_m, height_m);
    (are_below && once > direct + behind_m).then_some([once, twice])
}

fn is_below(place_m: Vec3, height_m: f32) -> bool {
    place_m.z < height_m - LEAST_DEPTH_M
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::heard::heard;

    const SURFACE_M: f32 = 2.5;

    /// One confident Gaussian, straight ahead at this range and height.
    fn source(range_m: f32, z_m: f32) -> Source {
        Source {
            mean_m: Vec3::new(range_m, 0.0, z_m),
            covariance_m2: SymmetricMat3::isotropic(0.02),
            strength: 1.0,
        }
    }

    fn place(ping: u32) -> Source {
        let fraction = f64::from(ping * 37 % 512) / 512.0;
        source(3.0 + 2.0 * fraction as f32, 0.3 * (fraction as f32 - 0.5))
    }

    /// Learnt from pings of one place each, and of another echo as `other` says for the place.
    fn learnt(pings: u32, other: impl Fn(Vec3) -> f64) -> Mirror {
        let mut mirror = Mirror::default();
        for ping in 0..pings {
            let place = place(ping);
            mirror.set_sources(vec![place]);
            let range_m = f64::from(place.mean_m.length());
            let echoes = [(range_m, 1e4), (other(place.mean_m), 1e3)];
            let (geometry, power, profile, strongest) = heard(0.0, &echoes);
            mirror.listen(&geometry, &power, &profile, strongest, 1.0);
        }
        mirror
    }

    fn image_m(place_m: Vec3) -> f64 {
        let image_m = Vec3::new(place_m.x, place_m.y, 2.0 * SURFACE_M - place_m.z);
        f64::from(0.5 * (place_m.length() + image_m.length()))
    }

    #[test]
    fn a_surface_is_told_by_its_images_to_a_step() {
        let height_m = learnt(2048, image_m).height_m();
        let error_m = height_m.map(|height_m| (height_m - SURFACE_M).abs());
        assert!(error_m.is_some_and(|m| m <= 0.08), "{height_m:?}");
    }

    #[test]
    fn few_echoes_tell_a_surface_and_very_few_do_not() {
        // Every fourth ping is asked.
        assert!(learnt(256, image_m).height_m().is_some());
        assert!(learnt(32, image_m).height_m().is_none());
    }

    #[test]
    fn a_structure_behind_is_no_surface() {
        assert_eq!(
            learnt(2048, |place_m| f64::from(place_m.length()) + 1.0).height_m(),
            None
        );
        assert_eq!(learnt(2048, |_| 6.0).height_m(), None);
    }

    #[test]
    fn what_is_louder_than_the_source_or_elsewhere_is_no_image() {
        let mut mirror = learnt(2048, image_m);
        let place = source(4.0, 0.1);
        mirror.set_sources(vec![place]);
        let (direct_m, image_m) = (f64::from(place.mean_m.length()), image_m(place.mean_m));
        let is_explained = |range_m: f64, power: f32| {
            let (geometry, intensity, ..) = heard(0.0, &[(direct_m, 1e4), (range_m, power)]);
            mirror.explained(&geometry, &intensity)[(range_m / 0.02) as usize]
        };
        assert!(is_explained(image_m, 1e3));
        assert!(!is_explained(image_m, 2e4) && !is_explained(image_m + 1.0, 1e3));
    }
}
