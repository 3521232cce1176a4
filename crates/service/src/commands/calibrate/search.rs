//! Where a parameter makes the dive most likely.

use std::collections::HashMap;

use serde::Serialize;

use super::trials::{Dive, Likelihoods, Trial};
use crate::arguments::Parameter;

/// Least likelihood gain that something has to have, standard errors.
pub(super) const TELLING_ERRORS: f64 = 4.0;
/// How often the search goes twice as far out, and how often in between.
const STEPS_OUT: usize = 3;
const STEPS_IN: usize = 2;
/// Runs of held-out pings that are left out in turn to see how sure a top is: neighbours are off together.
const BLOCKS: usize = 12;

/// What a dive says of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Verdict {
    /// As it is set.
    Fits,
    /// Another value makes the dive more likely.
    Off,
    /// Maps with other values are as likely.
    Open,
    /// Another value makes the pings of the search more likely, and others not.
    Unverified,
}

/// What was found of one parameter.
pub(super) struct Found {
    pub(super) best: Trial,
    pub(super) verdict: Verdict,
    /// One standard deviation of the best value; `None` where it is no top.
    pub(super) sigma: Option<f64>,
}

/// Looks further and further out until the best lies in between, and there more closely.
pub(super) fn search(dive: &Dive, parameter: Parameter, from: &Trial) -> anyhow::Result<Found> {
    let step = parameter.step();
    let at = |shift: f64| dive.trial(&parameter.shifted(&from.config, shift));
    let (below, above) = rayon::join(|| at(-step), || at(step));
    let mut tried = vec![(-step, below?), (0.0, from.clone()), (step, above?)];
    for _ in 0..STEPS_OUT {
        let outside = match best_of(&tried, from) {
            0 => 2.0 * tried[0].0,
            best if best + 1 == tried.len() => 2.0 * tried[best].0,
            _ => break,
        };
        insert(&mut tried, outside, at(outside)?);
    }
    for _ in 0..STEPS_IN {
        let best = best_of(&tried, from);
        if best == 0 || best + 1 == tried.len() {
            break;
        }
        let point = |index: usize| (tried[index].0, gain(&tried[index].1, from).0);
        let inside = vertex([point(best - 1), point(best), point(best + 1)]);
        insert(&mut tried, inside, at(inside)?);
    }
    let best_index = best_of(&tried, from);
    let best = &tried[best_index].1;
    let is_better = |a: &Trial, b: &Trial| {
        let (gain, error) = gain(a, b);
        gain > TELLING_ERRORS * error
    };
    let ends = [&tried[0].1, &tried[tried.len() - 1].1];
    let (best, verdict) = match () {
        () if is_better(best, from) => (best, Verdict::Off),
        () if ends.into_iter().all(|end| is_better(from, end)) => (from, Verdict::Fits),
        () => (from, Verdict::Open),
    };
    Ok(Found {
        best: best.clone(),
        verdict,
        sigma: sigma(&tried, best_index, from, 0.5 * step),
    })
}

/// Index of the most likely.
fn best_of(tried: &[(f64, Trial)], from: &Trial) -> usize {
    let gains = tried.iter().map(|(_, trial)| gain(trial, from).0);
    let best = gains.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
    best.map_or(0, |(index, _)| index)
}

fn insert(tried: &mut Vec<(f64, Trial)>, shift: f64, trial: Trial) {
    let at = tried.partition_point(|(other, _)| *other < shift);
    tried.insert(at, (shift, trial));
}

/// Likelihood gain of `trial` over `other` on held-out pings, nats per bin, with its standard error.
pub(super) fn gain(trial: &Trial, other: &Trial) -> (f64, f64) {
    gain_on(&trial.held_out, &other.held_out)
}

/// Mean gain and its standard error over the pings that both have.
pub(super) fn gain_on(now: &Likelihoods, before: &Likelihoods) -> (f64, f64) {
    let gains = gains(now, before);
    let count = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / count;
    let square = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>();
    (mean, (square / (count * (count - 1.0))).sqrt())
}

fn gains(now: &Likelihoods, before: &Likelihoods) -> Vec<f64> {
    let before: HashMap<u64, f64> = before.iter().copied().collect();
    let gains = now.iter();
    let gains = gains.filter_map(|(number, now)| before.get(number).map(|before| now - before));
    gains.collect()
}

