use echosplat_model::glam::DMat3;

use super::solve::Noise;
use super::*;

/// A pile as a map has it: one side of it, in patches, with noise and some that is not of it.
struct Drawn {
    samples: Vec<Sample>,
    radius_m: f64,
    lean_deg: [f64; 2],
}

fn sample(at_m: DVec3, sigma_m: f64) -> Sample {
    Sample {
        at_m,
        covariance_m2: DMat3::from_diagonal(DVec3::splat(sigma_m * sigma_m)),
        probability: 0.9,
        is_confident: true,
    }
}

fn drawn(noise: &mut Noise) -> Drawn {
    let within = |noise: &mut Noise, low: f64, high: f64| low + (high - low) * noise.share();
    let radius_m = within(noise, 0.1, 0.5);
    let lean = within(noise, 0.0, 10.0_f64).to_radians();
    let towards = within(noise, 0.0, std::f64::consts::TAU);
    let slope = lean.tan() * DVec2::from_angle(towards);
    let axis = slope.extend(1.0).normalize();
    let across = axis.any_orthonormal_pair();
    let length_m = within(noise, 2.0, 5.0);
    let arc = within(noise, 100.0, 200.0_f64).to_radians();
    let begin = within(noise, 0.0, std::f64::consts::TAU);
    let count = within(noise, 200.0, 700.0) as usize;
    let sigma_m = within(noise, 0.01, 0.03);
    let foot = DVec3::new(
        within(noise, -50.0, 50.0),
        within(noise, -50.0, 50.0),
        -10.0,
    );
    let samples = (0..count).map(|index| {
        let along = axis * within(noise, 0.0, length_m);
        let angle = begin + within(noise, 0.0, arc);
        let out = across.0 * angle.cos() + across.1 * angle.sin();
        let stray = if index % 40 == 0 {
            0.3 * noise.vector()
        } else {
            DVec3::ZERO
        };
        sample(
            foot + along + radius_m * out + sigma_m * noise.vector() + stray,
            sigma_m,
        )
    });
    Drawn {
        samples: samples.collect(),
        radius_m,
        lean_deg: [slope.x, slope.y].map(|slope| slope.atan().to_degrees()),
    }
}

#[test]
fn piles_are_within_two_sigma_of_what_they_are() {
    let mut noise = Noise(7);
    let mut sigmas_m = Vec::new();
    let mut sigmas_deg = Vec::new();
    let mut hits = 0;
    for _ in 0..40 {
        let pile = drawn(&mut noise);
        let found = fit_cylinder(&pile.samples).expect("a pile is drawn");
        let within = |told: Told, truth: f64| (told.value - truth).abs() <= 2.0 * told.sigma;
        let is_hit = within(found.radius_m, pile.radius_m)
            && within(found.lean_deg[0], pile.lean_deg[0])
            && within(found.lean_deg[1], pile.lean_deg[1]);
        hits += usize::from(is_hit);
        sigmas_m.push(found.radius_m.sigma);
        sigmas_deg.extend(found.lean_deg.map(|lean| lean.sigma));
    }
    let median = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let (sigma_m, sigma_deg) = (median(&mut sigmas_m), median(&mut sigmas_deg));
    assert!(hits >= 36, "{hits} of 40");
    assert!(sigma_m <= 0.03, "{sigma_m} m");
    assert!(sigma_deg <= 1.0, "{sigma_deg} degrees");
}

#[test]
fn what_is_no_pile_is_said() {
    let few: Vec<Sample> = (0..5)
        .map(|i| sample(DVec3::Z * f64::from(i), 0.01))
        .collect();
    assert!(matches!(fit_cylinder(&few), Err(SurveyError::Few { .. })));
    let flat =
        (0..900).map(|i| sample(DVec3::new(f64::from(i % 30), f64::from(i / 30), 0.0), 0.01));
    let flat: Vec<Sample> = flat.collect();
    assert!(matches!(
        fit_cylinder(&flat),
        Err(SurveyError::Unlike { .. })
    ));
}
