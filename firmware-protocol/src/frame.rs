//! The frame every message travels in.
//!
//! | offset | type | field |
//! |---|---|---|
//! | 0 | u8 × 2 | `42 52` ("BR") |
//! | 2 | u16 | payload length N |
//! | 4 | u16 | message id |
//! | 6 | u8 | source device id |
//! | 7 | u8 | destination device id |
//! | 8 | u8 × N | payload |
//! | 8+N | u16 | checksum: sum of all bytes before it, modulo 65536 |

use crate::error::{EncodeError, FrameError};
use crate::id;
use crate::message;
use crate::payload_lengths::PayloadLengths;
use crate::wire::{put, u16_at};

/// What every frame begins with.
pub(crate) const START: [u8; 2] = *b"BR";
/// Bytes before the payload.
pub(crate) const HEADER_BYTES: usize = 8;
/// Bytes of a frame without payload.
pub(crate) const OVERHEAD_BYTES: usize = HEADER_BYTES + 2;
/// Bytes from which length and id can be read.
pub(crate) const LENGTH_AND_ID_BYTES: usize = field::MESSAGE_ID.end;

/// The longest payload any id allows; the length field can say no more.
pub const MAX_PAYLOAD_BYTES: usize = u16::MAX as usize;
/// The longest frame of any id.
pub const MAX_FRAME_BYTES: usize = MAX_PAYLOAD_BYTES + OVERHEAD_BYTES;

mod field {
    use crate::wire::Field;

    pub(super) const START: Field = 0..2;
    pub(super) const PAYLOAD_LENGTH: Field = 2..4;
    pub(super) const MESSAGE_ID: Field = 4..6;
    pub(super) const SRC_DEVICE_ID: usize = 6;
    pub(super) const DST_DEVICE_ID: usize = 7;
}

/// One intact frame: start, length for its id, and checksum were right when it was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    bytes: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Checks that `bytes` is exactly one intact frame.
    ///
    /// # Errors
    /// Says what is wrong: the start, the length (against the id's table, or against the bytes
    /// given), or the checksum.
    pub fn from_bytes(bytes: &'a [u8]) -> Result<Self, FrameError> {
        match judge(bytes) {
            Verdict::Intact { byte_count } if byte_count == bytes.len() => Ok(Self { bytes }),
            Verdict::Intact { byte_count } | Verdict::Unfinished { byte_count } => {
                Err(FrameError::ByteCount {
                    expected: byte_count,
                    found: bytes.len(),
                })
            }
            Verdict::NoStart => Err(FrameError::Start),
            Verdict::BadLength {
                message_id,
                payload_bytes,
                ..
            } => Err(FrameError::Length {
                message_id,
                found: payload_bytes,
                allowed: PayloadLengths::of(message_id),
            }),
            Verdict::BadChecksum { .. } => Err(FrameError::Checksum),
        }
    }

    /// A frame that [`judge`] has found intact.
    pub(crate) fn judged_intact(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// Message id.
    #[must_use]
    pub fn message_id(&self) -> u16 {
        u16_at(self.bytes, field::MESSAGE_ID)
    }

    /// Device id of the sender; 0 is a host.
    #[must_use]
    pub fn src_device_id(&self) -> u8 {
        self.bytes[field::SRC_DEVICE_ID]
    }

    /// Device id of the receiver; 0 is any, 255 a broadcast.
    #[must_use]
    pub fn dst_device_id(&self) -> u8 {
        self.bytes[field::DST_DEVICE_ID]
    }

    /// The payload.
    #[must_use]
    pub fn payload(&self) -> &'a [u8] {
        &self.bytes[HEADER_BYTES..self.bytes.len() - 2]
    }

    /// The whole frame, from start to checksum.
    #[must_use]
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }
}

/// Sum of `bytes` modulo 65536, as a frame's last two bytes carry it.
#[must_use]
pub fn checksum(bytes: &[u8]) -> u16 {
    // 16-bit lanes: the compiler sums 16 bytes or more a step.
    bytes
        .iter()
        .fold(0, |sum: u16, &byte| sum.wrapping_add(u16::from(byte)))
}

