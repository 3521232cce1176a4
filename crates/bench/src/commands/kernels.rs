//! `echosplat bench kernels`: Gaussian–bin pairs per second on one core, beside the plain twins measured in turns with them.

use std::hint::black_box;
use std::time::{Duration, Instant};

use anyhow::Context;
use echosplat_measurement::heard::Detail;
use echosplat_measurement::lanes::{Level, avx2};
use echosplat_measurement::twin::Twin;
use echosplat_measurement::{Listener, Scene};
use echosplat_paper::GradientArrays;
use echosplat_paper::rendering::{PaperRenderer, Transmittance};
use echosplat_paper::scenes::{PaperScene, paper_scene};
use echosplat_paper::twin as paper_twin;
use echosplat_report::{Report, Section, Table};
use indicatif::ProgressBar;
use rayon::ThreadPoolBuilder;
use serde::Serialize;
use serde_json::{Map, json};

use super::Findings;
use crate::arguments::BenchOptions;
use crate::draw::Draw;
use crate::stability::{NOISE, Trial};
use echosplat_service::logging;

/// A measurement repeats what it measures for at least this long.
const LEAST_TIME: Duration = Duration::from_micros(1500);
const TURNS: usize = 80;
const QUICK_TURNS: usize = 5;
/// Gaussians in the measured ping, as many as a dense map has in a fan.
const GAUSSIANS: usize = 5_000;

type Call = Box<dyn FnMut()>;

/// One kernel; each call does all pairs of its scene once.
struct Kernel {
    name: &'static str,
    pairs: u64,
    forward: Call,
    /// After a forward of the same: what bins say of each Gaussian, or the gradient.
    backward: Call,
    twin_forward: Call,
    /// The twin's forward and backward together.
    twin_both: Call,
}

/// Best of all turns.
#[derive(Debug, Clone, Serialize)]
struct Rates {
    kernel: &'static str,
    /// Of one call.
    pairs: u64,
    /// Pairs per second and core.
    forward_per_s: f64,
    backward_per_s: f64,
    both_per_s: f64,
    twin_forward_per_s: f64,
    twin_both_per_s: f64,
    /// Times as fast as the twin.
    forward_ratio: f64,
    both_ratio: f64,
}

/// # Errors
/// If a thread of its own cannot be had.
pub(super) fn run(options: &BenchOptions) -> anyhow::Result<Findings> {
    let turns = if options.quick { QUICK_TURNS } else { TURNS };
    let one_core = ThreadPoolBuilder::new().num_threads(1).build();
    let one_core = one_core.context("cannot start a thread")?;
    let seed = options.seed;
    let rates = one_core.install(|| {
        let best = Level::new();
        let mut kernels = vec![
            strengths(seed, "strengths", best),
            scores(seed, "scores", best),
        ];
        if let Some(avx2) = avx2() {
            kernels.push(strengths(seed, "strengths, AVX2", avx2));
            kernels.push(scores(seed, "scores, AVX2", avx2));
        }
        for (name, transmittance) in [
            ("paper, T = 1", Transmittance::None),
            ("paper, exact", Transmittance::Exact),
            ("paper, averaged", Transmittance::Averaged),
        ] {
            kernels.push(paper(seed, name, transmittance));
        }
        let bar = logging::progress_bar(turns as u64, "{bar:40} turn {pos} of {len}");
        measure(&mut kernels, turns, &bar)
    });
    results(&rates)
}

/// What a pass that makes strengths does with a ping.
fn strengths(seed: u64, name: &'static str, level: Level) -> Kernel {
    let back = |listener: &mut Listener, measured: &[f32]| {
        black_box(listener.step_sums(measured));
    };
    let twin_back = |twin: &Twin, measured: &[f64], predicted: &[f64]| {
        black_box(twin.step_sums(measured, predicted));
    };
    kernel(seed, name, level, Detail::Strength, back, twin_back)
}

