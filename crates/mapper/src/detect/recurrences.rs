//! Echoes that are heard again: weaker, at a fixed distance behind their source or at a fixed multiple of its range.
//!
//! A plate on the vehicle or a joint in the cable sends every sound twice: a copy. Sound that goes to and fro once more, or
//! through the receiver in an unmeant way, draws an echo at a multiple of its range. Of two structures, one behind the other,
//! the far one is missing behind many echoes of the near one, and their distance along the beam, and the ratio of their
//! ranges, change as the vehicle moves; what comes back is behind all echoes that are strong enough, from wherever they come.
//!
//! Whether echoes come back at a distance or a ratio is weighed by likelihood, against the share of echoes that have another
//! at distances or ratios beside.
//!
//! Deliberately absent: what comes back stronger than its source, nearer to it than 0.25 m, or within 20 % of its range. Two
//! parallel surfaces, the farther one weaker, passed at one distance for a whole dive look the same.
//!
//! Cost: for each ping at most 24 strong bins × 305 distances and 125 ratios × 10 levels.

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
const DISTANCES: usize = 305;
/// Steps, derived: longer than an echo.
/// What comes back stands out from what is so many steps, 0.24 m, nearer and farther, further than an echo is long, or from
/// the nearest distance that is tried.
const DISTANCES_BESIDE: usize = 12;
/// Log ratio of ranges, grid.
/// Ratios of range, from the first in steps of 1 %.
const FIRST_LOG: f32 = 0.14;
/// Log ratio, grid: 1 %.
const STEP_LOG: f32 = 0.01;
/// Ratios tried; grid.
const RATIOS: usize = 125;
/// Steps either side; found.
/// A ratio stands out from what is so many steps beside it.
const RATIOS_BESIDE: usize = 7;
/// Strengths tried; grid.
/// How much weaker what comes back may be: 6 dB and more, in steps of 2 dB.
const LEVELS: usize = 10;
/// Fraction of strong echoes; assumed.
/// Beyond the share that has another at distances beside, structures at a like distance behind are heard of at most this
/// share of the rest.
const CHANCE_SHARE: f64 = 0.5;
/// Fraction, derived from two single looks.
/// Echoes that come back 6 dB weaker and more are heard of at least this share of the rest. Each has the speckle of a single
/// look: so many are weaker than their source by less than 12 dB.
const LEAST_SHARE: f64 = 0.6;
/// Nats, assumed: echoes are half independent.
/// Log ratio of the likelihoods of coming back and of chance, from which on it is told: twice what independent echoes would
/// need, since beams in succession see the same structures.
const LEAST_NATS: f64 = 2.0 * odds::LEAST_NATS;
/// Metres, derived: three bins, twice.
/// The beams' directions are spread, so that structures would be heard at a distance for half of the time at most: behind a
/// surface by a distance d, a parallel one is heard at d/cos θ, and so within three bins, w = 0.06 m, of one distance over
/// θ = √(2 w/d). Of directions spread evenly over twice that the mean has the length 1 − 4 w/(3 d).
const SPREAD_M: f64 = 0.08;
/// Log of range, derived: a step, twice.
/// The ranges are spread likewise: at a fixed distance behind a source at range r, a structure is heard within a step,
/// w = 0.01, of one ratio ρ over a part w ρ/(ρ − 1) of r either side. Ranges spread evenly over twice that scatter by
/// 4 w/√12 · ρ/(ρ − 1).
const RANGE_SCATTER: f64 = 0.0115;
/// Fraction, found: 15 dB.
/// A strong bin is within 15 dB of the strongest of late.
const STRONG_FRACTION: f32 = 0.03;
/// Strong bins of a ping asked; bounds work.
const MOST_ASKED: usize = 24;
/// Ratio over the threshold, derived: 5 dB for speckle.
/// What would be heard is this many times above the threshold: 5 dB, for speckle.
const AUDIBLE: f32 = 3.0;
/// Fraction of expected power, derived: 6 dB of speckle.
/// One echo may be this fraction of the strength expected: 6 dB less.
const SPECKLE_FRACTION: f32 = 0.25;
/// Fraction, physics: reflection loses 6 dB.
/// What comes back weakly has at most this fraction of its source's power; if it is strong, speckle above its level, it may
/// have all of it.
const MOST_FRACTION: f32 = 0.25;
/// Fraction off its ratio, derived: a step, beside a bin.
/// A multiple may be this far from its ratio, and a bin.
const RATIO_TOLERANCE: f32 = 0.012;
/// Pings between decisions; bounds work.
const DECISION_STRIDE: u32 = 64;

