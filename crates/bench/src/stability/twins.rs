//! The kernels against their twins, and gradients against differences.

use echosplat_acoustics::reference::online::{Cutoffs, numbers_of};
use echosplat_acoustics::{GradientArrays, Real};
use echosplat_paper::rendering::{PaperRenderer, Transmittance};
use echosplat_paper::twin;

use super::Row;
use super::cut;
use super::row::{Comparison, Label};
use super::scene::{Numbers, Scene};
use crate::draw::Draw;

const FORWARD: Label = Label {
    case: "kernels against twins",
    quantity: "intensity of the worst bin or pixel, errors relative to the largest",
    why: "Lanes of eight against plain loops in f64; the naive column is the same loops in f32.",
};

const BACKWARD: Label = Label {
    case: "kernels against twins",
    quantity: "dL/d(parameter), errors relative to the group's largest",
    why: "Row moments in lanes against plain loops in f64; the naive column is the same loops in f32.",
};

const DIFFERENCES: Label = Label {
    case: "gradients against central differences",
    quantity: "dL/d(parameter), errors relative to the group's largest",
    why: "The analytic gradient in f64 against differences of the forward in f64, cut-offs out of the \
          way; the naive column is the same differences in f32.",
};

/// Name and place of parameters of one unit.
const GROUPS: [(&str, std::ops::Range<usize>); 5] = [
    ("mean", 0..3),
    ("rotation", 3..7),
    ("log scale", 7..10),
    ("opacity logit", 10..11),
    ("log reflectivity", 11..12),
];

fn way(occlusion: bool) -> &'static str {
    if occlusion { "with occlusion" } else { "T = 1" }
}

/// The worst over several scenes.
fn worst(count: usize, mut of: impl FnMut() -> Comparison) -> Comparison {
    let first = of();
    (1..count).fold(first, |worst, _| worst.worse(of()))
}

/// One comparison for each of [`GROUPS`].
type Groups = [Comparison; 5];

fn worst_groups(count: usize, mut of: impl FnMut() -> Groups) -> Groups {
    let first = of();
    (1..count).fold(first, |worst, _| {
        let next = of();
        std::array::from_fn(|group| worst[group].worse(next[group]))
    })
}

/// Each group of `program` and `naive` against `truth`.
/// The program's gradient and the naive way's, each beside what it should be.
fn by_group(
    program: (&[Numbers<f64>], &[Numbers<f32>]),
    naive: (&[Numbers<f64>], &[Numbers<f32>]),
) -> Groups {
    fn of<R: Copy>(rows: &[Numbers<R>], range: &std::ops::Range<usize>) -> Vec<R> {
        let parts = rows.iter().flat_map(|row| row[range.clone()].iter());
        parts.copied().collect()
    }
    GROUPS.map(|(_, range)| {
        let (truth, found) = (of(program.0, &range), of(program.1, &range));
        let (naive_truth, naive) = (of(naive.0, &range), of(naive.1, &range));
        Comparison::of_many(&truth, &found).with_naive_many(&naive_truth, &naive)
    })
}

fn group_rows(groups: Groups, label: Label, of: &str, limit: f64) -> Vec<Row> {
    let pairs = groups.into_iter().zip(GROUPS);
    pairs
        .map(|(comparison, (name, _))| comparison.row(label, format!("{name}, {of}"), limit))
        .collect()
}

pub(super) fn online(seed: u64, quick: bool) -> Vec<Row> {
    let scenes = if quick { 4 } else { 30 };
    let mut rows = Vec::new();
    for occlusion in [false, true] {
        let mut draw = Draw::new(seed, 500);
        let forward = worst(scenes, || {
            let scene = Scene::random(&mut draw, 60, occlusion);
            let truth = scene.twin::<f64>();
            Comparison::of_many(&truth, &scene.program())
                .with_naive_many(&truth, &scene.twin::<f32>())
        });
        let of = format!("online, {}", way(occlusion));
        rows.push(forward.row(FORWARD, of, 2e-5));
    }
    for occlusion in [false, true] {
        let mut draw = Draw::new(seed, 510);
        let groups = worst_groups(scenes, || {
            let scene = Scene::random(&mut draw, 60, occlusion);
            let slope = scene.slope(&mut draw);
            let cutoffs = Cutoffs::default();
            let truth = scene.twin_gradient::<f64>(&slope, &cutoffs);
            let naive = scene.twin_gradient::<f32>(&slope, &cutoffs);
            by_group((&truth, &scene.program_gradient(&slope)), (&truth, &naive))
        });
        let of = format!("online, {}", way(occlusion));
        rows.extend(group_rows(groups, BACKWARD, &of, 1e-4));
    }
    rows
}

/// Nothing is cut that differences could trip over.
const UNCUT: Cutoffs = Cutoffs {
    range_sigmas: 12.0,
    raster_sigmas: 40.0,
    least_transmittance: 0.0,
};

