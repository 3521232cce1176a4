//! `echosplat bench paper`: the paper's method on the paper's two cases, beside what it prints.

mod report;

use std::sync::Arc;

use anyhow::Context;
use echosplat_metrics::{MapPoints, Metrics, Truth, evaluate, evaluate_raw};
use echosplat_model::PosedPing;
use echosplat_paper::{
    ASSERTED_IN_FENCE_FIGURE, ASSERTED_IN_TRUSS_FIGURE, CandidateCounts, Choices, EpochReport,
    Images, PaperMethod,
};
use echosplat_report::table;
use echosplat_report::{Picture, Report};
use echosplat_simulator::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene, SimulatedSonar};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::{Map, Value};

use super::Findings;
use super::runs::Clock;
use crate::arguments::{PaperBenchArguments, PaperCase};
use echosplat_service::{logging, processor, truth};
use report::choices_section;

const QUICK_SHARE: u32 = 5;
/// Judging a truss takes as long as some epochs.
const TRUSS_JUDGED_EVERY: u32 = 10;

/// One of the paper's cases, with what the paper prints of it.
#[derive(Debug, Clone, Copy, Serialize)]
struct Printed {
    #[serde(skip)]
    scene: &'static str,
    views: usize,
    candidates: usize,
    kept: usize,
    /// Aligned and cropped.
    cd_m: f64,
    hd_m: f64,
    /// The least opacity that its figures show.
    opacity: f32,
}

const FENCE: Printed = Printed {
    scene: "fence",
    views: 249,
    candidates: 50_940,
    kept: 38_024,
    cd_m: 0.129,
    hd_m: 1.391,
    opacity: ASSERTED_IN_FENCE_FIGURE,
};

const TRUSS: Printed = Printed {
    scene: "truss",
    views: 886,
    candidates: 811_690,
    kept: 174_637,
    cd_m: 0.740,
    hd_m: 10.181,
    opacity: ASSERTED_IN_TRUSS_FIGURE,
};

/// After an epoch.
#[derive(Debug, Clone, Serialize)]
struct Epoch {
    #[serde(flatten)]
    report: EpochReport,
    /// Of the method alone, from its images on.
    wall_s: f64,
    compute_s: f64,
    /// Raw; only where it was judged.
    cd_m: Option<f64>,
    hd_m: Option<f64>,
}

/// What a case came to.
struct Outcome {
    printed: Printed,
    views: usize,
    counts: CandidateCounts,
    beam_width_m: f32,
    start_s: f64,
    epochs: Vec<Epoch>,
    pairs: u64,
    peak_memory_bytes: u64,
    metrics: Metrics,
    /// The map at other thresholds than the one it asserts.
    at_opacity: Vec<(f32, Metrics)>,
    picture: Picture,
}

/// # Errors
/// If a case cannot be simulated, or shows nothing.
pub(super) fn run(arguments: &PaperBenchArguments) -> anyhow::Result<Findings> {
    let cases: &[Printed] = match arguments.case {
        PaperCase::Fence => &[FENCE],
        PaperCase::Truss => &[TRUSS],
        PaperCase::Both if arguments.options.quick => &[FENCE],
        PaperCase::Both => &[FENCE, TRUSS],
    };
    let mut choices = Choices::default();
    if arguments.options.quick {
        choices.epochs /= QUICK_SHARE;
    }
    choices.epochs = arguments.epochs.unwrap_or(choices.epochs);
    let outcomes: Vec<Outcome> = cases
        .iter()
        .map(|case| reconstruct(*case, &choices, arguments))
        .collect::<Result<_, _>>()?;
    results(&outcomes, &choices)
}

fn reconstruct(
    printed: Printed,
    choices: &Choices,
    arguments: &PaperBenchArguments,
) -> anyhow::Result<Outcome> {
    let (truth, pings) = simulated(printed.scene, arguments)?;
    processor::forget_peak_memory();
    let mut clock = Clock::start();
    let images = Images::from_pings(&pings, choices).context(printed.scene)?;
    drop(pings);
    let mut method = PaperMethod::new(images, choices.clone());
    clock.pause();
    let start_s = clock.wall_s;
    let epochs = epochs(&mut method, printed, &truth, &mut clock);
    let peak_memory_bytes = processor::peak_memory_bytes();
    let points = |opacity| {
        let map = method.gaussians_above(opacity);
        MapPoints::new(method.images().origin_m, &map)
    };
    let asserted = points(choices.asserted_opacity);
    let thresholds = [ASSERTED_IN_TRUSS_FIGURE, 0.5, ASSERTED_IN_FENCE_FIGURE];
    Ok(Outcome {
        printed,
        views: method.images().images.len(),
        counts: method.candidate_counts(),
        beam_width_m: method.beam_width_m(),
        start_s,
        epochs,
        pairs: method.pair_count(),
        peak_memory_bytes,
        metrics: evaluate(&asserted, &truth),
        at_opacity: thresholds
            .map(|opacity| (opacity, evaluate(&points(opacity), &truth)))
            .into(),
        picture: Picture::new(&asserted, &truth),
    })
}

