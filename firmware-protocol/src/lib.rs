//! The Blue Robotics Ping wire format as the `OmniScan` 450 speaks it: bytes to frames, frames to
//! messages, and back. The byte tables are in this crate's `README.md`.
//!
//! Two levels: [`Decoder`] finds intact [`Frame`]s in a stream that line noise may have damaged
//! and accounts for every byte that is not in one; [`Message`] reads a frame's payload into values
//! and writes values as a frame.
//!
//! This crate deliberately has no allocation, no standard library, no sockets, no clock, no device
//! behaviour (retries, acknowledgement, time) and no conversion to physical units beyond the
//! decibel scale of one profile.
//!
//! ```
//! use echosplat_firmware_protocol::{Decoder, Event, Message, id};
//!
//! let mut bytes = [0; 16];
//! let request = Message::GeneralRequest { requested_id: id::DEVICE_INFORMATION };
//! let byte_count = request.encode(0, 0, &mut bytes)?;
//!
//! let mut decoder = Decoder::new();
//! decoder.feed(&bytes[..byte_count], &mut |event| {
//!     let Event::Frame(frame) = event else { panic!("nothing is damaged here") };
//!     assert_eq!(Message::parse(&frame), Ok(request));
//! });
//! # Ok::<(), echosplat_firmware_protocol::EncodeError>(())
//! ```

#![no_std]

#[cfg(test)]
extern crate std;

mod decoder;
mod error;
mod frame;
pub mod id;
mod long_frame;
mod message;
mod payload_lengths;
mod skip;
mod wire;

pub use decoder::{Decoder, Event};
pub use error::{EncodeError, FrameError, ParseError};
pub use frame::{Frame, MAX_FRAME_BYTES, MAX_PAYLOAD_BYTES, checksum};
pub use message::{
    DeviceInformation, MAX_RESULT_COUNT, Message, OsMonoProfile, OsPingParams, PowerResults,
    ProtocolVersion, Status, SyncChannel, Text, power_db, product_of_message,
};
pub use payload_lengths::PayloadLengths;
pub use skip::{SkipReason, Skipped};
