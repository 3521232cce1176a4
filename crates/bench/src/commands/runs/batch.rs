//! Methods that take all pings at once: what they make of the first part of a dive, for some parts,
//! and of all of it.

use crate::baselines::Carving;
use crate::runs::{Method, Outcome, Spec, Work};
use anyhow::anyhow;
use echosplat_metrics::curve::Sample;
use echosplat_metrics::{MapPoints, Metrics, Truth, evaluate_raw};
use echosplat_model::PosedPing;
use echosplat_model::glam::DVec3;
use echosplat_paper::{Choices, ImageError, Images, PaperMethod, support};
use echosplat_prediction::held_out::HeldOut;
use echosplat_simulator::SimulatedSonar;
use rayon::prelude::*;

use super::{Clock, held_out};
use crate::fingerprint::Fingerprint;
use echosplat_service::config::Config;
use echosplat_service::{processor, truth};

/// Poses further apart than this are not interpolated across: the service's default.
const MAX_POSE_GAP_S: f64 = 0.5;

/// # Errors
/// If the method cannot work on such a dive.
pub(super) fn outcome(spec: &Spec, sonar: &SimulatedSonar) -> anyhow::Result<Outcome> {
    let trajectory = sonar.dive().trajectory(MAX_POSE_GAP_S);
    let count = (spec.share * sonar.dive().pings() as f64).round() as usize;
    let pings = (0..count).into_par_iter();
    let pings = pings.filter_map(|index| sonar.posed_ping(index, &trajectory));
    let bench = Bench {
        pings: pings.collect(),
        truth: truth::of_simulated(sonar.scene(), sonar.dive()),
    };
    processor::forget_peak_memory();
    let made = match spec.method {
        Method::Support => bench.parts(spec, supported)?,
        Method::Carving => bench.parts(spec, |pings| Ok(carved(pings)))?,
        Method::Paper => bench.epochs(spec, sonar)?,
        Method::Online => return Err(anyhow!("the mapper takes one ping after another")),
    };
    let (last, points) = made.last.ok_or_else(|| anyhow!("the dive has no pings"))?;
    let total = Work {
        compute_s: last.compute_s,
        pairs: last.pair_count,
        voxel_observations: last.voxel_observations,
    };
    Ok(Outcome {
        metrics: last.metrics,
        certainty: None,
        mid_dive_cd_m: f64::INFINITY,
        pings: last.ping_count,
        dive_s: last.dive_s,
        streamed: total,
        total,
        held_out: made.held_out,
        peak_memory_bytes: processor::peak_memory_bytes(),
        wall_s: 0.0,
        fingerprint: fingerprint(&points),
        samples: made.samples,
        met_budget: made.met_budget,
        left_out: Vec::new(),
        from_unmoved_m: None,
    })
}

/// What all parts or epochs came to.
#[derive(Default)]
struct Made {
    samples: Vec<Sample>,
    last: Option<(Sample, MapPoints)>,
    met_budget: bool,
    held_out: Option<HeldOut>,
}

impl Made {
    fn add(&mut self, sample: &Sample, points: MapPoints) {
        self.samples.push(*sample);
        self.last = Some((*sample, points));
    }
}

/// A map of some pings.
struct Map {
    points: MapPoints,
    voxel_observations: u64,
    /// Whether places found no room.
    is_cut: bool,
}

fn supported(pings: &[PosedPing]) -> anyhow::Result<Map> {
    match support(pings, &Choices::default()) {
        Ok(found) => Ok(Map {
            points: MapPoints::new(found.origin_m, &found.gaussians),
            voxel_observations: found.counts.arc_samples as u64,
            is_cut: found.counts.dropped_samples > 0,
        }),
        // Of nothing, nothing is known.
        Err(ImageError::Nothing { .. }) => Ok(Map {
            points: MapPoints::default(),
            voxel_observations: 0,
            is_cut: false,
        }),
        Err(error) => Err(error.into()),
    }
}

fn carved(pings: &[PosedPing]) -> Map {
    let carved = Carving::default().carve(pings);
    Map {
        points: MapPoints::of_positions(carved.positions_m),
        voxel_observations: carved.voxel_observations,
        is_cut: carved.dropped > 0,
    }
}

