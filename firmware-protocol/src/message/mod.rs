//! Messages: what a frame's payload says.

mod acknowledge;
mod identity;
mod os_mono_profile;
mod os_ping_params;
mod other_products;
mod request;
mod status;
mod sync_channel;
mod text;

pub use identity::{DeviceInformation, ProtocolVersion};
pub use os_mono_profile::{MAX_RESULT_COUNT, OsMonoProfile, PowerResults, power_db};
pub use os_ping_params::OsPingParams;
pub use other_products::product_of_message;
pub use status::Status;
pub use sync_channel::SyncChannel;
pub use text::Text;

pub(crate) use identity::{
    PAYLOAD_BYTES as DEVICE_INFORMATION_BYTES, VERSION_PAYLOAD_BYTES as PROTOCOL_VERSION_BYTES,
};
pub(crate) use os_mono_profile::{
    FIXED_BYTES as OS_MONO_PROFILE_FIXED_BYTES, RESULT_COUNT_KNOWN_BYTES, result_count_fits,
};
pub(crate) use os_ping_params::{
    PAYLOAD_BYTES as OS_PING_PARAMS_BYTES, SHORT_PAYLOAD_BYTES as OS_PING_PARAMS_SHORT_BYTES,
};
pub(crate) use status::PAYLOAD_BYTES as STATUS_BYTES;
pub(crate) use sync_channel::PAYLOAD_BYTES as SYNC_CHANNEL_BYTES;

use crate::error::{EncodeError, ParseError};
use crate::frame::{self, Frame};
use crate::id;
use crate::payload_lengths::PayloadLengths;

