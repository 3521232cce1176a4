//! The Gaussians of a pass side by side, block by block, as kernels read them.

use std::ops::Range;

use echosplat_measurement::heard::{Members, NUMBERS, Numbers, SHAPE_NUMBERS};
use echosplat_measurement::lanes::LANES;
use echosplat_model::glam::Vec3;
use rayon::prelude::*;

use crate::accumulate::evidence::{BlockIndex, Evidence, TileIndex};
use crate::accumulate::fan::Fan;
use crate::spawn::gaussians::Gaussians;

/// Sizes; bounds work.
/// Round Gaussians of more sizes than this are taken as shaped: a map has one, and its children.
const MOST_SIZES: usize = 4;

/// Blocks of a tile.
#[derive(Debug)]
struct OfTile {
    center_m: Vec3,
    blocks: Range<usize>,
}

/// Copies of what a ping needs to know of each Gaussian, one array per number. Those with shapes come first.
#[derive(Debug, Default)]
pub(crate) struct Field {
    tiles: Vec<OfTile>,
    /// Gaussians of a block, and which size they have, [`MOST_SIZES`] if they are shaped.
    blocks: Vec<(Members, usize)>,
    tile_radius_m: f32,
    block_radius_m: f32,
    slots: Vec<u32>,
    /// How many have shapes.
    shaped: usize,
    /// One sigma of round Gaussians of each size.
    sizes_m: Vec<f32>,
    /// Shape `[NUMBERS][Gaussians + LANES]`.
    numbers: [Vec<f32>; NUMBERS],
    /// Shape `[SHAPE_NUMBERS][shaped Gaussians + LANES]`.
    shapes: [Vec<f32>; SHAPE_NUMBERS],
}

impl Field {
    /// Cost: a sort, then some ten numbers for each Gaussian held; [`Self::renew`] has no sort.
    pub(crate) fn of(evidence: &Evidence, gaussians: &Gaussians) -> Self {
        Self::of_these(evidence, gaussians, gaussians.slots())
    }

