//! How good a map is without a truth: the likelihood of pings that were kept from it.
//!
//! Speckle of `L` looks makes a bin's intensity gamma distributed about its mean μ:
//! `p(I) = (L/μ)ᴸ I^{L−1} e^{−LI/μ} / Γ(L)`. The map predicts `μ = g·a + f`, `a` being what it renders,
//! against a constant μ. Gain `g`, floor `f`, the constant, and the number of looks of each predictor
//! are fitted on pings that the map was made of; held-out pings are only scored.
//!
//! The gain is no part of the measurement: it stands for what a published map does not say. A Gaussian
//! carries its strongest direction for all (`g` below 1), what was explained away is left out (above 1),
//! and pings are as the receiver gave them, not at the gain that the mapper refers them to.

use serde::{Deserialize, Serialize};

/// Half octaves of looks; grid.
/// Half steps from 1/16 of a look to 64.
const LOOKS_GRID: std::ops::RangeInclusive<i32> = -8..=12;
/// Steps; bounds work.
/// Steps of the fit of gain and floor; each is the multiplicative rule of gamma speckle.
const FIT_STEPS: usize = 100;
/// Share, derived: no receiver resolves zero.
/// Intensities below this share of the constant count as it: no receiver resolves zero, and its
/// logarithm would be all there is.
const LEAST_SHARE: f64 = 1e-4;

/// Whether the ping with this number is the last of its `every`, and so kept from a map that holds
/// every so many-th out; `every` 0 holds out none.
#[must_use]
pub fn is_held_out(sequence: u64, every: u64) -> bool {
    every > 0 && sequence % every == every - 1
}

/// Whether the ping with this number, one of the map's own, is one to fit gain and floor on: as many as
/// are held out, halfway between those.
#[must_use]
pub fn is_fitted_on(sequence: u64, every: u64) -> bool {
    !is_held_out(sequence, every) && sequence % every.max(1) == every.saturating_sub(1) / 2
}

/// One ping and what the map says of it, shape `[bins]` each, blanked bins left out, linear.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Pair {
    /// As measured.
    pub measured: Vec<f32>,
    /// As rendered, without noise.
    pub rendered: Vec<f32>,
}

/// How well one predictor does on the held-out pings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Number of looks of the gamma distribution, the most likely of a grid of half steps from 1/16 to
    /// 64.
    pub looks: f64,
    /// Mean logarithm of the density of a bin's intensity over the constant's level.
    pub log_likelihood_per_bin: f64,
    /// Mean absolute error per bin, in the pings' unit.
    pub l1: f64,
}

/// The map against a constant, on pings that neither has seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// Pings scored.
    pub ping_count: u64,
    /// Their bins outside the blanking.
    pub bin_count: u64,
    /// Pings of the map that gain, floor and constant were fitted on.
    pub fit_ping_count: u64,
    /// What the rendered map is multiplied by.
    pub gain: f64,
    /// Mean noise added to it, in the pings' unit.
    pub noise_floor: f64,
    /// The constant prediction, in the pings' unit.
    pub constant_level: f64,
    /// Of the map's prediction with the floor.
    pub map: Score,
    /// Of the constant.
    pub constant: Score,
    /// `map` minus `constant`, natural logarithm per bin: above 0 the map says something.
    pub gain_per_bin: f64,
}

impl HeldOut {
    /// What the map predicts where it renders `rendered`, noise included.
    #[must_use]
    pub fn predicted(&self, rendered: f32) -> f32 {
        (self.gain * f64::from(rendered) + self.noise_floor) as f32
    }

    /// Mean logarithm of the density of one ping's bins, of intensity over the constant's level; not
    /// a number without bins.
    #[must_use]
    pub fn log_likelihood_per_bin(&self, pair: &Pair) -> f64 {
        let predict = |rendered: f64| self.gain * rendered + self.noise_floor;
        let sums = Sums::of(std::slice::from_ref(pair), self.constant_level, predict);
        sums.log_likelihood(self.map.looks) / sums.count
    }
}

