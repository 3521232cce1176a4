//! The dive mapped with one parameter shifted, and how likely that makes the pings kept from the map.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use echosplat_join::ArrivedPose;
use echosplat_mapper::{Calibration, Calibrator, Mapper, MapperConfig};
use echosplat_model::{Ping, PosedPing};
use echosplat_pose::PoseSource;
use echosplat_prediction::held_out::{Pair, score};
use echosplat_prediction::{MapRenderer, pair_of};
use serde::Serialize;

use crate::arguments::Parameter;
use crate::config::Config;
use crate::exit::Usage;
use crate::logs;
use crate::pipeline::Poses;
use crate::thinned::Thinned;

/// Most pings of a dive that are looked at.
const MOST_PINGS: usize = 6144;
/// One of so many is kept from the map, and one of the map's own is fitted on.
const HOLD_BACK: usize = 10;
/// Fewest held-out pings that say anything.
const LEAST_HELD: usize = 30;
/// Work of a finish, pairs: enough to rank maps.
const WORKOUT_PAIRS: u64 = 300_000_000;
/// Least likelihood gain that something has to have, standard errors.
const TELLING_ERRORS: f64 = 4.0;
/// How often the search goes twice as far out, and how often in between.
const STEPS_OUT: usize = 3;
const STEPS_IN: usize = 2;

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
}

/// A log in memory, thinned.
pub(super) struct Dive {
    pings: Vec<Arc<Ping>>,
    poses: Vec<ArrivedPose>,
    /// What becomes of a ping, by its number.
    roles: HashMap<u64, Role>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Mapped,
    /// Mapped, and the renderer's gain and floor are fitted on it.
    Fitted,
    HeldOut,
}

fn role(index: usize) -> Role {
    match index % HOLD_BACK {
        4 => Role::Fitted,
        9 => Role::HeldOut,
        _ => Role::Mapped,
    }
}

/// What a configuration makes of a dive.
#[derive(Debug, Clone)]
pub(super) struct Trial {
    pub(super) config: Config,
    /// Log likelihood per bin of each held-out ping, by its number.
    pings: Vec<(u64, f64)>,
}

/// What was found of one parameter.
pub(super) struct Found {
    pub(super) best: Trial,
    pub(super) verdict: Verdict,
}

impl Dive {
    pub(super) fn read(log: &Path, poses: Option<&Path>, config: &Config) -> anyhow::Result<Self> {
        let mut kept = Thinned::new(MOST_PINGS);
        logs::pings(log, config, |ping| kept.push(|| ping))?;
        let pings: Vec<Arc<Ping>> = kept.into_kept();
        let poses = logs::poses(log, poses)?;
        let roles = pings.iter().enumerate();
        let roles = roles.map(|(index, ping)| (ping.sequence(), role(index)));
        Ok(Self {
            roles: roles.collect(),
            poses,
            pings,
        })
    }

    fn posed(&self, config: &Config) -> anyhow::Result<Vec<PosedPing>> {
        let source = PoseSource::recorded(self.poses.clone());
        let mut poses = Poses::waited_for(config, source)?;
        let mut posed = Vec::new();
        for ping in &self.pings {
            poses.push(Arc::clone(ping), Instant::now());
            while let Some(joined) = poses.pop() {
                posed.push(joined.posed);
            }
        }
        poses.finish();
        while let Some(joined) = poses.pop() {
            posed.push(joined.posed);
        }
        Ok(posed)
    }

    pub(super) fn trial(&self, config: &Config) -> anyhow::Result<Trial> {
        let posed = self.posed(config)?;
        let role = |ping: &PosedPing| self.roles.get(&ping.ping.sequence()).copied();
        let of_role = |wanted: Role| posed.iter().filter(move |p| role(p) == Some(wanted));
        let mut mapper = Mapper::new(MapperConfig {
            threads: 1,
            workout_pairs: WORKOUT_PAIRS,
            parts: config.mapper.parts.for_comparison(),
            ..config.mapper.clone()
        })?;
        for ping in posed.iter().filter(|p| role(p) != Some(Role::HeldOut)) {
            mapper.insert(ping);
        }
        let map = mapper.finish();
        let mut renderer = MapRenderer::new(map.origin_m, map.intensity_unit, &map.gaussians, true);
        let mut pair = |ping: &PosedPing| pair_of(&mut renderer, ping, &config.mapper);
        let fit: Vec<Pair> = of_role(Role::Fitted).map(&mut pair).collect();
        let held: Vec<Pair> = of_role(Role::HeldOut).map(&mut pair).collect();
        let found = score(&fit, &held).filter(|found| found.ping_count >= LEAST_HELD as u64);
        let Some(found) = found else {
            return Err(Usage::error(format!(
                "of {} pings {} have a pose and can be held out; at least {LEAST_HELD} must, \
                 and something be heard",
                self.pings.len(),
                held.len()
            )));
        };
        let numbers = of_role(Role::HeldOut).map(|ping| ping.ping.sequence());
        let likelihoods = held.iter().map(|pair| found.log_likelihood_per_bin(pair));
        Ok(Trial {
            config: config.clone(),
            pings: numbers.zip(likelihoods).collect(),
        })
    }

