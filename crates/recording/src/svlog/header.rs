//! The session packet: who recorded what, and from when device time counts.

use echosplat_model::Timestamp;
use serde::{Deserialize, Serialize};

/// The session packet of a log.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionHeader {
    /// Number of the session.
    pub session_id: u64,
    /// Unix time of the session's start: that of its first profile.
    pub timestamp: Timestamp,
    /// The sonars in it.
    pub devices: Vec<SessionDevice>,
    /// What recorded it.
    pub platform: String,
    /// Device time of that first profile, where it is known: by it other programs join the
    /// profiles' times with `timestamp`.
    pub device_uptime_s: Option<f64>,
    /// `timestamp` is when the log was opened, and its first profile came later by an unknown time: the vendor's
    /// Python client (bluerobotics-ping, 0.2.5) writes it so, and what was made after its example.
    pub is_from_opening: bool,
}

/// One sonar of a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionDevice {
    /// Where it was reached.
    #[serde(default)]
    pub url: String,
    /// `os450` for the `OmniScan` 450.
    #[serde(default)]
    pub product_id: String,
    /// Source of its packets.
    #[serde(default)]
    pub device_id: u8,
    /// What its owner calls it.
    #[serde(default)]
    pub nickname: String,
}

/// Why a session packet was not understood.
#[derive(Debug, thiserror::Error)]
pub enum HeaderError {
    /// Not JSON, or of another shape.
    #[error("not a session packet: {0}")]
    Json(#[from] serde_json::Error),
    /// Its time is no time.
    #[error("`timestamp` is `{found}`, expected ISO 8601 as in 2024-05-01T12:00:00.000Z")]
    Timestamp {
        /// What it says.
        found: String,
    },
    /// Longer than a frame.
    #[error("{0}")]
    Encode(echosplat_firmware_protocol::EncodeError),
}

/// The keys of the JSON as logs have them; everything but the time may be missing or `null`.
#[derive(Serialize, Deserialize)]
struct Packet {
    #[serde(default)]
    session_id: serde_json::Value,
    #[serde(default)]
    session_uptime: serde_json::Value,
    #[serde(default)]
    session_devices: serde_json::Value,
    #[serde(default)]
    session_platform: serde_json::Value,
    timestamp: String,
    #[serde(default)]
    timestamp_timezone_offset: serde_json::Value,
    #[serde(default)]
    os_uptime: serde_json::Value,
    /// Not in the vendor's table; `PINGVerter` does not read a log without it.
    #[serde(default)]
    process_uptime: serde_json::Value,
    #[serde(default, skip_serializing)]
    sonarlink_version: serde_json::Value,
    #[serde(default, skip_serializing)]
    process_path: serde_json::Value,
    #[serde(default, skip_serializing)]
    process_version: serde_json::Value,
}

impl Packet {
    /// By its fields: what records for `SonarView` names its version. The client leaves that empty, and does not know
    /// how long the system is up; what was made after it without that field is still Python, and so writes times to
    /// the microsecond where others write milliseconds, however few fields it has.
    fn is_from_opening(&self) -> bool {
        let text = |value: &serde_json::Value| value.as_str().map(str::to_lowercase);
        let is_python = match (text(&self.process_path), text(&self.process_version)) {
            (None, None) => fraction_digits(&self.timestamp) == 6,
            (path, version) => {
                path.is_some_and(|path| path.contains("python"))
                    || version.is_some_and(|version| version.starts_with("v3."))
            }
        };
        let is_unnamed = match text(&self.sonarlink_version) {
            Some(version) => version.is_empty(),
            None => is_python,
        };
        is_unnamed && !self.os_uptime.is_number()
    }
}

impl SessionHeader {
    /// Of a simulated or newly recorded dive with one `OmniScan` 450.
    #[must_use]
    pub fn new(timestamp: Timestamp, device_id: u8, url: &str) -> Self {
        Self {
            session_id: 1,
            timestamp,
            devices: vec![SessionDevice {
                url: url.to_owned(),
                product_id: "os450".to_owned(),
                device_id,
                nickname: String::new(),
            }],
            platform: concat!("echosplat ", env!("CARGO_PKG_VERSION")).to_owned(),
            device_uptime_s: None,
            is_from_opening: false,
        }
    }

    /// As the packet's JSON.
    #[must_use]
    pub fn to_json(&self) -> String {
        let packet = Packet {
            session_id: self.session_id.into(),
            session_uptime: 0.into(),
            session_devices: serde_json::json!(self.devices),
            session_platform: self.platform.as_str().into(),
            timestamp: format_timestamp(self.timestamp),
            timestamp_timezone_offset: 0.into(),
            os_uptime: self.device_uptime_s.into(),
            process_uptime: 0.into(),
            sonarlink_version: serde_json::Value::Null,
            process_path: serde_json::Value::Null,
            process_version: serde_json::Value::Null,
        };
        // Numbers and strings only: nothing here can fail to become JSON.
        serde_json::to_string(&packet).unwrap_or_default()
    }

    /// From the packet's JSON: devices may be a list or an object by any key, everything but the
    /// time may be missing.
    ///
    /// # Errors
    /// If it is no JSON object, or has no readable `timestamp`.
    pub fn parse(json: &[u8]) -> Result<Self, HeaderError> {
        let packet: Packet = serde_json::from_slice(json)?;
        let is_from_opening = packet.is_from_opening();
        let devices = match packet.session_devices {
            serde_json::Value::Array(list) => list,
            serde_json::Value::Object(object) => object.into_values().collect(),
            _ => Vec::new(),
        };
        let device = |value| serde_json::from_value::<SessionDevice>(value).ok();
        Ok(Self {
            session_id: packet.session_id.as_u64().unwrap_or(0),
            timestamp: parse_timestamp(&packet.timestamp)?,
            devices: devices.into_iter().filter_map(device).collect(),
            platform: packet.session_platform.as_str().unwrap_or("").to_owned(),
            device_uptime_s: packet.os_uptime.as_f64(),
            is_from_opening,
        })
    }
}

/// How many digits of a second a time has.
fn fraction_digits(timestamp: &str) -> usize {
    let fraction = timestamp
        .split_once('.')
        .map_or("", |(_, fraction)| fraction);
    fraction.bytes().take_while(u8::is_ascii_digit).count()
}

/// To the millisecond as the vendor writes it, or to the nanosecond where that says more.
fn format_timestamp(timestamp: Timestamp) -> String {
    let time = jiff::Timestamp::from_nanosecond(timestamp.nanos().into());
    // The calendar's range holds every i64 of nanoseconds.
    let time = time.unwrap_or(jiff::Timestamp::UNIX_EPOCH);
    match timestamp.nanos() % 1_000_000 {
        0 => format!("{time:.3}"),
        _ => format!("{time:.9}"),
    }
}

/// A time without zone is taken as UTC.
fn parse_timestamp(text: &str) -> Result<Timestamp, HeaderError> {
    let wrong = || HeaderError::Timestamp {
        found: text.chars().take(40).collect(),
    };
    let time: jiff::Timestamp = text
        .parse()
        .or_else(|_| format!("{text}Z").parse())
        .map_err(|_| wrong())?;
    let nanos = i64::try_from(time.as_nanosecond()).map_err(|_| wrong())?;
    Ok(Timestamp::from_nanos(nanos))
}
