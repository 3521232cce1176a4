//! The decoder on streams: how they are cut does not matter, time-outs let go of what they should.

use echosplat_firmware_protocol::{Decoder, Message, OsMonoProfile, PowerResults, SkipReason, id};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::damage_stream::{Damage, DamagedStream};
use crate::reference::{Found, decode, expected};

fn request() -> Vec<u8> {
    let mut bytes = vec![0; 12];
    let message = Message::GeneralRequest {
        requested_id: id::DEVICE_INFORMATION,
    };
    message.encode(0, 0, &mut bytes).unwrap();
    bytes
}

fn skipped(found: &[Found]) -> Vec<(usize, SkipReason)> {
    let skipped = found.iter().filter_map(|found| match found {
        Found::Skipped(skipped) => Some((skipped.byte_count, skipped.reason)),
        Found::Frame(_) => None,
    });
    skipped.collect()
}

fn frame_count(found: &[Found]) -> usize {
    found
        .iter()
        .filter(|found| matches!(found, Found::Frame(_)))
        .count()
}

/// The start of a JSON packet of 60000 bytes that never comes.
const FALSE_HEADER: [u8; 8] = [b'B', b'R', 0x60, 0xea, 10, 0, 0, 255];

#[test]
fn pieces_of_every_size_give_the_same_events() {
    let stream = DamagedStream::new(7, 24, 100, &Damage::ALL).bytes();
    let events = expected(&stream);
    assert!(frame_count(&events) >= 24);
    for size in 1..=stream.len() {
        assert_eq!(
            decode(stream.chunks(size)),
            events,
            "pieces of {size} bytes"
        );
    }
}

#[test]
fn pieces_of_random_size_give_the_events_of_the_slow_twin() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for seed in 0..40 {
        let stream = DamagedStream::new(seed, 60, 20, &Damage::ALL).bytes();
        let mut pieces = Vec::new();
        let mut rest = stream.as_slice();
        while !rest.is_empty() {
            let (piece, left) = rest.split_at(rng.random_range(1..=rest.len().min(3000)));
            pieces.push(piece);
            rest = left;
        }
        assert_eq!(decode(pieces), expected(&stream), "seed {seed}");
    }
}

#[test]
fn a_time_out_frees_the_intact_frames_behind_a_false_header() {
    let mut decoder = Decoder::new();
    let mut found: Vec<Found> = Vec::new();
    let stream = [&FALSE_HEADER[..], &request(), &request()].concat();
    decoder.feed(&stream, &mut |event| found.push(event.into()));
    assert_eq!(
        (found.len(), decoder.pending_byte_count()),
        (0, stream.len())
    );
    decoder.expire(&mut |event| found.push(event.into()));
    assert_eq!(frame_count(&found), 2);
    assert_eq!(skipped(&found), [(8, SkipReason::TimedOut)]);
    assert_eq!(decoder.pending_byte_count(), 0);
}

#[test]
fn a_time_out_spares_the_half_frame_behind_a_false_header() {
    let mut decoder = Decoder::new();
    let mut found: Vec<Found> = Vec::new();
    let whole = request();
    let (first, second) = whole.split_at(7);
    decoder.feed(&[&FALSE_HEADER[..], first].concat(), &mut |event| {
        found.push(event.into());
    });
    decoder.expire(&mut |event| found.push(event.into()));
    assert_eq!(decoder.pending_byte_count(), first.len());
    decoder.feed(second, &mut |event| found.push(event.into()));
    assert_eq!(frame_count(&found), 1);
    assert_eq!(skipped(&found), [(8, SkipReason::TimedOut)]);
}

#[test]
fn a_time_out_reports_noise_and_does_nothing_on_silence() {
    let mut decoder = Decoder::new();
    let mut found: Vec<Found> = Vec::new();
    decoder.expire(&mut |event| found.push(event.into()));
    assert!(found.is_empty());
    decoder.feed(&[0; 5], &mut |event| found.push(event.into()));
    assert_eq!((found.len(), decoder.pending_byte_count()), (0, 5));
    decoder.expire(&mut |event| found.push(event.into()));
    assert_eq!(skipped(&found), [(5, SkipReason::Noise)]);
    assert_eq!(decoder.pending_byte_count(), 0);
}