/// Fits on `fit` and scores `held`; `None` if either holds no bin, or nothing was ever heard.
#[must_use]
pub fn score(fit: &[Pair], held: &[Pair]) -> Option<HeldOut> {
    let constant_level = mean(bins(fit).map(|(measured, _)| measured))?;
    bins(held).next()?;
    if !(constant_level > 0.0) {
        return None;
    }
    let (gain, noise_floor) = fit_gain_and_floor(fit, constant_level);
    let by_map = |rendered: f64| gain * rendered + noise_floor;
    let by_constant = |_| constant_level;
    let map = score_one(fit, held, constant_level, by_map);
    let constant = score_one(fit, held, constant_level, by_constant);
    Some(HeldOut {
        ping_count: held.len() as u64,
        bin_count: bins(held).count() as u64,
        fit_ping_count: fit.len() as u64,
        gain,
        noise_floor,
        constant_level,
        map,
        constant,
        gain_per_bin: map.log_likelihood_per_bin - constant.log_likelihood_per_bin,
    })
}

/// Measured and rendered of every bin.
fn bins(pairs: &[Pair]) -> impl Iterator<Item = (f64, f64)> {
    pairs.iter().flat_map(|pair| {
        let both = pair.measured.iter().zip(&pair.rendered);
        both.map(|(&measured, &rendered)| (f64::from(measured), f64::from(rendered)))
    })
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0u64), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Maximum likelihood whatever the number of looks: each of the two is multiplied by
/// `√(Σ A I/μ² / Σ A/μ)`, `A` being what it is multiplied with.
fn fit_gain_and_floor(fit: &[Pair], level: f64) -> (f64, f64) {
    let rendered = mean(bins(fit).map(|(_, rendered)| rendered)).unwrap_or(0.0);
    if !(rendered > 0.0) {
        return (0.0, level);
    }
    let (mut gain, mut floor) = (0.5 * level / rendered, 0.5 * level);
    for _ in 0..FIT_STEPS {
        let mut sums = [[0.0; 2]; 2];
        for (measured, rendered) in bins(fit) {
            let predicted = gain * rendered + floor;
            let term = [measured / (predicted * predicted), 1.0 / predicted];
            for (sum, term) in sums.iter_mut().zip(term) {
                sum[0] += rendered * term;
                sum[1] += term;
            }
        }
        let [up, down] = sums;
        gain *= (up[0] / down[0]).sqrt();
        floor = (floor * (up[1] / down[1]).sqrt()).max(LEAST_SHARE * level);
    }
    (gain, floor)
}

fn score_one(
    fit: &[Pair],
    held: &[Pair],
    level: f64,
    predict: impl Fn(f64) -> f64 + Copy,
) -> Score {
    let of_fit = Sums::of(fit, level, predict);
    let of_held = Sums::of(held, level, predict);
    let grid = LOOKS_GRID.map(|half_steps| (0.5 * f64::from(half_steps)).exp2());
    let more_likely = |a: f64, b: f64| {
        let better = of_fit.log_likelihood(b) > of_fit.log_likelihood(a);
        if better { b } else { a }
    };
    let looks = grid.reduce(more_likely).unwrap_or(1.0);
    Score {
        looks,
        log_likelihood_per_bin: of_held.log_likelihood(looks) / of_held.count,
        l1: of_held.absolute / of_held.count,
    }
}

/// All that the likelihood of any number of looks needs; intensities over the constant's level.
#[derive(Default)]
struct Sums {
    count: f64,
    ln_measured: f64,
    ln_predicted: f64,
    ratio: f64,
    absolute: f64,
}

impl Sums {
    fn of(pairs: &[Pair], level: f64, predict: impl Fn(f64) -> f64) -> Self {
        let mut sums = Self::default();
        for (measured, rendered) in bins(pairs) {
            let predicted = predict(rendered);
            let heard = (measured / level).max(LEAST_SHARE);
            let expected = (predicted / level).max(LEAST_SHARE);
            sums.count += 1.0;
            sums.ln_measured += heard.ln();
            sums.ln_predicted += expected.ln();
            sums.ratio += heard / expected;
            sums.absolute += (measured - predicted).abs();
        }
        sums
    }

