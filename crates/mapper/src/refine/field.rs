//! The Gaussians of a pass side by side, block by block, as kernels read them.

use std::ops::Range;

use echosplat_acoustics::lanes::LANES;
use echosplat_acoustics::packed::NUMBERS;
use echosplat_model::glam::Vec3;
use rayon::prelude::*;

use crate::accumulate::evidence::{BlockIndex, Evidence, TileIndex};
use crate::accumulate::fan::Fan;
use crate::spawn::gaussians::Gaussians;

/// Gaussians that lie together.
#[derive(Debug)]
struct Group {
    center_m: Vec3,
    /// Of the groups inside, or of the Gaussians.
    members: Range<usize>,
}

/// Copies of what a ping needs to know of each Gaussian, one array per number.
#[derive(Debug, Default)]
pub(crate) struct Field {
    tiles: Vec<Group>,
    blocks: Vec<Group>,
    tile_radius_m: f32,
    block_radius_m: f32,
    slots: Vec<u32>,
    /// Shape `[NUMBERS][Gaussians + LANES]`.
    numbers: [Vec<f32>; NUMBERS],
}

impl Field {
    /// Cost: a sort, then 16 numbers for each Gaussian held.
    pub(crate) fn of(evidence: &Evidence, gaussians: &Gaussians) -> Self {
        let place = |slot: usize| {
            let block = gaussians.home[slot].0;
            (evidence.tile_of(block), block, slot as u32)
        };
        let mut places: Vec<(TileIndex, BlockIndex, u32)> = gaussians.slots().map(place).collect();
        places.par_sort_unstable();
        let mut field = Self {
            tile_radius_m: evidence.tile_radius_m(),
            block_radius_m: evidence.block_radius_m(),
            slots: places.iter().map(|&(.., slot)| slot).collect(),
            ..Self::default()
        };
        for of_tile in places.chunk_by(|a, b| a.0 == b.0) {
            let first = field.blocks.len();
            for of_block in of_tile.chunk_by(|a, b| a.1 == b.1) {
                let start = field.blocks.last().map_or(0, |block| block.members.end);
                field.blocks.push(Group {
                    center_m: evidence.center_of(evidence.block(of_block[0].1)),
                    members: start..start + of_block.len(),
                });
            }
            field.tiles.push(Group {
                center_m: evidence.tiles()[of_tile[0].0 as usize].center_m,
                members: first..field.blocks.len(),
            });
        }
        field.copy(gaussians);
        field
    }

    fn copy(&mut self, gaussians: &Gaussians) {
        let slots = &self.slots;
        let triple = |which: usize, slot: usize| match which {
            0 => gaussians.mean_m[slot],
            1 => gaussians.covariance_m2[slot].diagonal,
            2 => gaussians.covariance_m2[slot].mixed,
            3 => gaussians.strength[slot].ahead,
            _ => gaussians.strength[slot].behind,
        };
        let triples = self.numbers.par_chunks_exact_mut(3).enumerate();
        triples.for_each(|(which, numbers)| {
            for numbers in &mut *numbers {
                numbers.reserve_exact(slots.len() + LANES);
            }
            for &slot in slots {
                let triple = triple(which, slot as usize).to_array();
                for (numbers, number) in numbers.iter_mut().zip(triple) {
                    numbers.push(number);
                }
            }
            // Eight at a time may read beyond the last.
            for numbers in numbers {
                numbers.resize(slots.len() + LANES, 0.0);
            }
        });
    }

    /// As [`echosplat_acoustics::packed`] has them, with room for eight from each Gaussian on.
    pub(crate) fn numbers(&self) -> &[Vec<f32>; NUMBERS] {
        &self.numbers
    }

    /// Slot of the Gaussian at each place of the arrays.
    pub(crate) fn slots(&self) -> &[u32] {
        &self.slots
    }

    /// Finds the places of the arrays that a fan may see, block by block.
    pub(crate) fn in_fan(&self, fan: &Fan, found: &mut Vec<Range<usize>>) {
        found.clear();
        for tile in &self.tiles {
            if !fan.touches(tile.center_m, self.tile_radius_m) {
                continue;
            }
            for block in &self.blocks[tile.members.clone()] {
                if fan.touches(block.center_m, self.block_radius_m) {
                    found.push(block.members.clone());
                }
            }
        }
    }
}
