//! Random numbers as pure functions of (seed, purpose, index).

use glam::{DVec2, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a stream of random numbers is for; no two purposes share numbers.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    Surface = 1,
    Rays = 2,
    Noise = 3,
    PoseNoise = 4,
    Plan = 5,
    GainWalk = 6,
    Speckle = 7,
    PoseWalk = 8,
    Spikes = 9,
    Walker = 10,
    Fish = 11,
}

/// A stream that depends on nothing but its three keys.
pub(crate) struct Random {
    generator: ChaCha8Rng,
}

impl Random {
    pub(crate) fn new(seed: u64, purpose: Purpose, index: u64) -> Self {
        let mut key = [0u8; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..16].copy_from_slice(&(purpose as u64).to_le_bytes());
        key[16..24].copy_from_slice(&index.to_le_bytes());
        Self {
            generator: ChaCha8Rng::from_seed(key),
        }
    }

    /// In [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        (self.generator.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// In [low, high).
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Mean 1.
    pub(crate) fn exponential(&mut self) -> f64 {
        -(1.0 - self.unit()).ln()
    }

    /// Mean 1, variance 1 / `looks`: the mean power of that many independent looks at speckle.
    pub(crate) fn speckle(&mut self, looks: u32) -> f64 {
        let product: f64 = (0..looks).map(|_| 1.0 - self.unit()).product();
        -product.max(f64::MIN_POSITIVE).ln() / f64::from(looks)
    }

    /// Mean 0, variance 1 (Box–Muller).
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (2.0 * self.exponential()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }

    /// A complex number, real part first, of mean 0 and mean squared magnitude 1: the amplitude of
    /// many waves of random phase.
    pub(crate) fn amplitude(&mut self) -> DVec2 {
        let magnitude = self.exponential().sqrt();
        magnitude * DVec2::from_angle(std::f64::consts::TAU * self.unit())
    }

    /// Three of [`Self::normal`].
    pub(crate) fn normal3(&mut self) -> DVec3 {
        DVec3::new(self.normal(), self.normal(), self.normal())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(mut draw: impl FnMut() -> f64) -> (f64, f64) {
        let values: Vec<f64> = (0..200_000).map(|_| draw()).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        (mean, square / values.len() as f64)
    }

    #[test]
    fn the_distributions_have_their_moments() {
        let mut random = Random::new(1, Purpose::Noise, 0);
        let near = |(mean, variance): (f64, f64), m: f64, v: f64| {
            (mean - m).abs() < 0.03 && (variance - v).abs() < 0.03 * v.max(1.0)
        };
        assert!(near(moments(|| random.exponential()), 1.0, 1.0));
        assert!(near(moments(|| random.normal()), 0.0, 1.0));
        assert!(near(
            moments(|| random.amplitude().length_squared()),
            1.0,
            1.0
        ));
        assert!(near(moments(|| random.amplitude().y), 0.0, 0.5));
        for looks in [1, 4] {
            let (mean, variance) = moments(|| random.speckle(looks));
            assert!((mean - 1.0).abs() < 0.03);
            assert!((variance * f64::from(looks) - 1.0).abs() < 0.06);
        }
    }

    #[test]
    fn streams_differ_by_every_key() {
        let first = |seed, purpose, index| Random::new(seed, purpose, index).unit();
        let base = first(1, Purpose::Noise, 2);
        assert_eq!(base.to_bits(), first(1, Purpose::Noise, 2).to_bits());
        assert!((base - first(2, Purpose::Noise, 2)).abs() > 0.0);
        assert!((base - first(1, Purpose::Rays, 2)).abs() > 0.0);
        assert!((base - first(1, Purpose::Noise, 3)).abs() > 0.0);
    }
}
