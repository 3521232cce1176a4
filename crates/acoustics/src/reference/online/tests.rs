//! The twin against an independent projection and against differences of itself.

use super::*;
use crate::sample::{self, Numbers as Dice};
use crate::{GaussianArrays, Parameters, reference};
use echosplat_model::glam::{DMat3, DQuat, DVec3, Mat3, Quat, Vec3};

/// Nothing cut: what lies beyond 9 sigmas is below 10⁻¹⁷.
const UNCUT: Cutoffs = Cutoffs {
    range_sigmas: 9.0,
    raster_sigmas: 9.0,
    least_transmittance: 0.0,
};

const GAUSSIANS: usize = 4;

/// A few Gaussians one behind another, at least 5 cm apart, seen under any pose, beam and drift.
fn shadowing_scene(dice: &mut Dice) -> (PingGeometry, GaussianArrays) {
    let mut geometry = sample::geometry();
    geometry.range_start_m = 3.2;
    geometry.bin_count = 120;
    geometry.range_variance_m2 = dice.between(0.005, 0.03).powi(2);
    geometry.azimuth_variance_rad2 = dice.between(0.0, 0.01).powi(2);
    geometry.beam.azimuth_width_deg = dice.between(0.5, 2.0);
    geometry.beam.elevation_width_deg = dice.between(4.0, 8.0);
    let mut small = |size: f32| Vec3::from_array([0; 3].map(|_| dice.between(-size, size)));
    geometry.pose.drift_per_m = small(3e-3);
    geometry.pose.position_m = small(10.0);
    geometry.pose.axes = Mat3::from_quat(dice.rotation());
    let mut arrays = GaussianArrays::new();
    for place in 0..GAUSSIANS {
        let near_m = 3.5 + 0.4 * place as f32;
        let mut one = sample::in_view(dice, near_m, near_m + 0.35, [0.02, 0.1]);
        one.mean_m.z = one.mean_m.x * dice.between(-0.03, 0.03);
        one.mean_m = geometry.pose.position_m + geometry.pose.axes * one.mean_m;
        one.rotation *= dice.between(0.3, 3.0);
        arrays.push(one);
    }
    (geometry, arrays)
}

/// Step of each parameter: small against the centimetres over which anything changes.
fn step(parameter: usize, gaussian: &Numbers<f64>) -> f64 {
    match parameter {
        0..3 => 2e-5,
        3..7 => 2e-4 * gaussian[3..7].iter().map(|q| q * q).sum::<f64>().sqrt(),
        _ => 3e-4,
    }
}

/// Central differences of two sizes, extrapolated: error of fourth order, 10⁻⁹ here.
fn difference(loss: impl Fn(f64) -> f64, step: f64) -> f64 {
    let slope = |h: f64| (loss(h) - loss(-h)) / (2.0 * h);
    (4.0 * slope(step) - slope(2.0 * step)) / 3.0
}

/// Largest relative error of analytic gradients in the scene of `seed`, per parameter against the
/// larger of its difference and 10⁻⁴ of the Gaussian's largest; and of the difference itself.
fn worst_errors(seed: u64) -> (f64, f64) {
    let mut dice = Dice::new(seed);
    let (geometry, arrays) = shadowing_scene(&mut dice);
    let gaussians = numbers_of::<f64>(&arrays);
    let visible: Vec<u32> = (0..GAUSSIANS as u32).collect();
    let weights: Vec<f64> = (0..geometry.bin_count)
        .map(|_| f64::from(dice.between(-1.0, 1.0)))
        .collect();
    let loss = |gaussians: &[Numbers<f64>]| {
        let rendering = forward(&geometry, gaussians, &visible, true, &UNCUT);
        assert_eq!(rendering.rows.len(), GAUSSIANS, "seed {seed}");
        let terms = rendering.intensity.iter().zip(&weights);
        terms.map(|(i, w)| i * w).sum::<f64>()
    };
    let rendering = forward(&geometry, &gaussians, &visible, true, &UNCUT);
    let gradients = backward(&geometry, &gaussians, &rendering, &weights);
    let (mut worst, mut worst_difference) = (0f64, 0f64);
    for (i, gradient) in gradients.iter().enumerate() {
        let largest = gradient.iter().fold(0f64, |most, g| most.max(g.abs()));
        for (k, &found) in gradient.iter().enumerate() {
            let moved = |by: f64| {
                let mut gaussians = gaussians.clone();
                gaussians[i][k] += by;
                loss(&gaussians)
            };
            let h = step(k, &gaussians[i]);
            let expected = difference(moved, h);
            let scale = expected.abs().max(1e-4 * largest);
            worst = worst.max((found - expected).abs() / scale);
            if seed % 50 < 2 {
                let coarser = difference(moved, 2.0 * h);
                worst_difference = worst_difference.max((coarser - expected).abs() / scale);
            }
        }
    }
    (worst, worst_difference)
}