#[test]
fn the_end_of_a_stream_leaves_nothing_behind() {
    let mut decoder = Decoder::new();
    let mut found: Vec<Found> = Vec::new();
    // Three unfinished candidates, one inside the other, and a frame inside the second.
    let stream = [
        &FALSE_HEADER[..],
        &FALSE_HEADER,
        &request(),
        &FALSE_HEADER,
        b"B",
    ]
    .concat();
    decoder.feed(&stream, &mut |event| found.push(event.into()));
    decoder.finish(&mut |event| found.push(event.into()));
    assert_eq!(frame_count(&found), 1);
    assert_eq!(
        skipped(&found),
        [(16, SkipReason::TimedOut), (9, SkipReason::TimedOut)]
    );
    found.clear();
    decoder.feed(&request(), &mut |event| found.push(event.into()));
    assert_eq!(found, [Found::Frame(request())]);
}

#[test]
fn the_longest_frame_passes_and_a_false_one_gives_back_its_bytes() {
    let text = "x".repeat(65535);
    let mut long = vec![0; 65545];
    Message::Json(text.as_str().into())
        .encode(0, 255, &mut long)
        .unwrap();
    let broken: Vec<u8> = [&long[..65544], &[!long[65544]]].concat();
    // Behind the broken frame's first byte lies a candidate as long as the buffer again.
    let stream = [
        &b"B"[..],
        &long,
        &broken[..20000],
        &request(),
        &broken,
        &request(),
    ]
    .concat();
    for size in [1, 1000, 65545, stream.len()] {
        let found = decode(stream.chunks(size));
        assert_eq!(frame_count(&found), 3, "pieces of {size} bytes");
        assert_eq!(found, expected(&stream), "pieces of {size} bytes");
    }
}

fn unknown(message_id: u16, payload: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; 10 + payload.len()];
    let message = Message::Unknown {
        message_id,
        payload,
    };
    message.encode(3, 0, &mut bytes).unwrap();
    bytes
}

fn small_profile(ping_number: u32) -> Vec<u8> {
    DamagedStream::new(u64::from(ping_number), 8, 100, &[])
        .frames
        .into_iter()
        .find(|frame| frame[4..6] == id::OS_MONO_PROFILE.to_le_bytes())
        .unwrap()
}

#[test]
fn packets_of_other_products_and_texts_of_any_length_are_frames() {
    let text = "$GPGGA,".repeat(9_000);
    let mut nmea = vec![0; 10 + text.len()];
    let message = Message::Nmea(text.as_str().into());
    message.encode(0, 0, &mut nmea).unwrap();
    let mut points = vec![0; 65_535];
    ChaCha8Rng::seed_from_u64(9).fill(points.as_mut_slice());
    let stream = [
        small_profile(1),
        unknown(3009, &points),
        small_profile(2),
        nmea,
        unknown(3012, &points[..30_000]),
        small_profile(3),
    ];
    let whole: Vec<Found> = stream.iter().cloned().map(Found::Frame).collect();
    let bytes = stream.concat();
    for size in [1, 700, 65_536, bytes.len()] {
        assert_eq!(decode(bytes.chunks(size)), whole, "pieces of {size} bytes");
    }
    assert_eq!(expected(&bytes), whole);
}

#[test]
fn a_false_header_of_any_length_is_found_out_with_the_next_profile() {
    for message_id in [3, 10, 109, 150, 3009, 65_535] {
        for claimed in [2_049_u16, 5_000, 60_000] {
            let mut stream = b"BR".to_vec();
            stream.extend(claimed.to_le_bytes());
            stream.extend((message_id as u16).to_le_bytes());
            stream.extend([0, 0]);
            let profile = small_profile(4);
            stream.extend(&profile);
            let mut decoder = Decoder::new();
            let mut found: Vec<Found> = Vec::new();
            for piece in stream.chunks(50) {
                decoder.feed(piece, &mut |event| found.push(event.into()));
            }
            assert_eq!(skipped(&found), [(8, SkipReason::Length)]);
            assert_eq!(found.last(), Some(&Found::Frame(profile)));
        }
    }
}

