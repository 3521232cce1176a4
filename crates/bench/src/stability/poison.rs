//! Numbers that are none, in every field of a Gaussian: nothing of them may reach the others.

use echosplat_acoustics::{GaussianArrays, GradientArrays, PARAMETER_COUNT, Parameters};
use echosplat_paper::rendering::{PaperRenderer, Transmittance};
use glam::Vec3;

use super::Row;
use super::row::{Comparison, Label};
use super::scene::{Scene, plain};

const LABEL: Label = Label {
    case: "poison in one Gaussian",
    quantity: "fields out of 12 that spoil values or slopes (naive: that make its own profile none)",
    why: "Guards are written so that NaN fails them: a Gaussian with a number that is none is left \
          out whole.",
};

const POISONS: [(&str, f32); 5] = [
    ("NaN", f32::NAN),
    ("∞", f32::INFINITY),
    ("−∞", f32::NEG_INFINITY),
    ("largest f32", f32::MAX),
    ("subnormal", 1e-40),
];

pub(super) fn rows(_seed: u64, _quick: bool) -> Vec<Row> {
    let mut rows = Vec::new();
    for (name, poison) in POISONS {
        let online = (0..PARAMETER_COUNT).filter(|&field| !online_holds(field, poison));
        rows.push(row(format!("{name}, online"), online.count(), poison));
        let paper = (0..PARAMETER_COUNT).filter(|&field| !paper_holds(field, poison));
        rows.push(row(format!("{name}, paper"), paper.count(), poison));
    }
    rows
}

fn row(input: String, spoilt: usize, poison: f32) -> Row {
    let naive = (0..PARAMETER_COUNT).filter(|&field| {
        let profile = super::naive::profile(&super::scene::geometry(), &poisoned(field, poison));
        profile.iter().any(|value| !value.is_finite())
    });
    let comparison = Comparison::of(0.0, spoilt as f64, 1.0);
    comparison
        .with_naive(naive.count() as f64, 1.0)
        .row(LABEL, input, 0.0)
}

fn poisoned(field: usize, poison: f32) -> Parameters {
    let mut numbers = plain(Vec3::new(5.0, 0.0, 0.2)).to_array();
    numbers[field] = poison;
    Parameters::from_array(numbers)
}

fn neighbour() -> Parameters {
    plain(Vec3::new(8.0, 0.02, -0.2))
}

/// Image and slopes of some Gaussians.
type Rendered = (Vec<f32>, GradientArrays);

/// Whether all is finite, and, where the poison is no number, as if its Gaussian were not there.
fn holds(poison: f32, with: &Rendered, without: &Rendered) -> bool {
    let slopes = with.1.fields();
    let mut numbers = with.0.iter().chain(slopes.into_iter().flatten());
    let same = with
        .0
        .iter()
        .zip(&without.0)
        .all(|(a, b)| a.to_bits() == b.to_bits());
    numbers.all(|number| number.is_finite()) && (poison.is_finite() || same)
}

fn online_holds(field: usize, poison: f32) -> bool {
    [false, true].into_iter().all(|occlusion| {
        let render = |gaussians: &[Parameters]| {
            let mut scene = Scene::new(occlusion);
            gaussians
                .iter()
                .for_each(|gaussian| scene.gaussians.push(*gaussian));
            let mut slopes = GradientArrays::zeros(gaussians.len());
            for (index, row) in scene.program_gradient(&[1.0; 600]).into_iter().enumerate() {
                slopes.add(index, row);
            }
            (scene.program(), slopes)
        };
        let with = render(&[neighbour(), poisoned(field, poison)]);
        holds(poison, &with, &render(&[neighbour()]))
    })
}

fn paper_holds(field: usize, poison: f32) -> bool {
    let view = super::images::view();
    let render = |gaussians: &[Parameters]| {
        let mut arrays = GaussianArrays::new();
        gaussians.iter().for_each(|gaussian| arrays.push(*gaussian));
        let subset: Vec<u32> = (0..arrays.len() as u32).collect();
        let mut renderer = PaperRenderer::new();
        let image = renderer.forward(&view, &arrays, &subset, Transmittance::Exact);
        let image = image.to_vec();
        let mut slopes = GradientArrays::zeros(arrays.len());
        renderer.backward(&arrays, &vec![1.0; image.len()], &mut slopes);
        (image, slopes)
    };
    let with = render(&[neighbour(), poisoned(field, poison)]);
    holds(poison, &with, &render(&[neighbour()]))
}