fn check_gradients(seeds: impl Iterator<Item = u64>) {
    let (mut worst, mut worst_difference) = (0f64, 0f64);
    for seed in seeds {
        let (error, of_difference) = worst_errors(seed);
        assert!(error < 1e-5, "seed {seed}: {error:e}");
        worst = worst.max(error);
        worst_difference = worst_difference.max(of_difference);
    }
    println!("worst {worst:e}, of the difference {worst_difference:e}");
    // A difference of twice the step errs sixteen times as much.
    assert!(worst_difference < 1.6e-6, "{worst_difference:e}");
}

#[test]
fn gradients_are_the_differences_in_even_scenes() {
    check_gradients((0..1000).step_by(2));
}

#[test]
fn gradients_are_the_differences_in_odd_scenes() {
    check_gradients((1..1000).step_by(2));
}

#[test]
fn gaussians_of_those_scenes_shadow_one_another() {
    let shadowed = (0..100).filter(|&seed| {
        let (geometry, arrays) = shadowing_scene(&mut Dice::new(seed));
        let gaussians = numbers_of::<f64>(&arrays);
        let rendering = forward(
            &geometry,
            &gaussians,
            &[0, 1, 2, 3],
            true,
            &Cutoffs::default(),
        );
        rendering.rows.iter().any(|row| row.transmittance < 0.8)
    });
    assert!(shadowed.count() > 60);
}

/// Against the projection by Jacobian and full matrices.
#[test]
fn one_gaussian_is_what_the_jacobian_makes_of_it() {
    let mut dice = Dice::new(0);
    let mut geometry = sample::geometry();
    geometry.pose.drift_per_m = Vec3::ZERO;
    for case in 0..200 {
        let mut arrays = GaussianArrays::new();
        arrays.push(sample::in_view(&mut dice, 2.0, 11.0, [0.005, 0.2]));
        let gaussian = numbers_of::<f64>(&arrays)[0];
        let found = forward(&geometry, &[gaussian], &[0], false, &UNCUT).intensity;
        let [mx, my, mz, qx, qy, qz, qw, sx, sy, sz, logit, log] = gaussian;
        let rotation = DMat3::from_quat(DQuat::from_xyzw(qx, qy, qz, qw).normalize());
        let axes = rotation * DMat3::from_diagonal(DVec3::new(sx, sy, sz).map(f64::exp));
        let strength = opacity_of(logit) * log.exp();
        let mean_m = DVec3::new(mx, my, mz);
        let expected = reference::render(&geometry, mean_m, axes * axes.transpose());
        let peak = expected.iter().copied().fold(0.0, f64::max) * strength;
        for (a, b) in found.iter().zip(&expected) {
            let error = (a - b * strength).abs() / peak;
            assert!(error < 1e-11, "case {case}: {a} against {b}: {error:e}");
        }
    }
}

#[test]
fn the_nearer_shadows_the_farther_and_never_the_other_way() {
    let geometry = sample::geometry();
    let plate = |range_m: f32, logit: f32| Parameters {
        mean_m: Vec3::new(range_m, 0.0, 0.0),
        rotation: Quat::IDENTITY,
        log_scale: Vec3::new(0.01, 5.0, 5.0).map(f32::ln),
        opacity_logit: logit,
        reflectivity_log: 0.0,
    };
    let mut arrays = GaussianArrays::new();
    arrays.push(plate(6.0, 0.0));
    arrays.push(plate(5.0, 0.0));
    let gaussians = numbers_of::<f64>(&arrays);
    let rows = forward(&geometry, &gaussians, &[1, 0], true, &Cutoffs::default()).rows;
    assert!((rows[1].transmittance - 1.0).abs() < 1e-12);
    assert!(
        (rows[0].transmittance - 0.5).abs() < 0.05,
        "{}",
        rows[0].transmittance
    );
}
