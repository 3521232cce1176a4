//! One transmit and listen, as linear power over range.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::{Pose, Timestamp, Twist};

/// The most bins a ping may have; the device offers 200 to 1200.
pub const MAX_BIN_COUNT: usize = 4096;

/// How a ping was made. Bin `i` of `n` covers `range_start + range_length · [i, i+1)/n`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PingSettings {
    /// Range of the near edge of bin 0, at `speed_of_sound_mps`.
    pub range_start_m: f64,
    /// Range from the near edge of the first to the far edge of the last bin; positive.
    pub range_length_m: f64,
    /// Number of bins, 1 to [`MAX_BIN_COUNT`].
    pub bin_count: usize,
    /// Speed of sound the ranges above are computed with.
    pub speed_of_sound_mps: f64,
    /// Carrier frequency, 0 if unknown.
    pub frequency_hz: f64,
    /// Length of the transmitted pulse, 0 if unknown.
    pub pulse_duration_s: f64,
    /// Gain step of the receiver as the device reports it.
    pub gain_index: i16,
}

impl PingSettings {
    /// Length of one bin.
    #[must_use]
    pub fn bin_length_m(&self) -> f64 {
        self.range_length_m / self.bin_count as f64
    }

    /// Range of the near edge of bin `bin`; `bin_count` gives the far end.
    #[must_use]
    pub fn bin_edge_m(&self, bin: usize) -> f64 {
        self.range_start_m + self.range_length_m * (bin as f64 / self.bin_count as f64)
    }

    /// Range of the middle of bin `bin`.
    #[must_use]
    pub fn bin_center_m(&self, bin: usize) -> f64 {
        self.range_start_m + self.range_length_m * ((bin as f64 + 0.5) / self.bin_count as f64)
    }

    /// Range of the far edge of the last bin.
    #[must_use]
    pub fn range_end_m(&self) -> f64 {
        self.range_start_m + self.range_length_m
    }

    /// The bin that holds `range_m`, if any does.
    #[must_use]
    pub fn bin_of_range(&self, range_m: f64) -> Option<usize> {
        let position = (range_m - self.range_start_m) / self.bin_length_m();
        if !(position >= 0.0 && position < self.bin_count as f64) {
            return None;
        }
        Some(position as usize)
    }

    /// Length of the pulse in range: half of what sound travels while it lasts.
    #[must_use]
    pub fn pulse_length_m(&self) -> f64 {
        0.5 * self.pulse_duration_s * self.speed_of_sound_mps
    }

    /// The same settings with every range computed anew for another speed of sound.
    #[must_use]
    pub fn with_speed_of_sound(mut self, speed_of_sound_mps: f64) -> Self {
        let ratio = speed_of_sound_mps / self.speed_of_sound_mps;
        self.range_start_m *= ratio;
        self.range_length_m *= ratio;
        self.speed_of_sound_mps = speed_of_sound_mps;
        self
    }

    /// # Errors
    /// Says which setting lies outside what a sonar can have.
    pub fn check(&self) -> Result<(), PingError> {
        let setting = |name, value: f64, low: f64, high: f64| {
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(PingError::Setting {
                    name,
                    value,
                    low,
                    high,
                })
            }
        };
        setting("range_start_m", self.range_start_m, 0.0, 1000.0)?;
        setting("range_length_m", self.range_length_m, 0.01, 1000.0)?;
        setting(
            "bin_count",
            self.bin_count as f64,
            1.0,
            MAX_BIN_COUNT as f64,
        )?;
        setting(
            "speed_of_sound_mps",
            self.speed_of_sound_mps,
            1000.0,
            2000.0,
        )?;
        setting("frequency_hz", self.frequency_hz, 0.0, 1e8)?;
        setting("pulse_duration_s", self.pulse_duration_s, 0.0, 0.1)
    }
}

/// One transmit and listen. Made only by [`Ping::new`], so what it holds is finite and fits.
#[derive(Debug, Clone, PartialEq)]
pub struct Ping {
    sequence: u64,
    transmit_time: Timestamp,
    settings: PingSettings,
    beam_azimuth_rad: f32,
    view: Option<u32>,
    intensity: Vec<f32>,
}