static FRACTION_OF_LEVEL: LazyLock<[f32; LEVELS]> =
    LazyLock::new(|| std::array::from_fn(|level| 10f32.powf(-0.6 - 0.2 * level as f32)));

/// Where an echo comes back.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    /// So many metres behind its source.
    Behind(f32),
    /// At so many times its range.
    Times(f32),
}

impl Place {
    /// Range at which an echo from this range comes back, metres.
    fn of(self, range_m: f32) -> f32 {
        match self {
            Place::Behind(distance_m) => range_m + distance_m,
            Place::Times(ratio) => range_m * ratio,
        }
    }

    /// Range of the source of what came back from this range, and by how much it may be off, metres.
    fn source(self, range_m: f32) -> (f32, f32) {
        match self {
            Place::Behind(distance_m) => (range_m - distance_m, STEP_M),
            Place::Times(ratio) => (range_m / ratio, RATIO_TOLERANCE * range_m / ratio),
        }
    }

    /// By how much what comes back from this range may be off what is tried, metres.
    fn half_step_m(self, range_m: f32) -> f32 {
        match self {
            Place::Behind(_) => 0.5 * STEP_M,
            Place::Times(_) => 0.5 * STEP_LOG * range_m,
        }
    }
}

/// What was asked of one place at one level, and where the beams pointed.
#[derive(Debug, Clone, Copy, Default)]
struct Tried {
    asked: f64,
    found: f64,
    /// Logarithms of the fractions of their sources' powers that those found had, added up.
    log_fractions: f64,
    directions: DVec3,
    /// Sums over what was found of the logarithm of the source's range, and of its square.
    log_range: f64,
    log_range2: f64,
}

impl Tried {
    fn share(&self) -> f64 {
        self.found / self.asked.max(1.0)
    }

    /// Length of the mean direction of the beams that were asked.
    fn aligned(&self) -> f64 {
        self.directions.length() / self.asked
    }

    fn range_scatter(&self) -> f64 {
        let mean = self.log_range / self.found;
        (self.log_range2 / self.found - mean * mean).max(0.0).sqrt()
    }
}

/// Learns where echoes come back.
#[derive(Debug)]
pub(crate) struct Recurrences {
    distances: Vec<[Tried; LEVELS]>,
    ratios: Vec<[Tried; LEVELS]>,
    heard: u32,
    told: Vec<Told>,
}

/// Where echoes come back.
#[derive(Debug, Clone, Copy)]
struct Told {
    place: Place,
    /// The most of its source's power that an echo has there.
    most: f32,
    /// By so many nats it is likelier than chance.
    nats: f64,
}

impl Default for Recurrences {
    fn default() -> Self {
        Self {
            distances: vec![[Tried::default(); LEVELS]; DISTANCES],
            ratios: vec![[Tried::default(); LEVELS]; RATIOS],
            heard: 0,
            told: Vec::new(),
        }
    }
}