/// One message. Borrowed parts lie in the frame it was read from.
///
/// Floats are as the sender put them and may be anything, NaN and infinity included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Message<'a> {
    /// 0: nothing.
    Nop,
    /// 1: the request `acked_id` was carried out.
    Ack {
        /// Message id of the request.
        acked_id: u16,
    },
    /// 2: the request `nacked_id` was refused.
    Nack {
        /// Message id of the request.
        nacked_id: u16,
        /// Why, in the device's words.
        text: Text<'a>,
    },
    /// 3: free text.
    AsciiText(Text<'a>),
    /// 4: what the device is.
    DeviceInformation(DeviceInformation),
    /// 5: version of the protocol.
    ProtocolVersion(ProtocolVersion),
    /// 6: asks for one message.
    GeneralRequest {
        /// Message id of the answer asked for.
        requested_id: u16,
    },
    /// 10: a JSON text, not checked.
    Json(Text<'a>),
    /// 12: the log viewer's own; opaque.
    ViewConfiguration(&'a [u8]),
    /// 100: sets the device's id.
    SetDeviceId {
        /// The new id, 1 to 254.
        device_id: u8,
    },
    /// 109: NMEA 0183 text, not checked.
    Nmea(Text<'a>),
    /// 116: sets the speed of sound the device computes ranges with.
    SetSpeedOfSound {
        /// In millimetres per second.
        speed_of_sound_mmps: u32,
    },
    /// 150: one `MAVLink` message as JSON, not checked.
    Mavlink(Text<'a>),
    /// 169: which of how many synchronised units this is.
    SyncChannelNumber(SyncChannel),
    /// 170: sets what 169 tells; answered by ack.
    SetSyncChannelNumber(SyncChannel),
    /// 2194: undocumented.
    Status(Status),
    /// 2197: ping settings.
    OsPingParams(OsPingParams),
    /// 2198: one profile.
    OsMonoProfile(OsMonoProfile<'a>),
    /// An id that is not in the tables.
    Unknown {
        /// Message id.
        message_id: u16,
        /// The payload as it came.
        payload: &'a [u8],
    },
}

impl<'a> Message<'a> {
    /// Reads the payload of an intact frame.
    ///
    /// # Errors
    /// Names the field that is wrong, and what would be right.
    pub fn parse(frame: &Frame<'a>) -> Result<Self, ParseError> {
        Self::parse_payload(frame.message_id(), frame.payload())
    }

    /// Reads `payload` as that of message `message_id`.
    ///
    /// # Errors
    /// Names the field that is wrong, and what would be right.
    pub fn parse_payload(message_id: u16, payload: &'a [u8]) -> Result<Self, ParseError> {
        let allowed = PayloadLengths::of(message_id);
        let found = payload.len();
        if !allowed.allow(found) {
            return Err(ParseError::Length {
                message_id,
                found,
                allowed,
            });
        }
        Ok(match message_id {
            id::NOP => Self::Nop,
            id::ACK => acknowledge::parse_ack(payload),
            id::NACK => acknowledge::parse_nack(payload),
            id::ASCII_TEXT => Self::AsciiText(Text::from_bytes(payload)),
            id::DEVICE_INFORMATION => Self::DeviceInformation(DeviceInformation::parse(payload)),
            id::PROTOCOL_VERSION => Self::ProtocolVersion(ProtocolVersion::parse(payload)),
            id::GENERAL_REQUEST => request::parse_general_request(payload),
            id::JSON => Self::Json(Text::from_bytes(payload)),
            id::VIEW_CONFIGURATION => Self::ViewConfiguration(payload),
            id::SET_DEVICE_ID => request::parse_set_device_id(payload)?,
            id::NMEA => Self::Nmea(Text::from_bytes(payload)),
            id::SET_SPEED_OF_SOUND => request::parse_set_speed_of_sound(payload),
            id::MAVLINK => Self::Mavlink(Text::from_bytes(payload)),
            id::SYNC_CHANNEL_NUMBER => Self::SyncChannelNumber(SyncChannel::parse(payload)),
            id::SET_SYNC_CHANNEL_NUMBER => Self::SetSyncChannelNumber(SyncChannel::parse(payload)),
            id::STATUS => Self::Status(Status::parse(payload)),
            id::OS_PING_PARAMS => Self::OsPingParams(OsPingParams::parse(payload)?),
            id::OS_MONO_PROFILE => Self::OsMonoProfile(OsMonoProfile::parse(payload)?),
            _ => Self::Unknown {
                message_id,
                payload,
            },
        })
    }

    /// Message id.
    #[must_use]
    pub fn id(&self) -> u16 {
        match self {
            Self::Nop => id::NOP,
            Self::Ack { .. } => id::ACK,
            Self::Nack { .. } => id::NACK,
            Self::AsciiText(_) => id::ASCII_TEXT,
            Self::DeviceInformation(_) => id::DEVICE_INFORMATION,
            Self::ProtocolVersion(_) => id::PROTOCOL_VERSION,
            Self::GeneralRequest { .. } => id::GENERAL_REQUEST,
            Self::Json(_) => id::JSON,
            Self::ViewConfiguration(_) => id::VIEW_CONFIGURATION,
            Self::SetDeviceId { .. } => id::SET_DEVICE_ID,
            Self::Nmea(_) => id::NMEA,
            Self::SetSpeedOfSound { .. } => id::SET_SPEED_OF_SOUND,
            Self::Mavlink(_) => id::MAVLINK,
            Self::SyncChannelNumber(_) => id::SYNC_CHANNEL_NUMBER,
            Self::SetSyncChannelNumber(_) => id::SET_SYNC_CHANNEL_NUMBER,
            Self::Status(_) => id::STATUS,
            Self::OsPingParams(_) => id::OS_PING_PARAMS,
            Self::OsMonoProfile(_) => id::OS_MONO_PROFILE,
            Self::Unknown { message_id, .. } => *message_id,
        }
    }

    /// Length of the frame that [`encode`](Self::encode) writes, in bytes.
    #[must_use]
    pub fn encoded_byte_count(&self) -> usize {
        frame::OVERHEAD_BYTES + self.payload_byte_count()
    }

    /// Writes the message as a frame from device `src` to device `dst` (0 is a host or any device)
    /// to the start of `out`; returns the frame's length in bytes.
    ///
    /// # Errors
    /// If `out` is too small, a text or profile too long for its id, or a value not allowed;
    /// nothing is written then.
    pub fn encode(&self, src: u8, dst: u8, out: &mut [u8]) -> Result<usize, EncodeError> {
        if let Self::SetDeviceId { device_id } = *self {
            request::check_device_id(device_id)?;
        }
        let payload_bytes = self.payload_byte_count();
        frame::encode(self.id(), (src, dst), payload_bytes, out, |payload| {
            self.emit(payload);
        })
    }

    fn payload_byte_count(&self) -> usize {
        match self {
            Self::Nop => 0,
            Self::Ack { .. } | Self::GeneralRequest { .. } => 2,
            Self::Nack { text, .. } => 2 + text.as_bytes().len(),
            Self::AsciiText(text) | Self::Json(text) | Self::Nmea(text) | Self::Mavlink(text) => {
                text.as_bytes().len()
            }
            Self::DeviceInformation(_) => DEVICE_INFORMATION_BYTES,
            Self::ProtocolVersion(_) => PROTOCOL_VERSION_BYTES,
            Self::ViewConfiguration(payload) | Self::Unknown { payload, .. } => payload.len(),
            Self::SetDeviceId { .. } => 1,
            Self::SetSpeedOfSound { .. } => 4,
            Self::SyncChannelNumber(_) | Self::SetSyncChannelNumber(_) => SYNC_CHANNEL_BYTES,
            Self::Status(_) => STATUS_BYTES,
            Self::OsPingParams(_) => OS_PING_PARAMS_BYTES,
            Self::OsMonoProfile(profile) => profile.payload_byte_count(),
        }
    }

    /// Fills a payload of [`payload_byte_count`](Self::payload_byte_count) bytes.
    fn emit(&self, payload: &mut [u8]) {
        match self {
            Self::Nop => {}
            Self::Ack { acked_id: id } | Self::GeneralRequest { requested_id: id } => {
                payload.copy_from_slice(&id.to_le_bytes());
            }
            Self::Nack { nacked_id, text } => acknowledge::emit_nack(*nacked_id, *text, payload),
            Self::AsciiText(text) | Self::Json(text) | Self::Nmea(text) | Self::Mavlink(text) => {
                payload.copy_from_slice(text.as_bytes());
            }
            Self::DeviceInformation(information) => information.emit(payload),
            Self::ProtocolVersion(version) => version.emit(payload),
            Self::ViewConfiguration(bytes) | Self::Unknown { payload: bytes, .. } => {
                payload.copy_from_slice(bytes);
            }
            Self::SetDeviceId { device_id } => payload.copy_from_slice(&[*device_id]),
            Self::SetSpeedOfSound {
                speed_of_sound_mmps,
            } => {
                payload.copy_from_slice(&speed_of_sound_mmps.to_le_bytes());
            }
            Self::SyncChannelNumber(channel) | Self::SetSyncChannelNumber(channel) => {
                channel.emit(payload);
            }
            Self::Status(status) => status.emit(payload),
            Self::OsPingParams(params) => params.emit(payload),
            Self::OsMonoProfile(profile) => profile.emit(payload),
        }
    }
}