impl Ping {
    /// `intensity` is linear power per bin, shape `[bin_count]`, finite and not negative. `view` groups the
    /// beams of one image; `None` lets the mapper decide what counts as one view.
    ///
    /// # Errors
    /// If a setting is out of range, the number of bins differs, or an intensity is not a power.
    pub fn new(
        sequence: u64,
        transmit_time: Timestamp,
        settings: PingSettings,
        intensity: Vec<f32>,
    ) -> Result<Self, PingError> {
        settings.check()?;
        if intensity.len() != settings.bin_count {
            return Err(PingError::BinCount {
                expected: settings.bin_count,
                found: intensity.len(),
            });
        }
        if let Some(bin) = intensity
            .iter()
            .position(|&i| !(0.0..f32::MAX).contains(&i))
        {
            return Err(PingError::Intensity {
                bin,
                value: intensity[bin],
            });
        }
        Ok(Self {
            sequence,
            transmit_time,
            settings,
            beam_azimuth_rad: 0.0,
            view: None,
            intensity,
        })
    }

    /// The same ping as one beam of an image: its axis and the image's number.
    #[must_use]
    pub fn with_beam(mut self, beam_azimuth_rad: f32, view: u32) -> Self {
        self.beam_azimuth_rad = if beam_azimuth_rad.is_finite() {
            beam_azimuth_rad
        } else {
            0.0
        };
        self.view = Some(view);
        self
    }

    /// The power nearest to `value` that a bin can hold; 0 of what is no number.
    #[must_use]
    pub fn nearest_power(value: f32) -> f32 {
        value.max(0.0).min(f32::MAX.next_down())
    }

    /// The same ping with the power of each bin times a factor of it, or the [nearest](Self::nearest_power).
    #[must_use]
    pub fn scaled(&self, factor: impl Fn(usize) -> f32) -> Self {
        let bins = self.intensity.iter().enumerate();
        let scaled = bins.map(|(bin, power)| Self::nearest_power(power * factor(bin)));
        Self {
            intensity: scaled.collect(),
            ..*self
        }
    }

    /// The ping's number in its stream, across restarts of the device; no two pings share one. A
    /// ping that comes late, as datagrams and blocks of a log do, has its own right number, which
    /// is then less than that of a ping received before it.
    #[must_use]
    pub fn sequence(&self) -> u64 {
        self.sequence
    }

    /// When the pulse left.
    #[must_use]
    pub fn transmit_time(&self) -> Timestamp {
        self.transmit_time
    }

    /// When the echo from `range_m` met the surface there: the middle of its two-way path.
    #[must_use]
    pub fn echo_time(&self, range_m: f64) -> Timestamp {
        self.transmit_time
            .offset_by(range_m / self.settings.speed_of_sound_mps)
    }

    /// How it was made.
    #[must_use]
    pub fn settings(&self) -> &PingSettings {
        &self.settings
    }

    /// Azimuth of the beam's axis in the sensor's frame; 0 for the `OmniScan`.
    #[must_use]
    pub fn beam_azimuth_rad(&self) -> f32 {
        self.beam_azimuth_rad
    }

    /// Number of the image this ping is a beam of, if it came in images.
    #[must_use]
    pub fn view(&self) -> Option<u32> {
        self.view
    }

    /// Linear power per bin, shape `[bin_count]`.
    #[must_use]
    pub fn intensity(&self) -> &[f32] {
        &self.intensity
    }
}

