//! Pings that are none, between pings that are: left out or harmless.

use std::sync::Arc;

use echosplat_model::{Ping, PingSettings, PoseUncertainty, PosedPing};
use glam::{DQuat, DVec3};

use super::Base;
use super::voyage::settings;
use crate::draw::Draw;
use crate::stability::Row;
use crate::stability::row::{Comparison, Label};

const LEFT_OUT: Label = Label {
    case: "whole mapper: numbers that are none",
    quantity: "numbers of the map that differ in any bit from the one without such pings",
    why: "A ping whose pose, motion or uncertainty is not finite is counted and left out before it \
          reaches anything.",
};

const DEAF_ONES: Label = Label {
    case: "whole mapper: degenerate pings among good ones",
    quantity: "numbers of the map that differ in any bit from the one without such pings",
    why: "A receiver at its stop, a scale without a span, a glitch a million times as loud as any \
          echo, a range within the blanking and a pose that leaves everything open are evidence of \
          nothing: counted, and left out.",
};

const HARMLESS: Label = Label {
    case: "whole mapper: degenerate pings among good ones",
    quantity: "Chamfer distance to the truth over that without them",
    why: "Silence is darkness, and one side's darkness takes only so much from what others saw.",
};

/// A map with them is about as good.
const AS_GOOD: f64 = 1.25;

const REFUSED: Label = Label {
    case: "whole mapper: numbers that are none",
    quantity: "such pings that can be made",
    why: "A ping is checked where it is made: what is not a power, or not a sonar's setting, never \
          becomes one.",
};

/// One good ping in so many is followed by a bad one.
const BETWEEN: usize = 8;

/// A bad ping in place of a good one.
type Spoil = fn(&PosedPing, u64) -> Option<PosedPing>;

const POSES: [(&str, Spoil); 14] = [
    ("position NaN", |ping, _| placed(ping, DVec3::NAN)),
    ("rotation zero", |ping, _| {
        turned(ping, DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0))
    }),
    ("position ∞", |ping, _| {
        placed(ping, DVec3::new(0.0, f64::INFINITY, 0.0))
    }),
    ("position −∞", |ping, _| {
        placed(ping, DVec3::NEG_INFINITY)
    }),
    ("position the largest f64", |ping, _| {
        placed(ping, DVec3::MAX)
    }),
    ("position 10^300 m", |ping, _| {
        placed(ping, DVec3::splat(1e300))
    }),
    ("rotation NaN", |ping, _| turned(ping, DQuat::NAN)),
    ("rotation 10^200 long", |ping, _| {
        turned(ping, ping.world_from_sensor.rotation * 1e200)
    }),
    ("rotation subnormal", |ping, _| {
        turned(ping, ping.world_from_sensor.rotation * 1e-310)
    }),
    ("speed NaN", |ping, _| {
        let mut ping = ping.clone();
        ping.twist.linear_mps.y = f64::NAN;
        Some(ping)
    }),
    ("speed the largest f64", |ping, _| {
        let mut ping = ping.clone();
        ping.twist.linear_mps = DVec3::MAX;
        Some(ping)
    }),
    ("rate of turn ∞", |ping, _| {
        let mut ping = ping.clone();
        ping.twist.angular_radps.z = f64::INFINITY;
        Some(ping)
    }),
    ("reference range NaN", |ping, _| {
        let mut ping = ping.clone();
        ping.reference_range_m = f64::NAN;
        Some(ping)
    }),
    ("uncertainty NaN", |ping, _| {
        let mut ping = ping.clone();
        ping.uncertainty = Some(PoseUncertainty {
            position_m: f64::NAN,
            attitude_rad: 0.0,
        });
        Some(ping)
    }),
];

const DEAF: [(&str, Spoil); 8] = [
    ("saturated", |ping, _| {
        heard(ping, settings(), vec![1e4; 300])
    }),
    ("one bin at the largest f32 but one", |ping, _| {
        let mut power = ping.ping.intensity().to_vec();
        power[200] = 3.4e38;
        heard(ping, settings(), power)
    }),
    ("max = min", |ping, _| {
        heard(ping, settings(), vec![0.025; 300])
    }),
    ("all subnormal", |ping, _| {
        heard(ping, settings(), vec![1e-40; 300])
    }),
    ("all at the largest f32 but one", |ping, _| {
        heard(ping, settings(), vec![3.4e38; 300])
    }),
    ("num_results 1", |ping, seed| noise(ping, seed, 1, 6.0)),
    ("length 1 cm", |ping, seed| noise(ping, seed, 300, 0.01)),
    ("uncertain by 100 m", |ping, _| {
        let mut ping = ping.clone();
        ping.uncertainty = Some(PoseUncertainty {
            position_m: 100.0,
            attitude_rad: 3.0,
        });
        Some(ping)
    }),
];

