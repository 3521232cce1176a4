use echosplat_model::glam::DMat3;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::*;

fn share(random: &mut SplitMix64) -> f64 {
    (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

fn within(random: &mut SplitMix64, low: f64, high: f64) -> f64 {
    low + (high - low) * share(random)
}

fn sample(random: &mut SplitMix64, at_m: DVec3) -> Sample {
    // About normal: the sum of four.
    let noise =
        |random: &mut SplitMix64| 0.02 * (0..4).map(|_| within(random, -0.85, 0.85)).sum::<f64>();
    Sample {
        at_m: at_m + DVec3::new(noise(random), noise(random), noise(random)),
        covariance_m2: DMat3::from_diagonal(DVec3::splat(0.02 * 0.02)),
        probability: 0.9,
        is_confident: true,
        is_ground: false,
    }
}

/// Ground of 8 by 6 m, a wall, and rods at these places.
fn scene(seed: u64, rods: &[f64], crate_at: Option<DVec3>) -> Vec<Sample> {
    let mut random = SplitMix64::seed_from_u64(seed);
    let r = &mut random;
    let mut places = Vec::new();
    for _ in 0..6_000 {
        places.push(DVec3::new(within(r, 0.0, 8.0), within(r, 0.0, 6.0), -5.0));
    }
    for _ in 0..2_000 {
        places.push(DVec3::new(within(r, 0.0, 8.0), 6.0, within(r, -5.0, -2.0)));
    }
    for x in rods {
        for _ in 0..150 {
            places.push(DVec3::new(*x, 2.0, within(r, -5.0, -2.0)));
        }
    }
    if let Some(at) = crate_at {
        for _ in 0..400 {
            let side = DVec3::new(within(r, 0.0, 0.6), within(r, 0.0, 0.6), 0.6);
            places.push(at + side);
            places.push(at + DVec3::new(0.0, side.x, side.y));
        }
    }
    places.into_iter().map(|at| sample(r, at)).collect()
}

/// As another dive's estimator has it.
fn elsewhere(samples: &[Sample]) -> Vec<Sample> {
    let alignment = Alignment {
        turn_deg: 4.0,
        move_m: DVec3::new(0.5, -0.3, 0.2),
        pivot_m: DVec3::new(4.0, 3.0, -4.0),
        residual_m: 0.0,
        sigma_m: 0.0,
        pairs: 0,
    };
    alignment.apply(samples)
}

#[test]
fn what_did_not_change_is_not_told() {
    let before = scene(1, &[2.0, 4.0, 6.0], None);
    for seed in 2..8 {
        let after = elsewhere(&scene(seed, &[2.0, 4.0, 6.0], None));
        let found = compare(&before, &after).unwrap();
        assert_eq!(found.changes, [], "{seed}");
        assert!((found.alignment.turn_deg + 4.0).abs() < 0.1, "{found:?}");
        assert!(found.alignment.residual_m < 0.15, "{found:?}");
    }
}

#[test]
fn a_rod_that_went_and_a_crate_that_came_are_told_and_nothing_else() {
    let before = scene(1, &[2.0, 4.0, 6.0], None);
    let crate_at = DVec3::new(1.0, 3.5, -5.0);
    let after = elsewhere(&scene(9, &[2.0, 6.0], Some(crate_at)));
    let found = compare(&before, &after).unwrap();
    let kinds: Vec<Kind> = found.changes.iter().map(|change| change.kind).collect();
    assert_eq!(kinds, [Kind::Came, Kind::Went], "{found:?}");
    let [new, gone] = found.changes[..] else {
        return;
    };
    assert!(
        new.at_m.distance(crate_at + DVec3::new(0.2, 0.3, 0.5)) < 0.3,
        "{new:?}"
    );
    assert!(
        gone.at_m
            .truncate()
            .distance(DVec3::new(4.0, 2.0, 0.0).truncate())
            < 0.1
    );
    assert!(gone.size_m.z > 2.0 && gone.sigma_m < 0.4, "{gone:?}");
    // Each place is told what it is part of.
    let count = |all: &[Became], what| all.iter().filter(|became| **became == what).count();
    assert_eq!(count(&found.second, Became::Came), new.count);
    assert_eq!(count(&found.first, Became::Went), gone.count);
    assert_eq!(
        (found.first.len(), found.second.len()),
        (before.len(), after.len())
    );
    let is_rod = |at: DVec3| (at.x - 4.0).abs() < 0.3 && (at.y - 2.0).abs() < 0.3;
    let went = before.iter().zip(&found.first);
    let went = went.filter(|(_, became)| **became == Became::Went);
    assert!(went.into_iter().all(|(sample, _)| is_rod(sample.at_m)));
}

#[test]
fn a_crate_that_was_moved_is_told_with_how_far() {
    let at = DVec3::new(1.0, 3.5, -5.0);
    let by = DVec3::new(1.5, -0.5, 0.0);
    let before = scene(1, &[2.0, 4.0, 6.0], Some(at));
    let after = scene(5, &[2.0, 4.0, 6.0], Some(at + by));
    let found = compare(&before, &after).unwrap();
    let [moved] = found.changes[..] else {
        panic!("{found:?}");
    };
    assert_eq!(moved.kind, Kind::Moved);
    let count = |all: &[Became], what| all.iter().filter(|became| **became == what).count();
    assert!(count(&found.first, Became::MovedFrom) > 100);
    assert_eq!(count(&found.second, Became::MovedTo), moved.count);
    assert!(
        moved.by_m.distance(by) < 2.0 * moved.sigma_m.max(0.05),
        "{moved:?}"
    );
}

#[test]
fn maps_of_two_places_are_not_compared() {
    let here = scene(1, &[2.0], None);
    let mut there = scene(2, &[2.0], None);
    there.iter_mut().for_each(|sample| sample.at_m.x += 50.0);
    assert!(matches!(
        compare(&here, &there),
        Err(SurveyError::Apart { .. })
    ));
    assert!(matches!(
        compare(&here, &[]),
        Err(SurveyError::Apart { .. })
    ));
}

fn with(of: &[Sample], more: impl Iterator<Item = Sample>) -> Vec<Sample> {
    of.iter().copied().chain(more).collect()
}

#[test]
fn a_few_ambiguous_places_far_along_their_arcs_hide_no_change_and_those_all_along_do() {
    let before = scene(1, &[2.0, 4.0, 6.0], None);
    let after = scene(9, &[2.0, 6.0], None);
    let ambiguous = |z: f64| Sample {
        at_m: DVec3::new(4.0, 2.0, z),
        covariance_m2: DMat3::from_diagonal(DVec3::splat(4.0)),
        probability: 0.6,
        is_confident: false,
        is_ground: false,
    };
    let few = with(&after, [-4.5, -3.0].map(ambiguous).into_iter());
    let found = compare(&before, &few).unwrap();
    let kinds: Vec<Kind> = found.changes.iter().map(|change| change.kind).collect();
    assert_eq!(kinds, [Kind::Went], "{found:?}");
    let all = (0..30).map(|i| ambiguous(-5.0 + 0.1 * f64::from(i)));
    let found = compare(&before, &with(&after, all)).unwrap();
    assert_eq!(found.changes, []);
}

#[test]
fn ground_tells_of_no_change_and_explains_only_what_lies_on_it() {
    let at = DVec3::new(1.0, 3.5, -5.0);
    let as_ground = |mut samples: Vec<Sample>| {
        for sample in samples.iter_mut().filter(|sample| sample.at_m.z < -4.85) {
            sample.is_ground = true;
            sample.covariance_m2 = DMat3::from_diagonal(DVec3::new(0.04, 0.04, 0.04));
        }
        samples
    };
    let before = as_ground(scene(1, &[2.0, 4.0, 6.0], None));
    let after = as_ground(scene(5, &[2.0, 4.0, 6.0], Some(at)));
    let found = compare(&before, &after).unwrap();
    let [crate_of_it] = found.changes[..] else {
        panic!("{found:?}");
    };
    assert!(crate_of_it.size_m.z > 0.3, "{crate_of_it:?}");
    // A strip of ground that the first dive did not hear, in reach of what it did.
    let strip = (0..200).map(|i| Sample {
        at_m: DVec3::new(
            8.3 + 0.003 * f64::from(i),
            0.03 * f64::from(i),
            -5.0 + 0.001 * f64::from(i),
        ),
        ..before[0]
    });
    let after = with(&as_ground(scene(7, &[2.0, 4.0, 6.0], None)), strip);
    assert_eq!(compare(&before, &after).unwrap().changes, []);
}
