//! What can be wrong with a frame, a payload, or a message to be sent.

use thiserror::Error;

use crate::payload_lengths::PayloadLengths;

/// Why bytes are not one intact frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum FrameError {
    /// The first two bytes are not `42 52`.
    #[error("a frame begins with the bytes 42 52 (\"BR\"), these do not")]
    Start,
    /// The length field does not fit the message id, or the count of results inside a profile.
    #[error(
        "message {message_id} cannot have {found} payload bytes (allowed: {allowed}; a profile has 52 + 2 · num_results)"
    )]
    Length {
        /// Message id of the frame.
        message_id: u16,
        /// What the length field says.
        found: usize,
        /// What would be right.
        allowed: PayloadLengths,
    },
    /// Bytes are missing, or there are more than the frame has.
    #[error("the frame needs {expected} bytes, {found} were given")]
    ByteCount {
        /// Bytes the frame has, as far as can be told.
        expected: usize,
        /// Bytes given.
        found: usize,
    },
    /// The last two bytes are not the sum of the others.
    #[error("the checksum is not the sum of the frame's other bytes modulo 65536")]
    Checksum,
}

/// Why an intact frame's payload is no message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ParseError {
    /// The payload's length does not fit the message id.
    #[error("message {message_id} cannot have {found} payload bytes (allowed: {allowed})")]
    Length {
        /// Message id of the frame.
        message_id: u16,
        /// Bytes the payload has.
        found: usize,
        /// What would be right.
        allowed: PayloadLengths,
    },
    /// A profile's count of results does not fit its payload.
    #[error("the profile says num_results {stated}, its payload holds {held}")]
    ResultCount {
        /// What the field says.
        stated: u16,
        /// What the payload's length makes room for.
        held: usize,
    },
    /// A field has a value the protocol does not define.
    #[error("message {message_id}: {field} is {found}, allowed are {allowed}")]
    Value {
        /// Message id of the frame.
        message_id: u16,
        /// Name of the field.
        field: &'static str,
        /// Its value.
        found: u32,
        /// What would be right.
        allowed: &'static str,
    },
}

/// Why a message was not written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum EncodeError {
    /// The buffer is too small; nothing was written.
    #[error("the frame needs {needed} bytes, the buffer has {available}")]
    Buffer {
        /// Bytes the frame has.
        needed: usize,
        /// Bytes the buffer has.
        available: usize,
    },
    /// The payload would have a length that its message id does not allow.
    #[error("message {message_id} cannot have {found} payload bytes (allowed: {allowed})")]
    Length {
        /// Message id.
        message_id: u16,
        /// Bytes the payload would have.
        found: usize,
        /// What would be right.
        allowed: PayloadLengths,
    },
    /// A field has a value the protocol does not define.
    #[error("message {message_id}: {field} is {found}, allowed are {allowed}")]
    Value {
        /// Message id.
        message_id: u16,
        /// Name of the field.
        field: &'static str,
        /// Its value.
        found: u32,
        /// What would be right.
        allowed: &'static str,
    },
}
