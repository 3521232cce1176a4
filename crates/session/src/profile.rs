//! A profile's meaning: is it one that a sonar can make, and what are its settings and powers.

use echosplat_firmware_protocol::OsMonoProfile;
use echosplat_model::PingSettings;

use crate::config::{SessionConfig, Spreading};
use crate::continuity::Stamp;

/// Farther than any unit of the family hears (120 m), by a margin for odd speeds of sound.
const MAX_RANGE_MM: u32 = 300_000;
const MIN_LENGTH_MM: u32 = 10;
/// Speeds of sound in any water, in dm/s.
const SOUND_DMPS: std::ops::RangeInclusive<u16> = 13_000..=17_000;
const MAX_PING_HZ: u32 = 10_000_000;
const MAX_PULSE_S: f32 = 0.1;
const MAX_GAIN_INDEX: u16 = 15;
/// Beyond any power in water; linear it still fits an f32 with room to multiply.
const MAX_POWER_DB: f32 = 200.0;
/// Corrections for range start here, where ring-down hides all echoes anyway.
const MIN_CORRECTED_RANGE_M: f64 = 0.1;

/// Why a profile is none that a sonar can make.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Implausible {
    Settings,
    Scale,
}

/// Checks every field that is used. Headings and analog gain are not, and may hold anything.
pub(crate) fn check(profile: &OsMonoProfile<'_>) -> Result<(), Implausible> {
    let length = profile.length_mm;
    let range_is_real =
        profile.start_mm <= MAX_RANGE_MM && (MIN_LENGTH_MM..=MAX_RANGE_MM).contains(&length);
    let pulse_is_real = (0.0..=MAX_PULSE_S).contains(&profile.pulse_duration_sec);
    let settings_are_real = range_is_real
        && pulse_is_real
        && !profile.pwr_results.is_empty()
        && SOUND_DMPS.contains(&profile.sos_dmps)
        && profile.ping_hz <= MAX_PING_HZ
        && profile.gain_index <= MAX_GAIN_INDEX;
    if !settings_are_real {
        return Err(Implausible::Settings);
    }
    let (low, high) = (profile.min_pwr_db, profile.max_pwr_db);
    if !(-MAX_POWER_DB <= low && low <= high && high <= MAX_POWER_DB) {
        return Err(Implausible::Scale);
    }
    Ok(())
}

pub(crate) fn stamp(profile: &OsMonoProfile<'_>) -> Stamp {
    Stamp {
        ping_number: profile.ping_number,
        timestamp_ms: profile.timestamp_ms,
        start_mm: profile.start_mm,
        length_mm: profile.length_mm,
        bin_count: profile.pwr_results.len(),
        sos_dmps: profile.sos_dmps,
        ping_hz: profile.ping_hz,
        pulse_duration_s: profile.pulse_duration_sec,
    }
}

/// The settings of a checked profile, ranges at the configured speed of sound.
pub(crate) fn settings(profile: &OsMonoProfile<'_>, config: &SessionConfig) -> PingSettings {
    PingSettings {
        range_start_m: f64::from(profile.start_mm) * 1e-3,
        range_length_m: f64::from(profile.length_mm) * 1e-3,
        bin_count: profile.pwr_results.len(),
        speed_of_sound_mps: f64::from(profile.sos_dmps) * 0.1,
        frequency_hz: f64::from(profile.ping_hz),
        pulse_duration_s: f64::from(profile.pulse_duration_sec),
        gain_index: i16::try_from(profile.gain_index).unwrap_or(i16::MAX),
    }
    .with_speed_of_sound(config.speed_of_sound_mps)
}

/// Linear power per bin, corrected as configured, of a checked profile.
pub(crate) fn intensity(
    profile: &OsMonoProfile<'_>,
    settings: &PingSettings,
    config: &SessionConfig,
) -> Vec<f32> {
    let gain_index = usize::from(profile.gain_index);
    let gain_db = config.gain_offset_db.get(gain_index).copied();
    let scale = PowerScale::new(
        f64::from(profile.min_pwr_db) - gain_db.unwrap_or(0.0),
        f64::from(profile.max_pwr_db) - f64::from(profile.min_pwr_db),
    );
    let raw = profile.pwr_results.iter();
    if config.spreading == Spreading::None && config.absorption_db_per_m <= 0.0 {
        return raw.map(|raw| scale.linear(raw) as f32).collect();
    }
    raw.enumerate()
        .map(|(bin, raw)| {
            let range_m = settings.bin_center_m(bin).max(MIN_CORRECTED_RANGE_M);
            let power = scale.linear(raw) * range_gain(range_m, config);
            power.min(f64::from(f32::MAX) * 0.5) as f32
        })
        .collect()
}

