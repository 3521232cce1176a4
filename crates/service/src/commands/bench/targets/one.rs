//! One run: the simulated dive through the service's own way from pings to the finished map, and
//! what that map is worth.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use anyhow::Context;
use echosplat_evaluation::targets::{Outcome, Spec, Work};
use echosplat_evaluation::{MapPoints, evaluate_raw};
use echosplat_model::{Ping, Pose, Snapshot, StampedPose};
use echosplat_pose::PoseSource;
use echosplat_simulator::{Dive, SimulatedSonar};
use rayon::prelude::*;

use super::held_out;
use crate::arguments::DiveArguments;
use crate::config::Config;
use crate::exit::{Finish, Usage};
use crate::fingerprint::Fingerprint;
use crate::pipeline::{Mapping, Observed, Observer, Patience, Poses};
use crate::{dives, logging, maps, processor, truth};

/// Pings made together.
const PIECE: usize = 256;

/// Makes the run that `spec` describes in JSON, and prints its outcome as a line of JSON.
///
/// # Errors
/// If there is no such dive, or it cannot be mapped.
pub(in crate::commands::bench) fn run_one(
    spec: &str,
    keep_map: Option<&Path>,
) -> anyhow::Result<Finish> {
    let spec: Spec =
        serde_json::from_str(spec).map_err(|error| Usage::error(format!("--run: {error}")))?;
    let outcome = outcome(&spec, keep_map)?;
    logging::print(&serde_json::to_string(&outcome)?);
    Ok(Finish::Done)
}

fn outcome(spec: &Spec, keep_map: Option<&Path>) -> anyhow::Result<Outcome> {
    let begin = Instant::now();
    let sonar = sonar(spec)?;
    let dive = sonar.dive();
    let config = config(spec, dive);
    let half_s = 0.5 * spec.share * dive.duration_s();
    let observed = Arc::new(Mutex::new(Vec::new()));
    let poses = placed(dive, &spec.placement.pose());
    let poses = Poses::new(&config.pose, poses, Patience::HoldBack, None)?;
    let mapping = Mapping::start(&config, poses, Some(every(half_s, &observed)))?;
    let count = (spec.share * dive.pings() as f64).round() as usize;
    for start in (0..count).step_by(PIECE) {
        for ping in pings(&sonar, start..(start + PIECE).min(count))? {
            mapping.take(ping)?;
        }
    }
    let (map, report) = mapping.finish()?;
    let peak_memory_bytes = processor::peak_memory_bytes();
    if let Some(path) = keep_map {
        maps::write(&map, path)?;
    }
    let truth = truth::of_simulated(sonar.scene(), dive);
    let back = spec.placement.pose().inverse();
    let judge = |map: &Snapshot| evaluate_raw(&MapPoints::from(map).moved(&back), &truth);
    let (total, before) = (report.work, report.before_finish);
    Ok(Outcome {
        metrics: judge(&map),
        mid_dive_cd_m: middle(&observed, half_s).map_or(f64::INFINITY, |map| judge(&map).cd_m),
        pings: report.pings_mapped,
        streamed: Work {
            compute_s: before.compute_s,
            pairs: before.pairs,
            voxel_looks: before.voxel_looks,
        },
        total: Work {
            compute_s: total.compute_s,
            pairs: total.pairs,
            voxel_looks: total.voxel_looks,
        },
        held_back: match spec.is_plain() {
            true => held_out::score(&sonar, &map, &config)?,
            false => None,
        },
        peak_memory_bytes,
        wall_s: begin.elapsed().as_secs_f64(),
        fingerprint: Fingerprint::of_map(&map).to_string(),
        from_unmoved_m: None,
    })
}

fn sonar(spec: &Spec) -> anyhow::Result<SimulatedSonar> {
    let dive = DiveArguments {
        scene: spec.scene.clone(),
        dive: spec.dive,
        noise: spec.noise,
        seed: spec.seed,
        pings_per_s: None,
    };
    dives::sonar(&dive, spec.duration_s)
}

/// The defaults. Maps for nobody to see are not made: when they would be is the clock's choice,
/// and they would be counted.
fn config(spec: &Spec, dive: &Dive) -> Config {
    let mut config = Config::default();
    config.mapper.threads = spec.threads;
    config.pose.time_offset_s = spec.time_offset_s;
    config.pipeline.snapshot_interval_s = 2.0 * dive.duration_s();
    config
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
    PoseSource::File(poses.into_iter())
}

fn pings(sonar: &SimulatedSonar, range: std::ops::Range<usize>) -> anyhow::Result<Vec<Arc<Ping>>> {
    let ping = |index| sonar.ping(index).to_ping().context("a simulated ping");
    range.into_par_iter().map(ping).collect()
}

type Maps = Mutex<Vec<Observed>>;

fn every(interval_s: f64, kept: &Arc<Maps>) -> Observer {
    let kept = Arc::clone(kept);
    Observer {
        interval_s,
        take: Box::new(move |observed| {
            let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
            kept.push(observed);
        }),
    }
}

/// The first live map from the middle of the dive on.
fn middle(kept: &Maps, half_s: f64) -> Option<Arc<Snapshot>> {
    let kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
    let found = kept
        .iter()
        .find(|observed| observed.moment.dive_s >= half_s);
    found.map(|observed| Arc::clone(&observed.snapshot))
}
