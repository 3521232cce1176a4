//! Curves made up, for tests of what shows and judges them.

use glam::DVec3;

use crate::curve::{Curve, Sample};
use crate::{MapPoints, Truth, evaluate_raw};

/// A run whose error, in metres, is `scale` over the dive time in seconds: one sample every ten, the
/// first of an empty map.
#[must_use]
pub fn run(method: &str, seed: u64, scale: f64, count: usize) -> Curve {
    let truth = Truth::from_points(&[DVec3::ZERO]);
    let sample = |index: usize| {
        let dive_s = 10.0 * index as f64;
        let point = DVec3::X * (scale / dive_s);
        let map = MapPoints::of_positions((index > 0).then_some(point));
        Sample {
            dive_s,
            compute_s: 0.01 * dive_s * scale,
            pair_count: 1000 * index as u64,
            voxel_observations: 10_000 * index as u64,
            ping_count: 580 * index as u64,
            metrics: evaluate_raw(&map, &truth),
        }
    };
    Curve {
        samples: (0..count).map(sample).collect(),
        ..Curve::new(method, seed)
    }
}
