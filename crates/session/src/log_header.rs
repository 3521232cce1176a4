//! The session packets of a log: JSON in message 10.

use echosplat_model::Timestamp;
use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::iso8601;

/// The keys that matter; any of them marks a session packet.
#[derive(Debug, Deserialize)]
struct Keys {
    #[serde(default)]
    session_id: Option<IgnoredAny>,
    #[serde(default)]
    session_devices: Option<IgnoredAny>,
    #[serde(default)]
    timestamp: Option<Text>,
}

/// A value that should be text, and may be anything.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Text {
    Text(String),
    Other(IgnoredAny),
}

/// What a JSON packet of a log is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LogJson {
    /// A session begins, at a time if it says so.
    Session { timestamp: Option<Timestamp> },
    /// Something else.
    Other,
    /// No JSON object.
    Bad,
}

pub(crate) fn read(json: &[u8]) -> LogJson {
    // serde would take a list for the struct's fields in order.
    let is_object = json.trim_ascii_start().first() == Some(&b'{');
    let Some(keys) = is_object
        .then(|| serde_json::from_slice::<Keys>(json).ok())
        .flatten()
    else {
        return LogJson::Bad;
    };
    let is_session =
        keys.session_id.is_some() || keys.session_devices.is_some() || keys.timestamp.is_some();
    if !is_session {
        return LogJson::Other;
    }
    let timestamp = match keys.timestamp {
        Some(Text::Text(text)) => iso8601::parse(&text),
        Some(Text::Other(_)) | None => None,
    };
    LogJson::Session { timestamp }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn session_packets_with_and_without_time() {
        let json = br#"{"session_id": 3, "timestamp": "1970-01-01T00:00:01Z", "os_uptime": null}"#;
        let timestamp = Some(Timestamp::from_millis(1000));
        assert_eq!(read(json), LogJson::Session { timestamp });
        let untimed = LogJson::Session { timestamp: None };
        assert_eq!(read(br#"{"session_id": "a", "timestamp": null}"#), untimed);
        assert_eq!(read(br#"{"timestamp": 17, "session_id": 1}"#), untimed);
        assert_eq!(read(br#"{"anything": [1, 2]}"#), LogJson::Other);
    }

    #[test]
    fn what_is_no_json_object_is_bad() {
        let deep = "[".repeat(60_000);
        for bad in [&b""[..], b"[1]", b"{\"timestamp\":", deep.as_bytes()] {
            assert_eq!(read(bad), LogJson::Bad);
        }
    }
}
