//! The same dive elsewhere, and turned.

use echosplat_model::Pose;
use glam::DVec3;

use super::voyage::{Made, apart_m, moved};
use super::{Base, SAME_WITHIN_M};
use crate::stability::Row;
use crate::stability::row::{Comparison, Label};

const SHIFTED: Label = Label {
    case: "whole mapper: far origins",
    quantity: "Chamfer distance of the map from the one made at the origin, m",
    why: "Poses are brought to a local origin in f64; the map's own coordinates do not know where it \
          is.",
};

const SHIFTED_EXACTLY: Label = Label {
    case: "whole mapper: far origins",
    quantity: "numbers of the map that differ in any bit, places beyond their rounding",
    why: "A shift that is exact in f64 leaves every local coordinate as it was; only published \
          places of the near map are rounded in the poses' own frame.",
};

const WHOLE_TURNS: Label = Label {
    case: "whole mapper: yaw",
    quantity: "numbers of the map that differ in any bit",
    why: "A rotation is a unit quaternion; that and its negative are one.",
};

const TURNED: Label = Label {
    case: "whole mapper: yaw",
    quantity: "Chamfer distance of the map, turned back, from the one not turned, m",
    why: "Voxels lie along the first ping's heading, so that they turn with the dive.",
};

const TURNED_ANYHOW: Label = Label {
    quantity: "Chamfer distance to the truth over that of the dive not turned",
    ..TURNED
};

/// The map of a turned dive is no worse.
const AS_GOOD: f64 = 1.25;

pub(super) fn rows(base: &Base) -> Vec<Row> {
    let mut rows = Vec::new();
    for distance_m in base.some(1, &[1e7, 1e6, 1e5]) {
        // Not representable: a tenth is none in binary.
        let shift = DVec3::new(distance_m + 0.1, -0.7 * distance_m + 0.3, -0.1);
        let shifted = Pose {
            translation_m: shift,
            ..Pose::IDENTITY
        };
        let map = map_of(base, shifted);
        let apart_m = apart_m(Some(&base.map), map.as_ref(), |place| place - shift);
        let comparison = Comparison::of(0.0, apart_m, 1.0);
        rows.push(comparison.row(SHIFTED, format!("{distance_m:e} m"), SAME_WITHIN_M));
    }
    for power in base.some(0, &[23, 20, 17]) {
        let shift = DVec3::new(2_f64.powi(power), -2_f64.powi(power), 1024.0);
        let pings = moved(&base.pings, |pose| Pose {
            translation_m: pose.translation_m + shift,
            ..pose
        });
        let map = base.map_of(&pings);
        let input = format!("2^{power} m");
        rows.push(base.shifted_bits_row(map.as_ref(), shift, SHIFTED_EXACTLY, input));
    }
    if !base.quick {
        let negated = moved(&base.pings, |pose| Pose {
            rotation: -pose.rotation,
            ..pose
        });
        let map = base.map_of(&negated);
        rows.push(base.bits_row(map.as_ref(), WHOLE_TURNS, "quaternions negated"));
    }
    for yaw_deg in base.some(1, &[90.0, 180.0, -90.0, 360.0, 360_000.0]) {
        let comparison = Comparison::of(0.0, turned(base, yaw_deg).apart_m, 1.0);
        rows.push(comparison.row(TURNED, format!("{yaw_deg}°"), SAME_WITHIN_M));
    }
    let odd = base.some(1, &[33.0, 45.0, 10.0]);
    let turned: Vec<(f64, Turned)> = odd.into_iter().map(|d| (d, turned(base, d))).collect();
    for (yaw_deg, turned) in &turned {
        let comparison = Comparison::of(0.0, turned.apart_m, 1.0);
        rows.push(comparison.row(TURNED, format!("{yaw_deg}°"), SAME_WITHIN_M));
    }
    for (yaw_deg, turned) in &turned {
        let map = turned.back.as_ref();
        rows.push(base.ratio_row(map, TURNED_ANYHOW, format!("{yaw_deg}°"), AS_GOOD));
    }
    rows
}

/// The map of a turned dive.
struct Turned {
    /// From the clean one, once it is turned back.
    apart_m: f64,
    /// Its points turned back.
    back: Option<Made>,
}

fn turned(base: &Base, yaw_deg: f64) -> Turned {
    let turn = Pose::from_yaw_pitch_roll(yaw_deg.to_radians(), 0.0, 0.0, DVec3::ZERO);
    let back = map_of(base, turn).map(|made| made.moved(&turn.inverse()));
    Turned {
        apart_m: apart_m(Some(&base.map), back.as_ref(), |place| place),
        back,
    }
}

fn map_of(base: &Base, to_there: Pose) -> Option<Made> {
    base.map_of(&moved(&base.pings, |pose| Pose {
        rotation: to_there.rotation * pose.rotation,
        translation_m: to_there * pose.translation_m,
    }))
}
