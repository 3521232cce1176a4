//! Judges maps while the next ones are made: on a thread of its own, whose time is not the
//! mapper's.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use anyhow::{Context, anyhow};
use crossbeam_channel::{Receiver, Sender, bounded};
use echosplat_evaluation::curve::{Curve, Sample};
use echosplat_evaluation::report::Picture;
use echosplat_evaluation::{MapPoints, Truth, evaluate, evaluate_raw};
use echosplat_simulator::{Dive, Scene};

use super::report::Results;
use crate::arguments::DemoArguments;
use crate::pipeline::{Observed, Outcome};
use crate::truth;

/// Maps that wait to be judged. More come only if judging is slower than a dive's samples allow;
/// then the mapper's thread waits, so that no sample is lost.
const QUEUE: usize = 256;

/// A thread that judges.
pub(super) struct Judge {
    observed: Sender<Observed>,
    thread: JoinHandle<Judged>,
    newest: Arc<Mutex<Option<Sample>>>,
}

/// What the thread leaves.
struct Judged {
    truth: Truth,
    samples: Vec<Sample>,
}

impl Judge {
    /// Finds out what the dive can have seen, and then waits for maps.
    pub(super) fn start(scene: &Arc<Scene>, dive: &Arc<Dive>) -> anyhow::Result<Self> {
        let (sender, receiver) = bounded(QUEUE);
        let newest = Arc::new(Mutex::new(None));
        let (scene, dive, shown) = (Arc::clone(scene), Arc::clone(dive), Arc::clone(&newest));
        let thread = std::thread::Builder::new()
            .name("judge".to_owned())
            .spawn(move || judge_all(truth::of_simulated(&scene, &dive), &receiver, &shown))
            .context("cannot start the judge's thread")?;
        Ok(Self {
            observed: sender,
            thread,
            newest,
        })
    }

    /// Where maps go.
    pub(super) fn intake(&self) -> Box<dyn FnMut(Observed) + Send> {
        let sender = self.observed.clone();
        Box::new(move |observed| {
            // The judge ends last.
            let _ = sender.send(observed);
        })
    }

    /// The newest sample.
    pub(super) fn newest(&self) -> Arc<Mutex<Option<Sample>>> {
        Arc::clone(&self.newest)
    }

    /// Waits for the last sample, and judges the final map by every measure.
    pub(super) fn finish(
        self,
        outcome: &Outcome,
        arguments: &DemoArguments,
    ) -> anyhow::Result<Results> {
        drop(self.observed);
        let judged = self
            .thread
            .join()
            .map_err(|_| anyhow!("the judge's thread panicked"))?;
        let points = MapPoints::from(&*outcome.snapshot);
        let metrics = evaluate(&points, &judged.truth);
        let mut curve = Curve::new("online", arguments.dive.seed);
        curve.samples = judged.samples;
        curve.samples.push(Sample {
            dive_s: outcome.status.report.dive_s,
            compute_s: outcome.status.report.work.compute_s,
            pair_count: outcome.status.report.work.pairs,
            voxel_looks: outcome.status.report.work.voxel_looks,
            ping_count: outcome.status.report.pings_mapped,
            metrics,
        });
        Ok(Results {
            title: format!("{}, {}", arguments.dive.scene, arguments.dive.dive),
            noise: arguments.dive.noise.to_string(),
            seed: arguments.dive.seed,
            picture: Picture::new(&points, &judged.truth),
            metrics,
            curve,
            summary: outcome.status.summary(),
        })
    }
}

fn judge_all(
    truth: Truth,
    observed: &Receiver<Observed>,
    newest: &Mutex<Option<Sample>>,
) -> Judged {
    let samples = observed
        .iter()
        .map(|observed| {
            let sample = Sample {
                dive_s: observed.moment.dive_s,
                compute_s: observed.moment.compute_s,
                pair_count: observed.moment.pairs,
                voxel_looks: observed.moment.voxel_looks,
                ping_count: observed.moment.pings,
                metrics: evaluate_raw(&MapPoints::from(&*observed.snapshot), &truth),
            };
            *newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(sample);
            sample
        })
        .collect();
    Judged { truth, samples }
}
