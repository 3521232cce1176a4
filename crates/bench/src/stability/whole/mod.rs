//! What must not matter to a map: where the world's origin is, which way it is turned, in what
//! units it is measured, what order pings of a slice come in, and pings that are none. All through
//! the whole mapper, on small dives.

mod blind;
mod faults;
mod moved;
mod scaled;
mod tough;
mod voyage;

use std::sync::Arc;

use echosplat_mapper::MapperConfig;
use echosplat_model::PosedPing;
use echosplat_simulator::Scene;
use glam::DVec3;

use super::Row;
use super::row::{Comparison, Label};
use echosplat_metrics::Truth;
use voyage::{Made, Way, differing_bits};

/// Two maps may be this far apart and still count as the same.
const SAME_WITHIN_M: f64 = 0.005;

/// Half a voxel, the spacing of a finished map's points: maps whose candidates are not the same
/// are up to this far apart, and no further from the truth for it.
const SAMPLED_WITHIN_M: f64 = 0.031_25;

/// Of a dive: in fewer, next to nothing is seen from enough places.
const PING_COUNT: usize = 800;

/// The dive that all others are held against.
struct Base {
    seed: u64,
    quick: bool,
    scene: Arc<Scene>,
    pings: Vec<PosedPing>,
    config: MapperConfig,
    map: Made,
    truth: Truth,
    /// Of the clean map.
    error_m: f64,
}

pub(super) fn rows(seed: u64, quick: bool) -> Vec<Row> {
    let Some(base) = Base::new(seed, quick) else {
        return vec![Comparison::of(f64::NAN, f64::NAN, 1.0).row(NO_BASE, "clean dive", 0.0)];
    };
    let parts = [
        moved::rows,
        scaled::rows,
        tough::rows,
        faults::rows,
        blind::rows,
    ];
    parts.iter().flat_map(|part| part(&base)).collect()
}

const NO_BASE: Label = Label {
    case: "whole mapper",
    quantity: "a map of a clean dive",
    why: "Scene, pings and mapper are there.",
};

impl Base {
    fn new(seed: u64, quick: bool) -> Option<Self> {
        let scene = voyage::scene()?;
        let config = voyage::config();
        let pings = voyage::pings(&scene, Way::Around, seed, PING_COUNT);
        let map = voyage::map(&pings, &config)?;
        let truth = Truth::from_scene(&scene, None);
        Some(Self {
            error_m: map.error_m(&truth),
            truth,
            seed,
            quick,
            scene,
            pings,
            config,
            map,
        })
    }

    /// Of other pings with the same settings.
    fn map_of(&self, pings: &[PosedPing]) -> Option<Made> {
        voyage::map(pings, &self.config)
    }

    /// All inputs, or the first few of them for a first look.
    fn some<T: Copy>(&self, quick_count: usize, all: &[T]) -> Vec<T> {
        let count = if self.quick { quick_count } else { all.len() };
        all.iter().take(count).copied().collect()
    }

    /// What it is off the truth against the clean one.
    fn ratio_row(
        &self,
        map: Option<&Made>,
        label: Label,
        input: impl Into<String>,
        limit: f64,
    ) -> Row {
        let error_m = map.map_or(f64::NAN, |made| match made.unsound_count() {
            0 => made.error_m(&self.truth),
            _ => f64::NAN,
        });
        let ratio = error_m / self.error_m;
        let comparison = Comparison {
            truth: 1.0,
            program: ratio,
            error: ratio,
            naive: None,
        };
        comparison.row(label, input, limit)
    }

    /// Whether it is the clean one, bit for bit.
    fn bits_row(&self, map: Option<&Made>, label: Label, input: impl Into<String>) -> Row {
        self.shifted_bits_row(map, DVec3::ZERO, label, input)
    }

    /// Whether it is the clean one, made `shift_m` away, bit for bit.
    fn shifted_bits_row(
        &self,
        map: Option<&Made>,
        shift_m: DVec3,
        label: Label,
        input: impl Into<String>,
    ) -> Row {
        let there = map.map(|made| &made.snapshot);
        let differing = differing_bits(Some(&self.map.snapshot), there, shift_m);
        Comparison::of(0.0, differing, 1.0).row(label, input, 0.0)
    }
}