    /// Of some alone.
    pub(crate) fn of_these(
        evidence: &Evidence,
        gaussians: &Gaussians,
        slots: impl Iterator<Item = usize>,
    ) -> Self {
        let mut sizes_m: Vec<f32> = Vec::new();
        let mut size_of = |slot: usize| {
            let scale_m = gaussians.scale_m[slot];
            if scale_m.min_element().to_bits() != scale_m.max_element().to_bits() {
                return MOST_SIZES;
            }
            let bits = scale_m.x.to_bits();
            let known = sizes_m.iter().position(|size_m| size_m.to_bits() == bits);
            if known.is_none() && sizes_m.len() < MOST_SIZES {
                sizes_m.push(scale_m.x);
                return sizes_m.len() - 1;
            }
            known.unwrap_or(MOST_SIZES)
        };
        let place = |slot: usize| {
            let (block, size) = (gaussians.home[slot].0, size_of(slot));
            let is_round = size < MOST_SIZES;
            (is_round, evidence.tile_of(block), block, size, slot as u32)
        };
        let mut places: Vec<(bool, TileIndex, BlockIndex, usize, u32)> = slots.map(place).collect();
        places.par_sort_unstable();
        let mut field = Self {
            tile_radius_m: evidence.tile_radius_m(),
            block_radius_m: evidence.block_radius_m(),
            slots: places.iter().map(|&(.., slot)| slot).collect(),
            sizes_m,
            ..Self::default()
        };
        for of_tile in places.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let first = field.blocks.len();
            for of_block in of_tile.chunk_by(|a, b| (a.2, a.3) == (b.2, b.3)) {
                let start = field.blocks.last().map_or(0, |(block, _)| block.places.end);
                let members = Members {
                    places: start..start + of_block.len(),
                    center_m: evidence.center_of(evidence.block(of_block[0].2)),
                    radius_m: field.block_radius_m,
                    sigma_m: 0.0,
                };
                field.blocks.push((members, of_block[0].3));
            }
            field.tiles.push(OfTile {
                center_m: evidence.tiles()[of_tile[0].1 as usize].center_m,
                blocks: first..field.blocks.len(),
            });
        }
        field.shaped = places.partition_point(|&(is_round, ..)| !is_round);
        field.renew(evidence, gaussians, true);
        field
    }

    /// Copies what the Gaussians are now, of those that are alive still; none may have come or changed its size or its shape, and
    /// none its place unless `has_moved`.
    pub(crate) fn renew(&mut self, evidence: &Evidence, gaussians: &Gaussians, has_moved: bool) {
        let has_moved = self.let_go(gaussians) || has_moved;
        let slots = &self.slots;
        let fill = |numbers: &mut [Vec<f32>], slots: &[u32], triple: &dyn Fn(usize) -> Vec3| {
            for numbers in &mut *numbers {
                // Eight at a time may read beyond the last.
                numbers.resize(slots.len() + LANES, 0.0);
            }
            let [x, y, z] = numbers else { return };
            for (place, &slot) in slots.iter().enumerate() {
                [x[place], y[place], z[place]] = triple(slot as usize).to_array();
            }
        };
        let triples = self.numbers.par_chunks_exact_mut(3).enumerate();
        triples.for_each(|(which, numbers)| match which {
            0 if !has_moved => {}
            0 => fill(numbers, slots, &|slot| gaussians.mean_m[slot]),
            1 => fill(numbers, slots, &|slot| gaussians.strength[slot].ahead),
            _ => fill(numbers, slots, &|slot| gaussians.strength[slot].behind),
        });
        if !has_moved {
            return;
        }
        let shaped = &slots[..self.shaped];
        for (which, numbers) in self.shapes.chunks_exact_mut(3).enumerate() {
            fill(numbers, shaped, &|slot| match which {
                0 => gaussians.covariance_m2[slot].diagonal,
                _ => gaussians.covariance_m2[slot].mixed,
            });
        }
        let radius_m = evidence.block_radius_m();
        self.blocks
            .par_iter_mut()
            .with_min_len(64)
            .for_each(|(members, _)| {
                (members.radius_m, members.sigma_m) = (radius_m, 0.0);
                for &slot in &slots[members.places.clone()] {
                    let (mean_m, scale_m) = (
                        gaussians.mean_m[slot as usize],
                        gaussians.scale_m[slot as usize],
                    );
                    members.radius_m = members.radius_m.max(mean_m.distance(members.center_m));
                    members.sigma_m = members.sigma_m.max(scale_m.max_element());
                }
            });
    }

    /// Lets go of those that are no more; whether there are any.
    fn let_go(&mut self, gaussians: &Gaussians) -> bool {
        let is_alive = |slot: u32| gaussians.alive[slot as usize];
        if self.slots.iter().all(|&slot| is_alive(slot)) {
            return false;
        }
        let mut kept = 0;
        for (members, _) in &mut self.blocks {
            let places = members.places.clone();
            members.places.start = kept;
            for place in places {
                let slot = self.slots[place];
                if is_alive(slot) {
                    self.slots[kept] = slot;
                    kept += 1;
                }
            }
            members.places.end = kept;
        }
        let is_shaped = |(_, size): &(Members, usize)| *size == MOST_SIZES;
        let shaped = self.blocks.iter().rev().find(|block| is_shaped(block));
        self.shaped = shaped.map_or(0, |(members, _)| members.places.end);
        self.slots.truncate(kept);
        true
    }

    /// As [`echosplat_measurement::heard`] has them, with room for eight from each Gaussian on.
    pub(crate) fn numbers(&self) -> Numbers<'_> {
        Numbers {
            all: &self.numbers,
            shapes: &self.shapes,
            sizes_m: &self.sizes_m,
        }
    }

    /// Slot of the Gaussian at each place of the arrays.
    pub(crate) fn slots(&self) -> &[u32] {
        &self.slots
    }

    pub(crate) fn block_count(&self) -> usize {
        self.blocks.len()
    }

    /// Places of the Gaussians of a block.
    pub(crate) fn places(&self, block: usize) -> Range<usize> {
        self.blocks[block].0.places.clone()
    }

    /// Gaussians of a block, and which of [`Numbers::sizes_m`] they have, none where they are shaped.
    pub(crate) fn block(&self, block: u32) -> (&Members, usize) {
        let (members, size) = &self.blocks[block as usize];
        (members, (*size).min(self.sizes_m.len()))
    }

    /// Of some blocks their numbers and what [`Self::block`] tells.
    pub(crate) fn members_of<'a>(
        &'a self,
        blocks: &'a [u32],
    ) -> impl Iterator<Item = (u32, &'a Members, usize)> {
        blocks.iter().map(|&block| {
            let (members, size) = self.block(block);
            (block, members, size)
        })
    }

    /// Finds the blocks that a fan may see.
    pub(crate) fn in_fan(&self, fan: &Fan, found: &mut Vec<u32>) {
        found.clear();
        for tile in &self.tiles {
            if !fan.touches(tile.center_m, self.tile_radius_m) {
                continue;
            }
            for block in tile.blocks.clone() {
                let members = &self.blocks[block].0;
                let is_empty = members.places.is_empty();
                if !is_empty && fan.touches(members.center_m, self.block_radius_m) {
                    found.push(block as u32);
                }
            }
        }
    }
}
