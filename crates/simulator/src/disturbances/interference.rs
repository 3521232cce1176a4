//! Another sonar's pulses: at random ranges, or walking through the pings of a unit whose rate is nearly
//! its own.
//!
//! They come one way and straight, so they have no speckle, and stand far above the noise.

use echosplat_model::PingSettings;

use super::power;
use crate::random::{Purpose, Random};

/// Pulses at random ranges, evenly over the window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spikes {
    /// Pulses a ping, 0 to 64; of a fraction that share of the pings has one more.
    pub per_ping: f64,
    /// Power over the receiver's mean noise, decibels, 0 to 90.
    pub over_noise_db: f64,
    /// Length, bins, 0.1 to 100.
    pub length_bins: f64,
}

impl Default for Spikes {
    /// None; 30 dB above the noise, chosen, and 4 bins long: 90 µs where 600 bins cover 10 m.
    fn default() -> Self {
        Self {
            per_ping: 0.0,
            over_noise_db: 30.0,
            length_bins: 4.0,
        }
    }
}

impl Spikes {
    /// Adds them to `pulses`, power per bin over the mean noise.
    pub(crate) fn add_to(&self, pulses: &mut [f64], seed: u64, sequence: u64) {
        if !(self.per_ping > 0.0) {
            return;
        }
        let mut random = Random::new(seed, Purpose::Spikes, sequence);
        let one_more = random.unit() < self.per_ping.fract();
        let count = self.per_ping as usize + usize::from(one_more);
        for _ in 0..count {
            let first = random.unit() * pulses.len() as f64;
            add_pulse(pulses, first, self.length_bins, power(self.over_noise_db));
        }
    }
}

/// One pulse in every ping, at a range that walks steadily through the window and begins anew at its
/// other end.
///
/// Where the other unit pings every T′ and this one every T, it walks by c (T′ − T) / 2 a ping: with
/// 25 ms and 17 µs more by 12.5 mm, at 40 pings/s by 0.5 m/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Walker {
    /// Range gained in a second, metres, −1000 to 1000; 0 is no interferer.
    pub walk_mps: f64,
    /// Power over the receiver's mean noise, decibels, 0 to 90.
    pub over_noise_db: f64,
    /// Length, bins, 0.1 to 100.
    pub length_bins: f64,
}

impl Default for Walker {
    fn default() -> Self {
        let Spikes {
            over_noise_db,
            length_bins,
            ..
        } = Spikes::default();
        Self {
            walk_mps: 0.0,
            over_noise_db,
            length_bins,
        }
    }
}

impl Walker {
    /// Adds it to `pulses`, power per bin over the mean noise, of a ping `time_s` into the dive.
    pub(crate) fn add_to(
        &self,
        pulses: &mut [f64],
        settings: &PingSettings,
        seed: u64,
        time_s: f64,
    ) {
        if !(self.walk_mps.abs() > 0.0) {
            return;
        }
        let window_m = settings.range_length_m;
        let begin_m = Random::new(seed, Purpose::Walker, 0).unit() * window_m;
        let into_m = (begin_m + self.walk_mps * time_s).rem_euclid(window_m);
        let first = into_m / settings.bin_length_m();
        add_pulse(pulses, first, self.length_bins, power(self.over_noise_db));
    }
}

/// A pulse of even power from `first` on, both in bins; what lies beyond the last one is lost.
fn add_pulse(pulses: &mut [f64], first: f64, length: f64, power: f64) {
    let end = first + length;
    let reached = (end.ceil() as usize).min(pulses.len());
    for (bin, pulse) in pulses.iter_mut().enumerate().take(reached) {
        let overlap = end.min((bin + 1) as f64) - first.max(bin as f64);
        *pulse += power * overlap.max(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: PingSettings = PingSettings {
        range_start_m: 1.0,
        range_length_m: 10.0,
        bin_count: 500,
        speed_of_sound_mps: 1500.0,
        frequency_hz: 451_127.0,
        pulse_duration_s: 2e-5,
        gain_index: 0,
    };

    fn spikes(per_ping: f64, sequence: u64) -> Vec<f64> {
        let mut pulses = vec![0.0; 500];
        let spikes = Spikes {
            per_ping,
            over_noise_db: 20.0,
            length_bins: 4.0,
        };
        spikes.add_to(&mut pulses, 3, sequence);
        pulses
    }

    #[test]
    fn spikes_come_as_often_as_asked_at_their_level_and_evenly_over_range() {
        let energy = |per_ping: f64| -> f64 {
            let of_ping = |sequence| spikes(per_ping, sequence).into_iter().sum::<f64>();
            (0..2000).map(of_ping).sum::<f64>() / 2000.0
        };
        // Four bins of 100 each; of 500 places the last three cut a pulse short: 0.3 % less.
        assert!((energy(3.0) / 1200.0 - 1.0).abs() < 0.01, "{}", energy(3.0));
        assert!((energy(0.05) / 20.0 - 1.0).abs() < 0.2, "{}", energy(0.05));
        let one = spikes(1.0, 7);
        let lit = one.iter().filter(|pulse| **pulse > 0.0).count();
        assert!((4..=5).contains(&lit));
        assert!((one.iter().copied().fold(0.0, f64::max) - 100.0).abs() < 1e-9);
        let near: f64 = (0..2000)
            .map(|s| spikes(1.0, s)[..250].iter().sum::<f64>())
            .sum();
        assert!((near / 2000.0 / 200.0 - 1.0).abs() < 0.1, "{near}");
        assert!(spikes(0.0, 7).iter().all(|pulse| pulse.to_bits() == 0));
    }

    #[test]
    fn spikes_are_those_of_their_seed_and_ping() {
        assert_eq!(spikes(3.0, 5), spikes(3.0, 5));
        assert_ne!(spikes(3.0, 5), spikes(3.0, 6));
    }

    #[test]
    fn the_walker_gains_its_range_every_second_and_begins_anew() {
        let walker = Walker {
            walk_mps: 0.5,
            over_noise_db: 30.0,
            length_bins: 4.0,
        };
        // The middle of the pulse, bins.
        let middle = |time_s: f64| {
            let mut pulses = vec![0.0; 500];
            walker.add_to(&mut pulses, &SETTINGS, 1, time_s);
            let total: f64 = pulses.iter().sum();
            let moment = pulses
                .iter()
                .enumerate()
                .map(|(bin, p)| (bin as f64 + 0.5) * p);
            (moment.sum::<f64>() / total, total)
        };
        let begin = middle(0.0).0;
        // Back where it was after 10 m / 0.5 m/s; in between 25 bins of 2 cm a second.
        assert!((middle(20.0).0 - begin).abs() < 1e-6);
        let walked = |time_s: f64| (middle(time_s).0 - begin).rem_euclid(500.0);
        for time_s in [0.025, 1.0, 2.0, 7.0] {
            let (expected, (_, total)) = (25.0 * time_s, middle(time_s));
            // At the window's end the pulse is cut.
            if (total - 4000.0).abs() < 1e-6 {
                assert!((walked(time_s) - expected).abs() < 1e-6, "{time_s}");
            }
        }
        let heard = (0..800).filter(|ping| middle(f64::from(*ping) * 0.025).1 > 0.0);
        assert_eq!(heard.count(), 800);
    }
}
