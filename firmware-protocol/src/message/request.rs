//! 6 `general_request`, 100 `set_device_id`, 116 `set_speed_of_sound`: what a host asks of any device.

use super::Message;
use crate::error::{EncodeError, ParseError};
use crate::id;
use crate::wire::{u16_at, u32_at};

mod field {
    use crate::wire::Field;

    pub(super) const REQUESTED_ID: Field = 0..2;
    pub(super) const DEVICE_ID: usize = 0;
    pub(super) const SPEED_OF_SOUND: Field = 0..4;
}

const DEVICE_ID_NAME: &str = "device_id";
const DEVICE_IDS_ALLOWED: &str = "1 to 254";

pub(super) fn parse_general_request(payload: &[u8]) -> Message<'_> {
    Message::GeneralRequest {
        requested_id: u16_at(payload, field::REQUESTED_ID),
    }
}

pub(super) fn parse_set_device_id(payload: &[u8]) -> Result<Message<'_>, ParseError> {
    let device_id = payload[field::DEVICE_ID];
    if !device_id_is_allowed(device_id) {
        return Err(ParseError::Value {
            message_id: id::SET_DEVICE_ID,
            field: DEVICE_ID_NAME,
            found: device_id.into(),
            allowed: DEVICE_IDS_ALLOWED,
        });
    }
    Ok(Message::SetDeviceId { device_id })
}

pub(super) fn parse_set_speed_of_sound(payload: &[u8]) -> Message<'_> {
    Message::SetSpeedOfSound {
        speed_of_sound_mmps: u32_at(payload, field::SPEED_OF_SOUND),
    }
}

pub(super) fn check_device_id(device_id: u8) -> Result<(), EncodeError> {
    if !device_id_is_allowed(device_id) {
        return Err(EncodeError::Value {
            message_id: id::SET_DEVICE_ID,
            field: DEVICE_ID_NAME,
            found: device_id.into(),
            allowed: DEVICE_IDS_ALLOWED,
        });
    }
    Ok(())
}

fn device_id_is_allowed(device_id: u8) -> bool {
    (1..=254).contains(&device_id)
}