/// As the paper says: still images from planes at the four sides, no noise.
fn simulated(
    scene: &str,
    arguments: &PaperBenchArguments,
) -> anyhow::Result<(Truth, Vec<PosedPing>)> {
    let scene = Arc::new(Scene::named(scene)?);
    let options = DiveOptions {
        view_share: match arguments.options.quick {
            true => 1.0 / f64::from(QUICK_SHARE),
            false => 1.0,
        },
        ..DiveOptions::default()
    };
    let (noise, seed) = (NoiseLevel::None, arguments.options.seed);
    let dive = Dive::plan_with(DiveKind::Viewpoints, &scene, noise, seed, &options)?;
    let dive = Arc::new(dive);
    let truth = truth::of_simulated(&scene, &dive);
    let sonar = SimulatedSonar::new(scene, Arc::clone(&dive), noise, seed);
    let trajectory = dive.trajectory(0.5);
    let pings = (0..dive.pings()).into_par_iter();
    let pings = pings.filter_map(|index| sonar.posed_ping(index, &trajectory));
    Ok((truth, pings.collect()))
}

fn epochs(
    method: &mut PaperMethod,
    printed: Printed,
    truth: &Truth,
    clock: &mut Clock,
) -> Vec<Epoch> {
    let count = method.choices().epochs;
    let every = match printed.scene == TRUSS.scene {
        true => TRUSS_JUDGED_EVERY,
        false => 1,
    };
    let template = "{bar:40} epoch {pos:>3} of {len} · {msg}";
    let bar = logging::progress_bar(u64::from(count), template);
    let mut epochs = Vec::new();
    while !method.is_done() {
        clock.go_on();
        let report = method.run_epoch();
        clock.pause();
        let is_judged = report.epoch == 1 || report.epoch.is_multiple_of(every) || method.is_done();
        let judged = is_judged.then(|| {
            let points = MapPoints::new(method.images().origin_m, &method.gaussians());
            evaluate_raw(&points, truth)
        });
        let finite = |value: f64| value.is_finite().then_some(value);
        epochs.push(Epoch {
            report,
            wall_s: clock.wall_s,
            compute_s: clock.compute_s,
            cd_m: judged.and_then(|metrics| finite(metrics.cd_m)),
            hd_m: judged.and_then(|metrics| finite(metrics.hd_m)),
        });
        let (scene, asserted) = (printed.scene, report.asserted);
        bar.set_message(format!(
            "{scene} · loss {:.0} · {asserted} asserted",
            report.loss
        ));
        bar.inc(1);
    }
    bar.finish_and_clear();
    epochs
}

fn results(outcomes: &[Outcome], choices: &Choices) -> anyhow::Result<Findings> {
    let cases: Vec<Value> = outcomes
        .iter()
        .map(Outcome::json)
        .collect::<Result<_, _>>()?;
    let mut fields = Map::new();
    fields.insert("cases".to_owned(), Value::Array(cases));
    fields.insert("choices".to_owned(), serde_json::to_value(choices.rows())?);
    let highlights = outcomes.iter().map(|outcome| {
        let (cd_m, printed) = (Outcome::its_way(&outcome.metrics).0, outcome.printed);
        let (ours, theirs) = (table::metres(cd_m), table::metres(printed.cd_m));
        (
            format!("{}: CD its way", printed.scene),
            format!("{ours} m (paper {theirs})"),
        )
    });
    let empty = outcomes
        .iter()
        .filter(|outcome| !outcome.metrics.cd_m.is_finite());
    let failures = empty.map(|outcome| format!("{}: the map is empty", outcome.printed.scene));
    Ok(Findings {
        name: "paper",
        report: Report {
            title: "The paper's method".to_owned(),
            highlights: highlights.collect(),
            sections: outcomes
                .iter()
                .map(Outcome::section)
                .chain([choices_section(choices)])
                .collect(),
            ..Report::default()
        },
        text: outcomes.iter().map(Outcome::text).collect(),
        failures: failures.collect(),
        fields,
    })
}
