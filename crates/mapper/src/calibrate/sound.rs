//! The speed of sound under which pings are most likely.
//!
//! A map takes up an error of ranges in its landmarks, so that they tell little of it. How likely it makes pings that it was not
//! made of does tell: ranges that are wrong alike put the same structure elsewhere from each place it is seen from.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use super::parameters::{Estimate, PRIOR, RANGE};
use crate::classify::certainty::HALF_THICKNESS_M;

/// Log likelihoods of held-out pings, by block of time.
pub(crate) type Blocks = BTreeMap<u32, f64>;

/// Fraction, derived: a beam's width at 6 m.
/// From one speed of sound that is tried to the next, as a fraction of it: at 6 m what a beam of 0.8° is wide.
const STEP: f64 = 0.015;
/// Steps either way, physics of water.
/// Steps either way at most: fresh water near freezing has 1,402 m/s, warm salt water 1,560 m/s, and units reckon with 1,500.
const MOST_STEPS: i32 = 5;
/// Metres, derived: mean of rods up to 8 cm thick.
/// An echo comes from the near side of what it is taken for the middle of, and ranges that are a little short are as likely as a
/// faster sound. Rods and pipes are up to 8 cm thick, so this much, metres; one sigma is that of any thickness up to
/// there and 1.5 cm of a lever arm along the beam. Thicker piles are beyond it.
const NEARER_M: f64 = 0.5 * HALF_THICKNESS_M;
/// Metres, derived: thickness and lever arm.
const NEARER_SIGMA_M: f64 = 0.019;
/// Sigmas; found.
/// Another speed of sound is believed so many sigmas away.
const BELIEVED_SIGMAS: f64 = 4.0;

/// Fraction, measured on a fence and a frame.
/// What fraction of an error of ranges a dive's own map shows: it takes up the rest.
const SHOWN: f64 = 0.5;

/// Whether maps of their own would believe an error of ranges of which a dive's own map shows this much.
pub(crate) fn is_worth_asking((shown, _): (f64, f64), range_m: f64) -> bool {
    shown.abs() > SHOWN * BELIEVED_SIGMAS * NEARER_SIGMA_M / range_m
}

/// What a dive's own map tells, of what it shows and one sigma of it; never believed.
pub(crate) fn by_own_map((shown, sigma): (f64, f64)) -> Estimate {
    let top = Top {
        value: shown / SHOWN,
        own_sigma: sigma / SHOWN,
        common_sigma: 0.0,
    };
    top.told(false)
}

/// The top of a likelihood, as a fraction of the speed of sound, less 1.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Top {
    value: f64,
    /// One sigma of what pings tell.
    own_sigma: f64,
    /// One sigma of what no ping tells.
    common_sigma: f64,
}

impl Top {
    fn sigma(&self) -> f64 {
        self.own_sigma.hypot(self.common_sigma)
    }

    /// With what is known of water before any ping: a likelihood that is nearly level has its top anywhere.
    fn in_water(&self) -> (f64, f64) {
        let (told, prior) = (self.sigma().powi(2), PRIOR[RANGE].powi(2));
        let fraction = prior / (prior + told);
        (fraction * self.value, (fraction * told).sqrt())
    }

    /// Whether it is far enough off to be believed.
    pub(crate) fn is_off(&self) -> bool {
        let (value, sigma) = self.in_water();
        value.abs() > BELIEVED_SIGMAS * sigma
    }

    /// With one that other maps have: what they differ by is an error of both.
    pub(crate) fn and(self, other: Self) -> Self {
        let apart = (self.value - other.value).abs();
        Self {
            value: 0.5 * (self.value + other.value),
            own_sigma: self.own_sigma.max(other.own_sigma).hypot(apart),
            ..self
        }
    }

    /// As fractions of the speed of sound; believed at most if the likelihood is to be.
    pub(crate) fn told(self, is_likelihood: bool) -> Estimate {
        let (value, sigma) = self.in_water();
        Estimate {
            value,
            sigma,
            is_believed: is_likelihood && self.is_off(),
        }
    }
}

/// Looks for the speed of sound with the most of `of`, log likelihoods with ranges so many times as long, less 1, from the
/// configured one outwards until the best is between two others. `range_m` is the mean range of echoes.
///
/// `None` if pings do not tell, or only that it is further off than was tried.
pub(crate) fn most_likely(range_m: f64, mut of: impl FnMut(f64) -> Option<Blocks>) -> Option<Top> {
    let mut tried: BTreeMap<i32, Blocks> = BTreeMap::new();
    let mut middle = 0_i32;
    loop {
        for step in middle - 1..=middle + 1 {
            if let Entry::Vacant(untried) = tried.entry(step) {
                untried.insert(of(f64::from(step) * STEP)?);
            }
        }
        let all = |step: i32| tried[&step].values().sum::<f64>();
        let best = [middle - 1, middle + 1]
            .into_iter()
            .fold(
                middle,
                |best, step| {
                    if all(step) > all(best) { step } else { best }
                },
            );
        if best == middle {
            break;
        }
        if best.abs() >= MOST_STEPS {
            return None;
        }
        middle = best;
    }
    let [below, here, above] = [-1, 0, 1].map(|step| &tried[&(middle + step)]);
    let (offset, error) = vertex(below, here, above)?;
    let top = Top {
        value: STEP * (f64::from(middle) + offset) - NEARER_M / range_m,
        own_sigma: STEP * error,
        common_sigma: NEARER_SIGMA_M / range_m,
    };
    (top.value.is_finite() && top.sigma().is_finite()).then_some(top)
}