/// Standard error of the top of the parabola through the best and those beside it that are at least `apart` from it, by
/// leaving out each block of pings in turn. Between nearer ones maps differ by chance.
fn sigma(tried: &[(f64, Trial)], best: usize, from: &Trial, apart: f64) -> Option<f64> {
    let is_apart = |(shift, _): &&(f64, Trial)| (shift - tried[best].0).abs() >= apart;
    let (below, above) = (&tried[..best], &tried[best + 1..]);
    let below = below.iter().rev().find(is_apart).or(below.first())?;
    let above = above.iter().find(is_apart).or(above.last())?;
    let tried = [below, &tried[best], above];
    let of_each: Vec<Vec<f64>> = tried
        .iter()
        .map(|(_, trial)| gains(&trial.held_out, &from.held_out))
        .collect();
    let count = of_each.iter().map(Vec::len).min()?;
    let top_without = |left_out: usize| {
        let is_in = |index: &usize| index * BLOCKS / count.max(1) != left_out;
        let sum = |gains: &[f64]| (0..count).filter(is_in).map(|i| gains[i]).sum::<f64>();
        top([0, 1, 2].map(|i| (tried[i].0, sum(&of_each[i]))))
    };
    let tops: Vec<f64> = (0..BLOCKS).map(top_without).collect::<Option<_>>()?;
    let count = BLOCKS as f64;
    let mean = tops.iter().sum::<f64>() / count;
    let square: f64 = tops.iter().map(|top| (top - mean).powi(2)).sum();
    let sigma = (square * (count - 1.0) / count).sqrt();
    sigma.is_finite().then_some(sigma)
}

/// Of a parabola through three points; `None` if it has none.
fn top([(x0, y0), (x1, y1), (x2, y2)]: [(f64, f64); 3]) -> Option<f64> {
    let (left, right) = ((x1 - x0) * (y1 - y2), (x1 - x2) * (y1 - y0));
    let top = x1 - 0.5 * ((x1 - x0) * left - (x1 - x2) * right) / (left - right);
    let is_high = (y1 - y0) * (x2 - x1) > (y2 - y1) * (x1 - x0);
    is_high.then_some(top)
}

/// Where a parabola through three points, the middle one the highest, is highest.
fn vertex(points: [(f64, f64); 3]) -> f64 {
    let [(x0, _), (x1, _), (x2, _)] = points;
    let is_inside = |top: &f64| *top > x0 && *top < x2 && (top - x1).abs() > 1e-3 * (x2 - x0);
    // Of what is flat or already known, the middle of the longer side.
    top(points)
        .filter(is_inside)
        .unwrap_or(match x1 - x0 > x2 - x1 {
            true => 0.5 * (x0 + x1),
            false => 0.5 * (x1 + x2),
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn a_parabola_is_highest_at_its_vertex() {
        let y = |x: f64| 3.0 - 2.0 * (x - 0.3).powi(2);
        let points = |x: [f64; 3]| x.map(|x| (x, y(x)));
        assert!((vertex(points([-1.0, 0.0, 2.0])) - 0.3).abs() < 1e-12);
        // Flat, and known already.
        assert!((vertex([(0.0, 1.0), (1.0, 1.0), (4.0, 1.0)]) - 2.5).abs() < 1e-12);
        assert!((vertex(points([0.0, 0.3, 0.4])) - 0.15).abs() < 1e-12);
    }

    fn trial(pings: &[(u64, f64)]) -> Trial {
        Trial {
            config: Config::default(),
            held_out: pings.to_vec(),
            verifying: Vec::new(),
        }
    }

    #[test]
    fn a_gain_counts_only_pings_that_both_have() {
        let before = trial(&[(1, 0.0), (2, 0.0), (3, 0.0)]);
        let after = trial(&[(2, 1.0), (3, 2.0), (4, 100.0)]);
        let (mean, error) = gain(&after, &before);
        assert!((mean - 1.5).abs() < 1e-12 && (error - 0.5).abs() < 1e-12);
    }

    #[test]
    fn pings_that_disagree_on_the_top_make_it_unsure() {
        let from = trial(&(0..120).map(|i| (i, 0.0)).collect::<Vec<_>>());
        let at = |shift: f64, apart: f64| {
            let own = |i: u64| {
                if (i / 10).is_multiple_of(2) {
                    apart
                } else {
                    -apart
                }
            };
            let likelihood = |i: u64| (i, -(shift - own(i)).powi(2));
            (shift, trial(&(0..120).map(likelihood).collect::<Vec<_>>()))
        };
        let sigma_of = |apart: f64| {
            let tried = [-1.0, 0.1, 1.0].map(|shift| at(shift, apart));
            sigma(&tried, 1, &from, 0.5).unwrap()
        };
        assert!(sigma_of(0.0) < 1e-9);
        let expected = 0.3 / (BLOCKS as f64).sqrt();
        assert!((sigma_of(0.3) - expected).abs() < 0.2 * expected);
        // One beside the best that is as good but for chance tells nothing.
        let mut tried = [-1.0, 0.1, 1.0].map(|shift| at(shift, 0.3)).to_vec();
        let by_chance = |&(i, likelihood): &(u64, f64)| (i, likelihood - 1e-3 * (i / 10) as f64);
        let beside = tried[1]
            .1
            .held_out
            .iter()
            .map(by_chance)
            .collect::<Vec<_>>();
        tried.insert(2, (0.101, trial(&beside)));
        let near = sigma(&tried, 1, &from, 0.5).unwrap();
        assert!((near - expected).abs() < 0.2 * expected, "{near}");
        let tried = [0.0, 1.0].map(|shift| at(shift, 0.0));
        assert_eq!(sigma(&tried, 0, &from, 0.5), None);
    }
}