    /// What the dive's own map and others beside it say of the rest, the speed of sound first.
    pub(super) fn landmarks(&self, config: &Config) -> anyhow::Result<Option<Calibration>> {
        let mut mapper = Mapper::new(config.mapper.clone())?;
        for ping in &self.posed(config)? {
            mapper.insert(ping);
        }
        let calibration = mapper.calibrator().map(Calibrator::run).transpose()?;
        Ok(calibration.flatten())
    }

    /// Looks further and further out until the best lies in between, and there more closely.
    pub(super) fn search(&self, parameter: Parameter, from: &Trial) -> anyhow::Result<Found> {
        let step = parameter.step();
        let at = |shift: f64| self.trial(&parameter.shifted(&from.config, shift));
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
        let best = &tried[best_of(&tried, from)].1;
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
        })
    }
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

/// Likelihood gain of `trial` over `other`, nats per bin, and the standard error of that over the
/// pings that both have.
fn gain(trial: &Trial, other: &Trial) -> (f64, f64) {
    let before: HashMap<u64, f64> = other.pings.iter().copied().collect();
    let gains = trial.pings.iter();
    let gains = gains.filter_map(|(number, now)| before.get(number).map(|before| now - before));
    let gains: Vec<f64> = gains.collect();
    let count = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / count;
    let square = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>();
    (mean, (square / (count * (count - 1.0))).sqrt())
}

/// Where a parabola through three points, the middle one the highest, is highest.
fn vertex([(x0, y0), (x1, y1), (x2, y2)]: [(f64, f64); 3]) -> f64 {
    let (left, right) = ((x1 - x0) * (y1 - y2), (x1 - x2) * (y1 - y0));
    let top = x1 - 0.5 * ((x1 - x0) * left - (x1 - x2) * right) / (left - right);
    let is_inside = top > x0 && top < x2 && (top - x1).abs() > 1e-3 * (x2 - x0);
    // Of what is flat or already known, the middle of the longer side.
    match is_inside {
        true => top,
        false if x1 - x0 > x2 - x1 => 0.5 * (x0 + x1),
        false => 0.5 * (x1 + x2),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_highest_at_its_vertex() {
        let y = |x: f64| 3.0 - 2.0 * (x - 0.3).powi(2);
        let points = |x: [f64; 3]| x.map(|x| (x, y(x)));
        assert!((vertex(points([-1.0, 0.0, 2.0])) - 0.3).abs() < 1e-12);
        // Flat, and known already.
        assert!((vertex([(0.0, 1.0), (1.0, 1.0), (4.0, 1.0)]) - 2.5).abs() < 1e-12);
        assert!((vertex(points([0.0, 0.3, 0.4])) - 0.15).abs() < 1e-12);
    }

    #[test]
    fn a_gain_counts_only_pings_that_both_have() {
        let trial = |pings: &[(u64, f64)]| Trial {
            config: Config::default(),
            pings: pings.to_vec(),
        };
        let before = trial(&[(1, 0.0), (2, 0.0), (3, 0.0)]);
        let after = trial(&[(2, 1.0), (3, 2.0), (4, 100.0)]);
        let (mean, error) = gain(&after, &before);
        assert!((mean - 1.5).abs() < 1e-12 && (error - 0.5).abs() < 1e-12);
    }

    #[test]
    fn held_out_and_fitted_pings_are_as_many() {
        let count = |wanted| (0..100).filter(|&index| role(index) == wanted).count();
        assert_eq!([count(Role::Fitted), count(Role::HeldOut)], [10, 10]);
    }
}
