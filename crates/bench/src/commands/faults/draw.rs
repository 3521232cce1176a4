//! Random moments and bytes as a function of a seed: splitmix64.

/// A stream of numbers that depends on nothing but its seed.
#[derive(Debug, Clone)]
pub(super) struct Draw(u64);

impl Draw {
    /// Streams of two `purpose`s have nothing to do with each other.
    pub(super) fn new(seed: u64, purpose: u64) -> Self {
        Self(seed ^ purpose.wrapping_mul(0xd134_2543_de82_ef95))
    }

    pub(super) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    /// In [low, high).
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.bits() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    pub(super) fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| (self.bits() >> 24) as u8).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_draws_the_same_within_bounds() {
        let draw = |seed, purpose| Draw::new(seed, purpose).between(0.2, 3.0);
        assert_eq!(draw(1, 2).to_bits(), draw(1, 2).to_bits());
        assert!((draw(1, 2) - draw(1, 3)).abs() > 0.0);
        let mut many = Draw::new(5, 0);
        assert!((0..1000).all(|_| (0.2..3.0).contains(&many.between(0.2, 3.0))));
        assert_eq!(many.bytes(7).len(), 7);
    }
}
