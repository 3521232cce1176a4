//! Ping settings as a client asks for them, and what the device makes of them.

use echosplat_firmware_protocol::OsPingParams;
use echosplat_model::PingSettings;

/// What a unit offers; requests beyond are brought to the nearest end.
const LENGTH_MM: std::ops::RangeInclusive<u32> = 100..=120_000;
const START_MOST_MM: u32 = 120_000;
const RESULTS: std::ops::RangeInclusive<u16> = 200..=1200;
const GAIN: std::ops::RangeInclusive<i16> = -1..=7;
const INTERVAL_MOST_MS: u32 = 60_000;
const PULSE_FRACTION_LEAST: f64 = 1e-4;
const PULSE_FRACTION_MOST: f64 = 0.05;
const PULSE_FRACTION_DEFAULT: f64 = 0.002;
/// Beside the two-way time, as measured on a real unit.
const OVERHEAD_MS: f64 = 3.5;

/// Settings in force.
#[derive(Debug, Clone, Copy)]
pub(super) struct Asked {
    /// Ranges by the device's speed of sound.
    pub(super) settings: PingSettings,
    /// 0 is as fast as the range allows.
    msec_per_ping: u32,
}

impl Asked {
    pub(super) fn from_params(
        params: &OsPingParams,
        speed_of_sound_mps: f64,
        frequency_hz: f64,
    ) -> Self {
        let metres = |millimetres: u32| f64::from(millimetres) * 1e-3;
        let start_m = metres(params.start_mm.min(START_MOST_MM));
        let length_m = metres(params.length_mm.clamp(*LENGTH_MM.start(), *LENGTH_MM.end()));
        let bin_count = params.num_results.clamp(*RESULTS.start(), *RESULTS.end());
        let two_way_s = 2.0 * (start_m + length_m) / speed_of_sound_mps;
        let pulse_s = pulse_fraction(params.pulse_len_percent) * two_way_s;
        Self {
            settings: PingSettings {
                range_start_m: start_m,
                range_length_m: length_m,
                bin_count: usize::from(bin_count),
                speed_of_sound_mps,
                frequency_hz,
                // As the profile carries it.
                pulse_duration_s: f64::from(pulse_s as f32),
                gain_index: params.gain_index.clamp(*GAIN.start(), *GAIN.end()),
            },
            msec_per_ping: params.msec_per_ping.min(INTERVAL_MOST_MS),
        }
    }

    /// Time between pings: as asked for, or what the range needs, whole milliseconds.
    pub(super) fn interval_ms(&self) -> i64 {
        let settings = &self.settings;
        let two_way_ms = 2e3 * settings.range_end_m() / settings.speed_of_sound_mps;
        let least_ms = (two_way_ms + OVERHEAD_MS).ceil() as i64;
        least_ms.max(i64::from(self.msec_per_ping))
    }
}

/// A fraction despite its name. Rounded to 10⁻⁶, so that 0.002 as f32 is 0.002.
fn pulse_fraction(asked: f32) -> f64 {
    let fraction = (f64::from(asked) * 1e6).round() * 1e-6;
    if fraction > 0.0 {
        fraction.clamp(PULSE_FRACTION_LEAST, PULSE_FRACTION_MOST)
    } else {
        PULSE_FRACTION_DEFAULT
    }
}