    /// `Σ ln p` at this number of `looks`.
    fn log_likelihood(&self, looks: f64) -> f64 {
        let shape = looks * looks.ln() - libm::lgamma(looks);
        let spread = self.ln_predicted + self.ratio;
        self.count * shape + (looks - 1.0) * self.ln_measured - looks * spread
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pings_to_fit_on_are_as_many_as_those_held_out_and_none_is_both() {
        for every in [1, 2, 5, 10] {
            let held = (0..100).filter(|&s| is_held_out(s, every)).count();
            let fit = (0..100).filter(|&s| is_fitted_on(s, every)).count();
            assert_eq!(held, 100 / every as usize);
            assert_eq!(fit, if every == 1 { 0 } else { held });
        }
    }

    /// Reproducible numbers in 0 to 1, never 0.
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        }

        /// Gamma of four looks with mean 1.
        fn speckle(&mut self) -> f64 {
            (0..4).map(|_| -0.25 * self.next().ln()).sum()
        }
    }

    fn pairs(count: usize, seed: u64, truth: impl Fn(f64) -> f64) -> Vec<Pair> {
        let mut numbers = Numbers(seed);
        let mut pair = |_| {
            let mut pair = Pair::default();
            for bin in 0..200 {
                let rendered = if bin % 20 == 3 {
                    2.0 * numbers.next()
                } else {
                    0.0
                };
                pair.rendered.push(rendered as f32);
                pair.measured
                    .push((truth(rendered) * numbers.speckle()) as f32);
            }
            pair
        };
        (0..count).map(&mut pair).collect()
    }

    #[test]
    fn every_so_many_th_ping_is_held_out_and_none_by_default() {
        let held = |every| (0..10).filter(move |i| is_held_out(*i, every));
        assert_eq!(held(0).count(), 0);
        assert!(held(4).eq([3, 7]));
    }

    #[test]
    fn the_gain_floor_and_looks_that_made_the_pings_are_found() {
        let truth = |rendered: f64| 3.0 * rendered + 0.01;
        let found = score(&pairs(100, 1, truth), &pairs(10, 2, truth)).unwrap();
        assert!((found.gain / 3.0 - 1.0).abs() < 0.1, "{found:?}");
        assert!((found.noise_floor / 0.01 - 1.0).abs() < 0.02, "{found:?}");
        assert!((found.map.looks - 4.0).abs() < 1e-9, "{found:?}");
        assert!(found.gain_per_bin > 1.0 && found.map.l1 < found.constant.l1);
        assert_eq!((found.ping_count, found.bin_count), (10, 2000));
    }

    #[test]
    fn a_map_of_nothing_is_no_better_than_a_constant() {
        let mut nothing = pairs(50, 1, |_| 0.5);
        nothing.iter_mut().for_each(|pair| pair.rendered.fill(0.0));
        let found = score(&nothing, &nothing).unwrap();
        assert!(found.gain_per_bin.abs() < 1e-9, "{found:?}");
        assert!(found.gain.abs() < 1e-300);
    }

    #[test]
    fn a_wrong_map_does_worse_than_the_true_one() {
        let truth = |rendered: f64| 3.0 * rendered + 0.01;
        let (fit, held) = (pairs(50, 1, truth), pairs(20, 2, truth));
        let shifted = |pairs: &[Pair]| -> Vec<Pair> {
            let mut shifted = pairs.to_vec();
            shifted
                .iter_mut()
                .for_each(|pair| pair.rendered.rotate_right(5));
            shifted
        };
        let right = score(&fit, &held).unwrap();
        let wrong = score(&shifted(&fit), &shifted(&held)).unwrap();
        assert!(wrong.gain_per_bin < 0.1 * right.gain_per_bin, "{wrong:?}");
    }

    #[test]
    fn zeros_and_nothing_are_bounded_and_refused() {
        let zero = [Pair {
            measured: vec![0.0, 1.0],
            rendered: vec![0.0, 1.0],
        }];
        let found = score(&zero, &zero).unwrap();
        assert!(found.map.log_likelihood_per_bin.is_finite());
        assert_eq!(score(&[], &zero), None);
        assert_eq!(score(&zero, &[]), None);
        let silent = [Pair {
            measured: vec![0.0],
            rendered: vec![0.0],
        }];
        assert_eq!(score(&silent, &silent), None);
    }
}
