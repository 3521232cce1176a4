//! Any bytes, in any pieces: no panic, every byte accounted for, the same events however the
//! stream is cut.

#![no_main]

use std::cell::RefCell;

use echosplat_firmware_protocol::{Decoder, Event, Frame, Message, checksum};
use libfuzzer_sys::fuzz_target;

thread_local! {
    /// One for all inputs: `finish` must leave it as new.
    static DECODER: RefCell<Box<Decoder>> = RefCell::new(Box::new(Decoder::new()));
}

fuzz_target!(|input: &[u8]| {
    let [piece_bytes, mends_sums, stream @ ..] = input else {
        return;
    };
    let mut stream = stream.to_vec();
    if mends_sums & 1 == 1 {
        mend_sums(&mut stream);
    }
    DECODER.with_borrow_mut(|decoder| {
        let whole = digest(decoder, &stream, stream.len().max(1));
        assert_eq!(
            digest(decoder, &stream, usize::from(*piece_bytes) + 1),
            whole
        );
    });
});

/// Gives every candidate whose end is there a right sum: no fuzzer finds one by itself.
fn mend_sums(stream: &mut [u8]) {
    for at in 0..stream.len() {
        let [b'B', b'R', low, high, ..] = stream[at..] else {
            continue;
        };
        let sum_at = at + 8 + usize::from(u16::from_le_bytes([low, high]));
        if sum_at + 2 <= stream.len() {
            let sum = checksum(&stream[at..sum_at]);
            stream[sum_at..sum_at + 2].copy_from_slice(&sum.to_le_bytes());
        }
    }
}

/// Length and kind of every event, in order.
fn digest(decoder: &mut Decoder, stream: &[u8], piece_bytes: usize) -> Vec<(usize, &'static str)> {
    let mut events = Vec::new();
    let mut told = 0;
    let mut sink = |event: Event<'_>| {
        let (byte_count, kind) = match event {
            Event::Frame(frame) => {
                assert_eq!(Frame::from_bytes(frame.bytes()), Ok(frame));
                let _ = Message::parse(&frame);
                (frame.bytes().len(), "frame")
            }
            Event::Skipped(skipped) => (skipped.byte_count, skipped.reason.as_str()),
        };
        told += byte_count;
        events.push((byte_count, kind));
    };
    for piece in stream.chunks(piece_bytes) {
        decoder.feed(piece, &mut sink);
    }
    decoder.finish(&mut sink);
    assert_eq!(decoder.pending_byte_count(), 0);
    assert_eq!(told, stream.len());
    events
}
