//! Arbitrary bytes: no panic, and every byte accounted for.

use echosplat_firmware_protocol::{Decoder, Event, Frame, Message};
use proptest::prelude::*;

use crate::reference::{decode, expected};

/// Bytes that look more like frames than chance would have it.
fn frame_like_bytes() -> impl Strategy<Value = Vec<u8>> {
    let message_id = prop_oneof![
        prop::sample::select(vec![0_u16, 1, 2, 3, 4, 5, 6, 10, 12, 100, 109, 116]),
        prop::sample::select(vec![150_u16, 169, 170, 2194, 2197, 2198]),
        any::<u16>(),
    ];
    let payload_length = prop_oneof![0_u16..80, any::<u16>()];
    let header = (payload_length, message_id).prop_map(|(payload_length, message_id)| {
        [
            *b"BR",
            payload_length.to_le_bytes(),
            message_id.to_le_bytes(),
        ]
        .concat()
    });
    let frame = prop::collection::vec(any::<u8>(), 0..60).prop_map(|text| {
        let mut out = vec![0; text.len() + 10];
        let message = Message::Json(echosplat_firmware_protocol::Text::from_bytes(&text));
        message.encode(0, 255, &mut out).unwrap();
        out
    });
    prop_oneof![
        prop::collection::vec(any::<u8>(), 0..20),
        prop::collection::vec(prop::sample::select(vec![b'B', b'R', 0, 1, 10]), 0..20),
        header,
        frame,
    ]
}

/// One step of a decoder's life: bytes, or a time-out.
fn steps() -> impl Strategy<Value = Vec<Option<Vec<u8>>>> {
    prop::collection::vec(
        prop_oneof![9 => frame_like_bytes().prop_map(Some), 1 => Just(None)],
        0..40,
    )
}

proptest! {
    #[test]
    fn every_byte_is_in_one_event_or_pending(steps in steps()) {
        let mut decoder = Box::new(Decoder::new());
        let (mut fed, mut told) = (0, 0);
        for step in steps {
            let mut sink = |event: Event<'_>| match event {
                Event::Frame(frame) => {
                    told += frame.bytes().len();
                    assert_eq!(Frame::from_bytes(frame.bytes()), Ok(frame));
                    // Whatever it says, reading it must not panic.
                    let _ = Message::parse(&frame);
                }
                Event::Skipped(skipped) => told += skipped.byte_count,
            };
            match step {
                Some(bytes) => {
                    fed += bytes.len();
                    decoder.feed(&bytes, &mut sink);
                }
                None => decoder.expire(&mut sink),
            }
            prop_assert_eq!(told + decoder.pending_byte_count(), fed);
        }
    }

    #[test]
    fn the_slow_twin_agrees(pieces in prop::collection::vec(frame_like_bytes(), 0..40)) {
        let stream = pieces.concat();
        prop_assert_eq!(decode(pieces.iter().map(Vec::as_slice)), expected(&stream));
    }

    #[test]
    fn any_payload_of_any_id_parses_or_says_why(
        message_id in any::<u16>(),
        payload in prop::collection::vec(any::<u8>(), 0..300),
    ) {
        let _ = Message::parse_payload(message_id, &payload);
    }
}
