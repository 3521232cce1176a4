//! What a real unit makes of the echoes: one look of speckle, thermal noise, ring-down, its gain.
//!
//! Powers are in units of the mean thermal noise until gain is applied.

use echosplat_model::{PingSettings, Pose};

use super::gain::{GainTrack, gain_db};
use super::speckle::{self, Speckle};
use crate::random::{Purpose, Random};

/// Mean thermal noise of a real unit at gain index 7, dB, the same at every range.
const NOISE_DB: f64 = 6.4;
/// A surface of one steradian and reflectivity 1, met squarely 1 m away, over the mean noise. Chosen
/// so that rods 5 m away stand 5 to 15 dB above the noise and walls 20 to 30 dB.
const STERADIAN_OVER_NOISE_DB: f64 = 69.0;
/// Ring-down at range 0 over the noise, and the range in which it falls by a factor e: 45 to 60 dB at
/// gains 4 to 7, down to the noise at 0.4 m, as real units show it.
const RING_DOWN_OVER_NOISE_DB: f64 = 54.0;
const RING_DOWN_E_FOLD_M: f64 = 0.032;
/// The loudest echo is looked for beyond the ring-down.
const BLANKING_M: f64 = 0.5;
/// The pulse of a real unit lasts two bins.
const PULSE_BINS: f64 = 2.0;

/// One ping's number, and when and where it was transmitted.
pub(super) struct Moment {
    pub(super) sequence: u64,
    pub(super) time_s: f64,
    pub(super) world_from_sensor: Pose,
}

/// A real unit on a dive.
pub(super) struct FieldUnit {
    seed: u64,
    /// Power of an echo over the mean noise, per unit of what [`super::echo`] gives.
    echo_over_noise: f64,
    speckle: Speckle,
    gain: GainTrack,
}

impl FieldUnit {
    /// Its gain rests at index 7.
    pub(super) fn new(seed: u64) -> Self {
        Self {
            seed,
            echo_over_noise: power(STERADIAN_OVER_NOISE_DB),
            speckle: Speckle::new(seed),
            gain: GainTrack::following(&[], 0.0),
        }
    }

    /// The same with echoes of power 1 this much above the noise, linear.
    pub(super) fn with_echo_over_noise(self, echo_over_noise: f64) -> Self {
        Self {
            echo_over_noise,
            ..self
        }
    }

    pub(super) fn echo_over_noise(&self) -> f64 {
        self.echo_over_noise
    }

    /// Mean power of the noise as reported.
    pub(super) fn mean_noise(settings: &PingSettings) -> f64 {
        power(NOISE_DB + gain_db(settings.gain_index))
    }

    pub(super) fn with_gain(self, gain: GainTrack) -> Self {
        Self { gain, ..self }
    }

    pub(super) fn gain_index(&self, sequence: u64, time_s: f64) -> i16 {
        self.gain.index(sequence, time_s)
    }

    /// What the unit transmits in place of a shorter pulse, as a profile carries it.
    pub(super) fn pulse_duration_s(settings: &PingSettings) -> f64 {
        let bin_s = 2.0 * settings.bin_length_m() / settings.speed_of_sound_mps;
        f64::from(settings.pulse_duration_s.max(PULSE_BINS * bin_s) as f32)
    }

    /// Linear power per bin as the unit reports it at `settings.gain_index`.
    pub(super) fn heard(
        &self,
        moment: &Moment,
        settings: &PingSettings,
        echoes: &[f64],
    ) -> Vec<f64> {
        let gain = Self::mean_noise(settings);
        let received = self.received(moment, settings, echoes);
        received.into_iter().map(|power| gain * power).collect()
    }

    /// The loudest bin beyond the ring-down, dB at gain index 7.
    pub(super) fn loudest_db(
        &self,
        moment: &Moment,
        settings: &PingSettings,
        echoes: &[f64],
    ) -> f64 {
        let received = self.received(moment, settings, echoes);
        let beyond = received
            .iter()
            .enumerate()
            .filter(|(bin, _)| settings.bin_center_m(*bin) > BLANKING_M);
        let loudest = beyond.map(|(_, power)| *power).fold(0.0, f64::max);
        NOISE_DB + 10.0 * loudest.max(f64::MIN_POSITIVE).log10()
    }

    /// Echo and noise are one amplitude in the receiver: their sum's power is exponential, with the
    /// sum of their powers as its mean.
    fn received(&self, moment: &Moment, settings: &PingSettings, echoes: &[f64]) -> Vec<f64> {
        let mut random = Random::new(self.seed, Purpose::Noise, moment.sequence);
        let noise = speckle::received(echoes.len(), &mut random);
        let fresh = speckle::received(echoes.len(), &mut random);
        let pose = &moment.world_from_sensor;
        let phases = self.speckle.phases(pose, moment.time_s);
        let of_bin = |bin: usize| {
            let mut amplitude = noise[bin];
            if echoes[bin] > 0.0 {
                let speckled = self.speckle.amplitude(bin, &phases, fresh[bin]);
                amplitude += (self.echo_over_noise * echoes[bin]).sqrt() * speckled;
            }
            amplitude.length_squared() + ring_down(settings.bin_center_m(bin))
        };
        (0..echoes.len()).map(of_bin).collect()
    }
}

fn ring_down(range_m: f64) -> f64 {
    power(RING_DOWN_OVER_NOISE_DB) * (-range_m / RING_DOWN_E_FOLD_M).exp()
}

fn power(decibels: f64) -> f64 {
    10f64.powf(0.1 * decibels)
}

#[cfg(test)]
mod tests;
