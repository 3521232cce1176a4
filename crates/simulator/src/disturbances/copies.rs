//! Every echo once more at a constant offset in range: the way round by the vehicle's hull or frame, or a
//! second pulse that leaves the transducer.

use super::power;

/// Copies of every echo, later by a constant range.
///
/// A copy has a speckle of its own: the other way round adds the same scatterers with other phases.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EchoCopies {
    /// Further away by this, metres, 0 to 100; 0 is no copy. A plate of the vehicle d behind the
    /// transducer gives 2d.
    pub offset_m: f64,
    /// Weaker by this, decibels, 0 to 60; 10 by default, chosen.
    pub weaker_db: f64,
}

impl Default for EchoCopies {
    fn default() -> Self {
        Self {
            offset_m: 0.0,
            weaker_db: 10.0,
        }
    }
}

impl EchoCopies {
    /// Adds the copies to power per bin; what lies beyond the last bin is lost.
    pub(crate) fn add_to(&self, echoes: &mut [f64], bin_length_m: f64) {
        if !(self.offset_m > 0.0) {
            return;
        }
        let shift_bins = self.offset_m / bin_length_m;
        let (whole, share) = (shift_bins as usize, shift_bins.fract());
        let factor = power(-self.weaker_db);
        let sources = echoes.to_vec();
        let copied = echoes.iter_mut().skip(whole);
        let mut before = 0.0;
        for (power, source) in copied.zip(&sources) {
            // A shift by a fraction of a bin falls into two of them.
            *power += factor * ((1.0 - share) * source + share * before);
            before = *source;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_lies_at_its_offset_with_its_share_of_the_power() {
        let mut echoes = vec![0.0; 200];
        echoes[50] = 2.0;
        echoes[190] = 1.0;
        let copies = EchoCopies {
            offset_m: 1.3,
            weaker_db: 10.0,
        };
        // 1.3 m are 65 bins of 2 cm, 52 of 2.5 cm.
        copies.add_to(&mut echoes, 0.02);
        let lit: Vec<usize> = (0..200).filter(|&bin| echoes[bin] > 1e-9).collect();
        assert_eq!(lit, [50, 115, 190]);
        assert!((echoes[115] - 0.2).abs() < 1e-12 && (echoes[50] - 2.0).abs() < 1e-12);
    }

    #[test]
    fn a_fraction_of_a_bin_is_shared_by_two_and_the_energy_kept() {
        let mut echoes = vec![0.0; 100];
        echoes[10] = 1.0;
        let copies = EchoCopies {
            offset_m: 0.505,
            weaker_db: 6.0,
        };
        copies.add_to(&mut echoes, 0.02);
        // 25.25 bins on.
        assert!((echoes[35] / echoes[36] - 3.0).abs() < 1e-9);
        assert!((echoes[35] + echoes[36] - 10f64.powf(-0.6)).abs() < 1e-12);
    }

    #[test]
    fn without_an_offset_nothing_changes() {
        let mut echoes = vec![0.25, 0.5];
        EchoCopies::default().add_to(&mut echoes, 0.02);
        assert_eq!(echoes, [0.25, 0.5]);
    }
}
