//! `echosplat bench kernels`: Gaussian–bin pairs per second on one core, beside the plain twins in
//! f32 measured in turns with them.

use std::hint::black_box;
use std::time::{Duration, Instant};

use anyhow::Context;
use echosplat_acoustics::lanes::{Level, avx2};
use echosplat_acoustics::online::{OnlineOptions, OnlineRenderer};
use echosplat_acoustics::reference::online as online_twin;
use echosplat_acoustics::{GaussianArrays, GradientArrays, PingGeometry, sample};
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
use echosplat_service::logging;

/// A measurement repeats what it measures for at least this long.
const LEAST_TIME: Duration = Duration::from_micros(1500);
const TURNS: usize = 80;
const QUICK_TURNS: usize = 5;

/// One kernel; each call does all pairs of its scene once.
struct Kernel {
    name: &'static str,
    pairs: u64,
    forward: Box<dyn FnMut()>,
    /// After a forward of the same.
    backward: Box<dyn FnMut()>,
    twin_forward: Box<dyn FnMut()>,
    /// The twin's forward and backward together.
    twin_both: Box<dyn FnMut()>,
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
    /// Times as fast as the twin, both in f32.
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
            online(seed, "online, T = 1", false, best),
            online(seed, "online, with occlusion", true, best),
        ];
        if let Some(avx2) = avx2() {
            kernels.push(online(seed, "online, T = 1, AVX2", false, avx2));
            kernels.push(online(seed, "online, with occlusion, AVX2", true, avx2));
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

fn online(seed: u64, name: &'static str, occlusion: bool, level: Level) -> Kernel {
    let (geometry, gaussians) = sample::bench_scene(seed);
    let visible: Vec<u32> = (0..gaussians.len() as u32).collect();
    let options = OnlineOptions { occlusion };
    let slope = vec![1e-3; geometry.bin_count as usize];
    let mut count = OnlineRenderer::with_level(options, level);
    let _ = count.forward(&geometry, &gaussians, &visible);
    let twin = OnlineTwin {
        geometry,
        gaussians: online_twin::numbers_of(&gaussians),
        visible: visible.clone(),
        occlusion,
        slope: slope.clone(),
    };
    let renderers = [(); 2].map(|()| OnlineRenderer::with_level(options, level));
    let (forward, backward) = online_calls(renderers, geometry, gaussians, visible, slope);
    let both = twin.clone();
    Kernel {
        name,
        pairs: count.pair_count(),
        forward,
        backward,
        twin_forward: Box::new(move || drop(black_box(twin.forward()))),
        twin_both: Box::new(move || both.both()),
    }
}

type Call = Box<dyn FnMut()>;

/// Forward and backward on renderers of their own; backward's has been forward once.
fn online_calls(
    [mut renderer, mut back]: [OnlineRenderer; 2],
    geometry: PingGeometry,
    gaussians: GaussianArrays,
    visible: Vec<u32>,
    slope: Vec<f32>,
) -> (Call, Call) {
    let _ = back.forward(&geometry, &gaussians, &visible);
    let mut gradients = GradientArrays::zeros(gaussians.len());
    let same = gaussians.clone();
    let forward = move || {
        black_box(renderer.forward(&geometry, &gaussians, &visible));
    };
    let backward = move || {
        back.backward(&same, &slope, &mut gradients);
        black_box(&gradients);
    };
    (Box::new(forward), Box::new(backward))
}

#[derive(Clone)]
struct OnlineTwin {
    geometry: PingGeometry,
    gaussians: Vec<online_twin::Numbers<f32>>,
    visible: Vec<u32>,
    occlusion: bool,
    slope: Vec<f32>,
}

impl OnlineTwin {
    fn forward(&self) -> online_twin::Rendering<f32> {
        let cutoffs = online_twin::Cutoffs::default();
        let (geometry, visible) = (&self.geometry, &self.visible);
        online_twin::forward(geometry, &self.gaussians, visible, self.occlusion, &cutoffs)
    }

    fn both(&self) {
        let rendering = self.forward();
        let (geometry, gaussians) = (&self.geometry, &self.gaussians);
        black_box(online_twin::backward(
            geometry,
            gaussians,
            &rendering,
            &self.slope,
        ));
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
    let rows = online_twin::numbers_of::<f32>(&scene.gaussians);
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
    let [plain, shadowed] = paper_over_online(rates);
    let mut fields = Map::new();
    fields.insert("kernels".to_owned(), serde_json::to_value(rates)?);
    fields.insert(
        "paper_over_online".to_owned(),
        json!({"without_shadowing": plain, "with_shadowing": shadowed}),
    );
    let table = table(rates);
    let text = text(&table, [plain, shadowed]);
    let highlight = |name: &str, value: String| (name.to_owned(), value);
    let forward = rates.first().map_or(0.0, |rates| rates.forward_per_s);
    let backward = rates.first().map_or(0.0, |rates| rates.backward_per_s);
    Ok(Findings {
        name: "kernels",
        fields,
        report: Report {
            title: "Speed of the kernels".to_owned(),
            highlights: vec![
                highlight("online, forward", giga(forward) + " G/s"),
                highlight("online, backward", giga(backward) + " G/s"),
                highlight("paper's time a pair, T = 1", format!("{plain:.2} ×")),
                highlight("with shadowing", format!("{shadowed:.2} ×")),
            ],
            sections: vec![Section {
                title: "Gaussian–bin pairs per second on one core".to_owned(),
                text: "Projection, spreading and, where there is one, occlusion; a pair of the \
                       paper's renderer is a Gaussian and a pixel. Kernels and twins took turns; \
                       each figure is the best of all turns."
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

/// Time per pair, forward and backward, of the paper's renderer over the online one's: without
/// shadowing, and each with its own.
fn paper_over_online(rates: &[Rates]) -> [f64; 2] {
    let of = |name: &str| {
        let found = rates.iter().find(|rates| rates.kernel == name);
        found.map_or(f64::NAN, |rates| rates.both_per_s)
    };
    [
        of("online, T = 1") / of("paper, T = 1"),
        of("online, with occlusion") / of("paper, averaged"),
    ]
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
        "f32 twin, forward G/s",
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
        note: "× is times as fast as the plain twin in f32, in the same run.".to_owned(),
    }
}

fn text(table: &Table, [plain, shadowed]: [f64; 2]) -> String {
    let mut text = String::new();
    for row in std::iter::once(&table.columns).chain(&table.rows) {
        for (index, cell) in row.iter().enumerate() {
            let width = if index == 0 { 24 } else { 12 };
            let cell: String = cell.chars().take(width).collect();
            text += &format!("{cell:<width$} ");
        }
        text = text.trim_end().to_owned() + "\n";
    }
    text + &format!(
        "time a pair, paper's over online's: {plain:.2} without shadowing, {shadowed:.2} with\n"
    )
}
