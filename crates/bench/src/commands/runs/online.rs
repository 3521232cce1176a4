//! The simulated dive through the service's own way from pings to the finished map, and what the
//! map is worth on the way and at the end.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use crate::runs::{LeftOut, Outcome, Placement, Spec, Work};
use anyhow::Context;
use echosplat_metrics::curve::Sample;
use echosplat_metrics::{MapPoints, Metrics, certainty, evaluate_raw};
use echosplat_model::{Ping, Pose, Snapshot, StampedPose};
use echosplat_pose::PoseSource;
use echosplat_simulator::{Dive, SimulatedSonar};
use rayon::prelude::*;

use super::held_out;
use crate::fingerprint::Fingerprint;
use echosplat_service::config::Config;
use echosplat_service::pipeline::{Mapping, Observed, Observer, Poses, Schedule, Spent};
use echosplat_service::{maps, processor, truth};

/// Pings made together.
const PIECE: usize = 256;
/// A finish that took this share of what it may has been thinned to keep to it.
const BUDGET_SHARE: f64 = 0.9;

/// # Errors
/// If a setting is wrong, or the dive cannot be mapped.
pub(super) fn outcome(
    spec: &Spec,
    sonar: &SimulatedSonar,
    keep_map: Option<&Path>,
) -> anyhow::Result<Outcome> {
    let dive = sonar.dive();
    let config = config(spec, dive)?;
    let times = Times::of(spec, dive);
    let observed = Arc::new(Mutex::new(Vec::new()));
    let poses = placed(dive, &spec.placement.pose());
    let poses = Poses::waited_for(&config, poses)?;
    let mapping = Mapping::start(&config, poses, Some(keeping(&times, &observed)))?;
    let count = (spec.share * dive.pings() as f64).round() as usize;
    for start in (0..count).step_by(PIECE) {
        for ping in pings(sonar, start..(start + PIECE).min(count))? {
            mapping.take(ping)?;
        }
    }
    let (map, report) = mapping.finish()?;
    let peak_memory_bytes = processor::peak_memory_bytes();
    if let Some(path) = keep_map {
        maps::write(&map, path, &maps::RunNotes::default())?;
    }
    let truth = truth::of_simulated(sonar.scene(), dive);
    let back = spec.placement.pose().inverse();
    let judge = |map: &Snapshot| evaluate_raw(&MapPoints::from(map).moved(&back), &truth);
    let kept = std::mem::take(&mut *observed.lock().unwrap_or_else(PoisonError::into_inner));
    let judged: Vec<Sample> = kept.iter().map(|map| sample(map, judge)).collect();
    let (total, streamed) = (work(&report.work), work(&report.before_finish));
    Ok(Outcome {
        metrics: judge(&map),
        certainty: match spec.placement == Placement::default() {
            true => certainty(map.origin_m, &map.gaussians, &truth),
            false => None,
        },
        mid_dive_cd_m: times.middle(&judged),
        pings: report.pings_mapped,
        dive_s: report.dive_s,
        streamed,
        total,
        held_out: match spec.scores_held_out() {
            true => held_out::score(sonar, &map, &config)?,
            false => None,
        },
        peak_memory_bytes,
        wall_s: 0.0,
        fingerprint: Fingerprint::of_map(&map).to_string(),
        samples: times.wanted(&judged),
        met_budget: met_budget(&streamed, &total, &config),
        left_out: report.left_out.iter().map(left_out).collect(),
        from_unmoved_m: None,
    })
}

fn met_budget(streamed: &Work, total: &Work, config: &Config) -> bool {
    let finish_pairs = total.pairs.saturating_sub(streamed.pairs);
    finish_pairs as f64 >= BUDGET_SHARE * config.mapper.workout_pairs as f64
}

fn left_out(said: &echosplat_mapper::LeftOut) -> LeftOut {
    LeftOut {
        feature: said.feature.to_owned(),
        why: said.why.clone(),
    }
}

fn work(spent: &Spent) -> Work {
    Work {
        compute_s: spent.compute_s,
        pairs: spent.pairs,
        voxel_observations: spent.voxel_observations,
    }
}

/// The defaults and the spec's settings. Maps for nobody to see are not made: when they would be
/// is the clock's choice, and they would be counted.
fn config(spec: &Spec, dive: &Dive) -> anyhow::Result<Config> {
    let mut config = Config::of_settings(&spec.settings)?;
    config.mapper.threads = spec.threads;
    config.pose.time_offset_s = spec.time_offset_s;
    config.pipeline.snapshot_interval_s = 2.0 * dive.duration_s();
    Ok(config)
}

/// All poses of the dive, moved and turned in the world.
fn placed(dive: &Dive, place: &Pose) -> PoseSource {
    let put = |pose: &StampedPose| StampedPose {
        world_from_vehicle: match *place == Pose::IDENTITY {
            true => pose.world_from_vehicle,
            false => *place * pose.world_from_vehicle,
        },
        ..*pose
    };
    let poses: Vec<StampedPose> = dive.reported_poses().iter().map(put).collect();
    PoseSource::File(poses.into())
}

fn pings(sonar: &SimulatedSonar, range: std::ops::Range<usize>) -> anyhow::Result<Vec<Arc<Ping>>> {
    let ping = |index| sonar.ping(index).to_ping().context("a simulated ping");
    range.into_par_iter().map(ping).collect()
}

/// When live maps are kept, seconds since the first ping.
struct Times {
    /// The middle of what is mapped.
    half_s: f64,
    /// Of the curve.
    moments_s: Vec<f64>,
}

impl Times {
    fn of(spec: &Spec, dive: &Dive) -> Self {
        let end_s = spec.share * dive.duration_s();
        // The end is the last ping's transmit, which may come a rounding early.
        let last_s = end_s - 1.5 * dive.ping_interval_s();
        let shares = spec.moment_shares().into_iter();
        Self {
            half_s: 0.5 * end_s,
            moments_s: shares.map(|share| (share * end_s).min(last_s)).collect(),
        }
    }

    fn schedule(&self) -> Schedule {
        let mut times_s = self.moments_s.clone();
        times_s.push(self.half_s);
        times_s.sort_by(f64::total_cmp);
        Schedule::At(times_s)
    }

    /// CD of the first live map from the middle of the dive on; infinite without one.
    fn middle(&self, judged: &[Sample]) -> f64 {
        let found = judged.iter().find(|sample| sample.dive_s >= self.half_s);
        found.map_or(f64::INFINITY, |sample| sample.metrics.cd_m)
    }

    /// The first map from each moment on.
    fn wanted(&self, judged: &[Sample]) -> Vec<Sample> {
        let at = |moment_s: &f64| judged.iter().find(|sample| sample.dive_s >= *moment_s);
        let found = self.moments_s.iter().filter_map(at);
        let mut samples: Vec<Sample> = found.copied().collect();
        samples.dedup_by(|a, b| a.ping_count == b.ping_count);
        samples
    }
}

fn sample(observed: &Observed, judge: impl Fn(&Snapshot) -> Metrics) -> Sample {
    let moment = observed.moment;
    Sample {
        dive_s: moment.dive_s,
        compute_s: moment.compute_s,
        pair_count: moment.pairs,
        voxel_observations: moment.voxel_observations,
        ping_count: moment.pings,
        metrics: judge(&observed.snapshot),
    }
}

fn keeping(times: &Times, kept: &Arc<Mutex<Vec<Observed>>>) -> Observer {
    let kept = Arc::clone(kept);
    Observer {
        schedule: times.schedule(),
        take: Box::new(move |observed| {
            let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
            kept.push(observed);
        }),
    }
}
