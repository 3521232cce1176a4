//! 2197 `os_ping_params`: ping settings, and the switch that starts and stops pinging.

use crate::error::{EncodeError, ParseError};
use crate::frame;
use crate::id;
use crate::wire::{f32_at, i16_at, put, u16_at, u32_at};

/// Payload as the protocol's tables have it.
pub(crate) const PAYLOAD_BYTES: usize = 36;
/// Payload as one vendor page has it: one reserved byte at the end instead of three.
pub(crate) const SHORT_PAYLOAD_BYTES: usize = 34;

mod field {
    use crate::wire::Field;

    pub(super) const START_MM: Field = 0..4;
    pub(super) const LENGTH_MM: Field = 4..8;
    pub(super) const MSEC_PER_PING: Field = 8..12;
    pub(super) const RESERVED: Field = 12..20;
    pub(super) const PULSE_LEN_PERCENT: Field = 20..24;
    pub(super) const FILTER_DURATION_PERCENT: Field = 24..28;
    pub(super) const GAIN_INDEX: Field = 28..30;
    pub(super) const NUM_RESULTS: Field = 30..32;
    pub(super) const ENABLE: usize = 32;
}

/// Ping settings. Sent once, the device goes on pinging by itself until `enable` is sent false.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OsPingParams {
    /// Range at which the first result begins, in millimetres.
    pub start_mm: u32,
    /// Range from there to the end of the last result, in millimetres.
    pub length_mm: u32,
    /// Interval between pings in milliseconds; 0 is as fast as the range allows.
    pub msec_per_ping: u32,
    /// Pulse length as a fraction of the two-way time, despite its name; 0.002 is typical.
    pub pulse_len_percent: f32,
    /// Filter length as a fraction of the two-way time; 0.0015 is typical.
    pub filter_duration_percent: f32,
    /// -1 automatic, 0 to 7.
    pub gain_index: i16,
    /// Results per profile, 200 to 1200; 600 is typical.
    pub num_results: u16,
    /// True starts pinging, false stops it.
    pub enable: bool,
}

impl OsPingParams {
    /// Writes the message with the 34-byte payload of one vendor page, for units that do not
    /// follow the 36-byte one; otherwise as [`Message::encode`](crate::Message::encode).
    ///
    /// # Errors
    /// If `out` has less than 44 bytes; nothing is written then.
    pub fn encode_short(&self, src: u8, dst: u8, out: &mut [u8]) -> Result<usize, EncodeError> {
        frame::encode(
            id::OS_PING_PARAMS,
            (src, dst),
            SHORT_PAYLOAD_BYTES,
            out,
            |payload| {
                self.emit(payload);
            },
        )
    }

    /// Reads a payload of either length.
    pub(super) fn parse(payload: &[u8]) -> Result<Self, ParseError> {
        Ok(Self {
            start_mm: u32_at(payload, field::START_MM),
            length_mm: u32_at(payload, field::LENGTH_MM),
            msec_per_ping: u32_at(payload, field::MSEC_PER_PING),
            pulse_len_percent: f32_at(payload, field::PULSE_LEN_PERCENT),
            filter_duration_percent: f32_at(payload, field::FILTER_DURATION_PERCENT),
            gain_index: i16_at(payload, field::GAIN_INDEX),
            num_results: u16_at(payload, field::NUM_RESULTS),
            enable: parse_enable(payload[field::ENABLE])?,
        })
    }

    /// Fills a payload of either length; the bytes after `enable` are reserved.
    pub(super) fn emit(&self, payload: &mut [u8]) {
        put(payload, field::START_MM, &self.start_mm.to_le_bytes());
        put(payload, field::LENGTH_MM, &self.length_mm.to_le_bytes());
        put(
            payload,
            field::MSEC_PER_PING,
            &self.msec_per_ping.to_le_bytes(),
        );
        payload[field::RESERVED].fill(0);
        put(
            payload,
            field::PULSE_LEN_PERCENT,
            &self.pulse_len_percent.to_le_bytes(),
        );
        put(
            payload,
            field::FILTER_DURATION_PERCENT,
            &self.filter_duration_percent.to_le_bytes(),
        );
        put(payload, field::GAIN_INDEX, &self.gain_index.to_le_bytes());
        put(payload, field::NUM_RESULTS, &self.num_results.to_le_bytes());
        payload[field::ENABLE] = self.enable.into();
        payload[field::ENABLE + 1..].fill(0);
    }
}

fn parse_enable(enable: u8) -> Result<bool, ParseError> {
    match enable {
        0 => Ok(false),
        1 => Ok(true),
        found => Err(ParseError::Value {
            message_id: id::OS_PING_PARAMS,
            field: "enable",
            found: found.into(),
            allowed: "0 and 1",
        }),
    }
}
