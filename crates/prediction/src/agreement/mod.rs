//! How well pings and poses agree, without a truth and without a map.
//!
//! With the right poses a place that one ping found lit is found lit by others that observe it from
//! elsewhere; with wrong ones it is not. So poses are scored by how well a window's other pings predict which
//! ranges of a ping are lit. Where nothing is seen twice, and where pings have no pose, nothing is gained.
//!
//! Pure: no threads, no clock, no randomness. Cost of a gain: with 64 cells about 1,800 samples of arcs a ping,
//! as the square of the number of cells.

mod evidence;
mod lit;
mod score;

use std::sync::Arc;

use echosplat_mapper::MapperConfig;
use echosplat_model::{Ping, Pose};

pub use evidence::BLOCKS;
use evidence::{Arcs, Evidence};
use lit::LitPings;
use score::Baseline;

/// Log likelihood above that by range alone, natural logarithm, by block of time; shape `[BLOCKS]`.
pub type ByBlock = [f64; BLOCKS];

/// A window of pings that choices of their poses are compared on.
#[derive(Debug)]
pub struct Agreement {
    pings: Vec<Arc<Ping>>,
    lit: LitPings,
    baseline: Baseline,
    arcs: Arcs,
}

impl Agreement {
    /// Of pings in order of time, with their ranges up to the furthest echoes cut into `cell_count` cells: the
    /// fewer, the further off poses may be and still agree. `None` if nothing is heard.
    #[must_use]
    pub fn new(pings: Vec<Arc<Ping>>, config: &MapperConfig, cell_count: usize) -> Option<Self> {
        let lit = LitPings::of(&pings, config, cell_count)?;
        Some(Self {
            baseline: Baseline::of(&lit),
            arcs: Arcs::new(&lit, &config.beam),
            lit,
            pings,
        })
    }

    /// Its pings.
    #[must_use]
    pub fn pings(&self) -> &[Arc<Ping>] {
        &self.pings
    }

    /// How many pings hear anything.
    #[must_use]
    pub fn lit_pings(&self) -> usize {
        self.lit.lit_pings()
    }

    /// Length of a cell, metres: with poses further off than that nothing agrees.
    #[must_use]
    pub fn cell_m(&self) -> f64 {
        self.lit.cell_m
    }

    /// Cells that are lit or dark, of all pings.
    #[must_use]
    pub fn known_cells(&self) -> f64 {
        self.baseline.cell_count
    }

    /// What poses `world_from_sensor`, one for each ping at the middle of what was listened to, gain over none.
    #[must_use]
    pub fn gain(&self, poses: &[Option<Pose>]) -> ByBlock {
        let evidence = Evidence::new(&self.pings, poses, &self.lit, &self.arcs);
        let likelihood = self.baseline.with(&self.lit, &evidence);
        std::array::from_fn(|block| likelihood[block] - self.baseline.by_block[block])
    }
}

/// Standard error of a sum over blocks.
#[must_use]
pub fn error_of_sum(by_block: &[f64]) -> f64 {
    let count = by_block.len() as f64;
    let mean = by_block.iter().sum::<f64>() / count;
    let square = by_block.iter().map(|value| (value - mean).powi(2));
    (square.sum::<f64>() * count / (count - 1.0)).sqrt()
}