impl Recurrences {
    /// Whether echoes come back anywhere.
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
        let peaks = profile.peaks(intensity, STRONG_FRACTION * strongest);
        let thresholds = &profile.thresholds(intensity.len());
        let heard = Heard {
            geometry,
            intensity,
            thresholds,
            weight: f64::from(weight),
        };
        for &bin in peaks.iter().step_by(peaks.len() / MOST_ASKED + 1) {
            heard.ask(bin, &mut self.distances, behind);
            heard.ask(bin, &mut self.ratios, times);
        }
        self.heard = self.heard.wrapping_add(1);
        if self.heard.is_multiple_of(DECISION_STRIDE) {
            self.decide();
        }
    }

    fn decide(&mut self) {
        let distances = (1..DISTANCES - DISTANCES_BESIDE).filter_map(|step| {
            let most_aligned = 1.0 - SPREAD_M / f64::from(FIRST_M + STEP_M * step as f32);
            let from = step.saturating_sub(DISTANCES_BESIDE);
            let near = &self.distances[from..=step + DISTANCES_BESIDE];
            told(behind(step), near, step - from, |tried| {
                tried.aligned() <= most_aligned
            })
        });
        let ratio = |step: usize| {
            let least_scatter = RANGE_SCATTER / (1.0 - 1.0 / f64::from(times(step).of(1.0)));
            let near = &self.ratios[step - RATIOS_BESIDE..=step + RATIOS_BESIDE];
            told(times(step), near, RATIOS_BESIDE, |tried| {
                tried.range_scatter() >= least_scatter
            })
        };
        let steps = RATIOS_BESIDE..RATIOS - RATIOS_BESIDE;
        let ratios: Vec<Option<Told>> = steps.map(ratio).collect();
        // A ratio is also heard a step beside it.
        let is_best = |&(step, told): &(usize, &Told)| {
            let near = step.saturating_sub(RATIOS_BESIDE)..(step + RATIOS_BESIDE).min(ratios.len());
            ratios[near]
                .iter()
                .flatten()
                .all(|near| near.nats <= told.nats)
        };
        let all = ratios.iter().enumerate();
        let ratios = all.filter_map(|(step, told)| Some((step, told.as_ref()?)));
        let ratios = ratios.filter(is_best).map(|(_, told)| *told);
        self.told = distances.chain(ratios).collect();
    }

    /// Whether the echo in a bin may be one before it heard again.
    pub(crate) fn explain(
        &self,
        geometry: &PingGeometry,
        intensity: &[f32],
        blank: usize,
        bin: u32,
    ) -> bool {
        let power = intensity[bin as usize];
        let range_m = geometry.range_start_m + (bin as f32 + 0.5) * geometry.bin_length_m;
        self.told.iter().any(|told| {
            let (source_m, off_m) = told.place.source(range_m);
            let at = |range_m: f32| (range_m - geometry.range_start_m) / geometry.bin_length_m;
            let first = (at(source_m - off_m) - 1.0).max(0.0) as usize;
            let end = (at(source_m + off_m) + 1.0).max(0.0).ceil() as usize;
            let sources = intensity.get(first.max(blank)..end.min(bin as usize));
            power < told.most * greatest(sources.unwrap_or_default())
        })
    }
}

fn behind(step: usize) -> Place {
    Place::Behind(FIRST_M + STEP_M * step as f32)
}

fn times(step: usize) -> Place {
    Place::Times((FIRST_LOG + STEP_LOG * step as f32).exp())
}

/// A ping, and what it counts.
struct Heard<'a> {
    geometry: &'a PingGeometry,
    intensity: &'a [f32],
    thresholds: &'a [f32],
    weight: f64,
}

impl Heard<'_> {
    /// Asks whether the echo in a bin is heard again in each place.
    fn ask(&self, bin: usize, tried: &mut [[Tried; LEVELS]], place: fn(usize) -> Place) {
        let Heard {
            geometry,
            intensity,
            ..
        } = *self;
        let source = intensity[bin];
        let range_m = geometry.range_start_m + (bin as f32 + 0.5) * geometry.bin_length_m;
        let direction = self.weight * geometry.pose.axes.x_axis.as_dvec3();
        let log_range = f64::from(range_m).ln();
        for (step, tried) in tried.iter_mut().enumerate() {
            let place = place(step);
            let again_m = place.of(range_m);
            let at = ((again_m - geometry.range_start_m) / geometry.bin_length_m) as usize;
            let reach = (place.half_step_m(again_m) / geometry.bin_length_m).round() as usize;
            let (first, end) = (at.saturating_sub(reach.max(1)), at + reach.max(1) + 1);
            let Some(there) = intensity.get(first.max(bin + 1)..end) else {
                break;
            };
            let heard = greatest(there);
            for (tried, &fraction) in tried.iter_mut().zip(&*FRACTION_OF_LEVEL) {
                if fraction * source <= AUDIBLE * self.thresholds[at] {
                    break;
                }
                tried.asked += self.weight;
                tried.directions += direction;
                if heard > SPECKLE_FRACTION * fraction * source && heard < source {
                    tried.found += self.weight;
                    tried.log_fractions += self.weight * f64::from(heard / source).ln();
                    tried.log_range += self.weight * log_range;
                    tried.log_range2 += self.weight * log_range * log_range;
                }
            }
        }
    }
}

