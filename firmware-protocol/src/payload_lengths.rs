//! Which payload lengths each message id allows: what keeps a damaged length from being believed.

use core::fmt;

use crate::frame::MAX_PAYLOAD_BYTES;
use crate::id;
use crate::message;

/// The payload lengths of one message id, in bytes: `min`, `min + step`, … up to `max`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PayloadLengths {
    /// Shortest.
    pub min: usize,
    /// Longest.
    pub max: usize,
    /// From one allowed length to the next; at least 1.
    pub step: usize,
}

impl PayloadLengths {
    /// The lengths `message_id` allows. Texts, wrappers and ids outside the tables may have any
    /// that a header can say: nobody documents how long they get.
    #[must_use]
    pub const fn of(message_id: u16) -> Self {
        match message_id {
            id::NOP => Self::exactly(0),
            id::ACK | id::GENERAL_REQUEST => Self::exactly(2),
            id::NACK => Self::between(2, MAX_PAYLOAD_BYTES),
            id::DEVICE_INFORMATION => Self::exactly(message::DEVICE_INFORMATION_BYTES),
            id::PROTOCOL_VERSION => Self::exactly(message::PROTOCOL_VERSION_BYTES),
            id::SET_DEVICE_ID => Self::exactly(1),
            id::SET_SPEED_OF_SOUND => Self::exactly(4),
            id::SYNC_CHANNEL_NUMBER | id::SET_SYNC_CHANNEL_NUMBER => {
                Self::exactly(message::SYNC_CHANNEL_BYTES)
            }
            // Undocumented: later firmware may append to it.
            id::STATUS => Self::between(message::STATUS_BYTES, 4 * message::STATUS_BYTES),
            id::OS_PING_PARAMS => Self {
                min: message::OS_PING_PARAMS_SHORT_BYTES,
                max: message::OS_PING_PARAMS_BYTES,
                step: 2,
            },
            id::OS_MONO_PROFILE => Self {
                min: message::OS_MONO_PROFILE_FIXED_BYTES,
                max: message::OS_MONO_PROFILE_FIXED_BYTES + 2 * message::MAX_RESULT_COUNT,
                step: 2,
            },
            _ => Self::between(0, MAX_PAYLOAD_BYTES),
        }
    }

    /// Whether a payload of `byte_count` bytes is allowed.
    #[must_use]
    pub const fn allow(self, byte_count: usize) -> bool {
        byte_count >= self.min
            && byte_count <= self.max
            && (byte_count - self.min).is_multiple_of(self.step)
    }

    const fn exactly(byte_count: usize) -> Self {
        Self::between(byte_count, byte_count)
    }

    const fn between(min: usize, max: usize) -> Self {
        Self { min, max, step: 1 }
    }
}

impl fmt::Display for PayloadLengths {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.max - self.min, self.step) {
            (0, _) => write!(f, "{}", self.min),
            (_, 1) => write!(f, "{} to {}", self.min, self.max),
            (_, step) => write!(f, "{} to {} in steps of {step}", self.min, self.max),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    #[test]
    fn lengths_follow_the_tables() {
        let allowed = |message_id, max| -> std::vec::Vec<usize> {
            (0..=max)
                .filter(|&n| PayloadLengths::of(message_id).allow(n))
                .collect()
        };
        assert_eq!(allowed(id::NOP, 100), [0]);
        assert_eq!(allowed(id::DEVICE_INFORMATION, 100), [6]);
        assert_eq!(allowed(id::OS_PING_PARAMS, 100), [34, 36]);
        assert_eq!(allowed(id::OS_MONO_PROFILE, 56), [52, 54, 56]);
        assert!(PayloadLengths::of(id::OS_MONO_PROFILE).allow(52 + 2 * 1200));
        assert!(!PayloadLengths::of(id::OS_MONO_PROFILE).allow(65534));
    }

    #[test]
    fn lengths_read_as_a_sentence() {
        let text = |message_id| PayloadLengths::of(message_id).to_string();
        assert_eq!(text(id::ACK), "2");
        assert_eq!(text(id::ASCII_TEXT), "0 to 65535");
        assert_eq!(text(id::OS_PING_PARAMS), "34 to 36 in steps of 2");
    }
}
