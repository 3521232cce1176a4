//! What can be set, with defaults that hold for any scene.

use echosplat_measurement::{Beam, BeamError};
use serde::{Deserialize, Serialize};

use crate::Features;

/// Settings of the mapper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MapperConfig {
    /// Directional sensitivity of the sonar.
    pub beam: Beam,
    /// Metres, found: the transducer rings nearer.
    /// Nearer than this a ping is no evidence of anything: the transducer still rings. Metres.
    pub blanking_m: f64,
    /// Metres, derived from the beam where it is 0.
    /// Edge of an evidence voxel, metres; 0 takes what the beam resolves at the range where most strongest echoes come from.
    /// Finer ones take memory by the third power: whoever lets others choose bounds it.
    pub resolution_m: f64,
    /// Metres; assumed.
    /// One sigma of the sensor's position where the pose source says nothing, metres.
    pub position_sigma_m: f64,
    /// Degrees; assumed.
    /// One sigma of the sensor's attitude where the pose source says nothing, degrees.
    pub attitude_sigma_deg: f64,
    /// Seconds, assumed: aided navigation drifts over minutes.
    /// Time constant with which the error that neighbouring poses share fades, seconds: what is seen again later is seen
    /// with another error, and known the better.
    pub pose_error_time_s: f64,
    /// Noise powers, derived: noise passes once in 400 bins.
    /// A bin is an echo above this many times the mean noise power. 6 lets noise through once
    /// in 400 bins, at places that do not agree from ping to ping; echoes of rods are 5 to 15 dB.
    pub detection_factor: f32,
    /// Decibels; found.
    /// Echoes this far below the strongest of late at about their range are the beam's side lobes rather than surfaces,
    /// decibels.
    pub dynamic_range_db: f32,
    /// Pings; bounds latency.
    /// Pings whose evidence is taken in together; bounds the latency of the map.
    pub slice_pings: usize,
    /// Pings; bounds memory.
    /// Most pings that are remembered; beyond it the oldest go, and what they told stays with the Gaussians.
    pub history_pings: usize,
    /// Nats; found.
    /// Evidence at which a place becomes a Gaussian, in units of one clear observation.
    pub spawn_evidence: f32,
    /// Pairs; bounds work.
    /// Work that each ping allows, in Gaussian–bin pairs of a step or what takes as long; less makes the map lag, not
    /// worse.
    pub work_pairs_per_ping: u64,
    /// Whether somebody looks at the map while the dive goes on. If not, work waits for the end of the data, or until half of
    /// the pings that may be remembered are: half as much of it or less, and a map as near, though not the same to the bit.
    /// No key of a file: a run that a signal ends would leave no map.
    #[serde(skip)]
    pub live_map: bool,
    /// Steps; found.
    /// Steps of each stage when tiles are worked out.
    pub workout_passes: usize,
    /// Pairs; bounds work.
    /// About how many Gaussian–bin pairs a work-out may take; crowded maps look at fewer pings.
    pub workout_pairs: u64,
    /// Fraction; found.
    /// Least share of an echo that a confident Gaussian and its surroundings explain.
    pub confident_share: f32,
    /// Metres; found.
    /// Most one-sigma uncertainty of a confident Gaussian by its own pings alone, metres; one that is linked to a surface may
    /// have four times as much.
    pub confident_sigma_m: f32,
    /// Threads; layout.
    /// Threads of the mapper's own pool; 0 takes one per core. Does not change the result.
    pub threads: usize,
    /// What a scene may not need.
    pub parts: Features,
}

impl Default for MapperConfig {
    fn default() -> Self {
        Self {
            beam: Beam::default(),
            blanking_m: 0.5,
            resolution_m: 0.0,
            position_sigma_m: 0.02,
            attitude_sigma_deg: 0.2,
            pose_error_time_s: 60.0,
            detection_factor: 6.0,
            dynamic_range_db: 30.0,
            slice_pings: 4,
            history_pings: 65_536,
            spawn_evidence: 4.5,
            work_pairs_per_ping: 600_000,
            live_map: true,
            workout_passes: 16,
            workout_pairs: 6_000_000_000,
            confident_share: 0.7,
            confident_sigma_m: 0.25,
            threads: 0,
            parts: Features::default(),
        }
    }
}

/// A setting that cannot be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// Out of range.
    #[error("mapper.{key} is {value}; allowed is {low} to {high}")]
    OutOfRange {
        /// Name of the setting.
        key: &'static str,
        /// What it held.
        value: f64,
        /// Least allowed.
        low: f64,
        /// Most allowed.
        high: f64,
    },
    /// Of the beam.
    #[error("mapper.beam: {0}")]
    Beam(#[from] BeamError),
    /// The threads could not be started.
    #[error("mapper.threads: {0}")]
    Threads(String),
}

impl MapperConfig {
    /// # Errors
    /// Names the first setting that is out of range.
    pub fn check(&self) -> Result<(), ConfigError> {
        let within = |key, value: f64, low: f64, high: f64| {
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(ConfigError::OutOfRange {
                    key,
                    value,
                    low,
                    high,
                })
            }
        };
        self.beam.check()?;
        within("blanking_m", self.blanking_m, 0.0, 100.0)?;
        within("resolution_m", self.resolution_m, 0.0, 10.0)?;
        within("position_sigma_m", self.position_sigma_m, 0.0, 10.0)?;
        within("attitude_sigma_deg", self.attitude_sigma_deg, 0.0, 45.0)?;
        within("pose_error_time_s", self.pose_error_time_s, 0.1, 1e6)?;
        within("detection_factor", self.detection_factor.into(), 1.0, 1e6)?;
        within("dynamic_range_db", self.dynamic_range_db.into(), 3.0, 120.0)?;
        within("slice_pings", self.slice_pings as f64, 1.0, 1024.0)?;
        within("history_pings", self.history_pings as f64, 16.0, 1e6)?;
        within("spawn_evidence", self.spawn_evidence.into(), 0.1, 1e3)?;
        within(
            "work_pairs_per_ping",
            self.work_pairs_per_ping as f64,
            0.0,
            1e12,
        )?;
        within("workout_passes", self.workout_passes as f64, 0.0, 1000.0)?;
        within("workout_pairs", self.workout_pairs as f64, 1e6, 1e13)?;
        within("confident_share", self.confident_share.into(), 0.0, 1.0)?;
        within(
            "confident_sigma_m",
            self.confident_sigma_m.into(),
            1e-3,
            10.0,
        )?;
        within("threads", self.threads as f64, 0.0, 256.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed_and_nan_is_not() {
        assert_eq!(MapperConfig::default().check(), Ok(()));
        let odd = MapperConfig {
            blanking_m: f64::NAN,
            ..MapperConfig::default()
        };
        let said = odd.check().unwrap_err().to_string();
        assert!(said.contains("mapper.blanking_m"), "{said}");
    }
}
