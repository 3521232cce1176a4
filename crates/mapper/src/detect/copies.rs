//! Echoes that are heard again: weaker, at a fixed distance behind their source.
//!
//! A plate on the vehicle or a joint in the cable sends every sound twice. Of two structures, one behind the other, the
//! far one is missing behind many echoes of the near one, and their distance along the beam changes as it turns; a copy is
//! behind all echoes that are strong enough for it to be heard, from wherever they come.
//!
//! Whether they come back at a distance is weighed by likelihood, against the share of echoes that have another at distances
//! beside.
//!
//! Deliberately absent: copies stronger than their source, and any nearer to it than 0.25 m.
//!
//! Cost: for each ping at most 24 strong bins × 305 distances × 10 levels.

use std::sync::LazyLock;

use echosplat_measurement::PingGeometry;
use echosplat_model::glam::DVec3;

use crate::detect::odds::{self, nats_over_chance};
use crate::detect::profile::{Profile, greatest};

/// Metres behind the source, grid.
/// Distances behind the source, metres, from the first in steps.
const FIRST_M: f32 = 0.2;
/// Metres, grid: a bin.
const STEP_M: f32 = 0.02;
/// Distances tried; grid.
const OFFSETS: usize = 305;
/// Steps, derived: longer than an echo.
/// A copy stands out from what is so many steps, 0.24 m, beside it, further than an echo is long, or from the nearest
/// distance that is tried.
const BESIDE: usize = 12;
/// Strengths tried; grid.
/// How much weaker a copy may be: 6 dB and more, in steps of 2 dB.
const LEVELS: usize = 10;
/// Fraction of strong echoes; assumed.
/// Beyond the share that has another at distances beside, structures at a like distance behind are heard of at most this
/// share of the rest.
const CHANCE_SHARE: f64 = 0.5;
/// Fraction, derived from two single looks.
/// Copies 6 dB weaker and more are heard of at least this share of the rest. Each has the speckle of a single look: so many
/// are weaker than their source by less than 12 dB.
const COPY_SHARE: f64 = 0.6;
/// Nats, assumed: echoes are half independent.
/// Log ratio of the likelihoods of a copy and of chance, from which on it is told: twice what independent echoes would need,
/// since beams in succession see the same structures.
const LEAST_NATS: f64 = 2.0 * odds::LEAST_NATS;
/// Metres, derived: three bins, twice.
/// The beams' directions are spread, so that structures would be heard at a distance for half of the time at most: behind a
/// surface by a distance d, a parallel one is heard at d/cos θ, and so within three bins, w = 0.06 m, of one distance over
/// θ = √(2 w/d). Of directions spread evenly over twice that the mean has the length 1 − 4 w/(3 d).
const SPREAD_M: f64 = 0.08;
/// Fraction, found: 15 dB.
/// A strong bin is within 15 dB of the strongest of late.
const STRONG_FRACTION: f32 = 0.03;
/// Strong bins of a ping asked; bounds work.
const MOST_ASKED: usize = 24;
/// Ratio over the threshold, derived: 5 dB for speckle.
/// A copy that would be heard is this many times above the threshold: 5 dB, for speckle.
const AUDIBLE: f32 = 3.0;
/// Fraction of expected power, derived: 6 dB of speckle.
/// One echo may be this fraction of the strength expected: 6 dB less.
const SPECKLE_FRACTION: f32 = 0.25;
/// Fraction, physics: reflection loses 6 dB.
/// A weak copy has at most this fraction of its source's power; a strong one, speckle above its level, may have all of it.
const MOST_FRACTION: f32 = 0.25;
/// Pings between decisions; bounds work.
const DECISION_STRIDE: u32 = 64;

static FRACTION_OF_LEVEL: LazyLock<[f32; LEVELS]> =
    LazyLock::new(|| std::array::from_fn(|level| 10f32.powf(-0.6 - 0.2 * level as f32)));

/// What was asked of one distance at one level, and where the beams pointed.
#[derive(Debug, Clone, Copy, Default)]
struct Tried {
    asked: f64,
    found: f64,
    /// Of their sources' powers that those found had, added up.
    fractions: f64,
    directions: DVec3,
}

impl Tried {
    fn share(&self) -> f64 {
        self.found / self.asked.max(1.0)
    }

