//! The paper's renderer where its formulas are singular or stiff.

use echosplat_paper::rendering::{PaperRenderer, PaperView, Transmittance};
use echosplat_paper::{GaussianArrays, GradientArrays, PARAMETER_COUNT, Parameters, scenes, twin};
use glam::{Mat3, Quat, Vec3};

use super::Row;
use super::cut;
use super::row::{Comparison, Label};
use crate::draw::Draw;

const QUANTITY: &str = "value of the worst pixel, errors relative to the largest";

const CONDITION: Label = Label {
    case: "paper: covariance condition",
    quantity: QUANTITY,
    why: "The determinant of (24) is a sum of squares of cross products, and (25) is evaluated by \
          Cholesky.",
};

const SINGULAR: Label = Label {
    case: "paper: polar axis, range 0, behind",
    quantity: QUANTITY,
    why: "(19) has no meaning within 5 cm of the sensor or 0.06° of its z axis; Gaussians there are \
          left out, and none behind appears before it.",
};

const THROUGH: Label = Label {
    case: "paper: transmittance",
    quantity: QUANTITY,
    why: "(26), (27) in logarithms of 1 − α f, front to back; a pixel of which less than 10⁻⁴ is \
          left is done.",
};

const POISON: Label = Label {
    case: "paper: poison in one Gaussian",
    quantity: "fields out of 12 that spoil values or slopes",
    why: "Guards are written so that NaN fails them: a Gaussian with a number that is none is left \
          out whole.",
};

/// A Gaussian that is nothing special.
fn plain(mean_m: Vec3) -> Parameters {
    Parameters {
        mean_m,
        rotation: Quat::IDENTITY,
        log_scale: Vec3::splat(-3.0),
        opacity_logit: 0.5,
        reflectivity_log: -0.5,
    }
}

fn view() -> PaperView {
    PaperView {
        position_m: Vec3::ZERO,
        axes: Mat3::IDENTITY,
        ..scenes::paper_scene_of(0, 0).view
    }
}

pub(super) fn rows(seed: u64, quick: bool) -> Vec<Row> {
    let count = if quick { 20 } else { 200 };
    let mut rows: Vec<Row> = [2, 4, 6, 8, 10, 12]
        .map(|decade| condition(seed, decade, count))
        .into();
    let places = [
        ("0.1 m off the axis at 3 m", Vec3::new(0.1, 0.01, 3.0)),
        ("1 mm off the axis at 3 m", Vec3::new(1e-3, 1e-4, 3.0)),
        ("10⁻²⁰ m off the axis at 3 m", Vec3::new(1e-20, 0.0, -3.0)),
        ("on the axis at 3 m", Vec3::new(0.0, 0.0, 3.0)),
        ("1 mm before the sensor", Vec3::new(1e-3, 0.0, 0.0)),
        ("10⁻²⁵ m before the sensor", Vec3::new(1e-25, 0.0, 0.0)),
        ("at the sensor", Vec3::ZERO),
        ("behind, 180°", Vec3::new(-4.0, 1e-4, 0.1)),
        ("behind, −180°", Vec3::new(-4.0, -1e-4, 0.1)),
    ];
    rows.extend(places.map(|(input, mean_m)| singular(input, mean_m)));
    let counts = if quick { [200, 5_000] } else { [200, 100_000] };
    for count in counts {
        for (name, opacity) in [("0.5", 0.5), ("10⁻⁸", 1e-8)] {
            let input = format!("{count} Gaussians of opacity {name}");
            rows.push(crowd(seed, count, opacity).row(THROUGH, input, 1e-4));
        }
    }
    let poisons = [
        ("NaN", f32::NAN),
        ("∞", f32::INFINITY),
        ("−∞", f32::NEG_INFINITY),
        ("largest f32", f32::MAX),
        ("subnormal", 1e-40),
    ];
    rows.extend(poisons.map(|(name, poison)| {
        let spoilt = (0..PARAMETER_COUNT).filter(|&field| !holds(field, poison));
        Comparison::of(0.0, spoilt.count() as f64, 1.0).row(POISON, name, 0.0)
    }));
    rows
}