/// What a pass that moves means does with it.
fn scores(seed: u64, name: &'static str, level: Level) -> Kernel {
    let back = |listener: &mut Listener, measured: &[f32]| {
        black_box(listener.scores(measured));
    };
    let twin_back = |twin: &Twin, measured: &[f64], predicted: &[f64]| {
        black_box(twin.scores(measured, predicted));
    };
    kernel(seed, name, level, Detail::Full, back, twin_back)
}

fn kernel(
    seed: u64,
    name: &'static str,
    level: Level,
    detail: Detail,
    back: impl Fn(&mut Listener, &[f32]) + 'static,
    twin_back: impl Fn(&Twin, &[f64], &[f64]) + 'static,
) -> Kernel {
    let trial = Trial::random(&mut Draw::new(seed, 700), GAUSSIANS);
    let (geometry, scene) = (trial.geometry, Scene::of(&trial.elements));
    let (mut listener, predicted) = trial.listener(level);
    let pairs = listener.pair_count();
    let (mut forward, other) = (Listener::with_level(level), trial.clone());
    let measured: Vec<f64> = predicted.iter().map(|&power| power.into()).collect();
    Kernel {
        name,
        pairs,
        forward: Box::new(move || {
            black_box(forward.hear(&scene, &geometry, NOISE, detail));
        }),
        backward: Box::new(move || back(&mut listener, &predicted)),
        twin_forward: Box::new(move || drop(black_box(trial.twin().predicted(NOISE.into())))),
        twin_both: Box::new(move || {
            let twin = other.twin();
            twin_back(&twin, &measured, &twin.predicted(NOISE.into()));
        }),
    }
}

fn paper(seed: u64, name: &'static str, transmittance: Transmittance) -> Kernel {
    let scene = paper_scene(seed);
    let all = scene.all();
    let slope = vec![1e-3; scene.view.pixel_count()];
    let mut back = PaperRenderer::new();
    let _ = back.forward(&scene.view, &scene.gaussians, &all, transmittance);
    let pairs = back.pair_count();
    let mut gradients = GradientArrays::zeros(scene.gaussians.len());
    let (same, d_image) = (scene.gaussians.clone(), slope.clone());
    let rows = paper_twin::rows_of::<f32>(&scene.gaussians);
    let rows_both = rows.clone();
    let view = scene.view;
    let PaperScene { gaussians, .. } = scene;
    let mut renderer = PaperRenderer::new();
    Kernel {
        name,
        pairs,
        forward: Box::new(move || {
            black_box(renderer.forward(&view, &gaussians, &all, transmittance));
        }),
        backward: Box::new(move || {
            back.backward(&same, &d_image, &mut gradients);
            black_box(&gradients);
        }),
        twin_forward: Box::new(move || {
            let setting = paper_twin::Setting::new(&view, transmittance);
            black_box(paper_twin::forward(&setting, &rows));
        }),
        // It makes its own forward.
        twin_both: Box::new(move || {
            let setting = paper_twin::Setting::new(&view, transmittance);
            black_box(paper_twin::backward(&setting, &rows_both, &slope));
        }),
    }
}

/// Seconds of each part of a kernel, best of all turns.
type Best = [f64; 4];

