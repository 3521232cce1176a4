//! Units of length and of power, and sizes far from the usual.

use std::sync::Arc;

use echosplat_mapper::MapperConfig;
use echosplat_model::{Ping, Pose, PosedPing};

use super::voyage::{self, Made, apart_m};
use super::{Base, SAMPLED_WITHIN_M};
use crate::stability::Row;
use crate::stability::row::{Comparison, Label};

const LENGTHS: Label = Label {
    case: "whole mapper: units",
    quantity: "Chamfer distance of the map, scaled back, from the one in metres, m",
    why: "Ranges, places, settings and sigmas are scaled alike. What stays in metres in the mapper is \
          what belongs to the sea and not to the scene: how far speckle stays the same, how far a \
          shadow reaches.",
};

const POWERS: Label = Label {
    case: "whole mapper: units",
    quantity: "numbers of the map that differ in any bit",
    why: "Noise and strengths are learnt from the pings; the published unit is a power of two.",
};

const SIZES: Label = Label {
    case: "whole mapper: sizes",
    quantity: "pairs and voxel observations a ping, over those of the usual size; not a number where the map \
               holds one that is none",
    why: "Work is bounded by what is in the fan and not by metres.",
};

const CROWDS: Label = Label {
    case: "whole mapper: sizes",
    quantity: "pairs and voxel observations a ping, over those of the usual dive; not a number where the map \
               holds one that is none",
    why: "Late candidates are told of every remembered ping once; neither steps nor finish grow with \
          how often a place was looked at.",
};

/// Work a ping may take against the usual.
const WORK_WITHIN: f64 = 4.0;
pub(super) fn rows(base: &Base) -> Vec<Row> {
    let mut rows = Vec::new();
    for power in base.some(1, &[10, -10, 40, -40]) {
        let scale = 2_f32.powi(power);
        let map = base.map_of(&louder(&base.pings, scale));
        rows.push(base.bits_row(map.as_ref(), POWERS, format!("power × 2^{power}")));
    }
    for scale in base.some(0, &[2.0, 0.5]) {
        let map = map_scaled(base, scale);
        let apart_m = apart_m(Some(&base.map), map.as_ref(), |place| place / scale);
        let comparison = Comparison::of(0.0, apart_m, 1.0);
        rows.push(comparison.row(LENGTHS, format!("lengths × {scale}"), SAMPLED_WITHIN_M));
    }
    for (name, scale) in base.some(1, &[("3 mm", 1.0 / 512.0), ("100 m", 64.0)]) {
        let map = map_scaled(base, scale);
        let input = format!("a structure of {name}");
        rows.push(work_row(base, map.as_ref(), SIZES, input, base.pings.len()));
    }
    let count = if base.quick { 1_000 } else { 10_000 };
    let first = base.pings.iter().take(1).cycle();
    let pings: Vec<PosedPing> = first.take(count).cloned().collect();
    let map = base.map_of(&pings);
    let input = format!("{count} pings in one place");
    rows.push(work_row(base, map.as_ref(), CROWDS, input, count));
    rows
}

fn work_row(
    base: &Base,
    map: Option<&Made>,
    label: Label,
    input: String,
    ping_count: usize,
) -> Row {
    let usual = base.map.work() as f64 / base.pings.len() as f64;
    let ratio = match map {
        Some(made) if made.unsound_count() == 0 => made.work() as f64 / ping_count as f64 / usual,
        _ => f64::NAN,
    };
    let comparison = Comparison {
        truth: 1.0,
        program: ratio,
        error: ratio,
        naive: None,
    };
    comparison.row(label, input, WORK_WITHIN)
}

/// The same pings, every bin times `scale`.
fn louder(pings: &[PosedPing], scale: f32) -> Vec<PosedPing> {
    let louder = |posed: &PosedPing| {
        let ping = &posed.ping;
        let power = ping.intensity().iter().map(|power| power * scale).collect();
        let ping = Ping::new(
            ping.sequence(),
            ping.transmit_time(),
            *ping.settings(),
            power,
        );
        let ping = Arc::new(ping.ok()?);
        Some(PosedPing {
            ping,
            ..posed.clone()
        })
    };
    pings.iter().filter_map(louder).collect()
}

/// The map of everything `scale` times as large.
fn map_scaled(base: &Base, scale: f64) -> Option<Made> {
    let larger = |posed: &PosedPing| {
        let ping = &posed.ping;
        let mut settings = *ping.settings();
        settings.range_start_m *= scale;
        settings.range_length_m *= scale;
        settings.pulse_duration_s *= scale;
        let pose = Pose {
            translation_m: posed.world_from_sensor.translation_m * scale,
            ..posed.world_from_sensor
        };
        voyage::posed(
            ping.sequence(),
            settings,
            ping.intensity().to_vec(),
            pose,
            ping.view(),
        )
    };
    let pings: Vec<PosedPing> = base.pings.iter().filter_map(larger).collect();
    let config = &base.config;
    let config = MapperConfig {
        blanking_m: config.blanking_m * scale,
        resolution_m: config.resolution_m * scale,
        position_sigma_m: config.position_sigma_m * scale,
        confident_sigma_m: (f64::from(config.confident_sigma_m) * scale).clamp(1e-3, 10.0) as f32,
        ..config.clone()
    };
    voyage::map(&pings, &config)
}