#[test]
fn no_sum_right_by_chance_makes_a_long_frame_swallow_profiles() {
    let inner = [small_profile(5), small_profile(6), vec![0; 3_000]].concat();
    let stream = unknown(4_000, &inner);
    for size in [1, 333, stream.len()] {
        let found = decode(stream.chunks(size));
        assert_eq!(frame_count(&found), 2, "pieces of {size} bytes");
        assert_eq!(found, expected(&stream));
    }
}

#[test]
fn long_frames_false_and_true_give_the_events_of_the_slow_twin_however_cut() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for seed in 0..150 {
        let mut stream = Vec::new();
        for _ in 0..rng.random_range(1..6) {
            let payload_bytes: usize = rng.random_range(2_000..6_000);
            let mut payload = vec![0; payload_bytes];
            rng.fill(payload.as_mut_slice());
            let profile = small_profile(rng.random_range(0..4));
            for _ in 0..rng.random_range(0..3) {
                // Whole, cut by the end, or only a header.
                let at = rng.random_range(0..payload_bytes);
                let length = rng.random_range(1..=profile.len()).min(payload_bytes - at);
                payload[at..at + length].copy_from_slice(&profile[..length]);
            }
            let mut frame = unknown(3009, &payload);
            if rng.random_ratio(1, 3) {
                frame.truncate(rng.random_range(1..frame.len()));
            }
            stream.extend(frame);
            stream.extend(profile);
        }
        let events = expected(&stream);
        for _ in 0..6 {
            let size = rng.random_range(1..=stream.len().min(4_000));
            assert_eq!(decode(stream.chunks(size)), events, "seed {seed}, {size}");
        }
    }
}

#[test]
fn a_profile_says_its_power_in_decibels() {
    let raw: Vec<u8> = [0_u16, 13107, 65535]
        .iter()
        .flat_map(|raw| raw.to_le_bytes())
        .collect();
    let profile = OsMonoProfile {
        ping_number: 0,
        start_mm: 0,
        length_mm: 1000,
        timestamp_ms: 0,
        ping_hz: 451_127,
        gain_index: 0,
        sos_dmps: 15000,
        channel_number: 0,
        pulse_duration_sec: 0.0,
        analog_gain: 1.0,
        max_pwr_db: 70.0,
        min_pwr_db: -30.0,
        transducer_heading_deg: 0.0,
        vehicle_heading_deg: 0.0,
        pwr_results: PowerResults::from_bytes(&raw).unwrap(),
    };
    assert_eq!(
        profile.pwr_results.iter().collect::<Vec<_>>(),
        [0, 13107, 65535]
    );
    assert_eq!(
        [0, 1, 2, 3].map(|i| profile.power_db(i)),
        [Some(-30.0), Some(-10.0), Some(70.0), None]
    );
    assert!(PowerResults::from_bytes(&raw[1..]).is_err());
    assert!(PowerResults::from_bytes(&[0; 8194]).is_err());
}

#[test]
fn what_no_reader_would_take_is_not_written() {
    let mut out = vec![0; 70000];
    let long = "x".repeat(65536);
    let too_long = [
        Message::AsciiText(long.as_str().into()),
        Message::Json(long.as_str().into()),
        Message::Unknown {
            message_id: id::ACK,
            payload: &[1, 2, 3],
        },
        Message::SetDeviceId { device_id: 0 },
        Message::SetDeviceId { device_id: 255 },
    ];
    for message in too_long {
        assert!(message.encode(0, 0, &mut out).is_err());
        assert!(out.iter().all(|&byte| byte == 0));
    }
}
