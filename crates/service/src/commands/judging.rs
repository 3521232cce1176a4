//! Looks at maps while the next ones are made, and judges them where a truth is known: on a thread of its
//! own, whose time is not the mapper's, with a line for each as soon as it is judged.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use anyhow::{Context, anyhow};
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use echosplat_metrics::curve::{Curve, Sample};
use echosplat_metrics::{MapPoints, Metrics, Truth, distances_to_truth, evaluate, evaluate_raw};
use echosplat_model::{Snapshot, Standing};
use echosplat_report::{Picture, Trajectory, table};
use echosplat_web::Feed;

use crate::logging;
use crate::pipeline::{Observed, Observer, Outcome, Schedule, Way};

/// Time between two maps that are judged, on the dive's clock.
const JUDGED_EVERY_S: f64 = 10.0;
/// Maps that wait to be judged. The mapper never waits: more are left out and counted.
const QUEUE: usize = 64;

/// Most moments of which counts are kept; when they are full every other one goes.
const MAX_MOMENTS: usize = 4096;

/// A thread that judges.
pub(super) struct Judge {
    observed: Sender<Observed>,
    thread: JoinHandle<Judged>,
    newest: Arc<Mutex<Option<Sample>>>,
    left_out: Arc<AtomicU64>,
    way: Way,
    lines: bool,
}

/// How a truth is found out, on the judge's thread.
pub(super) type TruthOf = Box<dyn FnOnce() -> Truth + Send>;

/// What the thread leaves.
struct Judged {
    truth: Option<Truth>,
    samples: Vec<Sample>,
    growth: Vec<Growth>,
}

/// How much map there was at a moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Growth {
    pub(super) dive_s: f64,
    pub(super) compute_s: f64,
    pub(super) confident: usize,
    pub(super) ambiguous: usize,
}

/// What a run was worth.
pub(super) struct Verdict {
    pub(super) picture: Picture,
    pub(super) trajectory: Trajectory,
    pub(super) growth: Vec<Growth>,
    /// Where a truth is known.
    pub(super) against_truth: Option<AgainstTruth>,
}

/// How far a run's maps were from the truth.
pub(super) struct AgainstTruth {
    /// Of the final map.
    pub(super) metrics: Metrics,
    pub(super) curve: Curve,
    /// Of each of the final map's Gaussians, metres.
    pub(super) errors_m: Vec<f64>,
}

impl Judge {
    /// Finds out the truth, if there is one, and then waits for maps; `lines` says each that is judged on standard
    /// output, and a page draws them.
    pub(super) fn start(
        truth: Option<TruthOf>,
        lines: bool,
        page: Option<Feed>,
    ) -> anyhow::Result<Self> {
        let (sender, receiver) = bounded(QUEUE);
        let newest = Arc::new(Mutex::new(None));
        let shown = Arc::clone(&newest);
        let thread = std::thread::Builder::new()
            .name("judge".to_owned())
            .spawn(move || judge_all(truth, &receiver, &shown, lines, page.as_ref()))
            .context("cannot start the judge's thread")?;
        Ok(Self {
            observed: sender,
            thread,
            newest,
            left_out: Arc::default(),
            way: Way::default(),
            lines,
        })
    }

    /// Shows it maps as the dive goes on.
    pub(super) fn observer(&self) -> Observer {
        let (sender, left_out) = (self.observed.clone(), Arc::clone(&self.left_out));
        Observer {
            schedule: Schedule::Every(JUDGED_EVERY_S),
            take: Box::new(move |observed| {
                if let Err(TrySendError::Full(_)) = sender.try_send(observed) {
                    left_out.fetch_add(1, Ordering::Relaxed);
                }
            }),
        }
    }

    /// Where the run says where the sonar was.
    pub(super) fn way(&self) -> Way {
        Arc::clone(&self.way)
    }

    /// The newest sample.
    pub(super) fn newest(&self) -> Arc<Mutex<Option<Sample>>> {
        Arc::clone(&self.newest)
    }