/// Whether all is finite with one number poisoned, and, where the poison is none, as if its Gaussian were not there.
fn holds(field: usize, poison: f32) -> bool {
    let neighbour = plain(Vec3::new(8.0, 0.02, -0.2));
    let mut numbers = plain(Vec3::new(5.0, 0.0, 0.2)).to_array();
    numbers[field] = poison;
    let render = |gaussians: &[Parameters]| {
        let mut arrays = GaussianArrays::new();
        gaussians.iter().for_each(|gaussian| arrays.push(*gaussian));
        rendered(&view(), &arrays, Transmittance::Exact)
    };
    let (with, slopes) = render(&[neighbour, Parameters::from_array(numbers)]);
    let (without, _) = render(&[neighbour]);
    let mut all = with.iter().chain(slopes.fields().into_iter().flatten());
    all.all(|number| number.is_finite()) && (poison.is_finite() || with == without)
}

/// An image, and slopes of the sum of its pixels.
fn rendered(
    view: &PaperView,
    gaussians: &GaussianArrays,
    shadows: Transmittance,
) -> (Vec<f32>, GradientArrays) {
    let subset: Vec<u32> = (0..gaussians.len() as u32).collect();
    let mut renderer = PaperRenderer::new();
    let image = renderer.forward(view, gaussians, &subset, shadows).to_vec();
    let mut gradients = GradientArrays::zeros(gaussians.len());
    renderer.backward(gaussians, &vec![1.0; image.len()], &mut gradients);
    (image, gradients)
}

/// The program against the twin; slopes that are not finite make it worst.
fn compare(view: &PaperView, gaussians: &GaussianArrays, shadows: Transmittance) -> Comparison {
    let (image, gradients) = rendered(view, gaussians, shadows);
    let setting = twin::Setting::new(view, shadows);
    let nearest = cut::nearest_image(&setting, &twin::rows_of(gaussians), &image);
    let comparison = Comparison::of_many(&nearest, &image);
    let is_finite = gradients
        .fields()
        .iter()
        .all(|f| f.iter().all(|g| g.is_finite()));
    match is_finite {
        true => comparison,
        false => Comparison {
            error: f64::NAN,
            ..comparison
        },
    }
}

fn one(gaussian: Parameters) -> GaussianArrays {
    let mut gaussians = GaussianArrays::new();
    gaussians.push(gaussian);
    gaussians
}

fn condition(seed: u64, decade: u32, count: usize) -> Row {
    let mut draw = Draw::new(seed, 600 + u64::from(decade));
    let ratio = 10_f32.powf(0.5 * decade as f32);
    let mut worst: Option<Comparison> = None;
    for _ in 0..count {
        let longest_m = (1.05e-5 * ratio).max(0.5);
        let middle_m = longest_m * ratio.powf(-draw.between(0.0, 1.0));
        let gaussian = Parameters {
            rotation: draw.rotation(),
            log_scale: Vec3::new(longest_m, middle_m, longest_m / ratio).map(f32::ln),
            ..plain(Vec3::new(5.0, 0.2, 0.4) + 0.1 * draw.cube())
        };
        let here = compare(&view(), &one(gaussian), Transmittance::None);
        worst = Some(worst.map_or(here, |worst| worst.worse(here)));
    }
    let worst = worst.unwrap_or(Comparison::of(f64::NAN, f64::NAN, 1.0));
    worst.row(CONDITION, format!("10^{decade}, worst of {count}"), 1e-4)
}

fn singular(input: &str, mean_m: Vec3) -> Row {
    let comparison = compare(&view(), &one(plain(mean_m)), Transmittance::Exact);
    comparison.row(SINGULAR, input, 1e-4)
}

/// Wider than a few pixels, one behind another over 6 m.
fn crowd(seed: u64, count: usize, opacity: f64) -> Comparison {
    let mut draw = Draw::new(seed, 620);
    let logit = (opacity / (1.0 - opacity)).ln() as f32;
    let mut gaussians = GaussianArrays::new();
    for index in 0..count {
        let range_m = 3.0 + 6.0 * index as f32 / count as f32;
        gaussians.push(Parameters {
            log_scale: Vec3::new(0.05, 0.1, 0.1).map(f32::ln),
            opacity_logit: logit,
            ..plain(Vec3::new(range_m, 0.05 * draw.between(-1.0, 1.0), 0.0))
        });
    }
    compare(&view(), &gaussians, Transmittance::Exact)
}
