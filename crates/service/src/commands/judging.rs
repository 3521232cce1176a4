//! Judges maps while the next ones are made: on a thread of its own, whose time is not the
//! mapper's, with a line for each as soon as it is judged.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use anyhow::{Context, anyhow};
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use echosplat_metrics::curve::{Curve, Sample};
use echosplat_metrics::{MapPoints, Metrics, Truth, evaluate, evaluate_raw};
use echosplat_report::table;
use echosplat_report::{Picture, Section, Table};
use echosplat_web::Feed;
use serde_json::Value;

use crate::logging;
use crate::pipeline::{Observed, Observer, Outcome, Schedule};

/// Time between two maps that are judged, on the dive's clock.
const JUDGED_EVERY_S: f64 = 10.0;
/// Maps that wait to be judged. The mapper never waits: more are left out and counted.
const QUEUE: usize = 64;

/// A thread that judges.
pub(super) struct Judge {
    observed: Sender<Observed>,
    thread: JoinHandle<Judged>,
    newest: Arc<Mutex<Option<Sample>>>,
    left_out: Arc<AtomicU64>,
    lines: bool,
}

/// What the thread leaves.
struct Judged {
    truth: Truth,
    samples: Vec<Sample>,
}

/// What a run was worth.
pub(super) struct Verdict {
    pub(super) picture: Picture,
    pub(super) metrics: Metrics,
    pub(super) curve: Curve,
}

impl Judge {
    /// Finds out the truth, and then waits for maps; `lines` says each on standard output, and a page
    /// draws them.
    pub(super) fn start(
        truth: impl FnOnce() -> Truth + Send + 'static,
        lines: bool,
        page: Option<Feed>,
    ) -> anyhow::Result<Self> {
        let (sender, receiver) = bounded(QUEUE);
        let newest = Arc::new(Mutex::new(None));
        let shown = Arc::clone(&newest);
        let thread = std::thread::Builder::new()
            .name("judge".to_owned())
            .spawn(move || judge_all(truth(), &receiver, &shown, lines, page.as_ref()))
            .context("cannot start the judge's thread")?;
        Ok(Self {
            observed: sender,
            thread,
            newest,
            left_out: Arc::default(),
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
        let metrics = evaluate(&points, &judged.truth);
        let report = &outcome.status.report;
        let last = Sample {
            dive_s: report.dive_s,
            compute_s: report.work.compute_s,
            pair_count: report.work.pairs,
            voxel_looks: report.work.voxel_looks,
            ping_count: report.pings_mapped,
            metrics,
        };
        if self.lines {
            say(&last, judged.samples.is_empty());
        }
        let mut curve = Curve::new("online", seed);
        curve.samples = judged.samples;
        curve.samples.push(last);
        Ok(Verdict {
            picture: Picture::new(&points, &judged.truth),
            metrics,
            curve,
        })
    }
}

impl Verdict {
    /// Curves, figures, picture and what the run took, `summary` as `--json` has it.
    pub(super) fn section(&self, title: String, text: String, summary: &Value) -> Section {
        Section {
            title,
            text,
            curves: vec![self.curve.clone()],
            metrics: Some(self.metrics),
            picture: Some(self.picture.clone()),
            tables: vec![run_table(summary)],
            ..Section::default()
        }
    }

    /// Figures worth reading first.
    pub(super) fn highlights(&self) -> Vec<(String, String)> {
        let metrics = &self.metrics;
        let figure = |name: &str, value: String| (name.to_owned(), value);
        vec![
            figure("Chamfer distance", table::metres(metrics.cd_m) + " m"),
            figure("Hausdorff distance", table::metres(metrics.hd_m) + " m"),
            figure("Gaussians", metrics.confident_count.to_string()),
        ]
    }
}

fn judge_all(
    truth: Truth,
    observed: &Receiver<Observed>,
    newest: &Mutex<Option<Sample>>,
    lines: bool,
    page: Option<&Feed>,
) -> Judged {
    let mut samples = Vec::new();
    for observed in observed {
        let sample = Sample {
            dive_s: observed.moment.dive_s,
            compute_s: observed.moment.compute_s,
            pair_count: observed.moment.pairs,
            voxel_looks: observed.moment.voxel_looks,
            ping_count: observed.moment.pings,
            metrics: evaluate_raw(&MapPoints::from(&*observed.snapshot), &truth),
        };
        if lines {
            say(&sample, samples.is_empty());
        }
        if let Some(page) = page {
            let (cd_m, hd_m) = (sample.metrics.cd_m, sample.metrics.hd_m);
            page.error(sample.dive_s, cd_m, hd_m);
        }
        *newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(sample);
        samples.push(sample);
    }
    Judged { truth, samples }
}

/// A line of the table, the first with its head.
fn say(sample: &Sample, is_first: bool) {
    if is_first {
        logging::print(&format!("{}\n{}", table::CAPTION, table::header()));
    }
    logging::print(&table::row(sample));
}

fn run_table(summary: &Value) -> Table {
    let row = |name: &str, field: &str| {
        let value = summary[field].as_f64().unwrap_or(0.0);
        let shown = match value.fract() == 0.0 {
            true => format!("{value:.0}"),
            false => format!("{value:.2}"),
        };
        vec![name.to_owned(), shown]
    };
    Table {
        title: "The run".to_owned(),
        columns: vec!["what".to_owned(), "value".to_owned()],
        rows: vec![
            row("pings received", "pings_received"),
            row("pings mapped", "pings_mapped"),
            row("pings without a pose", "pings_without_pose"),
            row("damaged frames", "frames_bad"),
            row("processor seconds of the mapper", "compute_s"),
            row("seconds by the clock", "wall_s"),
            row("Gaussian–bin pairs", "pairs"),
            row("most memory held, bytes", "peak_memory_bytes"),
        ],
        note: String::new(),
    }
}
