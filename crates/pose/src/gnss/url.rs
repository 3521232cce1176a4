//! Names of satellite receivers.

use std::fmt;
use std::str::FromStr;

use echosplat_ros::rmw_zenoh::topic_name;
use serde::{Deserialize, Serialize};

use crate::url::host_and_port;

/// Where chart plotters and NMEA multiplexers send to.
const DEFAULT_NMEA_PORT: u16 = 10_110;

/// Where fixes come from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum GnssUrl {
    /// `udp://HOST[:PORT]`: listens there for NMEA 0183.
    Nmea(String),
    /// `ros2:///TOPIC`: `NavSatFix` of ROS 2 with `rmw_zenoh`; the topic's whole name.
    Ros2(String),
}

/// Every form, for messages and help.
pub const GNSS_URL_FORMS: &str = "udp://0.0.0.0:10110, which listens for NMEA, or ros2:///TOPIC";

/// A text that names no receiver.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("GNSS receiver {text:?}: {reason}; it must be {GNSS_URL_FORMS}")]
pub struct GnssUrlError {
    text: String,
    reason: String,
}

impl FromStr for GnssUrl {
    type Err = GnssUrlError;

    fn from_str(text: &str) -> Result<Self, GnssUrlError> {
        let wrong = |reason: String| GnssUrlError {
            text: text.to_owned(),
            reason,
        };
        match text.split_once("://") {
            Some(("udp", rest)) => host_and_port(rest, DEFAULT_NMEA_PORT)
                .map(Self::Nmea)
                .map_err(wrong),
            Some(("ros2", rest)) => topic_name(rest)
                .map(Self::Ros2)
                .map_err(|error| wrong(error.to_string())),
            _ => Err(wrong("it is none".to_owned())),
        }
    }
}

impl TryFrom<String> for GnssUrl {
    type Error = GnssUrlError;

    fn try_from(text: String) -> Result<Self, GnssUrlError> {
        text.parse()
    }
}

impl From<GnssUrl> for String {
    fn from(url: GnssUrl) -> Self {
        url.to_string()
    }
}

impl fmt::Display for GnssUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nmea(address) => write!(f, "udp://{address}"),
            Self::Ros2(topic) => write!(f, "ros2://{topic}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_are_read_and_written_and_others_are_refused() {
        for (text, written) in [
            ("udp://0.0.0.0:10110", "udp://0.0.0.0:10110"),
            ("udp://127.0.0.1", "udp://127.0.0.1:10110"),
            ("ros2:///gps/fix", "ros2:///gps/fix"),
        ] {
            let url: GnssUrl = text.parse().unwrap();
            assert_eq!(url.to_string(), written);
        }
        for text in ["", "tcp://a:1", "udp://", "udp://a:b", "ros2://1", "10110"] {
            let said = text.parse::<GnssUrl>().unwrap_err().to_string();
            assert!(said.contains("udp://0.0.0.0:10110"), "{said}");
        }
    }
}
