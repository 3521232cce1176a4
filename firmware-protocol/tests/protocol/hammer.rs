//! Very many short inputs from a seed: no panic, no byte unaccounted for.

use echosplat_firmware_protocol::{Decoder, Event, Message, checksum};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const MAX_INPUT_BYTES: usize = 96;

const TABLE_IDS: [u16; 18] = [
    0, 1, 2, 3, 4, 5, 6, 10, 12, 100, 109, 116, 150, 169, 170, 2194, 2197, 2198,
];

/// Random bytes with up to three headers written over them, some with a right sum.
fn fill(rng: &mut ChaCha8Rng, input: &mut [u8]) {
    rng.fill_bytes(input);
    for _ in 0..rng.random_range(0..4) {
        let at = rng.random_range(0..input.len());
        write_header(rng, &mut input[at..]);
    }
}

fn write_header(rng: &mut ChaCha8Rng, at: &mut [u8]) {
    if at.len() < 10 {
        at[0] = b'B';
        return;
    }
    let room = at.len() - 10;
    let payload_bytes = if rng.random_ratio(1, 8) {
        rng.random()
    } else {
        rng.random_range(0..=room) as u16
    };
    let message_id = TABLE_IDS[rng.random_range(0..TABLE_IDS.len())];
    at[..2].copy_from_slice(b"BR");
    at[2..4].copy_from_slice(&payload_bytes.to_le_bytes());
    at[4..6].copy_from_slice(&message_id.to_le_bytes());
    let sum_at = 8 + usize::from(payload_bytes);
    if sum_at + 2 <= at.len() && rng.random() {
        let sum = checksum(&at[..sum_at]);
        at[sum_at..sum_at + 2].copy_from_slice(&sum.to_le_bytes());
    }
}

/// Returns how many frames there were, and how many of them were messages.
fn hammer(seed: u64, input_count: u64) -> (u64, u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut decoder = Box::new(Decoder::new());
    let mut buffer = [0; MAX_INPUT_BYTES];
    let (mut frames, mut messages) = (0, 0);
    for _ in 0..input_count {
        let input = &mut buffer[..rng.random_range(1..=MAX_INPUT_BYTES)];
        fill(&mut rng, input);
        let mut told = 0;
        let mut sink = |event: Event<'_>| match event {
            Event::Frame(frame) => {
                told += frame.bytes().len();
                frames += 1;
                messages += u64::from(Message::parse(&frame).is_ok());
            }
            Event::Skipped(skipped) => told += skipped.byte_count,
        };
        let (first, second) = input.split_at(rng.random_range(0..=input.len()));
        decoder.feed(first, &mut sink);
        if rng.random_ratio(1, 4) {
            decoder.expire(&mut sink);
        }
        decoder.feed(second, &mut sink);
        decoder.finish(&mut sink);
        assert_eq!(told, input.len(), "seed {seed}: {input:02x?}");
    }
    (frames, messages)
}

/// A million inputs, or a billion (minutes) with `ECHOSPLAT_LONG=1`.
#[test]
fn short_random_inputs_do_no_harm() {
    let inputs = if std::env::var_os("ECHOSPLAT_LONG").is_some() {
        1_000_000_000
    } else {
        1_000_000
    };
    let (frames, messages) = hammer(450, inputs);
    println!("{inputs} inputs: {frames} frames, {messages} of them messages, no panic");
    assert!(messages > 10_000 && frames > messages);
}
