//! Scenes to try and to measure on: the same for the same seed on every machine.

use echosplat_model::glam::{Mat3, Quat, Vec3};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use crate::{Beam, GaussianArrays, Parameters, PingGeometry, PingPose};

/// Gaussians in view in [`bench_scene`]; layout.
pub const BENCH_GAUSSIANS: usize = 2_000;

/// A sequence of even numbers: samples need no better generator.
#[derive(Debug, Clone)]
pub struct Numbers(SplitMix64);

impl Numbers {
    /// A sequence of its own for every seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::seed_from_u64(seed))
    }

    /// 64 even bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Even between `low` and `high`.
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        let unit = (self.bits() >> 40) as f32 / (1u64 << 24) as f32;
        low + (high - low) * unit
    }

    /// A direction's turn, even enough for samples.
    pub fn rotation(&mut self) -> Quat {
        let mut part = || self.between(-1.0, 1.0);
        let raw = [part(), part(), part(), part()];
        let length = raw.iter().map(|x| x * x).sum::<f32>().sqrt();
        if length > 0.1 {
            Quat::from_array(raw.map(|x| x / length))
        } else {
            Quat::IDENTITY
        }
    }
}

/// A ping's geometry: it looks along x from the map's origin: 600 bins of 2 cm, the default beam,
/// with 1 cm and 0.2° of doubt about its pose, a vehicle that moves and turns while it listens.
#[must_use]
pub fn geometry() -> PingGeometry {
    PingGeometry {
        pose: PingPose {
            position_m: Vec3::ZERO,
            axes: Mat3::IDENTITY,
            drift_per_m: Vec3::new(1e-4, 2e-4, -1e-4),
            reference_range_m: 6.0,
        },
        range_start_m: 0.0,
        bin_length_m: 0.02,
        bin_count: 600,
        range_variance_m2: 1e-4,
        azimuth_variance_rad2: 1.2e-5,
        beam: Beam::default(),
    }
}

/// A ping that sees [`BENCH_GAUSSIANS`] Gaussians of 2 to 10 cm at 3 to 11 m, 12 to 40 bins each,
/// all of them in view: what a crowded map asks of the kernels.
#[must_use]
pub fn bench_scene(seed: u64) -> (PingGeometry, GaussianArrays) {
    let geometry = geometry();
    let mut numbers = Numbers::new(seed);
    let mut arrays = GaussianArrays::with_capacity(BENCH_GAUSSIANS);
    for _ in 0..BENCH_GAUSSIANS {
        arrays.push(in_view(&mut numbers, 3.0, 11.0, [0.02, 0.1]));
    }
    (geometry, arrays)
}

/// A Gaussian inside the beam of [`geometry`], its sigmas between those of `sigma_m`.
pub fn in_view(numbers: &mut Numbers, near_m: f32, far_m: f32, sigma_m: [f32; 2]) -> Parameters {
    let range_m = numbers.between(near_m, far_m);
    let elevation = numbers.between(-0.4, 0.4);
    let azimuth = numbers.between(-0.01, 0.01);
    let lever_m = range_m * elevation.cos();
    let mean_m = Vec3::new(
        lever_m * azimuth.cos(),
        lever_m * azimuth.sin(),
        range_m * elevation.sin(),
    );
    let [low, high] = sigma_m.map(f32::ln);
    let mut log = || numbers.between(low, high);
    let log_scale = Vec3::new(log(), log(), log());
    Parameters {
        mean_m,
        rotation: numbers.rotation(),
        log_scale,
        opacity_logit: numbers.between(-3.0, 3.0),
        reflectivity_log: numbers.between(-3.0, 0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_is_a_scene_and_all_of_it_is_in_view() {
        let (geometry, arrays) = bench_scene(7);
        assert_eq!(bench_scene(7).1, arrays);
        assert_ne!(bench_scene(8).1, arrays);
        let mut pairs = 0;
        for i in 0..arrays.len() {
            let one = arrays.get(i);
            let splat = geometry.project(one.mean_m, &one.covariance_m2()).unwrap();
            pairs += geometry.bins_of(&splat).len();
        }
        let mean = pairs as f32 / arrays.len() as f32;
        assert!((12.0..45.0).contains(&mean), "{mean} bins each");
    }
}