/// Where the parabola through three sums over blocks has its top, in steps from the middle, and its standard error by
/// leaving out each block in turn.
fn vertex(below: &Blocks, here: &Blocks, above: &Blocks) -> Option<(f64, f64)> {
    let blocks: Vec<[f64; 2]> = here
        .iter()
        .filter_map(|(block, here)| Some([below.get(block)? - here, above.get(block)? - here]))
        .collect();
    let top = |[below, above]: [f64; 2]| {
        let bend = -(below + above);
        (bend > 0.0).then(|| 0.5 * (above - below) / bend)
    };
    let all = blocks
        .iter()
        .fold([0.0; 2], |sum, b| [sum[0] + b[0], sum[1] + b[1]]);
    let without = blocks.iter().map(|b| top([all[0] - b[0], all[1] - b[1]]));
    let without: Vec<f64> = without.collect::<Option<_>>()?;
    let count = without.len() as f64;
    let mean = without.iter().sum::<f64>() / count;
    let square: f64 = without.iter().map(|top| (top - mean).powi(2)).sum();
    Some((top(all)?, (square * (count - 1.0) / count).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE_M: f64 = 6.0;

    /// Twelve blocks of a dive whose sound is faster by `truth`, each with its own error, and a common one of `map` by
    /// the number of steps.
    fn blocks(fraction: f64, truth: f64, map: impl Fn(i32) -> f64) -> Blocks {
        let block = |number: u32| {
            let own = truth + 1e-3 * (f64::from(number) - 5.5);
            let off = (fraction - own - NEARER_M / RANGE_M) / STEP;
            (
                number,
                -1000.0 * off * off + map((fraction / STEP).round() as i32),
            )
        };
        (0..12).map(block).collect()
    }

    fn found(truth: f64, map: impl Fn(i32) -> f64) -> Option<Top> {
        most_likely(RANGE_M, |fraction| Some(blocks(fraction, truth, &map)))
    }

    #[test]
    fn the_speed_of_sound_is_found_however_far_off_it_is_within_what_water_has() {
        for truth in [-0.06, -0.01, 0.0, 0.004, 0.02, 0.05] {
            let top = found(truth, |_| 0.0).unwrap();
            assert!((top.value - truth).abs() < 1e-6, "{truth}: {top:?}");
            // Blocks are off by 3.6 parts in a thousand each.
            assert!(
                (top.own_sigma - 3.6e-3 / 12f64.sqrt()).abs() < 1e-4,
                "{top:?}"
            );
            assert_eq!(top.told(true).is_believed, truth.abs() > 0.015, "{truth}");
        }
        assert!(found(0.2, |_| 0.0).is_none());
    }

    #[test]
    fn what_maps_of_other_pings_do_not_say_too_is_not_believed() {
        let good_by_chance = found(0.0, |step| 6e3 * f64::from(step)).unwrap();
        let other = found(0.0, |_| 0.0).unwrap();
        assert!(good_by_chance.is_off() && !other.is_off());
        assert!(good_by_chance.told(true).is_believed);
        assert!(!good_by_chance.told(false).is_believed);
        let both = good_by_chance.and(other).told(true);
        assert!(!both.is_believed && both.sigma > 0.015, "{both:?}");
    }

    #[test]
    fn a_top_that_is_hardly_told_is_what_water_has() {
        let vague = Top {
            value: 0.057,
            own_sigma: 0.013,
            common_sigma: 0.003,
        };
        assert!(!vague.is_off() && vague.value > BELIEVED_SIGMAS * vague.sigma());
        let told = vague.told(true);
        assert!((0.038..0.042).contains(&told.value), "{told:?}");
        assert!((0.010..0.012).contains(&told.sigma), "{told:?}");
        let sure = Top {
            own_sigma: 1e-4,
            common_sigma: 1e-4,
            ..vague
        };
        assert!((sure.told(true).value - 0.057).abs() < 1e-5);
    }

    #[test]
    fn maps_are_asked_of_what_they_would_believe() {
        let (small, large) = ((0.003, 1e-3), (-0.0075, 1e-3));
        assert!(!is_worth_asking(small, RANGE_M) && is_worth_asking(large, RANGE_M));
        let told = by_own_map(large);
        assert!(
            !told.is_believed && (told.value + 0.015).abs() < 3e-4,
            "{told:?}"
        );
        assert!((told.sigma - 2e-3).abs() < 1e-4, "{told:?}");
    }

    #[test]
    fn pings_that_are_as_likely_at_every_speed_tell_nothing() {
        let even = most_likely(RANGE_M, |_| Some(Blocks::from([(0, 1.0), (1, 2.0)])));
        assert!(even.is_none());
        assert!(most_likely(RANGE_M, |_| None).is_none());
    }
}
