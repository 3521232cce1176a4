//! What the device sends of a ping: 16-bit decibels on the ping's own scale.

use std::sync::Arc;

use echosplat_model::{Ping, PingError, PingSettings, Timestamp};

/// Foot of a real unit's decibel scale: what a bin without any power shows.
const SCALE_FOOT_DB: f64 = -45.0;

/// Power over range as the device's `os_mono_profile` holds it.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Power of a full-scale result, dB.
    pub max_pwr_db: f32,
    /// Power of a zero result, dB.
    pub min_pwr_db: f32,
    /// One per bin: `power_db = min + raw / 65535 · (max − min)`.
    pub pwr_results: Vec<u16>,
}

impl Profile {
    /// `power` is linear, one per bin, not negative.
    pub(crate) fn from_power(power: &[f64]) -> Self {
        let decibels = |power: &f64| (10.0 * power.log10()).max(SCALE_FOOT_DB);
        let levels_db: Vec<f64> = power.iter().map(decibels).collect();
        let min = levels_db.iter().copied().fold(f64::INFINITY, f64::min) as f32;
        let max = levels_db.iter().copied().fold(f64::NEG_INFINITY, f64::max) as f32;
        let (min_pwr_db, max_pwr_db) = if min.is_finite() {
            (min, max)
        } else {
            (SCALE_FOOT_DB as f32, SCALE_FOOT_DB as f32)
        };
        let span = f64::from(max_pwr_db) - f64::from(min_pwr_db);
        let raw = |level_db: &f64| {
            let share = (level_db - f64::from(min_pwr_db)) / span.max(1e-12);
            (share * 65535.0).round().clamp(0.0, 65535.0) as u16
        };
        Self {
            max_pwr_db,
            min_pwr_db,
            pwr_results: levels_db.iter().map(raw).collect(),
        }
    }

    /// Linear power per bin as a reader of the profile computes it: `10^(power_db / 10)`.
    #[must_use]
    pub fn intensity(&self) -> Vec<f32> {
        let (min, max) = (f64::from(self.min_pwr_db), f64::from(self.max_pwr_db));
        let linear = |&raw: &u16| {
            let level_db = min + f64::from(raw) / 65535.0 * (max - min);
            10f64.powf(0.1 * level_db) as f32
        };
        self.pwr_results.iter().map(linear).collect()
    }
}

/// One ping as the device made it.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedPing {
    /// Counts the pings of the dive from 0.
    pub sequence: u64,
    /// Device clock at transmit, milliseconds since the dive began.
    pub device_time_ms: u32,
    /// How it was made.
    pub settings: PingSettings,
    /// Number of the image it is a beam of, in a viewpoint dive.
    pub view: Option<u32>,
    /// As sent.
    pub profile: Profile,
    /// Linear power per bin as read back from the profile, shape `[bin_count]`.
    pub intensity: Vec<f32>,
}

impl SimulatedPing {
    /// Device time at transmit on the base the dive's poses share.
    #[must_use]
    pub fn transmit_time(&self) -> Timestamp {
        Timestamp::from_millis(i64::from(self.device_time_ms))
    }

    /// The same ping as a session would hand it on.
    ///
    /// # Errors
    /// If the settings it was made with are none a ping can have.
    pub fn to_ping(&self) -> Result<Arc<Ping>, PingError> {
        let ping = Ping::new(
            self.sequence,
            self.transmit_time(),
            self.settings,
            self.intensity.clone(),
        )?;
        Ok(Arc::new(match self.view {
            Some(view) => ping.with_beam(0.0, view),
            None => ping,
        }))
    }
}