const SILENT: [(&str, Spoil); 4] = [
    ("all zero", |ping, _| silenced(ping)),
    ("num_results 200, noise", |ping, seed| {
        noise(ping, seed, 200, 6.0)
    }),
    ("num_results 1200, noise", |ping, seed| {
        noise(ping, seed, 1200, 6.0)
    }),
    ("length 1 km, noise", |ping, seed| {
        noise(ping, seed, 300, 1000.0)
    }),
];

const NOT_A_POWER: [f32; 5] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, f32::MAX];

pub(super) fn rows(base: &Base) -> Vec<Row> {
    let made = NOT_A_POWER.iter().filter(|&&bad| {
        let first = &base.pings[0];
        heard(first, settings(), vec![bad; 300]).is_some()
    });
    let comparison = Comparison::of(0.0, made.count() as f64, 1.0);
    let mut rows = vec![comparison.row(REFUSED, "NaN, ±∞, −1, largest f32", 0.0)];
    let all: Vec<Spoil> = POSES.iter().chain(&DEAF).map(|(_, spoil)| *spoil).collect();
    let map = base.map_of(&with(base, &all));
    rows.push(base.bits_row(map.as_ref(), LEFT_OUT, "all of these in turn"));
    for (name, spoil) in base.some(0, &POSES) {
        let map = base.map_of(&with(base, &[spoil]));
        rows.push(base.bits_row(map.as_ref(), LEFT_OUT, name));
    }
    for (name, spoil) in base.some(0, &DEAF) {
        let map = base.map_of(&with(base, &[spoil]));
        rows.push(base.bits_row(map.as_ref(), DEAF_ONES, name));
    }
    for (name, spoil) in base.some(0, &SILENT) {
        let map = base.map_of(&with(base, &[spoil]));
        rows.push(base.ratio_row(map.as_ref(), HARMLESS, name, AS_GOOD));
    }
    rows
}

/// The clean dive's pings with bad ones between them, each kind in its turn.
fn with(base: &Base, spoils: &[Spoil]) -> Vec<PosedPing> {
    let mut pings = Vec::new();
    for (index, ping) in base.pings.iter().enumerate() {
        pings.push(ping.clone());
        if index % BETWEEN == BETWEEN / 2 {
            let spoil = spoils.get(index / BETWEEN % spoils.len().max(1));
            pings.extend(spoil.and_then(|spoil| spoil(ping, base.seed)));
        }
    }
    pings
}

fn placed(ping: &PosedPing, translation_m: DVec3) -> Option<PosedPing> {
    let mut ping = ping.clone();
    ping.world_from_sensor.translation_m = translation_m;
    Some(ping)
}

fn turned(ping: &PosedPing, rotation: DQuat) -> Option<PosedPing> {
    let mut ping = ping.clone();
    ping.world_from_sensor.rotation = rotation;
    Some(ping)
}

/// Another ping from the same pose.
fn heard(posed: &PosedPing, settings: PingSettings, power: Vec<f32>) -> Option<PosedPing> {
    let ping = &posed.ping;
    let ping = Ping::new(ping.sequence(), ping.transmit_time(), settings, power).ok()?;
    Some(PosedPing {
        ping: Arc::new(ping),
        ..posed.clone()
    })
}

/// The same without any power.
pub(super) fn silenced(ping: &PosedPing) -> Option<PosedPing> {
    let bins = ping.ping.intensity().len();
    heard(ping, *ping.ping.settings(), vec![0.0; bins])
}

/// Nothing but noise, to where other pings end or elsewhere.
fn noise(posed: &PosedPing, seed: u64, bin_count: usize, range_length_m: f64) -> Option<PosedPing> {
    let settings = PingSettings {
        bin_count,
        range_length_m,
        ..settings()
    };
    let mut draw = Draw::new(seed, 800 + posed.ping.sequence());
    let power = (0..bin_count).map(|_| -0.025 * (1.0 - draw.between(0.0, 1.0)).ln());
    heard(posed, settings, power.collect())
}