pub(super) fn differences(seed: u64, quick: bool) -> Vec<Row> {
    let scenes = if quick { 2 } else { 12 };
    let mut rows = Vec::new();
    for occlusion in [false, true] {
        let mut draw = Draw::new(seed, 520);
        let groups = worst_groups(scenes, || {
            let scene = Scene::random(&mut draw, 6, occlusion);
            let slope = scene.slope(&mut draw);
            let analytic = scene.twin_gradient::<f64>(&slope, &UNCUT);
            let truth = central::<f64>(&scene, &slope, 1e-5);
            let naive = central::<f32>(&scene, &slope, 1e-3);
            by_group_f64(&truth, &analytic, &naive)
        });
        rows.extend(group_rows(groups, DIFFERENCES, way(occlusion), 1e-5));
    }
    rows
}

fn by_group_f64(
    truth: &[Numbers<f64>],
    analytic: &[Numbers<f64>],
    naive: &[Numbers<f32>],
) -> Groups {
    let of = |rows: &[Numbers<f64>], range: &std::ops::Range<usize>| -> Vec<f64> {
        rows.iter()
            .flat_map(|row| row[range.clone()].to_vec())
            .collect()
    };
    GROUPS.map(|(_, range)| {
        let naive = naive.iter().flat_map(|row| row[range.clone()].to_vec());
        let naive: Vec<f32> = naive.collect();
        let truth = of(truth, &range);
        Comparison::of_many(&truth, &of(analytic, &range)).with_naive_many(&truth, &naive)
    })
}

/// Fourth-order central differences of `Σ slope · I` by every parameter.
fn central<R: Real>(scene: &Scene, slope: &[f32], step: f64) -> Vec<Numbers<R>> {
    let numbers = numbers_of::<R>(&scene.gaussians);
    let loss = |index: usize, parameter: usize, by: f64| {
        let mut moved = numbers.clone();
        moved[index][parameter] += R::of(by);
        let intensity = scene.twin_of(&moved, &UNCUT);
        let pairs = intensity.into_iter().zip(slope);
        pairs.fold(R::ZERO, |sum, (i, &s)| sum + i * R::of_f32(s))
    };
    let slope_by = |index: usize, parameter: usize| {
        let difference = |by: f64| loss(index, parameter, by) - loss(index, parameter, -by);
        (R::of(8.0) * difference(step) - difference(2.0 * step)) / R::of(12.0 * step)
    };
    (0..numbers.len())
        .map(|index| std::array::from_fn(|parameter| slope_by(index, parameter)))
        .collect()
}

const WAYS: [(&str, Transmittance); 3] = [
    ("paper, T = 1", Transmittance::None),
    ("paper, exact", Transmittance::Exact),
    ("paper, averaged", Transmittance::Averaged),
];

pub(super) fn paper(seed: u64, quick: bool) -> Vec<Row> {
    let (scenes, count) = if quick { (1, 300) } else { (4, 2_000) };
    let mut rows = Vec::new();
    for (name, transmittance) in WAYS {
        let mut next = seed;
        let mut draw = Draw::new(seed, 530);
        let mut forward: Option<Comparison> = None;
        let groups = worst_groups(scenes, || {
            next += 1;
            let scene = echosplat_paper::scenes::paper_scene_of(next, count);
            let setting = twin::Setting::new(&scene.view, transmittance);
            let all = scene.all();
            let mut renderer = PaperRenderer::new();
            let image = renderer.forward(&scene.view, &scene.gaussians, &all, transmittance);
            let exact = numbers_of::<f64>(&scene.gaussians);
            let truth = cut::nearest_image(&setting, &exact, image);
            let numbers = numbers_of::<f32>(&scene.gaussians);
            let naive = twin::forward(&setting, &numbers);
            let naive_truth = cut::nearest_image(&setting, &exact, &naive);
            let here = Comparison::of_many(&truth, image).with_naive_many(&naive_truth, &naive);
            forward = Some(forward.map_or(here, |worst| worst.worse(here)));

            let slope: Vec<f32> = (0..truth.len()).map(|_| draw.between(-1.0, 1.0)).collect();
            let mut gradients = GradientArrays::zeros(scene.gaussians.len());
            renderer.backward(&scene.gaussians, &slope, &mut gradients);
            let program: Vec<_> = (0..gradients.len()).map(|i| gradients.get(i)).collect();
            let naive = twin::backward(&setting, &numbers, &slope);
            let nearest = |found: &_| cut::nearest_gradients(&setting, &exact, &slope, found);
            by_group((&nearest(&program), &program), (&nearest(&naive), &naive))
        });
        let forward = forward.unwrap_or(Comparison::of(f64::NAN, f64::NAN, 1.0));
        rows.push(forward.row(FORWARD, name, 1e-4));
        rows.extend(group_rows(groups, BACKWARD, name, 3e-4));
    }
    rows
}
