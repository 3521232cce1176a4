//! Names for bits.

use std::fmt;
use std::hash::Hasher;

use echosplat_model::{Snapshot, Standing};
use fnv::FnvHasher;

/// FNV-1a of 64 bits, shown in hexadecimal: the same on every machine and in every release, and
/// no proof against anyone who wants two things to have the same name.
#[derive(Default)]
pub(crate) struct Fingerprint(FnvHasher);

impl Hasher for Fingerprint {
    fn write(&mut self, bytes: &[u8]) {
        self.0.write(bytes);
    }

    fn finish(&self) -> u64 {
        self.0.finish()
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.finish())
    }
}

impl Fingerprint {
    /// Of all that a map says: its origin, its unit, and every Gaussian in order.
    pub(crate) fn of_map(map: &Snapshot) -> Self {
        let mut bits = Self::default();
        for number in map.origin_m.to_array() {
            bits.write(&number.to_bits().to_le_bytes());
        }
        bits.write(&map.intensity_unit.to_bits().to_le_bytes());
        for gaussian in &map.gaussians {
            let g = gaussian;
            bits.write(&g.id.to_le_bytes());
            bits.write(&[u8::from(g.standing == Standing::Confident)]);
            let places = g.mean_m.to_array().into_iter().chain(g.scale_m.to_array());
            let rest = [g.opacity, g.reflectivity, g.sigma_m];
            for number in places.chain(g.rotation.to_array()).chain(rest) {
                bits.write(&number.to_bits().to_le_bytes());
            }
        }
        bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_published_function() {
        let mut bits = Fingerprint::default();
        assert_eq!(bits.to_string(), "cbf29ce484222325");
        bits.write(b"foobar");
        assert_eq!(bits.to_string(), "85944171f73967e8");
    }
}