/// What is told of a place, the `here`th of those `near` it, by the level at which it stands out most and is `spread`.
fn told(
    place: Place,
    near: &[[Tried; LEVELS]],
    here: usize,
    spread: impl Fn(&Tried) -> bool,
) -> Option<Told> {
    let nats = |level: usize| {
        let share = |tried: &[Tried; LEVELS]| tried[level].share();
        let tried = &near[here][level];
        let beside = share(&near[0]).max(share(&near[near.len() - 1]));
        let and = |of_rest: f64| beside + of_rest * (1.0 - beside);
        let (chance, least) = (and(CHANCE_SHARE), and(LEAST_SHARE));
        let nats = nats_over_chance(tried.asked, tried.found, chance, least);
        let is_told = nats >= LEAST_NATS
            && near.iter().all(|near| share(near) <= tried.share())
            && spread(tried);
        is_told.then_some((nats, tried))
    };
    let levels = (0..LEVELS).filter_map(nats);
    let (nats, tried) = levels.max_by(|a, b| a.0.total_cmp(&b.0))?;
    // Speckle of a single look in both: the logarithm of their ratio is as often above as below that of their strengths.
    let most = (tried.log_fractions / tried.found).exp() as f32 / SPECKLE_FRACTION;
    Some(Told {
        place,
        most: most.clamp(MOST_FRACTION, 1.0),
        nats,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::heard::heard;

    /// Learnt from pings at headings up to `spread_deg` with an echo at 3 to 5 m and another, if any, as `other` says
    /// for the ping's number, the echo's range and the heading.
    fn learnt(spread_deg: f64, other: impl Fn(u32, f64, f64) -> Option<(f64, f32)>) -> Recurrences {
        learnt_from(640, 1.0, spread_deg, other)
    }

    fn learnt_from(
        pings: u32,
        weight: f32,
        spread_deg: f64,
        other: impl Fn(u32, f64, f64) -> Option<(f64, f32)>,
    ) -> Recurrences {
        let mut copies = Recurrences::default();
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
        for Told { place, most, .. } in copies.told {
            let Place::Behind(offset_m) = place else {
                panic!("{place:?}");
            };
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

    #[test]
    fn what_keeps_its_ratio_is_told_and_doubted_and_what_is_stronger_is_not() {
        for ratio in [1.3, 1.7, 2.0, 2.3] {
            let multiples = learnt(2.0, |_, range_m, _| Some((ratio * range_m, 1e3)));
            let [Told { place, .. }] = *multiples.told else {
                panic!("{ratio}: {:?}", multiples.told);
            };
            assert!(
                (place.of(1.0) / ratio as f32 - 1.0).abs() < 0.012,
                "{place:?}"
            );
        }
        let multiples = learnt(2.0, |_, range_m, _| Some((1.7 * range_m, 1e3)));
        let explained = |echoes: &[(f64, f32)], bins: std::ops::Range<u32>| {
            let (geometry, power, profile, _) = heard(0.0, echoes);
            let explain = |bin| multiples.explain(&geometry, &power, profile.first_bin(), bin);
            bins.filter(|&bin| explain(bin)).collect::<Vec<u32>>()
        };
        let echoes = [(4.0, 1e4), (6.0, 1e3), (6.8, 1e3)];
        assert_eq!(explained(&echoes, 299..302), []);
        assert_eq!(explained(&echoes, 339..342), [339, 340, 341]);
        assert_eq!(explained(&[(4.0, 1e4), (6.8, 8e3)], 339..342), []);
    }

    #[test]
    fn a_long_dive_does_not_make_a_ratio_of_chance() {
        let mut multiples = Recurrences::default();
        let before = Tried {
            asked: 5e8,
            found: 5e7,
            log_range: 5e7,
            log_range2: 6e7,
            ..Tried::default()
        };
        multiples.ratios[60] = [before; LEVELS];
        let ratio = f64::from(times(60).of(1.0));
        for _ in 0..4096 {
            let (geometry, power, profile, strongest) =
                heard(0.0, &[(4.0, 1e4), (4.0 * ratio, 1e3)]);
            multiples.listen(&geometry, &power, &profile, strongest, 1.0);
        }
        let after = multiples.ratios[60][0];
        assert!(after.asked > before.asked + 4096.0 && after.found > before.found + 4096.0);
        assert!(!multiples.are_told());
    }

    #[test]
    fn what_is_passed_at_one_range_tells_no_ratio() {
        let mut multiples = Recurrences::default();
        for _ in 0..1024 {
            let (geometry, power, profile, strongest) = heard(0.0, &[(4.0, 1e4), (6.0, 1e3)]);
            multiples.listen(&geometry, &power, &profile, strongest, 1.0);
        }
        assert!(!multiples.are_told());
    }
}
