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
    /// An endpoint without a port.
    #[error(
        "zenoh {setting} {endpoint}: no port; routers listen on 7447, as in tcp/192.168.2.1:7447"
    )]
    NoPort {
        /// Path of the setting that names it, separated by slashes.
        setting: &'static str,
        /// As it was given.
        endpoint: String,
    },
    /// An endpoint of a kind that this program was built without.
    #[error(
        "zenoh {setting} {endpoint}: {} is not built in; built in is {built_in}, as in tcp/127.0.0.1:7447",
        .endpoint.split('/').next().unwrap_or_default()
    )]
    Endpoint {
        /// Path of the setting that names it, separated by slashes.
        setting: &'static str,
        /// As it was given.
        endpoint: String,
        /// Kinds of endpoint there are, separated by commas.
        built_in: String,
    },
    /// Poses are to come from ROS 2, of which no domain is configured.
    #[error(
        "poses come from ros2://, but bus.ros_domain_id is not set; write the vehicle's ROS_DOMAIN_ID there, 0 unless it has another"
    )]
    NoRosDomain,
    /// No topic of ROS that poses can come from.
    #[error("poses: {0}")]
    RosTopic(String),
    /// A message that no subscriber would take.
    #[error("the {what} has {found} bytes; at most {limit} are sent")]
    TooLong {
        /// Which message.
        what: &'static str,
        /// Bytes it has.
        found: usize,
        /// Bytes it may have.
        limit: usize,
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