    /// Waits for the last sample, and judges the final map by every measure.
    pub(super) fn finish(self, outcome: &Outcome, seed: u64) -> anyhow::Result<Verdict> {
        drop(self.observed);
        let judged = self
            .thread
            .join()
            .map_err(|_| anyhow!("the judge's thread panicked"))?;
        let left_out = self.left_out.load(Ordering::Relaxed);
        if left_out > 0 {
            tracing::warn!(left_out, "maps came faster than they could be judged");
        }
        let points = MapPoints::from(&*outcome.snapshot);
        let mut growth = judged.growth;
        let report = &outcome.status.report;
        growth.push(grown(
            &outcome.snapshot,
            report.dive_s,
            report.work.compute_s,
        ));
        let mut verdict = Verdict {
            picture: Picture::of_map(&points),
            trajectory: trajectory(&self.way),
            growth,
            against_truth: None,
        };
        let Some(truth) = judged.truth else {
            return Ok(verdict);
        };
        let metrics = evaluate(&points, &truth);
        let last = Sample {
            dive_s: report.dive_s,
            compute_s: report.work.compute_s,
            pair_count: report.work.pairs,
            voxel_observations: report.work.voxel_observations,
            ping_count: report.pings_mapped,
            metrics,
        };
        if self.lines {
            say(&last, judged.samples.is_empty());
        }
        let mut curve = Curve::new("online", seed);
        curve.samples = judged.samples;
        curve.samples.push(last);
        verdict.picture = Picture::new(&points, &truth);
        verdict.against_truth = Some(AgainstTruth {
            metrics,
            curve,
            errors_m: errors_m(&outcome.snapshot, &truth),
        });
        Ok(verdict)
    }
}

/// Of all Gaussians alike, in their order.
fn errors_m(snapshot: &Snapshot, truth: &Truth) -> Vec<f64> {
    let place = |mean: glam::Vec3| match mean.is_finite() {
        true => snapshot.origin_m + mean.as_dvec3(),
        false => snapshot.origin_m,
    };
    let places = snapshot.gaussians.iter().map(|g| place(g.mean_m));
    distances_to_truth(&MapPoints::of_positions(places).confident, truth)
}

fn trajectory(way: &Way) -> Trajectory {
    let way = way.lock().unwrap_or_else(PoisonError::into_inner);
    let points = way.points().iter();
    Trajectory(points.map(|point| (point.dive_s, point.place_m)).collect())
}

fn grown(map: &Snapshot, dive_s: f64, compute_s: f64) -> Growth {
    let is_asserted = |g: &&echosplat_model::Gaussian| g.standing == Standing::Confident;
    let confident = map.gaussians.iter().filter(is_asserted).count();
    Growth {
        dive_s,
        compute_s,
        confident,
        ambiguous: map.gaussians.len() - confident,
    }
}

fn judge_all(
    truth: Option<TruthOf>,
    observed: &Receiver<Observed>,
    newest: &Mutex<Option<Sample>>,
    lines: bool,
    page: Option<&Feed>,
) -> Judged {
    let mut judged = Judged {
        truth: truth.map(|truth| truth()),
        samples: Vec::new(),
        growth: Vec::new(),
    };
    for observed in observed {
        let moment = observed.moment;
        if judged.growth.len() == MAX_MOMENTS {
            let mut index = 0;
            judged.growth.retain(|_| {
                index += 1;
                index % 2 == 1
            });
        }
        let growth = grown(&observed.snapshot, moment.dive_s, moment.compute_s);
        judged.growth.push(growth);
        let Some(truth) = &judged.truth else { continue };
        let sample = Sample {
            dive_s: moment.dive_s,
            compute_s: moment.compute_s,
            pair_count: moment.pairs,
            voxel_observations: moment.voxel_observations,
            ping_count: moment.pings,
            metrics: evaluate_raw(&MapPoints::from(&*observed.snapshot), truth),
        };
        if lines {
            say(&sample, judged.samples.is_empty());
        }
        if let Some(page) = page {
            let (cd_m, hd_m) = (sample.metrics.cd_m, sample.metrics.hd_m);
            page.error(sample.dive_s, cd_m, hd_m);
        }
        *newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(sample);
        judged.samples.push(sample);
    }
    judged
}

/// A line of the table, the first with its head.
fn say(sample: &Sample, is_first: bool) {
    if is_first {
        logging::print(&format!("{}\n{}", table::CAPTION, table::header()));
    }
    logging::print(&table::row(sample));
}
