//! Order within a slice, and much going wrong at once.

use echosplat_model::{Pose, PosedPing};
use glam::DVec3;

use super::Base;
use super::faults::silenced;
use crate::draw::Draw;
use crate::stability::Row;
use crate::stability::row::Label;

const ORDER: Label = Label {
    case: "whole mapper: order",
    quantity: "numbers of the map that differ in any bit",
    why: "A slice is put in order of time before anything is taken from it.",
};

const TOUGH: Label = Label {
    case: "whole mapper: tough mode",
    quantity: "Chamfer distance to the truth over that of the clean dive",
    why: "What is not finite is left out; darkness from one side takes only so much; positions follow \
          what most pings say.",
};

const TWICE: f64 = 2.0;

/// What goes wrong, as shares of the pings.
#[derive(Debug, Clone, Copy)]
struct Trouble {
    name: &'static str,
    /// Half of them without power, half without a pose.
    spoilt: f32,
    dropped: f32,
    /// Up to two metres and 180° off.
    misplaced: f32,
}

const TROUBLES: [Trouble; 4] = [
    Trouble {
        name: "10 % spoilt, 20 % dropped, 1 % of poses wrong",
        spoilt: 0.1,
        dropped: 0.2,
        misplaced: 0.01,
    },
    Trouble {
        name: "10 % spoilt",
        spoilt: 0.1,
        dropped: 0.0,
        misplaced: 0.0,
    },
    Trouble {
        name: "20 % dropped",
        spoilt: 0.0,
        dropped: 0.2,
        misplaced: 0.0,
    },
    Trouble {
        name: "1 % of poses wrong",
        spoilt: 0.0,
        dropped: 0.0,
        misplaced: 0.01,
    },
];

pub(super) fn rows(base: &Base) -> Vec<Row> {
    let slice = base.config.slice_pings;
    let reversed = base.pings.chunks(slice).flat_map(|s| s.iter().rev());
    let reversed: Vec<PosedPing> = reversed.cloned().collect();
    let map = base.map_of(&reversed);
    let mut rows = vec![base.bits_row(map.as_ref(), ORDER, "every slice reversed")];
    for trouble in base.some(1, &TROUBLES) {
        let map = base.map_of(&troubled(base, trouble));
        rows.push(base.ratio_row(map.as_ref(), TOUGH, trouble.name, TWICE));
    }
    rows
}

fn troubled(base: &Base, trouble: Trouble) -> Vec<PosedPing> {
    let mut draw = Draw::new(base.seed, 700);
    let mut pings = Vec::new();
    for posed in &base.pings {
        let [dropped, spoilt, which, misplaced] = std::array::from_fn(|_| draw.between(0.0, 1.0));
        let off_m = 2.0 * draw.cube().as_dvec3();
        let turn = draw.rotation().as_dquat();
        if dropped < trouble.dropped {
            continue;
        }
        let mut posed = posed.clone();
        if misplaced < trouble.misplaced {
            posed.world_from_sensor = Pose {
                rotation: turn * posed.world_from_sensor.rotation,
                translation_m: posed.world_from_sensor.translation_m + off_m,
            };
        }
        if spoilt < trouble.spoilt {
            match which < 0.5 {
                true => posed.world_from_sensor.translation_m = DVec3::NAN,
                false => posed = silenced(&posed).unwrap_or(posed),
            }
        }
        pings.push(posed);
    }
    pings
}
