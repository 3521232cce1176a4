//! Our frame decoder beside that of the public crate `bluerobotics-ping` 0.3.6: speed on
//! well-formed frames, and intact frames lost to damage beside them, in the same run.
//!
//! Only the peer's frame layer is used. Its message layer reads a profile's results as UTF-8 text
//! and panics on real ones.

use std::hint::black_box;
use std::time::{Duration, Instant};

use bluerobotics_ping::decoder::{Decoder as PeerDecoder, DecoderResult};
use echosplat_firmware_protocol::{Decoder, Event};

#[allow(dead_code)]
#[path = "../../../firmware-protocol/tests/protocol/damage_stream.rs"]
mod damage_stream;
#[allow(dead_code)]
#[path = "../../../firmware-protocol/tests/protocol/reference.rs"]
mod reference;

use damage_stream::{Damage, DamagedStream};

const SEED: u64 = 450;
const PIECE_BYTES: usize = 4096;
const TIME_PER_DECODER: Duration = Duration::from_secs(2);

fn main() {
    println!("seed {SEED}, pieces of {PIECE_BYTES} bytes");
    print_speeds();
    println!("\nintact frames lost                                 of     ours     peer");
    print_losses("nothing damaged", &undamaged(200));
    print_losses(
        "one header that claims 65535 bytes",
        &with_gap(&[100], &false_header()),
    );
    print_losses(
        "a stray 42 before every frame",
        &with_gap(&every_gap(), b"B"),
    );
    print_losses(
        "a stray 42 52 before every frame",
        &with_gap(&every_gap(), b"BR"),
    );
    for kind in Damage::ALL {
        let stream = DamagedStream::new(SEED, 1000, 600, &[kind]);
        print_losses(&format!("{kind:?} in two gaps of three"), &stream);
    }
    let all = DamagedStream::new(SEED, 9600, 600, &Damage::ALL);
    print_losses("all of these, strewn", &all);
}

fn print_speeds() {
    let stream = undamaged(3000).bytes();
    let ours = best_speed(&stream, |stream| our_frames(stream, &mut |_| {}));
    let peer = best_speed(&stream, |stream| peer_frames(stream, &mut |_| {}));
    println!("well-formed profiles of 600 results: ours {ours:.3} GB/s, peer {peer:.4} GB/s");
    println!("ratio {:.0}", ours / peer);
}

/// Best pass that fits the time, in gigabytes per second.
fn best_speed(stream: &[u8], mut pass: impl FnMut(&[u8])) -> f64 {
    let begun = Instant::now();
    let mut best = Duration::MAX;
    while begun.elapsed() < TIME_PER_DECODER {
        let pass_begun = Instant::now();
        pass(black_box(stream));
        best = best.min(pass_begun.elapsed());
    }
    stream.len() as f64 / best.as_secs_f64() / 1e9
}

fn our_frames(stream: &[u8], sink: &mut dyn FnMut(&[u8])) {
    let mut decoder = Box::new(Decoder::new());
    let mut on_event = |event: Event<'_>| {
        if let Event::Frame(frame) = event {
            sink(black_box(frame.bytes()));
        }
    };
    for piece in stream.chunks(PIECE_BYTES) {
        decoder.feed(piece, &mut on_event);
    }
    decoder.finish(&mut on_event);
}

/// The peer takes one byte a call, and after an error goes on with the next.
fn peer_frames(stream: &[u8], sink: &mut dyn FnMut(&bluerobotics_ping::message::ProtocolMessage)) {
    let mut decoder = PeerDecoder::new();
    for byte in stream {
        if let DecoderResult::Success(message) = decoder.parse_byte(*byte) {
            sink(black_box(&message));
        }
    }
}

fn undamaged(frame_count: usize) -> DamagedStream {
    DamagedStream::new(SEED, frame_count, 600, &[])
}

fn every_gap() -> Vec<usize> {
    (0..200).collect()
}

/// 200 frames with `damage` in the given gaps.
fn with_gap(gaps: &[usize], damage: &[u8]) -> DamagedStream {
    let mut stream = undamaged(200);
    for &gap in gaps {
        stream.gaps[gap] = damage.to_vec();
    }
    stream
}

fn false_header() -> Vec<u8> {
    vec![b'B', b'R', 0xff, 0xff, 0x96, 0x08, 1, 0]
}

fn print_losses(name: &str, stream: &DamagedStream) {
    let bytes = stream.bytes();
    let mut ours = Recovered::new(&stream.frames);
    our_frames(&bytes, &mut |frame| ours.take(frame));
    let mut peer = Recovered::new(&stream.frames);
    peer_frames(&bytes, &mut |message| peer.take(&message.serialized()));
    let total = stream.frames.len();
    println!(
        "{name:44} {total:8} {:8} {:8}",
        total - ours.count,
        total - peer.count
    );
}

/// Counts the intact frames found, in their order.
struct Recovered<'a> {
    rest: &'a [Vec<u8>],
    count: usize,
}

impl<'a> Recovered<'a> {
    fn new(frames: &'a [Vec<u8>]) -> Self {
        Self {
            rest: frames,
            count: 0,
        }
    }

    fn take(&mut self, frame: &[u8]) {
        if let Some(position) = self.rest.iter().position(|intact| intact == frame) {
            self.rest = &self.rest[position + 1..];
            self.count += 1;
        }
    }
}
