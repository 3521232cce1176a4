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
        is_ground: false,
    }
}

/// With `are_alike` the places of each side of each metre err alike, as where poses are off.
fn drawn(noise: &mut Noise, are_alike: bool) -> Drawn {
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
    let mut shared_m = [[0.0; 4]; 6];
    if are_alike {
        for shared_m in shared_m.as_flattened_mut() {
            *shared_m = sigma_m * noise.vector().x;
        }
    }
    let samples = (0..count).map(|index| {
        let up_m = within(noise, 0.0, length_m);
        let angle = begin + within(noise, 0.0, arc);
        let out = across.0 * angle.cos() + across.1 * angle.sin();
        let side = (angle / std::f64::consts::FRAC_PI_2) as usize % 4;
        let along = axis * up_m + out * shared_m[up_m as usize][side];
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

/// Of 40 piles how many are within two sigma in radius and lean; median sigmas, metres and degrees.
fn hits(noise: &mut Noise, are_alike: bool) -> (usize, f64, f64) {
    let mut sigmas_m = Vec::new();
    let mut sigmas_deg = Vec::new();
    let mut hits = 0;
    for _ in 0..40 {
        let pile = drawn(noise, are_alike);
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
    (hits, median(&mut sigmas_m), median(&mut sigmas_deg))
}

#[test]
fn piles_are_within_two_sigma_of_what_they_are_whether_or_not_places_err_alike() {
    let mut noise = Noise(7);
    for are_alike in [false, true] {
        let (hits, sigma_m, sigma_deg) = hits(&mut noise, are_alike);
        assert!(hits >= 36, "{hits} of 40");
        assert!(sigma_m <= 0.03, "{sigma_m} m");
        assert!(sigma_deg <= 1.0, "{sigma_deg} degrees");
    }
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
