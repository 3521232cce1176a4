//! Numbers drawn from a seed.

use glam::{Quat, Vec3};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// A stream of numbers that depends on its seed and nothing else.
#[derive(Debug, Clone)]
pub(crate) struct Draw(SplitMix64);

impl Draw {
    /// `purpose` keeps streams of one seed apart.
    pub(crate) fn new(seed: u64, purpose: u64) -> Self {
        let seed = seed ^ purpose.wrapping_mul(0xd6e8_feb8_6659_fd93);
        Self(SplitMix64::seed_from_u64(seed))
    }

    /// 64 even bits.
    pub(crate) fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// In [low, high).
    pub(crate) fn between(&mut self, low: f32, high: f32) -> f32 {
        let unit = (self.bits() >> 40) as f32 * (1.0 / (1u64 << 24) as f32);
        low + (high - low) * unit
    }

    /// In [low, high), to the last bit.
    pub(crate) fn finely_between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.bits() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    pub(crate) fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        self.0.fill_bytes(&mut bytes);
        bytes
    }

    /// Each component in [−1, 1).
    pub(crate) fn cube(&mut self) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|_| self.between(-1.0, 1.0)))
    }

    /// Any rotation, each as likely as another (Marsaglia 1972).
    pub(crate) fn rotation(&mut self) -> Quat {
        let pair = |draw: &mut Self| loop {
            let (a, b) = (draw.between(-1.0, 1.0), draw.between(-1.0, 1.0));
            let s = a * a + b * b;
            if s < 1.0 && s > 0.0 {
                return (a, b, s);
            }
        };
        let ((x, y, s), (z, w, t)) = (pair(self), pair(self));
        let k = ((1.0 - s) / t).sqrt();
        Quat::from_xyzw(x, y, z * k, w * k)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stay_in_bounds_and_rotations_are_unit() {
        let mut draw = Draw::new(1, 2);
        for _ in 0..1000 {
            assert!((-2.0..3.0).contains(&draw.between(-2.0, 3.0)));
            assert!((0.2..3.0).contains(&draw.finely_between(0.2, 3.0)));
            assert!((draw.rotation().length() - 1.0).abs() < 1e-5);
        }
        assert_eq!(draw.bytes(7).len(), 7);
    }

    #[test]
    fn seeds_and_purposes_have_streams_of_their_own() {
        assert_eq!(Draw::new(1, 2).bits(), Draw::new(1, 2).bits());
        assert_ne!(Draw::new(1, 2).bits(), Draw::new(1, 3).bits());
        assert_ne!(Draw::new(1, 2).bits(), Draw::new(2, 2).bits());
    }
}
