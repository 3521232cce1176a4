//! What gets through a crowd, forward and backward.

use echosplat_acoustics::Parameters;
use echosplat_acoustics::reference::online::Cutoffs;
use glam::Vec3;

use super::Row;
use super::naive;
use super::row::{Comparison, Label};
use super::scene::{Scene, plain};
use crate::draw::Draw;

const THROUGH: Label = Label {
    case: "transmittance",
    quantity: "intensity of the worst bin, errors relative to the profile's peak",
    why: "ln(1 − α) summed with compensation, not a product: nothing underflows and no 1 − α rounds \
          to 1. Below 10⁻⁴ nothing more is heard.",
};

const CAP: Label = Label {
    case: "backward near α = 0.999",
    quantity: "dL/d logit of the frontmost, errors relative to the largest slope",
    why: "α is capped at 0.999, so that T/(1 − α) stays accurate; the slope goes through the cap, so \
          that a Gaussian beyond it finds back.",
};

pub(super) fn transmittance(seed: u64, quick: bool) -> Vec<Row> {
    let counts = if quick { [200, 5_000] } else { [200, 100_000] };
    let mut rows = Vec::new();
    for count in counts {
        for (name, opacity) in [("0.5", 0.5), ("10⁻⁸", 1e-8)] {
            let row = crowd(seed, count, opacity);
            rows.push(row.row(
                THROUGH,
                format!("{count} Gaussians of opacity {name}"),
                1e-4,
            ));
        }
    }
    rows
}

/// Sheets wider than the beam, one behind another over 6 m.
fn crowd(seed: u64, count: usize, opacity: f64) -> Comparison {
    let mut draw = Draw::new(seed, 300);
    let mut scene = Scene::new(true);
    let logit = (opacity / (1.0 - opacity)).ln() as f32;
    for index in 0..count {
        let range_m = 3.0 + 6.0 * index as f32 / count as f32;
        scene.gaussians.push(Parameters {
            log_scale: Vec3::new(0.02, 1.0, 3.0).map(f32::ln),
            opacity_logit: logit,
            ..plain(Vec3::new(range_m, 0.02 * draw.between(-1.0, 1.0), 0.0))
        });
    }
    let truth = scene.twin::<f64>();
    let naive = naive_crowd(&scene, opacity as f32);
    Comparison::of_many(&truth, &scene.program()).with_naive_many(&truth, &naive)
}

/// Each sheet covers the beam nearly whole: one product for all of it.
fn naive_crowd(scene: &Scene, opacity: f32) -> Vec<f32> {
    let through = naive::running_product(&vec![opacity; scene.gaussians.len()]);
    let mut sum = vec![0.0; scene.geometry.bin_count as usize];
    for (index, through) in through.into_iter().enumerate() {
        if through <= 0.0 {
            break;
        }
        let profile = naive::profile(&scene.geometry, &scene.gaussians.get(index));
        for (total, part) in sum.iter_mut().zip(profile) {
            *total += through * part;
        }
    }
    sum
}

pub(super) fn cap(seed: u64, _quick: bool) -> Vec<Row> {
    let mut rows = Vec::new();
    for logit in [4.0, 6.9, 8.0, 10.0, 12.0] {
        let mut draw = Draw::new(seed, 310);
        let mut scene = Scene::new(true);
        for index in 0..12 {
            scene.gaussians.push(Parameters {
                log_scale: Vec3::new(0.02, 0.3, 0.6).map(f32::ln),
                opacity_logit: if index < 2 {
                    logit
                } else {
                    draw.between(-1.0, 1.0)
                },
                ..plain(Vec3::new(
                    3.0 + 0.2 * index as f32,
                    0.0,
                    0.3 * draw.between(-1.0, 1.0),
                ))
            });
        }
        let slope = scene.slope(&mut draw);
        let truth = scene.twin_gradient::<f64>(&slope, &Cutoffs::default());
        let program = scene.program_gradient(&slope);
        let of = |rows: &[[f64; 12]]| rows.iter().map(|row| row[10]).collect::<Vec<_>>();
        let program: Vec<f32> = program.iter().map(|row| row[10]).collect();
        let comparison = Comparison::of_many(&of(&truth), &program);
        let comparison = Comparison {
            naive: Some(naive_rest(logit)),
            ..comparison
        };
        rows.push(comparison.row(CAP, format!("two of logit {logit} in front"), 1e-4));
    }
    rows
}

/// The slope of what is left behind twelve, the first of this logit, and its relative error
/// against the same sum in f64.
fn naive_rest(logit: f32) -> (f64, f64) {
    let opacities = [logit; 12].map(|logit| naive::logistic_and_slope(logit).0);
    let slope = f64::from(naive::slope_of_rest(&opacities));
    let exact = 1.0 / (1.0 + f64::from(logit).exp());
    let truth = -exact.powi(11);
    (slope, (slope / truth - 1.0).abs())
}
