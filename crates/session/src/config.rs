//! What is asked of the device, and how its numbers are understood.

use serde::{Deserialize, Serialize};

/// Which clock a ping's transmit time is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockSource {
    /// The host's: device time mapped by the least delay seen.
    #[default]
    Host,
    /// The device's own, unwrapped; for a log plus its session's base.
    Device,
}

/// What is still to be undone of the loss by spreading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Spreading {
    /// Profiles are already corrected for range.
    #[default]
    None,
    /// 20 log r is added.
    Db20,
    /// 40 log r is added.
    Db40,
}

/// What is asked of the device, and how its numbers are understood.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SessionConfig {
    /// Near edge of the first bin, as the device counts range. 0 to 120 m.
    pub range_start_m: f64,
    /// Length of all bins together, as the device counts range. 0.1 to 120 m.
    pub range_length_m: f64,
    /// Time from ping to ping; 0 is as fast as the range allows. At most 60,000 ms.
    pub ping_interval_ms: u32,
    /// Pulse length as a fraction of the two-way time (wire name `pulse_len_percent`).
    pub pulse_len_fraction: f64,
    /// Filter length as a fraction of the two-way time (wire name `filter_duration_percent`).
    pub filter_duration_fraction: f64,
    /// Gain step of the receiver, 0 to 7; −1 is automatic.
    pub gain_index: i16,
    /// Bins of a profile, 200 to 1200.
    pub bin_count: u16,
    /// Speed of sound in the water; ranges are rescaled from the one the device assumed.
    pub speed_of_sound_mps: f64,
    /// What is still to be undone of the loss by spreading.
    pub spreading: Spreading,
    /// Loss by absorption still to be undone, one way; applied to both ways. 0 to 2 dB/m.
    pub absorption_db_per_m: f64,
    /// What each gain step adds to the reported power, by gain index; subtracted. Empty is none.
    pub gain_offset_db: Vec<f64>,
    /// Of several units, the one of this channel is listened to. Without this, `source` and
    /// `heading_deg` it is the first that is heard.
    pub channel: Option<u8>,
    /// The one whose frames have this source, the device's id.
    pub source: Option<u8>,
    /// The one that says that it looks there, within 30°; -180 to 360°.
    pub heading_deg: Option<f64>,
    /// Which clock transmit times are on.
    pub clock: ClockSource,
    /// Least delay from transmit to arrival, subtracted on the host's clock. 0 to 5 s.
    pub link_latency_s: f64,
}

impl Default for SessionConfig {
    fn default() -> Self {
        Self {
            range_start_m: 0.0,
            range_length_m: 10.0,
            ping_interval_ms: 0,
            pulse_len_fraction: 0.002,
            filter_duration_fraction: 0.0015,
            gain_index: -1,
            bin_count: 600,
            speed_of_sound_mps: 1500.0,
            spreading: Spreading::None,
            absorption_db_per_m: 0.0,
            gain_offset_db: Vec::new(),
            channel: None,
            source: None,
            heading_deg: None,
            clock: ClockSource::Host,
            link_latency_s: 0.0,
        }
    }
}

/// A setting that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("sonar setting `{key}` is {value}; allowed is {low} to {high}")]
pub struct SessionConfigError {
    /// Name of the field.
    pub key: &'static str,
    /// What it held.
    pub value: f64,
    /// Least allowed.
    pub low: f64,
    /// Most allowed.
    pub high: f64,
}

/// The least interval beyond the two-way time that a real unit was seen to need.
const PING_OVERHEAD_S: f64 = 0.0035;

impl SessionConfig {
    /// # Errors
    /// Names the first setting out of range, what it holds and what is allowed.
    pub fn check(&self) -> Result<(), SessionConfigError> {
        within("range_start_m", self.range_start_m, 0.0, 120.0)?;
        within("range_length_m", self.range_length_m, 0.1, 120.0)?;
        let interval = f64::from(self.ping_interval_ms);
        within("ping_interval_ms", interval, 0.0, 60_000.0)?;
        within("pulse_len_fraction", self.pulse_len_fraction, 0.0, 1.0)?;
        let filter = self.filter_duration_fraction;
        within("filter_duration_fraction", filter, 0.0, 1.0)?;
        within("gain_index", f64::from(self.gain_index), -1.0, 7.0)?;
        within("bin_count", f64::from(self.bin_count), 200.0, 1200.0)?;
        let sound = self.speed_of_sound_mps;
        within("speed_of_sound_mps", sound, 1300.0, 1700.0)?;
        within("absorption_db_per_m", self.absorption_db_per_m, 0.0, 2.0)?;
        let offsets = self.gain_offset_db.len() as f64;
        within("gain_offset_db (number of values)", offsets, 0.0, 16.0)?;
        for &offset in &self.gain_offset_db {
            within("gain_offset_db", offset, -100.0, 100.0)?;
        }
        let heading_deg = self.heading_deg.unwrap_or(0.0);
        within("heading_deg", heading_deg, -180.0, 360.0)?;
        within("link_latency_s", self.link_latency_s, 0.0, 5.0)
    }

    /// Whether it says which of several units is listened to.
    #[must_use]
    pub fn chooses_a_unit(&self) -> bool {
        self.channel.is_some() || self.source.is_some() || self.heading_deg.is_some()
    }

    /// Time from ping to ping to expect: what is asked, or what the range takes if that is longer.
    #[must_use]
    pub fn expected_interval_s(&self) -> f64 {
        let range_m = self.range_start_m + self.range_length_m;
        let shortest_s = 2.0 * range_m / self.speed_of_sound_mps + PING_OVERHEAD_S;
        shortest_s.max(f64::from(self.ping_interval_ms) * 1e-3)
    }

    /// Start and length as the wire has them.
    pub(crate) fn range_mm(&self) -> (u32, u32) {
        let millimetres = |metres: f64| (metres * 1e3).round() as u32;
        let (start, length) = (self.range_start_m, self.range_length_m);
        (millimetres(start), millimetres(length))
    }
}

fn within(key: &'static str, value: f64, low: f64, high: f64) -> Result<(), SessionConfigError> {
    if value >= low && value <= high {
        return Ok(());
    }
    Err(SessionConfigError {
        key,
        value,
        low,
        high,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed_and_nan_is_not() {
        assert_eq!(SessionConfig::default().check(), Ok(()));
        let odd = SessionConfig {
            range_length_m: f64::NAN,
            ..SessionConfig::default()
        };
        let error = odd.check().unwrap_err().to_string();
        assert!(error.contains("range_length_m") && error.contains("0.1 to 120"));
        let many = SessionConfig {
            gain_offset_db: vec![0.0, f64::INFINITY],
            ..SessionConfig::default()
        };
        assert_eq!(many.check().unwrap_err().key, "gain_offset_db");
    }

    #[test]
    fn ten_metres_take_seventeen_milliseconds() {
        let interval_s = SessionConfig::default().expected_interval_s();
        assert!((interval_s - 0.0168).abs() < 1e-3);
    }
}
