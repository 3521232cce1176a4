//! What the device adds to the echoes: speckle, background, ring-down, ghosts, gain, dropouts. That
//! of [`NoiseLevel::Field`] is in [`super::field`].

use echosplat_model::PingSettings;

use super::NoiseLevel;
use super::gain::GAIN_START;
use crate::disturbances::EchoMultiples;
use crate::random::{Purpose, Random};

/// Noise floor of a real unit at gain step 0, dB.
const FLOOR_DB: f64 = -16.0;
/// The strongest echo of a dive stands this far above the floor.
pub(super) const STRONGEST_OVER_FLOOR_DB: f64 = 45.0;
/// Ring-down at range 0 above the floor, and the range in which it falls by a factor e.
const RING_DOWN_OVER_FLOOR_DB: f64 = 61.0;
const RING_DOWN_E_FOLD_M: f64 = 0.03;
/// Gain per step of the gain index, of echoes and floor alike.
const GAIN_STEP_DB: f64 = 3.0;
/// Where a ghost of a strong echo lies, and how much weaker.
const GHOSTS: EchoMultiples = EchoMultiples {
    ratio: 1.5,
    weaker_db: 10.0,
};
/// An echo is strong if within 20 dB of the strongest.
const STRONG_SHARE: f64 = 0.01;
const DROPOUT_SHARE: f64 = 0.05;
/// After its first pings the gain walks every eight seconds.
const GAIN_HOLD_S: f64 = 8.0;

/// Turns echoes into the power the device reports.
pub(super) struct DeviceSide {
    pub(super) level: NoiseLevel,
    pub(super) seed: u64,
    /// Power of the strongest echo of the dive, as echoes are computed.
    pub(super) strongest: f64,
}

impl DeviceSide {
    /// Linear power per bin on the device's scale. `gain_index` multiplies echoes and floor.
    pub(super) fn heard(
        &self,
        sequence: u64,
        settings: &PingSettings,
        mut echoes: Vec<f64>,
    ) -> Vec<f64> {
        let mut random = Random::new(self.seed, Purpose::Noise, sequence);
        if self.level.is_harsh() {
            GHOSTS.add_of_strong(&mut echoes, settings, STRONG_SHARE * self.strongest);
            // A dropout is a ping that came back without its echoes.
            if random.unit() < DROPOUT_SHARE {
                echoes.fill(0.0);
            }
        }
        let gain = power(GAIN_STEP_DB * f64::from(settings.gain_index.max(0)));
        let scale = gain * power(FLOOR_DB + STRONGEST_OVER_FLOOR_DB) / self.strongest;
        let Some(looks) = self.level.looks() else {
            return echoes.into_iter().map(|echo| echo * scale).collect();
        };
        let floor = gain * power(FLOOR_DB);
        let ring_down = gain * power(FLOOR_DB + RING_DOWN_OVER_FLOOR_DB);
        let mut bin_power = |(bin, echo): (usize, f64)| {
            let speckled = echo * scale * random.speckle(looks);
            let ringing = ring_down * (-settings.bin_center_m(bin) / RING_DOWN_E_FOLD_M).exp();
            speckled + floor * random.exponential() + ringing
        };
        echoes.into_iter().enumerate().map(&mut bin_power).collect()
    }

    /// Mean power of the floor as reported.
    pub(super) fn mean_noise(settings: &PingSettings) -> f64 {
        let gain = power(GAIN_STEP_DB * f64::from(settings.gain_index.max(0)));
        gain * power(FLOOR_DB)
    }

    /// Over that, power of an echo of 1 as echoes are computed.
    pub(super) fn echo_over_noise(&self) -> f64 {
        power(STRONGEST_OVER_FLOOR_DB) / self.strongest
    }

    /// The gain index the device reports `time_s` into the dive.
    pub(super) fn gain_index(&self, sequence: u64, time_s: f64, asked: i16) -> i16 {
        if !self.level.is_harsh() {
            return asked.max(0);
        }
        if let Some(&index) = GAIN_START.get(sequence as usize) {
            return index;
        }
        let held = (time_s.max(0.0) / GAIN_HOLD_S) as u64;
        let draw = Random::new(self.seed, Purpose::GainWalk, held).unit();
        5 + (draw * 3.0) as i16
    }
}

fn power(decibels: f64) -> f64 {
    10f64.powf(0.1 * decibels)
}