/// What the bytes of a candidate frame say so far. More bytes turn `Unfinished` into another
/// verdict and change no other one, so the verdict does not depend on how a stream is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// The first bytes are not those of a frame.
    NoStart,
    /// Not decidable before there are `byte_count` bytes.
    Unfinished { byte_count: usize },
    /// The length cannot be right; the candidate covers `byte_count` bytes as far as is known.
    BadLength {
        message_id: u16,
        payload_bytes: usize,
        byte_count: usize,
    },
    /// The sum over all `byte_count` bytes is wrong.
    BadChecksum { byte_count: usize },
    /// The first `byte_count` bytes are a frame.
    Intact { byte_count: usize },
}

/// Message id and payload length that a header claims, once both are there.
pub(crate) fn claimed(bytes: &[u8]) -> Option<(u16, usize)> {
    let header = bytes.get(..LENGTH_AND_ID_BYTES)?;
    let payload_bytes = usize::from(u16_at(header, field::PAYLOAD_LENGTH));
    Some((u16_at(header, field::MESSAGE_ID), payload_bytes))
}

/// Judges the candidate that begins at `bytes[0]`.
pub(crate) fn judge(bytes: &[u8]) -> Verdict {
    let start_bytes = bytes.len().min(START.len());
    if bytes[..start_bytes] != START[..start_bytes] {
        return Verdict::NoStart;
    }
    if bytes.len() < LENGTH_AND_ID_BYTES {
        return Verdict::Unfinished {
            byte_count: LENGTH_AND_ID_BYTES,
        };
    }
    let message_id = u16_at(bytes, field::MESSAGE_ID);
    let payload_bytes = usize::from(u16_at(bytes, field::PAYLOAD_LENGTH));
    if !PayloadLengths::of(message_id).allow(payload_bytes) {
        return Verdict::BadLength {
            message_id,
            payload_bytes,
            byte_count: HEADER_BYTES,
        };
    }
    let byte_count = OVERHEAD_BYTES + payload_bytes;
    if message_id == id::OS_MONO_PROFILE {
        match message::result_count_fits(&bytes[HEADER_BYTES.min(bytes.len())..], payload_bytes) {
            Some(true) => {}
            Some(false) => {
                return Verdict::BadLength {
                    message_id,
                    payload_bytes,
                    byte_count,
                };
            }
            None => {
                let byte_count = HEADER_BYTES + message::RESULT_COUNT_KNOWN_BYTES;
                return Verdict::Unfinished { byte_count };
            }
        }
    }
    judge_checksum(bytes, byte_count)
}

fn judge_checksum(bytes: &[u8], byte_count: usize) -> Verdict {
    if bytes.len() < byte_count {
        return Verdict::Unfinished { byte_count };
    }
    let summed = byte_count - 2;
    if checksum(&bytes[..summed]) == u16_at(bytes, summed..byte_count) {
        Verdict::Intact { byte_count }
    } else {
        Verdict::BadChecksum { byte_count }
    }
}

/// Writes a frame of `payload_bytes` whose payload `emit` fills; returns the frame's length.
pub(crate) fn encode(
    message_id: u16,
    (src_device_id, dst_device_id): (u8, u8),
    payload_bytes: usize,
    out: &mut [u8],
    emit: impl FnOnce(&mut [u8]),
) -> Result<usize, EncodeError> {
    let allowed = PayloadLengths::of(message_id);
    let length = match u16::try_from(payload_bytes) {
        Ok(length) if allowed.allow(payload_bytes) => length,
        _ => {
            return Err(EncodeError::Length {
                message_id,
                found: payload_bytes,
                allowed,
            });
        }
    };
    let byte_count = OVERHEAD_BYTES + payload_bytes;
    let available = out.len();
    let Some(bytes) = out.get_mut(..byte_count) else {
        return Err(EncodeError::Buffer {
            needed: byte_count,
            available,
        });
    };
    put(bytes, field::START, &START);
    put(bytes, field::PAYLOAD_LENGTH, &length.to_le_bytes());
    put(bytes, field::MESSAGE_ID, &message_id.to_le_bytes());
    bytes[field::SRC_DEVICE_ID] = src_device_id;
    bytes[field::DST_DEVICE_ID] = dst_device_id;
    let summed = byte_count - 2;
    emit(&mut bytes[HEADER_BYTES..summed]);
    let sum = checksum(&bytes[..summed]);
    put(bytes, summed..byte_count, &sum.to_le_bytes());
    Ok(byte_count)
}