    /// Length of the mean direction of the beams that were asked.
    fn aligned(&self) -> f64 {
        self.directions.length() / self.asked
    }
}

/// Learns how far behind their source echoes come back.
#[derive(Debug)]
pub(crate) struct Copies {
    tried: Vec<[Tried; LEVELS]>,
    heard: u32,
    told: Vec<Told>,
}

/// A distance at which echoes come back.
#[derive(Debug, Clone, Copy)]
struct Told {
    offset_m: f32,
    /// The most of its source's power that a copy has there.
    most: f32,
}

impl Default for Copies {
    fn default() -> Self {
        Self {
            tried: vec![[Tried::default(); LEVELS]; OFFSETS],
            heard: 0,
            told: Vec::new(),
        }
    }
}

impl Copies {
    /// Whether echoes come back at any distance.
    pub(crate) fn are_told(&self) -> bool {
        !self.told.is_empty()
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
        let weight = f64::from(weight);
        let direction = weight * geometry.pose.axes.x_axis.as_dvec3();
        let peaks = profile.peaks(intensity, STRONG_FRACTION * strongest);
        let thresholds = profile.thresholds(intensity.len());
        for &bin in peaks.iter().step_by(peaks.len() / MOST_ASKED + 1) {
            let source = intensity[bin];
            for (step, tried) in self.tried.iter_mut().enumerate() {
                let behind = (offset_m(step) / geometry.bin_length_m + 0.5) as usize;
                let Some(there) = intensity.get(bin + behind - 1..=bin + behind + 1) else {
                    break;
                };
                let heard = greatest(there);
                let could_hear =
                    |fraction: f32| fraction * source > AUDIBLE * thresholds[bin + behind];
                for (tried, &fraction) in tried.iter_mut().zip(&*FRACTION_OF_LEVEL) {
                    if !could_hear(fraction) {
                        break;
                    }
                    tried.asked += weight;
                    tried.directions += direction;
                    if heard > SPECKLE_FRACTION * fraction * source && heard < source {
                        tried.found += weight;
                        tried.fractions += weight * f64::from(heard / source);
                    }
                }
            }
        }
        self.heard = self.heard.wrapping_add(1);
        if self.heard.is_multiple_of(DECISION_STRIDE) {
            self.decide();
        }
    }

    fn decide(&mut self) {
        let steps = 1..OFFSETS - BESIDE;
        let told = steps.filter_map(|step| {
            let level = (0..LEVELS).find(|&level| self.is_told(step, level))?;
            let tried = &self.tried[step][level];
            let most = (tried.fractions / tried.found) as f32 / SPECKLE_FRACTION;
            Some(Told {
                offset_m: offset_m(step),
                most: most.clamp(MOST_FRACTION, 1.0),
            })
        });
        self.told = told.collect();
    }

    fn is_told(&self, step: usize, level: usize) -> bool {
        let here = self.tried[step][level];
        let share = |step: usize| self.tried[step][level].share();
        let (nearer, farther) = (step.saturating_sub(BESIDE), step + BESIDE);
        let beside = share(nearer).max(share(farther));
        let and = |of_rest: f64| beside + of_rest * (1.0 - beside);
        let nats = nats_over_chance(here.asked, here.found, and(CHANCE_SHARE), and(COPY_SHARE));
        nats >= LEAST_NATS
            && (nearer..=farther).all(|near| share(near) <= here.share())
            && here.aligned() <= most_aligned(step)
    }

    /// Whether the echo in a bin may be a copy of one before it.
    pub(crate) fn explain(
        &self,
        geometry: &PingGeometry,
        intensity: &[f32],
        blank: usize,
        bin: u32,
    ) -> bool {
        let tolerance = (STEP_M / geometry.bin_length_m).ceil() as usize + 1;
        let power = intensity[bin as usize];
        self.told.iter().any(|told| {
            let behind = (told.offset_m / geometry.bin_length_m).round() as usize;
            let Some(source) = (bin as usize).checked_sub(behind) else {
                return false;
            };
            let first = source.saturating_sub(tolerance).max(blank);
            let sources = intensity.get(first..=source + tolerance);
            power < told.most * greatest(sources.unwrap_or_default())
        })
    }
}

