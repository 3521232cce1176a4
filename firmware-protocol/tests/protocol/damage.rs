//! An intact frame is never lost to damage beside it.

use echosplat_firmware_protocol::{Decoder, Event};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::damage_stream::{Damage, DamagedStream};

/// Decodes in pieces of random size; returns the bytes skipped.
fn skipped_byte_count_of(stream: &DamagedStream, seed: u64) -> usize {
    let bytes = stream.bytes();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut decoder = Box::new(Decoder::new());
    let mut frames = stream.frames.iter();
    let (mut frame_bytes, mut skipped_bytes) = (0, 0);
    let mut sink = |event: Event<'_>| match event {
        Event::Frame(frame) => {
            frame_bytes += frame.bytes().len();
            assert_eq!(
                Some(frame.bytes()),
                frames.next().map(Vec::as_slice),
                "seed {seed}"
            );
        }
        Event::Skipped(skipped) => skipped_bytes += skipped.byte_count,
    };
    let mut rest = bytes.as_slice();
    while !rest.is_empty() {
        let (piece, left) = rest.split_at(rng.random_range(1..=rest.len().min(4096)));
        decoder.feed(piece, &mut sink);
        rest = left;
    }
    decoder.finish(&mut sink);
    assert_eq!(frames.len(), 0, "frames were lost, seed {seed}");
    assert_eq!(frame_bytes + skipped_bytes, bytes.len(), "seed {seed}");
    skipped_bytes
}

#[test]
fn every_intact_frame_among_damage_is_found_and_every_other_byte_counted() {
    for seed in [450, 451, 452] {
        let stream = DamagedStream::new(seed, 9600, 600, &Damage::ALL);
        println!(
            "seed {seed}: {} damaged bytes, {} sums right by chance and made anew",
            stream.damaged_byte_count(),
            stream.coincidences,
        );
        assert!(stream.damaged_byte_count() > 1_000_000);
        assert_eq!(
            skipped_byte_count_of(&stream, seed),
            stream.damaged_byte_count()
        );
    }
}

#[test]
fn no_kind_of_damage_loses_a_frame() {
    for kind in Damage::ALL {
        for seed in 0..4 {
            let stream = DamagedStream::new(seed, 300, 200, &[kind]);
            let skipped = skipped_byte_count_of(&stream, seed);
            assert_eq!(
                skipped,
                stream.damaged_byte_count(),
                "{kind:?}, seed {seed}"
            );
        }
    }
}
