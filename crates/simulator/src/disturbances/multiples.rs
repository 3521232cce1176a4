//! Every echo once more at a constant multiple of its range: sound that goes to and fro between structure and vehicle, or
//! a receiver that hears more than one frequency.

use echosplat_model::PingSettings;

use super::power;

/// Echoes at a multiple of their range, drawn out as their range is.
///
/// Each has a speckle of its own, as copies have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EchoMultiples {
    /// Range over that of the source, 1 to 10; 1 is no multiple. Once more to and fro is 2.
    pub ratio: f64,
    /// Weaker by this, decibels, 0 to 60; 15 by default, chosen.
    pub weaker_db: f64,
}

impl Default for EchoMultiples {
    fn default() -> Self {
        Self {
            ratio: 1.0,
            weaker_db: 15.0,
        }
    }
}

impl EchoMultiples {
    /// Adds the multiples to power per bin; what lies beyond the last bin is lost.
    pub(crate) fn add_to(&self, echoes: &mut [f64], settings: &PingSettings) {
        self.add_of_strong(echoes, settings, 0.0);
    }

    /// The same, of bins with more power than `strong`.
    pub(crate) fn add_of_strong(&self, echoes: &mut [f64], settings: &PingSettings, strong: f64) {
        if !(self.ratio > 1.0) {
            return;
        }
        let factor = power(-self.weaker_db);
        let position = |edge: usize| {
            (self.ratio * settings.bin_edge_m(edge) - settings.range_start_m)
                / settings.bin_length_m()
        };
        let sources = echoes.to_vec();
        let sources = sources.into_iter().enumerate();
        for (bin, source) in sources.filter(|&(_, source)| source > strong) {
            let (from, to) = (position(bin), position(bin + 1));
            let end = (to.ceil() as usize).min(echoes.len());
            for (at, power) in echoes.iter_mut().enumerate().take(end).skip(from as usize) {
                let overlap = to.min((at + 1) as f64) - from.max(at as f64);
                *power += factor * source * overlap.max(0.0) / (to - from);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn added(ratio: f64, at: usize) -> Vec<f64> {
        let settings = PingSettings {
            range_start_m: 1.0,
            range_length_m: 4.0,
            bin_count: 200,
            speed_of_sound_mps: 1500.0,
            frequency_hz: 450e3,
            pulse_duration_s: 2e-5,
            gain_index: 0,
        };
        let multiples = EchoMultiples {
            ratio,
            weaker_db: 10.0,
        };
        let mut echoes = vec![0.0; 200];
        echoes[at] = 2.0;
        multiples.add_to(&mut echoes, &settings);
        echoes
    }

    #[test]
    fn a_multiple_lies_at_its_ratio_drawn_out_with_its_share_of_the_energy() {
        // From 2 to 2.02 m: at twice that from 4 to 4.04 m.
        let echoes = added(2.0, 50);
        let lit: Vec<usize> = (0..200).filter(|&bin| echoes[bin] > 1e-9).collect();
        assert_eq!(lit, [50, 150, 151]);
        assert!((echoes[150] - 0.1).abs() < 1e-9 && (echoes[151] - 0.1).abs() < 1e-9);
        assert!((echoes[50] - 2.0).abs() < 1e-12);
        // From 2.6 to 2.626 m.
        let echoes = added(1.3, 50);
        let energy: f64 = echoes[80..82].iter().sum();
        assert!((energy - 0.2).abs() < 1e-9, "{energy}");
    }

    #[test]
    fn nothing_is_added_beyond_the_last_bin_or_at_a_ratio_of_one() {
        for (ratio, at) in [(2.0, 150), (1.0, 50)] {
            let echoes = added(ratio, at);
            assert!((echoes.iter().sum::<f64>() - 2.0).abs() < 1e-12);
        }
    }
}
