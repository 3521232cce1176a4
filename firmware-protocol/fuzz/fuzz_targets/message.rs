//! Any payload of any id: parsed or refused, and what is parsed can be written and read again.

#![no_main]

use echosplat_firmware_protocol::{Frame, MAX_FRAME_BYTES, Message};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|input: &[u8]| {
    let [low, high, payload @ ..] = input else {
        return;
    };
    let message_id = u16::from_le_bytes([*low, *high]);
    let Ok(message) = Message::parse_payload(message_id, payload) else {
        return;
    };
    let mut first = vec![0; message.encoded_byte_count().min(MAX_FRAME_BYTES)];
    let byte_count = message
        .encode(1, 2, &mut first)
        .expect("a parsed message fits its id");
    assert_eq!(byte_count, first.len());
    let frame = Frame::from_bytes(&first).expect("what is written is a frame");
    let again = Message::parse(&frame).expect("what is written can be read");
    let mut second = vec![0; byte_count];
    assert_eq!(again.encode(1, 2, &mut second), Ok(byte_count));
    assert_eq!(first, second);
});