/// What spreading and absorption took, as a factor of power.
fn range_gain(range_m: f64, config: &SessionConfig) -> f64 {
    let spreading = match config.spreading {
        Spreading::None => 1.0,
        Spreading::Db20 => range_m * range_m,
        Spreading::Db40 => (range_m * range_m).powi(2),
    };
    spreading * linear_power(2.0 * config.absorption_db_per_m * range_m)
}

fn linear_power(db: f64) -> f64 {
    10.0_f64.powf(0.1 * db)
}

/// `10^(dB/10)` of raw results by tables: since dB is linear in the raw 16 bits, power is a
/// product of one factor for each of three groups of them. 128 powers instead of one a bin.
struct PowerScale {
    /// By bits 10 to 15, times the power of raw 0.
    high: [f64; 64],
    /// By bits 5 to 9.
    middle: [f64; 32],
    /// By bits 0 to 4.
    low: [f64; 32],
}

impl PowerScale {
    fn new(min_db: f64, span_db: f64) -> Self {
        let step_db = span_db / 65_535.0;
        let factor = |raw: usize| linear_power(raw as f64 * step_db);
        let floor = linear_power(min_db);
        Self {
            high: std::array::from_fn(|i| floor * factor(i << 10)),
            middle: std::array::from_fn(|i| factor(i << 5)),
            low: std::array::from_fn(factor),
        }
    }

    fn linear(&self, raw: u16) -> f64 {
        let raw = usize::from(raw);
        self.high[raw >> 10] * self.middle[(raw >> 5) & 31] * self.low[raw & 31]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_firmware_protocol::PowerResults;

    fn profile(results: &[u8]) -> OsMonoProfile<'_> {
        OsMonoProfile {
            ping_number: 1,
            start_mm: 1_000,
            length_mm: 10_000,
            timestamp_ms: 25,
            ping_hz: 451_127,
            gain_index: 2,
            sos_dmps: 15_000,
            channel_number: 0,
            pulse_duration_sec: 2e-5,
            analog_gain: f32::NAN,
            max_pwr_db: 60.0,
            min_pwr_db: -20.0,
            transducer_heading_deg: 0.0,
            vehicle_heading_deg: f32::NAN,
            pwr_results: PowerResults::from_bytes(results).unwrap(),
        }
    }

    #[test]
    fn the_tables_are_the_formula() {
        let scale = PowerScale::new(-45.3, 117.9);
        for raw in (0..=u16::MAX).step_by(7) {
            let db = -45.3 + f64::from(raw) / 65_535.0 * 117.9;
            let relative = scale.linear(raw) / 10.0_f64.powf(db / 10.0) - 1.0;
            assert!(relative.abs() < 1e-12, "{raw}");
        }
    }

    #[test]
    fn corrections_add_up_in_decibels() {
        let results = [0xff, 0xff, 0x00, 0x00];
        let profile = profile(&results);
        let config = SessionConfig {
            spreading: Spreading::Db40,
            absorption_db_per_m: 0.1,
            gain_offset_db: vec![0.0, 3.0, 6.0],
            speed_of_sound_mps: 1515.0,
            ..SessionConfig::default()
        };
        let settings = settings(&profile, &config);
        assert!((settings.range_end_m() - 11.11).abs() < 1e-9);
        let intensity = intensity(&profile, &settings, &config);
        for (bin, power_db) in [(0, 60.0), (1, -20.0)] {
            let range_m = settings.bin_center_m(bin);
            let expected_db = power_db - 6.0 + 40.0 * range_m.log10() + 0.2 * range_m;
            let found_db = 10.0 * f64::from(intensity[bin]).log10();
            assert!((found_db - expected_db).abs() < 1e-4);
        }
    }

    #[test]
    fn what_no_sonar_makes_is_refused() {
        let results = [0; 4];
        let good = profile(&results);
        assert_eq!(check(&good), Ok(()));
        let settings = Err(Implausible::Settings);
        let zero_length = OsMonoProfile {
            length_mm: 0,
            ..good
        };
        let far = OsMonoProfile {
            start_mm: u32::MAX,
            ..good
        };
        let silent = OsMonoProfile {
            sos_dmps: 0,
            ..good
        };
        let endless = OsMonoProfile {
            pulse_duration_sec: f32::NAN,
            ..good
        };
        for bad in [zero_length, far, silent, endless, profile(&[])] {
            assert_eq!(check(&bad), settings);
        }
        for (low, high) in [
            (1.0, 0.0),
            (f32::NAN, 0.0),
            (0.0, f32::NAN),
            (0.0, f32::INFINITY),
            (-1e30, 0.0),
        ] {
            let bad = OsMonoProfile {
                min_pwr_db: low,
                max_pwr_db: high,
                ..good
            };
            assert_eq!(check(&bad), Err(Implausible::Scale));
        }
    }
}
