//! What can go wrong with the bus itself; bad messages are counted, not errors.

use std::path::PathBuf;
use std::time::Duration;

/// Why the bus did not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// A key of [`crate::BusConfig`] out of range.
    #[error("bus.{key} is {found}; allowed is {allowed}")]
    Config {
        /// Name of the key.
        key: &'static str,
        /// What it held.
        found: String,
        /// What it may hold.
        allowed: &'static str,
    },
    /// A zenoh configuration file that cannot be used.
    #[error("zenoh configuration {path} (from {source_name}) cannot be used: {reason}", path = .path.display())]
    ConfigFile {
        /// Which file.
        path: PathBuf,
        /// Who named it: the option or the environment variable.
        source_name: &'static str,
        /// What zenoh says.
        reason: String,
    },
    /// One `key=json5` that zenoh does not take.
    #[error("zenoh setting {key}={value} is refused: {reason}")]
    ZenohSetting {
        /// Path of the setting, separated by slashes.
        key: String,
        /// The JSON5 text.
        value: String,
        /// What zenoh says.
        reason: String,
    },
    /// zenoh failed.
    #[error("zenoh could not {action}: {reason}")]
    Zenoh {
        /// What was tried.
        action: String,
        /// What zenoh says.
        reason: String,
    },
    /// Not done in time.
    #[error("{action} took longer than {} s", .limit.as_secs_f64())]
    TimedOut {
        /// What was tried.
        action: &'static str,
        /// How long was allowed.
        limit: Duration,
    },
}

impl BusError {
    pub(crate) fn zenoh(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
        let action = action.into();
        move |reason| Self::Zenoh {
            action,
            reason: reason.to_string(),
        }
    }
}
