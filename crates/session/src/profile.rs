//! A profile's meaning: is it one that a sonar can make, and what are its settings and powers.

use std::fmt;

use echosplat_firmware_protocol::OsMonoProfile;
use echosplat_model::PingSettings;

use crate::config::{SessionConfig, Spreading};
use crate::continuity::Stamp;
use crate::counters::ProfilesRejected;

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

/// Why a profile is none that a sonar can make. Shown as what it says and what is allowed, as in
/// `speed of sound 0 m/s; allowed is 1300 to 1700 m/s`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Implausible {
    /// In millimetres.
    RangeStart(u32),
    /// In millimetres.
    RangeLength(u32),
    Bins,
    /// In dm/s.
    SpeedOfSound(u16),
    /// In Hz.
    Frequency(u32),
    /// In seconds.
    Pulse(f32),
    Gain(u16),
    /// Least and most, in dB.
    Scale(f32, f32),
}

impl Implausible {
    /// The counter of such profiles.
    pub(crate) fn counter(self, rejected: &mut ProfilesRejected) -> &mut u64 {
        match self {
            Self::RangeStart(_) | Self::RangeLength(_) => &mut rejected.range,
            Self::Bins => &mut rejected.bins,
            Self::SpeedOfSound(_) => &mut rejected.speed_of_sound,
            Self::Frequency(_) => &mut rejected.frequency,
            Self::Pulse(_) => &mut rejected.pulse,
            Self::Gain(_) => &mut rejected.gain,
            Self::Scale(..) => &mut rejected.scale,
        }
    }
}

impl fmt::Display for Implausible {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let metres = |millimetres: u32| f64::from(millimetres) * 1e-3;
        let most_m = metres(MAX_RANGE_MM);
        match *self {
            Self::RangeStart(start_mm) => {
                let start_m = metres(start_mm);
                write!(f, "start of range {start_m} m; allowed is 0 to {most_m} m")
            }
            Self::RangeLength(length_mm) => {
                let (length_m, least_m) = (metres(length_mm), metres(MIN_LENGTH_MM));
                write!(
                    f,
                    "length of range {length_m} m; allowed is {least_m} to {most_m} m"
                )
            }
            Self::Bins => f.write_str("0 bins; there must be 1 at least"),
            Self::SpeedOfSound(dmps) => {
                let speed_mps = f64::from(dmps) * 0.1;
                let (low, high) = (SOUND_DMPS.start() / 10, SOUND_DMPS.end() / 10);
                write!(
                    f,
                    "speed of sound {speed_mps} m/s; allowed is {low} to {high} m/s"
                )
            }
            Self::Frequency(hz) => {
                write!(f, "frequency {hz} Hz; allowed is 0 to {MAX_PING_HZ} Hz")
            }
            Self::Pulse(pulse_s) => {
                write!(f, "pulse of {pulse_s} s; allowed is 0 to {MAX_PULSE_S} s")
            }
            Self::Gain(index) => {
                write!(f, "gain index {index}; allowed is 0 to {MAX_GAIN_INDEX}")
            }
            Self::Scale(low, high) => write!(
                f,
                "power from {low} to {high} dB; allowed is -{MAX_POWER_DB} to {MAX_POWER_DB} dB, \
                 the lower first"
            ),
        }
    }
}

/// Checks every field that is used. Headings and analog gain are not, and may hold anything.
pub(crate) fn check(profile: &OsMonoProfile<'_>) -> Result<(), Implausible> {
    let &OsMonoProfile {
        start_mm,
        length_mm,
        sos_dmps,
        ping_hz,
        gain_index,
        pulse_duration_sec,
        ..
    } = profile;
    let require = |is_real: bool, otherwise| if is_real { Ok(()) } else { Err(otherwise) };
    let has_length = (MIN_LENGTH_MM..=MAX_RANGE_MM).contains(&length_mm);
    let has_pulse = (0.0..=MAX_PULSE_S).contains(&pulse_duration_sec);
    let has_sound = SOUND_DMPS.contains(&sos_dmps);
    require(start_mm <= MAX_RANGE_MM, Implausible::RangeStart(start_mm))?;
    require(has_length, Implausible::RangeLength(length_mm))?;
    require(!profile.pwr_results.is_empty(), Implausible::Bins)?;
    require(has_sound, Implausible::SpeedOfSound(sos_dmps))?;
    require(ping_hz <= MAX_PING_HZ, Implausible::Frequency(ping_hz))?;
    require(has_pulse, Implausible::Pulse(pulse_duration_sec))?;
    require(gain_index <= MAX_GAIN_INDEX, Implausible::Gain(gain_index))?;
    let (low, high) = (profile.min_pwr_db, profile.max_pwr_db);
    let has_scale = -MAX_POWER_DB <= low && low <= high && high <= MAX_POWER_DB;
    require(has_scale, Implausible::Scale(low, high))
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
        let refused = |change: fn(&mut OsMonoProfile<'_>)| {
            let mut bad = good;
            change(&mut bad);
            let reason = check(&bad).unwrap_err();
            let mut rejected = ProfilesRejected::default();
            *reason.counter(&mut rejected) += 1;
            assert_eq!(rejected.implausible(), 1);
            (reason.to_string(), rejected)
        };
        let (words, rejected) = refused(|bad| bad.sos_dmps = 0);
        assert_eq!(words, "speed of sound 0 m/s; allowed is 1300 to 1700 m/s");
        assert_eq!(rejected.speed_of_sound, 1);
        for (change, words) in [
            (
                (|bad| bad.length_mm = 0) as fn(&mut OsMonoProfile<'_>),
                "length of range 0 m; allowed is 0.01 to 300 m",
            ),
            (
                |bad| bad.start_mm = u32::MAX,
                "start of range 4294967.295 m",
            ),
            (|bad| bad.pulse_duration_sec = f32::NAN, "pulse of NaN s"),
            (
                |bad| bad.gain_index = 16,
                "gain index 16; allowed is 0 to 15",
            ),
            (|bad| bad.ping_hz = u32::MAX, "10000000 Hz"),
        ] {
            let (said, rejected) = refused(change);
            assert!(said.contains(words), "{said}");
            assert_eq!((rejected.settings(), rejected.scale), (1, 0));
        }
        assert_eq!(check(&profile(&[])), Err(Implausible::Bins));
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
            assert!(matches!(check(&bad), Err(Implausible::Scale(..))));
        }
    }
}
