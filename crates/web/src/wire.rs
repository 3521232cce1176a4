//! What goes over the WebSocket.
//!
//! Text messages are JSON objects with a `kind`: `hello` first, then `status`, `pose`, `error`, `epoch` and, every
//! two seconds, `alive`.
//! Binary messages are, little-endian:
//!
//! | offset | what |
//! |---|---|
//! | 0 | kind, u8: 1 a message of a delta, 2 a message of a snapshot, 3 a ping |
//! | 1 | zeros up to 4 |
//! | 4 | bytes of the header, u32 |
//! | 8 | when it was made, or a ping came, f64, milliseconds since 1970 on this machine's clock |
//! | 16 | header, JSON |
//! | then | payload |
//!
//! Header and payload of a delta and of a snapshot are attachment and payload of the bus's messages:
//! see [`echosplat_bus::map_message`] and [`echosplat_bus::point_cloud`]. A ping's header says
//! `sequence`, `time_ns`, `range_start_m`, `range_length_m`, `floor_db` and `step_db`; its payload is a
//! byte a bin, `floor_db + step_db · byte` decibels of linear power, 0 for all that is less.
//!
//! From the browser the text `snapshot` asks for the map anew.

use std::time::SystemTime;

use axum::body::Bytes;
use echosplat_model::Timestamp;

/// Bytes before the header.
const HEAD_BYTES: usize = 16;

/// What a binary message is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Delta = 1,
    Snapshot = 2,
    Ping = 3,
}

/// One binary message, made now.
pub(crate) fn binary(kind: Kind, header: &[u8], payload: &[u8]) -> Bytes {
    binary_of(kind, now_ms(), header, payload)
}

/// The same, of what came at this time.
pub(crate) fn binary_of(kind: Kind, at_ms: f64, header: &[u8], payload: &[u8]) -> Bytes {
    let mut bytes = Vec::with_capacity(HEAD_BYTES + header.len() + payload.len());
    bytes.extend([kind as u8, 0, 0, 0]);
    let header_len = u32::try_from(header.len()).unwrap_or(0);
    bytes.extend(header_len.to_le_bytes());
    bytes.extend(at_ms.to_le_bytes());
    bytes.extend(header);
    bytes.extend(payload);
    bytes.into()
}

/// Milliseconds since 1970.
pub(crate) fn now_ms() -> f64 {
    Timestamp::from(SystemTime::now()).as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_are_those_documented() {
        let bytes = binary(Kind::Ping, b"{}", &[7, 8, 9]);
        assert_eq!(bytes[..4], [3, 0, 0, 0]);
        assert_eq!(bytes[4..8], [2, 0, 0, 0]);
        assert_eq!(bytes[16..], *b"{}\x07\x08\x09");
    }
}
