//! Decoding speed on one core, in gigabytes of stream per second, for streams from clean to made
//! to hurt: `cargo bench -p echosplat-firmware-protocol`.

#![allow(
    clippy::print_stdout,
    reason = "a table on standard output is what this program is for"
)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use echosplat_firmware_protocol::{
    Decoder, EncodeError, Event, Message, OsMonoProfile, ParseError, PowerResults, checksum, id,
};

const STREAM_BYTES: usize = 4 << 20;
const TIME_PER_ROW: Duration = Duration::from_millis(400);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let profiles = repeated(&profile(600)?);
    let requests = repeated(&encoded(&Message::GeneralRequest {
        requested_id: id::NOP,
    })?);
    let noise: Vec<u8> = (0..STREAM_BYTES).map(|at| ((at * at) >> 7) as u8).collect();
    // Each header claims the longest payload and no sum is right: every byte is summed once for
    // every eighth byte of the longest frame.
    let hostile = repeated(b"BR\xff\xff\x0a\x00\x00\xff");

    println!(
        "checksum alone                            {:7.3} GB/s",
        checksum_speed(&profiles)
    );
    println!(
        "profiles, 600 results, pieces of 64 KiB   {:7.3} GB/s",
        speed(&profiles, 65536)
    );
    println!(
        "profiles, 600 results, pieces of 1460     {:7.3} GB/s",
        speed(&profiles, 1460)
    );
    println!(
        "profiles, 600 results, pieces of 64       {:7.3} GB/s",
        speed(&profiles, 64)
    );
    println!(
        "profiles, 600 results, pieces of 1        {:7.3} GB/s",
        speed(&profiles, 1)
    );
    println!(
        "requests of 12 bytes, pieces of 64 KiB    {:7.3} GB/s",
        speed(&requests, 65536)
    );
    println!(
        "noise, pieces of 64 KiB                   {:7.3} GB/s",
        speed(&noise, 65536)
    );
    println!(
        "only false headers, pieces of 64 KiB      {:7.4} GB/s",
        speed(&hostile, 65536)
    );
    Ok(())
}

fn profile(result_count: usize) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let raw: Vec<u8> = (0..2 * result_count).map(|at| (at * 37) as u8).collect();
    Ok(encoded(&Message::OsMonoProfile(mono_profile(&raw)?))?)
}

fn mono_profile(raw: &[u8]) -> Result<OsMonoProfile<'_>, ParseError> {
    Ok(OsMonoProfile {
        ping_number: 1,
        start_mm: 0,
        length_mm: 10_000,
        timestamp_ms: 17,
        ping_hz: 451_127,
        gain_index: 4,
        sos_dmps: 15_000,
        channel_number: 0,
        pulse_duration_sec: 2.5e-5,
        analog_gain: 1.0,
        max_pwr_db: 75.0,
        min_pwr_db: -45.0,
        transducer_heading_deg: 0.0,
        vehicle_heading_deg: 0.0,
        pwr_results: PowerResults::from_bytes(raw)?,
    })
}

fn encoded(message: &Message<'_>) -> Result<Vec<u8>, EncodeError> {
    let mut bytes = vec![0; message.encoded_byte_count()];
    message.encode(1, 0, &mut bytes)?;
    Ok(bytes)
}

fn repeated(bytes: &[u8]) -> Vec<u8> {
    bytes.repeat(STREAM_BYTES / bytes.len())
}

/// Best of the passes over `stream` that fit the time, in gigabytes per second.
fn best_speed(stream: &[u8], mut pass: impl FnMut(&[u8])) -> f64 {
    let begun = Instant::now();
    let mut best = Duration::MAX;
    while begun.elapsed() < TIME_PER_ROW {
        let pass_begun = Instant::now();
        pass(black_box(stream));
        best = best.min(pass_begun.elapsed());
    }
    stream.len() as f64 / best.as_secs_f64() / 1e9
}

fn speed(stream: &[u8], piece_bytes: usize) -> f64 {
    let mut decoder = Box::new(Decoder::new());
    best_speed(stream, |stream| {
        let mut frame_count = 0;
        let mut sink =
            |event: Event<'_>| frame_count += usize::from(matches!(event, Event::Frame(_)));
        for piece in stream.chunks(piece_bytes) {
            decoder.feed(piece, &mut sink);
        }
        decoder.finish(&mut sink);
        black_box(frame_count);
    })
}

fn checksum_speed(stream: &[u8]) -> f64 {
    best_speed(stream, |stream| {
        for piece in stream.chunks(1260) {
            black_box(checksum(piece));
        }
    })
}
