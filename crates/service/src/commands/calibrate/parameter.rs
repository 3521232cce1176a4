//! What is shifted.

use echosplat_prediction::alignment::Quantity;

use crate::arguments::Parameter;
use crate::config::Config;

impl Parameter {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Time => "time offset",
            Self::Yaw => "mount's yaw",
            Self::Pitch => "mount's pitch",
            Self::Roll => "mount's roll",
        }
    }

    /// As it is looked for far off.
    pub(super) fn quantity(self) -> Quantity {
        match self {
            Self::Time => Quantity::TimeOffset,
            Self::Yaw => Quantity::Yaw,
            Self::Pitch => Quantity::Pitch,
            Self::Roll => Quantity::Roll,
        }
    }

    /// Place in `yaw_pitch_roll_deg`.
    pub(super) fn angle(self) -> Option<usize> {
        match self {
            Self::Time => None,
            Self::Yaw => Some(0),
            Self::Pitch => Some(1),
            Self::Roll => Some(2),
        }
    }

    /// What is tried first, to both sides, seconds or degrees.
    pub(super) fn step(self) -> f64 {
        match self {
            Self::Time => 0.1,
            Self::Yaw | Self::Pitch => 1.0,
            Self::Roll => 2.0,
        }
    }

    pub(super) fn show(self, value: f64) -> String {
        match self {
            Self::Time => format!("{value:.3} s"),
            _ => format!("{value:.2}°"),
        }
    }

    /// With its sigma, where that is known.
    pub(super) fn show_with(self, value: f64, sigma: Option<f64>) -> String {
        match (self, sigma) {
            (_, None) => self.show(value),
            (Self::Time, Some(sigma)) => format!("{value:.3} ± {sigma:.3} s"),
            (_, Some(sigma)) => format!("{value:.2} ± {sigma:.2}°"),
        }
    }

    pub(super) fn of(self, config: &Config) -> f64 {
        match self.angle() {
            Some(angle) => config.pose.vehicle_from_sensor.yaw_pitch_roll_deg[angle],
            None => config.pose.time_offset_s,
        }
    }

    /// With this one as it is in `other`.
    pub(super) fn set_as_in(self, config: &Config, other: &Config) -> Config {
        self.shifted(config, self.of(other) - self.of(config))
    }

    pub(super) fn shifted(self, config: &Config, shift: f64) -> Config {
        let mut config = config.clone();
        match self.angle() {
            Some(angle) => config.pose.vehicle_from_sensor.yaw_pitch_roll_deg[angle] += shift,
            None => config.pose.time_offset_s += shift,
        }
        config
    }
}
