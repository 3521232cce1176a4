//! 1 ack, 2 nack: the device's answers to a request.

use super::{Message, Text};
use crate::wire::{put, u16_at};

mod field {
    use crate::wire::Field;

    pub(super) const REQUEST_ID: Field = 0..2;
}

pub(super) fn parse_ack(payload: &[u8]) -> Message<'_> {
    Message::Ack {
        acked_id: u16_at(payload, field::REQUEST_ID),
    }
}

pub(super) fn parse_nack(payload: &[u8]) -> Message<'_> {
    Message::Nack {
        nacked_id: u16_at(payload, field::REQUEST_ID),
        text: Text::from_bytes(&payload[field::REQUEST_ID.end..]),
    }
}

pub(super) fn emit_nack(nacked_id: u16, text: Text<'_>, payload: &mut [u8]) {
    put(payload, field::REQUEST_ID, &nacked_id.to_le_bytes());
    payload[field::REQUEST_ID.end..].copy_from_slice(text.as_bytes());
}
