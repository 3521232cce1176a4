//! A small dive made of frames, through session and mapper to a map.

use std::sync::Arc;

use echosplat_firmware_protocol::{Message, OsMonoProfile, PowerResults};
use echosplat_mapper::{Mapper, MapperConfig};
use echosplat_model::{Ping, Pose, PosedPing, Snapshot, Timestamp, Twist};
use echosplat_session::{Session, SessionConfig, SessionEvent};
use glam::DVec3;

use crate::draw::Draw;

/// Where the only target is, from the dive's middle.
pub(super) const TARGET_M: DVec3 = DVec3::new(5.0, 0.0, 0.0);
const PING_INTERVAL_MS: u32 = 25;
const FLOOR_DB: f32 = -16.0;
const ECHO_DB: f32 = 29.0;

/// What a device says of one ping.
pub(super) struct Heard {
    pub(super) length_mm: u32,
    pub(super) min_db: f32,
    pub(super) max_db: f32,
    pub(super) results: Vec<u16>,
}

pub(super) fn heard(length_mm: u32, results: Vec<u16>) -> Heard {
    Heard {
        length_mm,
        min_db: -40.0,
        max_db: 40.0,
        results,
    }
}

/// Decibels on the scale of [`heard`].
pub(super) fn power(decibels: f32) -> u16 {
    ((decibels + 40.0) / 80.0 * 65_535.0).clamp(0.0, 65_535.0) as u16
}

/// Exponential noise, decibels.
pub(super) fn noise(draw: &mut Draw) -> f32 {
    FLOOR_DB + 10.0 * (-(1.0 - draw.between(0.0, 1.0)).ln()).max(1e-6).log10()
}

pub(super) fn water(seed: u64, index: u32, bins: usize) -> Vec<u16> {
    let mut draw = Draw::new(seed, u64::from(index));
    (0..bins).map(|_| power(noise(&mut draw))).collect()
}

/// A heave of two metres with the heading sweeping the beam across the target.
fn pose(index: u32) -> Pose {
    let t = f64::from(index) / 480.0 * std::f64::consts::TAU;
    let yaw = 0.03 * (37.0 * t).sin();
    Pose::from_yaw_pitch_roll(yaw, 0.0, 0.3 * (3.0 * t).sin(), DVec3::Z * t.sin())
}

/// Echoes of a small sphere over noise.
fn echoes(seed: u64, index: u32, bins: usize) -> Vec<u16> {
    let mut results = water(seed, index, bins);
    let q = pose(index).inverse() * TARGET_M;
    let azimuth_sigma = 0.8_f64.to_radians() / 2.355;
    let off = q.y.atan2(q.x) / azimuth_sigma;
    let echo_db = ECHO_DB - (10.0 / std::f32::consts::LN_10) * (0.5 * off * off) as f32;
    let bin = (q.length() / 10.0 * bins as f64) as usize;
    results[bin] = results[bin].max(power(echo_db));
    results
}

/// Some pings.
pub(super) struct Dive<F> {
    pub(super) count: u32,
    pub(super) of: F,
}

/// A dive past one target.
pub(super) fn of_target(seed: u64, count: u32, bins: usize) -> Dive<impl Fn(u32) -> Heard> {
    let of = move |index| heard(10_000, echoes(seed, index, bins));
    Dive { count, of }
}

impl<F: Fn(u32) -> Heard> Dive<F> {
    /// The map of the dive, and how many profiles were rejected. `None` where no thread can be started for the mapper.
    pub(super) fn map(&self) -> Option<(Snapshot, u64)> {
        let mut session = Session::listening(SessionConfig::default(), Timestamp::ZERO);
        let config = MapperConfig {
            threads: 1,
            workout_passes: 8,
            ..MapperConfig::default()
        };
        let mut mapper = Mapper::new(config).ok()?;
        for index in 0..self.count {
            let now = Timestamp::from_millis(i64::from(index * PING_INTERVAL_MS));
            session.receive(&frame(index, &(self.of)(index)).unwrap_or_default(), now);
            while let Some(event) = session.poll_event() {
                let SessionEvent::Ping { ping, .. } = event else {
                    continue;
                };
                mapper.insert(&posed(ping, index));
            }
        }
        let rejected = session.counters().profiles_rejected.total();
        Some((mapper.finish(), rejected))
    }
}

fn posed(ping: Arc<Ping>, index: u32) -> PosedPing {
    PosedPing {
        ping,
        world_from_sensor: pose(index),
        twist: Twist::default(),
        reference_range_m: 5.0,
        uncertainty: None,
        jitter: None,
    }
}

fn frame(index: u32, heard: &Heard) -> Option<Vec<u8>> {
    let results: Vec<u8> = heard
        .results
        .iter()
        .flat_map(|raw| raw.to_le_bytes())
        .collect();
    let message = Message::OsMonoProfile(OsMonoProfile {
        ping_number: index,
        start_mm: 0,
        length_mm: heard.length_mm,
        timestamp_ms: index * PING_INTERVAL_MS,
        ping_hz: 451_127,
        gain_index: 0,
        sos_dmps: 15_000,
        channel_number: 0,
        pulse_duration_sec: 2e-5,
        analog_gain: 0.0,
        max_pwr_db: heard.max_db,
        min_pwr_db: heard.min_db,
        transducer_heading_deg: 0.0,
        vehicle_heading_deg: 0.0,
        pwr_results: PowerResults::from_bytes(&results).ok()?,
    });
    let mut bytes = vec![0; message.encoded_byte_count()];
    let written = message.encode(1, 0, &mut bytes).ok()?;
    bytes.truncate(written);
    Some(bytes)
}
