//! Pings with given echoes, for tests.

use echosplat_measurement::PingGeometry;
use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Ping, PingSettings, Pose, PosedPing, Timestamp, Twist};

use crate::MapperConfig;
use crate::accumulate::history::geometry_of;
use crate::detect::profile::{Backdrop, Levels, Profile};

const BINS: usize = 600;
const BIN_M: f64 = 0.02;

/// A level ping of faint noise with echoes at these ranges, metres, and powers: what it saw, its powers, what they
/// say and the strongest of them.
pub(crate) fn heard(
    heading_deg: f64,
    echoes: &[(f64, f32)],
) -> (PingGeometry, Vec<f32>, Profile, f32) {
    let mut power: Vec<f32> = (0..BINS)
        .map(|bin| 0.5 + 0.01 * (bin * 7 % 100) as f32)
        .collect();
    for &(range_m, strength) in echoes {
        let bin = (range_m / BIN_M) as usize;
        power[bin - 1..=bin + 1].fill(strength);
    }
    let pose = Pose {
        rotation: DQuat::from_rotation_z(heading_deg.to_radians()),
        ..Pose::IDENTITY
    };
    let posed = posed(0, power.clone(), pose);
    let config = MapperConfig::default();
    let mut levels = Levels::default();
    let profile = levels.profile(
        &posed.ping,
        0.04,
        &Backdrop::default(),
        Box::default(),
        &config,
    );
    let geometry = geometry_of(&posed, DVec3::ZERO, &config);
    (geometry, power, profile, levels.strongest())
}

/// A ping of these powers, 50 ms after the one of the number before.
pub(crate) fn posed(number: u32, power: Vec<f32>, world_from_sensor: Pose) -> PosedPing {
    let range_length_m = BIN_M * power.len() as f64;
    let settings = PingSettings {
        range_start_m: 0.0,
        range_length_m,
        bin_count: power.len(),
        speed_of_sound_mps: 1500.0,
        frequency_hz: 450e3,
        pulse_duration_s: 2e-5,
        gain_index: 0,
    };
    let time = Timestamp::from_nanos(i64::from(number) * 50_000_000);
    let ping = Ping::new(number.into(), time, settings, power).unwrap();
    PosedPing {
        ping: ping.into(),
        world_from_sensor,
        twist: Twist::default(),
        reference_range_m: 0.5 * range_length_m,
        uncertainty: None,
        jitter: None,
    }
}
