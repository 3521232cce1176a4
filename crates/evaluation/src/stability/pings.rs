//! Degenerate pings, as frames of the device: rejected or mapped rightly, never mass from nothing.

use std::sync::Arc;

use echosplat_firmware_protocol::{Message, OsMonoProfile, PowerResults};
use echosplat_mapper::{Budget, Mapper, MapperConfig};
use echosplat_model::{Ping, Pose, PosedPing, Snapshot, Standing, Timestamp, Twist};
use echosplat_session::{Session, SessionConfig, SessionEvent};
use glam::DVec3;

use super::Row;
use super::draw::Draw;
use super::row::{Comparison, Label};
use crate::metrics::FALSE_BEYOND_M;

const NOTHING: Label = Label {
    case: "degenerate pings",
    quantity: "Gaussians in the map of a dive with nothing to see (naive: echoes in a ping, by half \
               of its own maximum)",
    why: "Settings that no sonar has are rejected by the session; an echo must stand above the \
          ping's own noise, so that what is the same in every bin is none.",
};

const TARGET: Label = Label {
    case: "degenerate pings",
    quantity: "distance of the furthest confident Gaussian from the only target, m",
    why: "Any number of bins that the device offers is mapped; ranges come from the profile's own \
          header.",
};

const TARGET_M: DVec3 = DVec3::new(5.0, 0.0, 0.0);
const PING_INTERVAL_MS: u32 = 25;
const FLOOR_DB: f32 = -16.0;
const ECHO_DB: f32 = 29.0;

/// What a device says of one ping.
struct Heard {
    length_mm: u32,
    min_db: f32,
    max_db: f32,
    results: Vec<u16>,
}

pub(super) fn rows(seed: u64, quick: bool) -> Vec<Row> {
    let count = if quick { 240 } else { 480 };
    let mut rows: Vec<Row> = [200, 1200].map(|bins| target(seed, count, bins)).into();
    rows.push(nothing("num_results 1", count, |index| {
        let mut draw = Draw::new(seed, u64::from(index));
        heard(10_000, vec![power(noise(&mut draw))])
    }));
    for length_mm in [0, 1, u32::MAX] {
        let input = format!("length {length_mm} mm");
        rows.push(nothing(&input, count, |index| {
            heard(length_mm, water(seed, index, 600))
        }));
    }
    rows.push(nothing("all-zero power", count, |_| {
        heard(10_000, vec![0; 600])
    }));
    rows.push(nothing("saturated power", count, |_| {
        heard(10_000, vec![u16::MAX; 600])
    }));
    rows.push(nothing("saturated after open water", count, |index| {
        let open = index < count / 3;
        let results = if open {
            water(seed, index, 600)
        } else {
            vec![u16::MAX; 600]
        };
        heard(10_000, results)
    }));
    rows.push(nothing("max = min decibels", count, |index| Heard {
        min_db: 30.0,
        max_db: 30.0,
        ..heard(10_000, water(seed, index, 600))
    }));
    rows
}

fn heard(length_mm: u32, results: Vec<u16>) -> Heard {
    Heard {
        length_mm,
        min_db: -40.0,
        max_db: 40.0,
        results,
    }
}

/// Decibels on the scale of [`heard`].
fn power(decibels: f32) -> u16 {
    ((decibels + 40.0) / 80.0 * 65_535.0).clamp(0.0, 65_535.0) as u16
}

/// Exponential noise, decibels.
fn noise(draw: &mut Draw) -> f32 {
    FLOOR_DB + 10.0 * (-(1.0 - draw.between(0.0, 1.0)).ln()).max(1e-6).log10()
}

fn water(seed: u64, index: u32, bins: usize) -> Vec<u16> {
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

fn target(seed: u64, count: u32, bins: usize) -> Row {
    let map = map(count, |index| heard(10_000, echoes(seed, index, bins)));
    let error_m = map.map_or(f64::NAN, |(snapshot, _)| furthest_m(&snapshot));
    Comparison::of(0.0, error_m, 1.0).row(TARGET, format!("num_results {bins}"), FALSE_BEYOND_M)
}

/// Of what is asserted; a target that is nowhere in the map is not mapped rightly either.
fn furthest_m(snapshot: &Snapshot) -> f64 {
    let (mut furthest_m, mut nearest_m) = (0.0_f64, f64::INFINITY);
    for gaussian in &snapshot.gaussians {
        let off_m = (snapshot.origin_m + gaussian.mean_m.as_dvec3()).distance(TARGET_M);
        nearest_m = nearest_m.min(off_m);
        if gaussian.standing == Standing::Confident {
            furthest_m = furthest_m.max(off_m);
        }
    }
    furthest_m.max(nearest_m)
}

fn nothing(input: &str, count: u32, of: impl Fn(u32) -> Heard) -> Row {
    let lit = naive_echoes(&of(count - 1));
    let map = map(count, of);
    let rejected = map.as_ref().map_or(0, |(_, rejected)| *rejected);
    let input = match rejected {
        0 => input.to_owned(),
        _ => format!("{input} ({rejected} of {count} profiles rejected)"),
    };
    let held = map.map_or(f64::NAN, |(snapshot, _)| snapshot.gaussians.len() as f64);
    let comparison = Comparison::of(0.0, held, 1.0).with_naive(lit, 1.0);
    comparison.row(NOTHING, input, 0.0)
}

/// Bins above half of the ping's own maximum, power scaled to it in f32: the intensity threshold
/// as it is commonly put.
fn naive_echoes(heard: &Heard) -> f64 {
    let span = heard.max_db - heard.min_db;
    let linear = |raw: u16| 10_f32.powf((heard.min_db + f32::from(raw) / 65_535.0 * span) / 10.0);
    let power: Vec<f32> = heard.results.iter().map(|&raw| linear(raw)).collect();
    let most = power.iter().copied().fold(0.0, f32::max);
    power.iter().filter(|&&p| p / most > 0.5).count() as f64
}

/// Through session and mapper; also how many profiles were rejected. `None` where no thread can be
/// started for the mapper.
fn map(count: u32, of: impl Fn(u32) -> Heard) -> Option<(Snapshot, u64)> {
    let mut session = Session::listening(SessionConfig::default(), Timestamp::ZERO);
    let config = MapperConfig {
        threads: 1,
        finish_passes: 8,
        ..MapperConfig::default()
    };
    let mut mapper = Mapper::new(config).ok()?;
    for index in 0..count {
        let now = Timestamp::from_millis(i64::from(index * PING_INTERVAL_MS));
        session.receive(&frame(index, &of(index)).unwrap_or_default(), now);
        while let Some(event) = session.poll_event() {
            let SessionEvent::Ping { ping, .. } = event else {
                continue;
            };
            mapper.insert(&posed(ping, index));
            mapper.optimize(Budget { pairs: 200_000 });
        }
    }
    let rejected = session.counters().profiles_rejected.total();
    Some((mapper.finish(), rejected))
}

fn posed(ping: Arc<Ping>, index: u32) -> PosedPing {
    PosedPing {
        ping,
        world_from_sensor: pose(index),
        twist: Twist::default(),
        reference_range_m: 5.0,
        uncertainty: None,
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
