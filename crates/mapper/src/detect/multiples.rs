//! Echoes that are heard again: weaker, at a fixed multiple of their range.
//!
//! Sound that goes to and fro more than once, or through the receiver in an unmeant way, draws every
//! strong echo a second time further out. A structure elsewhere keeps no fixed ratio to others as the
//! vehicle moves; what does is learnt from the dive, and such echoes say nothing of their place,
//! neither that something is there nor that nothing is.
//!
//! Deliberately absent: multiples stronger than a quarter of their source, and any within 25 % of its range. Two
//! parallel surfaces, the farther one weaker, passed at one distance for a whole dive look the same.
//!
//! Cost: for each ping at most 24 strong bins × 125 ratios.

use std::sync::LazyLock;

use echosplat_measurement::PingGeometry;

use crate::detect::profile::Profile;

/// Log ratio of ranges, grid.
/// Ratios of range, from the first in steps of 1 %.
const FIRST_LOG: f32 = 0.14;
/// Log ratio, grid: 1 %.
const STEP_LOG: f32 = 0.01;
/// Ratios tried; grid.
const RATIOS: usize = 125;
/// Steps either side; found.
/// A peak stands out from what is so many steps beside it.
const BESIDE: usize = 7;
/// Fraction of strong echoes; found.
/// Share of strong echoes with a weaker one at the ratio, and how many times that of ratios beside.
const LEAST_SHARE: f64 = 0.12;
/// Ratio of shares; found.
const LEAST_CONTRAST: f64 = 2.5;
/// Strong bins; found.
/// Independent strong bins before anything is told.
const LEAST_ASKED: f64 = 500.0;
/// Log of range; found.
/// Scatter of the logarithm of range over the strong bins that have a weaker one at the ratio: what
/// is passed at one range has one ratio to anything.
const LEAST_RANGE_SCATTER: f64 = 0.05;
/// Fraction, found: 15 dB.
/// A strong bin is within 15 dB of the strongest of late.
const STRONG_FRACTION: f32 = 0.03;
/// Strong bins of a ping asked; bounds work.
const MOST_ASKED: usize = 24;
/// Fraction, physics: reflection loses 6 dB.
/// A multiple has at most this fraction of its source's power.
const MOST_FRACTION: f32 = 0.25;
/// Pings between decisions; bounds work.
const DECISION_STRIDE: u32 = 64;
/// Fraction off its ratio, derived: a step, beside a bin.
/// A multiple may be this far from its ratio, and a bin.
const RATIO_TOLERANCE: f32 = 0.012;

static RATIO_OF_STEP: LazyLock<[f32; RATIOS]> =
    LazyLock::new(|| std::array::from_fn(|step| (FIRST_LOG + STEP_LOG * step as f32).exp()));

/// What was asked of one ratio. In f64: single precision stands still after some hours of strong bins.
#[derive(Debug, Clone, Copy, Default)]
struct Tried {
    asked: f64,
    found: f64,
    /// Sums over what was found of the logarithm of the source's range, and of its square.
    log_range: f64,
    log_range2: f64,
}

impl Tried {
    fn share(&self) -> f64 {
        self.found / self.asked.max(1.0)
    }

    fn range_scatter(&self) -> f64 {
        let mean = self.log_range / self.found;
        (self.log_range2 / self.found - mean * mean).max(0.0).sqrt()
    }
}

/// Learns at which ratios echoes come back.
#[derive(Debug)]
pub(crate) struct Multiples {
    tried: Vec<Tried>,
    heard: u32,
    ratios: Vec<f32>,
}

impl Default for Multiples {
    fn default() -> Self {
        Self {
            tried: vec![Tried::default(); RATIOS],
            heard: 0,
            ratios: Vec::new(),
        }
    }
}

impl Multiples {
    /// Ratios of range at which echoes come back, ascending; none as long as none stands out.
    pub(crate) fn ratios(&self) -> &[f32] {
        &self.ratios
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
        let mut is_echo = vec![false; intensity.len()];
        for &(start, end) in &profile.echoes {
            is_echo[start as usize..end as usize].fill(true);
        }
        let power = |bin: usize| {
            let three = &intensity[bin.saturating_sub(1)..(bin + 2).min(intensity.len())];
            three.iter().sum::<f32>() / three.len() as f32
        };
        let is_strong = |&bin: &usize| is_echo[bin] && power(bin) > STRONG_FRACTION * strongest;
        let strong: Vec<usize> = (profile.first_bin()..intensity.len())
            .filter(is_strong)
            .collect();
        for &bin in strong.iter().step_by(strong.len() / MOST_ASKED + 1) {
            let range_m = geometry.range_start_m + (bin as f32 + 0.5) * geometry.bin_length_m;
            let (log_range, source) = (f64::from(range_m).ln(), power(bin));
            for (tried, ratio) in self.tried.iter_mut().zip(&*RATIO_OF_STEP) {
                let at = (ratio * range_m - geometry.range_start_m) / geometry.bin_length_m;
                if at as usize >= intensity.len() {
                    break;
                }
                tried.asked += weight;
                if is_echo[at as usize] && power(at as usize) < MOST_FRACTION * source {
                    tried.found += weight;
                    tried.log_range += weight * log_range;
                    tried.log_range2 += weight * log_range * log_range;
                }
            }
        }
        self.heard = self.heard.wrapping_add(1);
        if self.heard.is_multiple_of(DECISION_STRIDE) {
            self.decide();
        }
    }