/// All parts of all kernels in turns, so that what slows the machine down slows all.
fn measure(kernels: &mut [Kernel], turns: usize, bar: &ProgressBar) -> Vec<Rates> {
    let mut best = vec![[f64::INFINITY; 4]; kernels.len()];
    for _ in 0..turns {
        for (kernel, best) in kernels.iter_mut().zip(&mut best) {
            let parts = [
                &mut kernel.forward,
                &mut kernel.backward,
                &mut kernel.twin_forward,
                &mut kernel.twin_both,
            ];
            for (part, best) in parts.into_iter().zip(best) {
                *best = best.min(seconds_of(part));
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let pairs = kernels.iter().zip(&best);
    pairs.map(|(kernel, best)| rates(kernel, best)).collect()
}

fn seconds_of(call: &mut Call) -> f64 {
    let (mut calls, began) = (0_u32, Instant::now());
    loop {
        call();
        calls += 1;
        let passed = began.elapsed();
        if passed >= LEAST_TIME {
            return passed.as_secs_f64() / f64::from(calls);
        }
    }
}

fn rates(kernel: &Kernel, [forward, backward, twin_forward, twin_both]: &Best) -> Rates {
    let pairs = kernel.pairs as f64;
    let both = forward + backward;
    Rates {
        kernel: kernel.name,
        pairs: kernel.pairs,
        forward_per_s: pairs / forward,
        backward_per_s: pairs / backward,
        both_per_s: pairs / both,
        twin_forward_per_s: pairs / twin_forward,
        twin_both_per_s: pairs / twin_both,
        forward_ratio: twin_forward / forward,
        both_ratio: twin_both / both,
    }
}

fn results(rates: &[Rates]) -> anyhow::Result<Findings> {
    let ratio = paper_over_strengths(rates);
    let mut fields = Map::new();
    fields.insert("kernels".to_owned(), serde_json::to_value(rates)?);
    fields.insert("paper_over_strengths".to_owned(), json!(ratio));
    let table = table(rates);
    let text = text(&table, ratio);
    let highlight = |name: &str, value: String| (name.to_owned(), value);
    let forward = rates.first().map_or(0.0, |rates| rates.forward_per_s);
    let backward = rates.first().map_or(0.0, |rates| rates.backward_per_s);
    Ok(Findings {
        name: "kernels",
        fields,
        report: Report {
            title: "Speed of the kernels".to_owned(),
            highlights: vec![
                highlight("spread", giga(forward) + " G/s"),
                highlight("gather", giga(backward) + " G/s"),
                highlight("paper's time a pair, T = 1", format!("{ratio:.2} ×")),
            ],
            sections: vec![Section {
                title: "Gaussian–bin pairs per second on one core".to_owned(),
                text: "Projection and spreading, then what bins say of each Gaussian: strengths by \
                       the multiplicative step, or scores of its mean. A pair of the paper's renderer \
                       is a Gaussian and a pixel. Kernels and twins took turns; each figure is the \
                       best of all turns."
                    .to_owned(),
                tables: vec![table],
                ..Section::default()
            }],
            ..Report::default()
        },
        text,
        failures: Vec::new(),
    })
}

/// Time per pair, forward and backward, of the paper's renderer without shadowing over that of strengths.
fn paper_over_strengths(rates: &[Rates]) -> f64 {
    let of = |name: &str| {
        let found = rates.iter().find(|rates| rates.kernel == name);
        found.map_or(f64::NAN, |rates| rates.both_per_s)
    };
    of("strengths") / of("paper, T = 1")
}

fn giga(per_s: f64) -> String {
    format!("{:.3}", per_s * 1e-9)
}

fn table(rates: &[Rates]) -> Table {
    let columns = [
        "kernel",
        "pairs",
        "forward G/s",
        "backward G/s",
        "both G/s",
        "twin, forward G/s",
        "both G/s",
        "forward ×",
        "both ×",
    ];
    let row = |rates: &Rates| {
        vec![
            rates.kernel.to_owned(),
            rates.pairs.to_string(),
            giga(rates.forward_per_s),
            giga(rates.backward_per_s),
            giga(rates.both_per_s),
            giga(rates.twin_forward_per_s),
            giga(rates.twin_both_per_s),
            format!("{:.1}", rates.forward_ratio),
            format!("{:.1}", rates.both_ratio),
        ]
    };
    Table {
        title: "Rates".to_owned(),
        columns: columns.map(str::to_owned).into(),
        rows: rates.iter().map(row).collect(),
        note: "× is times as fast as the plain twin in the same run: f64, the paper's f32."
            .to_owned(),
    }
}

fn text(table: &Table, ratio: f64) -> String {
    let mut text = String::new();
    for row in std::iter::once(&table.columns).chain(&table.rows) {
        for (index, cell) in row.iter().enumerate() {
            let width = if index == 0 { 24 } else { 12 };
            let cell: String = cell.chars().take(width).collect();
            text += &format!("{cell:<width$} ");
        }
        text = text.trim_end().to_owned() + "\n";
    }
    text + &format!("time a pair, paper's over that of strengths: {ratio:.2}\n")
}