/// A ping and where its sensor was.
#[derive(Debug, Clone, PartialEq)]
pub struct PosedPing {
    /// The ping.
    pub ping: Arc<Ping>,
    /// Pose of the sensor at `reference_range_m`'s echo time.
    pub world_from_sensor: Pose,
    /// Motion of the sensor during the ping, in the sensor's frame; zero if unknown.
    pub twist: Twist,
    /// Range whose echo time the pose belongs to: the middle of what was listened to.
    pub reference_range_m: f64,
    /// What the pose is off by against those around it, one sigma: along the range, and about the fan's normal. `None` if its
    /// source says nothing of it.
    pub uncertainty: Option<crate::PoseUncertainty>,
    /// One sigma of what poses scatter by from one to the next, before it was smoothed away; `None`
    /// if nobody looked.
    pub jitter: Option<crate::PoseUncertainty>,
}

/// Why numbers are no ping.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PingError {
    /// A setting out of range.
    #[error("ping setting {name} is {value}; allowed is {low} to {high}")]
    Setting {
        /// Name of the field.
        name: &'static str,
        /// What it held.
        value: f64,
        /// Least allowed.
        low: f64,
        /// Most allowed.
        high: f64,
    },
    /// Bins and settings disagree.
    #[error("ping holds {found} intensities, its settings say {expected} bins")]
    BinCount {
        /// By the settings.
        expected: usize,
        /// In the profile.
        found: usize,
    },
    /// Not a power.
    #[error("intensity of bin {bin} is {value}; it must be finite and not negative")]
    Intensity {
        /// Index of the bin.
        bin: usize,
        /// What it held.
        value: f32,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> PingSettings {
        PingSettings {
            range_start_m: 1.0,
            range_length_m: 10.0,
            bin_count: 500,
            speed_of_sound_mps: 1500.0,
            frequency_hz: 451_127.0,
            pulse_duration_s: 2e-5,
            gain_index: 0,
        }
    }

    #[test]
    fn bins_cover_the_range_half_open() {
        let s = settings();
        assert_eq!(s.bin_of_range(1.0), Some(0));
        assert_eq!(s.bin_of_range(1.03), Some(1));
        assert_eq!(s.bin_of_range(11.0), None);
        assert_eq!(s.bin_of_range(0.999), None);
        assert_eq!(s.bin_of_range(f64::NAN), None);
        assert!((s.bin_edge_m(500) - s.range_end_m()).abs() < 1e-12);
        assert!((s.bin_center_m(0) - 1.01).abs() < 1e-12);
    }

    #[test]
    fn one_per_cent_of_sound_speed_is_ten_centimetres_at_ten_metres() {
        let s = settings().with_speed_of_sound(1515.0);
        assert!((s.range_end_m() - 11.11).abs() < 1e-9);
    }

    #[test]
    fn a_factor_leaves_powers_whatever_it_is() {
        let ping = Ping::new(0, Timestamp::ZERO, settings(), vec![2.0; 500]).unwrap();
        for (factor, power) in [
            (3.0, 6.0),
            (f32::INFINITY, f32::MAX.next_down()),
            (f32::NAN, 0.0),
            (-1.0, 0.0),
        ] {
            let scaled = ping.scaled(|bin| if bin == 7 { factor } else { 1.0 });
            let heard = [scaled.intensity()[7], scaled.intensity()[8]];
            assert_eq!(heard.map(f32::to_bits), [power, 2.0].map(f32::to_bits));
            let again = Ping::new(0, Timestamp::ZERO, settings(), scaled.intensity().to_vec());
            assert!(again.is_ok(), "factor {factor}");
        }
    }

    #[test]
    fn what_is_not_a_power_is_refused() {
        for bad in [f32::NAN, f32::INFINITY, -1.0, f32::MAX] {
            let mut intensity = vec![0.0; 500];
            intensity[7] = bad;
            let refused = Ping::new(0, Timestamp::ZERO, settings(), intensity);
            assert!(matches!(refused, Err(PingError::Intensity { bin: 7, .. })));
        }
        let short = Ping::new(0, Timestamp::ZERO, settings(), vec![0.0; 499]);
        assert!(matches!(short, Err(PingError::BinCount { .. })));
        let mut odd = settings();
        odd.range_length_m = f64::NAN;
        assert!(Ping::new(0, Timestamp::ZERO, odd, vec![0.0; 500]).is_err());
    }
}