/// What methods work on and are judged by.
struct Bench {
    pings: Vec<PosedPing>,
    truth: Truth,
}

impl Bench {
    /// Maps of the first part of the pings, each made from nothing and timed by itself; the last
    /// is that of all of them.
    fn parts(
        &self,
        spec: &Spec,
        map: impl Fn(&[PosedPing]) -> anyhow::Result<Map>,
    ) -> anyhow::Result<Made> {
        let mut made = Made::default();
        for share in shares(spec) {
            let count = (share * self.pings.len() as f64).round() as usize;
            let view_at = |index: usize| self.pings.get(index).and_then(|p| p.ping.view());
            let count = whole_views(view_at, count);
            let (pings, mut clock) = (&self.pings[..count], Clock::start());
            let map = map(pings)?;
            clock.pause();
            made.met_budget |= map.is_cut;
            let sample = Sample {
                dive_s: self.dive_s(pings),
                compute_s: clock.compute_s,
                pair_count: 0,
                voxel_observations: map.voxel_observations,
                ping_count: count as u64,
                metrics: self.judge(&map.points),
            };
            made.add(&sample, map.points);
        }
        Ok(made)
    }

    /// The paper's method on all pings, after some of its epochs.
    fn epochs(&self, spec: &Spec, sonar: &SimulatedSonar) -> anyhow::Result<Made> {
        let choices = Choices::default();
        let judged: Vec<u32> = shares(spec)
            .into_iter()
            .map(|share| ((share * f64::from(choices.epochs)).round() as u32).max(1))
            .collect();
        let mut clock = Clock::start();
        let mut method = PaperMethod::new(Images::from_pings(&self.pings, &choices)?, choices);
        let voxel_observations = method.candidate_counts().arc_samples as u64;
        let mut made = Made::default();
        while !method.is_done() {
            let report = method.run_epoch();
            if !judged.contains(&report.epoch) {
                continue;
            }
            clock.pause();
            let points = MapPoints::new(method.images().origin_m, &method.gaussians());
            let sample = Sample {
                dive_s: self.dive_s(&self.pings),
                compute_s: clock.compute_s,
                pair_count: method.pair_count(),
                voxel_observations,
                ping_count: self.pings.len() as u64,
                metrics: self.judge(&points),
            };
            made.add(&sample, points);
            clock.go_on();
        }
        if spec.scores_held_out() {
            made.held_out = held_out::score(sonar, &method.snapshot(), &Config::default())?;
        }
        Ok(made)
    }

    fn judge(&self, points: &MapPoints) -> Metrics {
        evaluate_raw(points, &self.truth)
    }

    /// From the dive's first ping to the last of these.
    fn dive_s(&self, pings: &[PosedPing]) -> f64 {
        let times = self.pings.first().zip(pings.last());
        times.map_or(0.0, |(first, last)| {
            let begin = first.ping.transmit_time();
            last.ping.transmit_time().seconds_since(begin)
        })
    }
}

/// At most so many pings, without the last image if it is cut; `view_at` says which image a ping
/// belongs to.
fn whole_views(view_at: impl Fn(usize) -> Option<u32>, count: usize) -> usize {
    match view_at(count) {
        Some(cut) => (0..count)
            .rposition(|index| view_at(index) != Some(cut))
            .map_or(count, |last| last + 1),
        None => count,
    }
}

/// All of it where no moments are asked for.
fn shares(spec: &Spec) -> Vec<f64> {
    match spec.moments {
        0 => vec![1.0],
        _ => spec.moment_shares(),
    }
}

fn fingerprint(points: &MapPoints) -> String {
    use std::hash::Hasher;
    let mut bits = Fingerprint::default();
    for number in points.positions().iter().flat_map(DVec3::to_array) {
        bits.write(&number.to_bits().to_le_bytes());
    }
    bits.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_is_taken_whole_or_not_at_all() {
        let views = [Some(1), Some(1), Some(2), Some(2), Some(2)];
        let at = |index: usize| views.get(index).copied().flatten();
        let counts = [1, 2, 3, 4, 5].map(|count| whole_views(at, count));
        // Of the first image alone nothing would be left, so it stays cut.
        assert_eq!(counts, [1, 2, 2, 2, 5]);
        assert_eq!(whole_views(|_| None, 3), 3);
    }
}
