//! 2194 status: undocumented, seen on real units about every 1.1 s.

use crate::wire::{f32_at, put, u32_at};

/// The part of the payload that is understood.
pub(crate) const PAYLOAD_BYTES: usize = 16;

mod field {
    use crate::wire::Field;

    pub(super) const VALUE_0: Field = 0..4;
    pub(super) const VALUE_1: Field = 4..8;
    pub(super) const TIMESTAMP_MS: Field = 8..12;
    pub(super) const CHANNEL_NUMBER: usize = 12;
    pub(super) const PADDING: Field = 13..16;
}

/// The fields told apart so far. Bytes after the sixteenth are ignored on reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// Two numbers of unknown meaning.
    pub values: [f32; 2],
    /// Device time since power-up, in milliseconds.
    pub timestamp_ms: u32,
    /// As in a profile.
    pub channel_number: u8,
}

impl Status {
    pub(super) fn parse(payload: &[u8]) -> Self {
        Self {
            values: [
                f32_at(payload, field::VALUE_0),
                f32_at(payload, field::VALUE_1),
            ],
            timestamp_ms: u32_at(payload, field::TIMESTAMP_MS),
            channel_number: payload[field::CHANNEL_NUMBER],
        }
    }

    pub(super) fn emit(&self, payload: &mut [u8]) {
        put(payload, field::VALUE_0, &self.values[0].to_le_bytes());
        put(payload, field::VALUE_1, &self.values[1].to_le_bytes());
        put(
            payload,
            field::TIMESTAMP_MS,
            &self.timestamp_ms.to_le_bytes(),
        );
        payload[field::CHANNEL_NUMBER] = self.channel_number;
        payload[field::PADDING].fill(0);
    }
}
