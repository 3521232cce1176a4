//! The paper's kernels against their twin.

use echosplat_paper::rendering::{PaperRenderer, Transmittance};
use echosplat_paper::{GradientArrays, scenes, twin};

use super::Row;
use super::cut;
use super::row::{Comparison, Label};
use crate::draw::Draw;

const FORWARD: Label = Label {
    case: "paper's kernels against twins",
    quantity: "intensity of the worst pixel, errors relative to the largest",
    why: "Lanes of eight against plain loops in f64.",
};

const BACKWARD: Label = Label {
    case: "paper's kernels against twins",
    quantity: "dL/d(parameter), errors relative to the group's largest",
    why: "Row moments in lanes against plain loops in f64.",
};

/// Name and place of parameters of one unit.
const GROUPS: [(&str, std::ops::Range<usize>); 5] = [
    ("mean", 0..3),
    ("rotation", 3..7),
    ("log scale", 7..10),
    ("opacity logit", 10..11),
    ("log reflectivity", 11..12),
];

const WAYS: [(&str, Transmittance); 3] = [
    ("paper, T = 1", Transmittance::None),
    ("paper, exact", Transmittance::Exact),
    ("paper, averaged", Transmittance::Averaged),
];

pub(super) fn paper(seed: u64, quick: bool) -> Vec<Row> {
    let (scenes, count) = if quick { (1, 300) } else { (4, 2_000) };
    let mut rows = Vec::new();
    for (name, transmittance) in WAYS {
        let mut draw = Draw::new(seed, 530);
        let each = (1..=scenes).map(|more| compare(seed + more, count, transmittance, &mut draw));
        let worst = each.reduce(|a, b| std::array::from_fn(|k| a[k].worse(b[k])));
        let [forward, groups @ ..] = worst.unwrap_or([Comparison::of(f64::NAN, f64::NAN, 1.0); 6]);
        rows.push(forward.row(FORWARD, name, 1e-4));
        for (comparison, (group, _)) in groups.into_iter().zip(GROUPS) {
            rows.push(comparison.row(BACKWARD, format!("{group}, {name}"), 3e-4));
        }
    }
    rows
}

/// Of the image, and of each of [`GROUPS`].
fn compare(
    seed: u64,
    count: usize,
    transmittance: Transmittance,
    draw: &mut Draw,
) -> [Comparison; 6] {
    let scene = scenes::paper_scene_of(seed, count);
    let setting = twin::Setting::new(&scene.view, transmittance);
    let mut renderer = PaperRenderer::new();
    let image = renderer.forward(&scene.view, &scene.gaussians, &scene.all(), transmittance);
    let exact = twin::rows_of::<f64>(&scene.gaussians);
    let truth = cut::nearest_image(&setting, &exact, image);
    let forward = Comparison::of_many(&truth, image);
    let slope: Vec<f32> = (0..truth.len()).map(|_| draw.between(-1.0, 1.0)).collect();
    let mut gradients = GradientArrays::zeros(scene.gaussians.len());
    renderer.backward(&scene.gaussians, &slope, &mut gradients);
    let program: Vec<_> = (0..gradients.len()).map(|i| gradients.get(i)).collect();
    let truth = cut::nearest_gradients(&setting, &exact, &slope, &program);
    let group = |(_, range): &(&str, std::ops::Range<usize>)| {
        let truth: Vec<f64> = truth
            .iter()
            .flat_map(|row| row[range.clone()].to_vec())
            .collect();
        let found: Vec<f32> = program
            .iter()
            .flat_map(|row| row[range.clone()].to_vec())
            .collect();
        Comparison::of_many(&truth, &found)
    };
    let [a, b, c, d, e] = GROUPS.each_ref().map(group);
    [forward, a, b, c, d, e]
}