/// The most that the mean direction of beams may have for a length, where structures are told from copies at a distance.
fn most_aligned(step: usize) -> f64 {
    1.0 - SPREAD_M / f64::from(offset_m(step))
}

fn offset_m(step: usize) -> f32 {
    FIRST_M + STEP_M * step as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::heard::heard;

    /// Learnt from pings at headings up to `spread_deg` with an echo at 3 to 5 m and another, if any, as `other` says
    /// for the ping's number, the echo's range and the heading.
    fn learnt(spread_deg: f64, other: impl Fn(u32, f64, f64) -> Option<(f64, f32)>) -> Copies {
        learnt_from(640, 1.0, spread_deg, other)
    }

    fn learnt_from(
        pings: u32,
        weight: f32,
        spread_deg: f64,
        other: impl Fn(u32, f64, f64) -> Option<(f64, f32)>,
    ) -> Copies {
        let mut copies = Copies::default();
        for ping in 0..pings {
            let range_m = 3.0 + 2.0 * f64::from(ping * 37 % 512) / 512.0;
            let heading_deg = spread_deg * (f64::from(ping % 7) / 3.0 - 1.0);
            let mut echoes = vec![(range_m, 1e4)];
            echoes.extend(other(ping, range_m, heading_deg));
            let (geometry, power, profile, strongest) = heard(heading_deg, &echoes);
            copies.listen(&geometry, &power, &profile, strongest, weight);
        }
        copies
    }

    #[test]
    fn what_keeps_its_distance_behind_all_echoes_is_a_copy() {
        let copies = learnt(40.0, |_, range_m, _| Some((range_m + 1.3, 1e3)));
        assert!(copies.are_told());
        for Told { offset_m, most } in copies.told {
            assert!((offset_m - 1.3).abs() < 0.05, "{offset_m}");
            assert!((0.3..0.5).contains(&most), "{most}");
        }
    }

    #[test]
    fn what_is_missing_behind_half_of_the_echoes_is_none() {
        let copies = learnt(40.0, |ping, range_m, _| {
            ping.is_multiple_of(2).then_some((range_m + 1.3, 1e3))
        });
        assert!(!copies.are_told());
    }

    #[test]
    fn a_copy_is_told_after_tens_of_echoes_as_near_as_its_source_is_long() {
        for behind_m in [0.3, 0.5, 5.0] {
            let copy = |_, range_m, _| Some((range_m + behind_m, 1e3));
            assert!(learnt_from(64, 1.0, 70.0, copy).are_told(), "{behind_m}");
            assert!(!learnt_from(64, 0.1, 70.0, copy).are_told(), "{behind_m}");
        }
    }

    #[test]
    fn an_echo_as_long_as_the_distance_is_none() {
        let copies = learnt(70.0, |_, range_m, _| Some((range_m + 0.06, 5e3)));
        assert!(!copies.are_told());
    }

    #[test]
    fn a_parallel_surface_is_none_whether_seen_from_all_sides_or_from_one() {
        let parallel = |_, range_m: f64, heading_deg: f64| {
            Some((range_m + 1.3 / heading_deg.to_radians().cos(), 1e3))
        };
        for spread_deg in [40.0, 2.0] {
            assert!(!learnt(spread_deg, parallel).are_told());
        }
    }

    #[test]
    fn a_strong_copy_may_be_as_loud_as_its_source() {
        let copies = learnt(40.0, |_, range_m, _| Some((range_m + 1.3, 2.5e3)));
        assert!(copies.told.iter().any(|told| told.most >= 0.99));
        let copies = learnt(40.0, |_, range_m, _| Some((range_m + 1.3, 1e2)));
        assert!(copies.told.iter().all(|told| told.most == MOST_FRACTION));
        assert!(copies.are_told());
    }

    #[test]
    fn what_is_louder_than_a_copy_can_be_is_not_explained() {
        let copies = learnt(40.0, |_, range_m, _| Some((range_m + 1.3, 1e3)));
        let explained = |echo: (f64, f32)| {
            let (geometry, power, profile, _) = heard(0.0, &[(4.0, 1e4), echo]);
            copies.explain(
                &geometry,
                &power,
                profile.first_bin(),
                (echo.0 / 0.02) as u32,
            )
        };
        assert!(explained((5.3, 1e3)));
        assert!(!explained((5.3, 5e3)) && !explained((5.6, 1e3)));
    }
}