    fn decide(&mut self) {
        self.ratios.clear();
        for step in BESIDE..RATIOS - BESIDE {
            let (here, share) = (self.tried[step], self.tried[step].share());
            let beside = [step - BESIDE, step + BESIDE].map(|other| self.tried[other].share());
            let near = self.tried[step - BESIDE..=step + BESIDE].iter();
            let is_told = here.asked >= LEAST_ASKED
                && share >= LEAST_SHARE
                && share >= LEAST_CONTRAST * beside[0].max(beside[1])
                && near.fold(0.0, |most: f64, tried| most.max(tried.share())) <= share
                && here.range_scatter() >= LEAST_RANGE_SCATTER;
            if is_told {
                self.ratios.push(RATIO_OF_STEP[step]);
            }
        }
    }

    /// Whether the echo in a bin may be one before it heard again.
    pub(crate) fn explain(
        &self,
        geometry: &PingGeometry,
        intensity: &[f32],
        blank: usize,
        bin: u32,
    ) -> bool {
        let start = geometry.range_start_m / geometry.bin_length_m;
        let power = intensity[bin as usize];
        self.ratios.iter().any(|ratio| {
            let at = (start + bin as f32 + 0.5) / ratio;
            let near = at * (1.0 - RATIO_TOLERANCE) - start - 1.0;
            let far = at * (1.0 + RATIO_TOLERANCE) - start + 1.0;
            let first = (near.max(0.0) as usize).max(blank);
            let end = (far.max(0.0).ceil() as usize).min(bin as usize);
            let sources = intensity.get(first..end).unwrap_or_default();
            power < MOST_FRACTION * sources.iter().copied().fold(0.0, f32::max)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::heard::heard;

    /// Learnt from pings that see the first echo at 3 to 5 m and another as `other` says.
    fn learnt(other: impl Fn(f64) -> (f64, f32)) -> Multiples {
        let mut multiples = Multiples::default();
        for step in 0..512 {
            let range_m = 3.0 + 2.0 * f64::from(step * 37 % 512) / 512.0;
            let (geometry, power, profile, strongest) =
                heard(0.0, &[(range_m, 1e4), other(range_m)]);
            multiples.listen(&geometry, &power, &profile, strongest, 1.0);
        }
        multiples
    }

    #[test]
    fn what_keeps_its_ratio_is_told_and_doubted_and_what_is_stronger_is_not() {
        let multiples = learnt(|range_m| (1.7 * range_m, 1e3));
        let [ratio] = multiples.ratios() else {
            panic!("{:?}", multiples.ratios());
        };
        assert!((ratio / 1.7 - 1.0).abs() < 0.012, "{ratio}");
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
        let mut multiples = Multiples::default();
        let before = Tried {
            asked: 5e8,
            found: 5e7,
            log_range: 5e7,
            log_range2: 6e7,
        };
        multiples.tried[60] = before;
        let ratio = f64::from(RATIO_OF_STEP[60]);
        for _ in 0..4096 {
            let (geometry, power, profile, strongest) =
                heard(0.0, &[(4.0, 1e4), (4.0 * ratio, 1e3)]);
            multiples.listen(&geometry, &power, &profile, strongest, 1.0);
        }
        let after = multiples.tried[60];
        assert!(after.asked > before.asked + 4096.0 && after.found > before.found + 4096.0);
        assert_eq!(multiples.ratios(), [0.0; 0]);
    }

    #[test]
    fn what_keeps_its_distance_is_another_structure() {
        assert_eq!(learnt(|range_m| (range_m + 2.0, 1e3)).ratios(), [0.0; 0]);
    }

    #[test]
    fn what_is_passed_at_one_range_tells_nothing() {
        let mut multiples = Multiples::default();
        for _ in 0..1024 {
            let (geometry, power, profile, strongest) = heard(0.0, &[(4.0, 1e4), (6.0, 1e3)]);
            multiples.listen(&geometry, &power, &profile, strongest, 1.0);
        }
        assert_eq!(multiples.ratios(), [0.0; 0]);
    }
}
