//! Numbers drawn from a seed: splitmix64 (Steele, Lea and Flood 2014).

use glam::{Quat, Vec3};

/// A stream of numbers that depends on its seed and nothing else.
#[derive(Debug, Clone)]
pub(crate) struct Draw(u64);

impl Draw {
    /// `purpose` keeps the streams of different rows apart.
    pub(crate) fn new(seed: u64, purpose: u64) -> Self {
        Self(seed ^ purpose.wrapping_mul(0xd6e8_feb8_6659_fd93))
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [low, high).
    pub(crate) fn between(&mut self, low: f32, high: f32) -> f32 {
        let unit = (self.next() >> 40) as f32 * (1.0 / (1u64 << 24) as f32);
        low + (high - low) * unit
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
            let x = draw.between(-2.0, 3.0);
            assert!((-2.0..3.0).contains(&x));
            assert!((draw.rotation().length() - 1.0).abs() < 1e-5);
        }
        assert_ne!(Draw::new(1, 2).next(), Draw::new(1, 3).next());
        assert_ne!(Draw::new(1, 2).next(), Draw::new(2, 2).next());
    }
}
