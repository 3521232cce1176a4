//! Pings on their way to browsers: a few, the oldest gives way.

use std::collections::VecDeque;
use std::sync::Arc;

use axum::body::Bytes;
use echosplat_model::Ping;
use serde_json::json;

use crate::wire::{self, Kind};

/// Pings between two looks at the ring, 40 ms apart: 400 a second, seven times what a sonar sends.
const RING_LEN: usize = 16;
/// Decibels of one step of a byte.
const STEP_DB: f32 = 0.5;
/// What 255 such steps reach below the strongest bin.
const SPAN_DB: f32 = 127.0;

/// A ping, and when it came, milliseconds since 1970.
#[derive(Debug)]
pub(crate) struct Arrived {
    pub(crate) ping: Arc<Ping>,
    pub(crate) at_ms: f64,
}

/// The newest pings.
#[derive(Debug, Default)]
pub(crate) struct PingRing {
    pings: VecDeque<Arrived>,
    not_shown: u64,
}

impl PingRing {
    /// Never grows beyond its length.
    pub(crate) fn push(&mut self, ping: &Arc<Ping>) {
        if self.pings.len() == RING_LEN {
            self.pings.pop_front();
            self.not_shown += 1;
        }
        self.pings.push_back(Arrived {
            ping: Arc::clone(ping),
            at_ms: wire::now_ms(),
        });
    }

    /// All that is there.
    pub(crate) fn take(&mut self) -> VecDeque<Arrived> {
        std::mem::take(&mut self.pings)
    }

    /// Pings that gave way.
    pub(crate) fn not_shown(&self) -> u64 {
        self.not_shown
    }
}

/// A ping as the browser takes it, a byte a bin.
pub(crate) fn encode(Arrived { ping, at_ms }: &Arrived) -> Bytes {
    let decibels = |power: f32| 10.0 * power.max(1e-30).log10();
    let strongest = ping.intensity().iter().copied().fold(0.0, f32::max);
    let floor_db = decibels(strongest).ceil() - SPAN_DB;
    let step = |&power: &f32| ((decibels(power) - floor_db) / STEP_DB).round() as u8;
    let payload: Vec<u8> = ping.intensity().iter().map(step).collect();
    let settings = ping.settings();
    let header = json!({
        "sequence": ping.sequence(),
        "time_ns": ping.transmit_time().nanos(),
        "range_start_m": settings.range_start_m,
        "range_length_m": settings.range_length_m,
        "floor_db": floor_db,
        "step_db": STEP_DB,
    });
    wire::binary_of(Kind::Ping, *at_ms, header.to_string().as_bytes(), &payload)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use echosplat_model::{PingSettings, Timestamp};

    pub(crate) fn ping(sequence: u64, intensity: Vec<f32>) -> Arc<Ping> {
        let settings = PingSettings {
            range_start_m: 0.5,
            range_length_m: 10.0,
            bin_count: intensity.len(),
            speed_of_sound_mps: 1500.0,
            frequency_hz: 450e3,
            pulse_duration_s: 1e-4,
            gain_index: 0,
        };
        let time = Timestamp::from_millis(sequence as i64 * 20);
        Arc::new(Ping::new(sequence, time, settings, intensity).unwrap())
    }

    fn arrived(sequence: u64, intensity: Vec<f32>) -> Arrived {
        Arrived {
            ping: ping(sequence, intensity),
            at_ms: 0.0,
        }
    }

    #[test]
    fn decibels_come_within_half_a_step() {
        let powers = vec![0.0, 1e-9, 1e-3, 1.0, 50.0];
        let bytes = encode(&arrived(1, powers.clone()));
        let header_len = u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
        let header: serde_json::Value =
            serde_json::from_slice(&bytes[16..16 + header_len]).unwrap();
        let floor_db = header["floor_db"].as_f64().unwrap();
        let payload = &bytes[16 + header_len..];
        assert_eq!(payload[0], 0);
        for (byte, power) in payload.iter().zip(&powers).skip(1) {
            let shown_db = floor_db + 0.5 * f64::from(*byte);
            let true_db = 10.0 * f64::from(*power).log10();
            assert!((shown_db - true_db).abs() <= 0.2501, "{shown_db} {true_db}");
        }
    }

    #[test]
    fn silence_is_encoded_too() {
        let bytes = encode(&arrived(1, vec![0.0; 4]));
        assert!(bytes.len() > 16);
    }

    #[test]
    fn the_ring_keeps_the_newest() {
        let mut ring = PingRing::default();
        (0..40).for_each(|sequence| ring.push(&ping(sequence, vec![1.0])));
        let kept: Vec<u64> = ring.take().iter().map(|a| a.ping.sequence()).collect();
        assert_eq!(kept, Vec::from_iter(24..40));
        assert_eq!(ring.not_shown(), 24);
    }
}
