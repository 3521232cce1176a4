//! Many in one place, and sizes that have nothing to do with each other.

use echosplat_acoustics::Parameters;
use glam::Vec3;

use super::Row;
use super::naive;
use super::row::{Comparison, Label};
use super::scene::{Scene, plain};
use crate::draw::Draw;

const LABEL: Label = Label {
    case: "crowds and mixed sizes",
    quantity: "intensity of the worst bin, errors relative to the profile's peak",
    why: "Order is by range and then by index; logarithms of transmittance add up with \
          compensation; work is bounded by Gaussians times bins.",
};

pub(super) fn rows(seed: u64, quick: bool) -> Vec<Row> {
    let count = if quick { 1_000 } else { 10_000 };
    let mut rows = vec![nothing()];
    for occlusion in [false, true] {
        let way = if occlusion { "with occlusion" } else { "T = 1" };
        let same = coincident(count, occlusion);
        rows.push(compare(&same).row(LABEL, format!("{count} in one place, {way}"), 2e-4));
        let mixed = mixed(seed, count / 50, occlusion);
        rows.push(compare(&mixed).row(LABEL, format!("1 mm to 100 m, {way}"), 2e-4));
    }
    rows
}

fn nothing() -> Row {
    let scene = Scene::new(true);
    let truth = vec![0.0; scene.geometry.bin_count as usize];
    Comparison::of_many(&truth, &scene.program()).row(LABEL, "no Gaussian", 0.0)
}

fn coincident(count: usize, occlusion: bool) -> Scene {
    let mut scene = Scene::new(occlusion);
    for _ in 0..count {
        scene.gaussians.push(Parameters {
            opacity_logit: -6.0,
            ..plain(Vec3::new(5.0, 0.01, 0.3))
        });
    }
    scene
}

fn mixed(seed: u64, count: usize, occlusion: bool) -> Scene {
    let mut draw = Draw::new(seed, 400);
    let mut scene = Scene::new(occlusion);
    for index in 0..count {
        let log_scale = match index % 4 {
            0 => 100_f32.ln(),
            _ => draw.between(0.001_f32.ln(), 0.1_f32.ln()),
        };
        let range_m = draw.between(2.0, 9.0);
        scene.gaussians.push(Parameters {
            log_scale: Vec3::splat(log_scale),
            opacity_logit: if index % 4 == 0 { -8.0 } else { 0.0 },
            // What is huge sends back as little as the rest, so that both show.
            reflectivity_log: if index % 4 == 0 { -12.0 } else { -0.5 },
            ..plain(Vec3::new(
                range_m,
                0.0,
                0.1 * range_m * draw.between(-1.0, 1.0),
            ))
        });
    }
    scene
}

/// Program and twin; the naive way without occlusion only, where it is one.
fn compare(scene: &Scene) -> Comparison {
    let truth = scene.twin::<f64>();
    let comparison = Comparison::of_many(&truth, &scene.program());
    match scene.occlusion {
        true => comparison.with_naive_many(&truth, &scene.twin::<f32>()),
        false => comparison.with_naive_many(&truth, &sum(scene)),
    }
}

fn sum(scene: &Scene) -> Vec<f32> {
    let mut sum = vec![0.0; scene.geometry.bin_count as usize];
    for index in 0..scene.gaussians.len() {
        let profile = naive::profile(&scene.geometry, &scene.gaussians.get(index));
        sum.iter_mut()
            .zip(profile)
            .for_each(|(total, part)| *total += part);
    }
    sum
}
