//! Counts per voxel, kept where anything was ever seen.

use std::collections::HashMap;

use glam::{DVec3, IVec3};

/// Voxels along the edge of a block, as a power of two.
const EDGE_BITS: i32 = 3;
const BLOCK_VOXELS: usize = 1 << (3 * EDGE_BITS);
/// Bounds memory: 4 KiB a block.
const BLOCKS_MAX: usize = 1 << 16;

/// What was seen of one voxel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Voxel {
    /// Whether it lies on any echo's arc.
    pub(super) is_on_arc: bool,
    /// Pings that found it lit.
    pub(super) hits: u16,
    /// Pings that found it dark.
    pub(super) misses: u16,
    /// Counts pings from 1; each observes a voxel once.
    last_ping: u32,
}

/// Blocks of 8³ voxels.
pub(super) struct Voxels {
    edge_m: f64,
    index: HashMap<IVec3, usize>,
    blocks: Vec<(IVec3, Box<[Voxel; BLOCK_VOXELS]>)>,
    /// The block asked for last: neighbours in space are asked for in a row.
    newest: (IVec3, Option<usize>),
    dropped: u64,
}

impl Voxels {
    pub(super) fn new(edge_m: f64) -> Self {
        Self {
            edge_m,
            index: HashMap::new(),
            blocks: Vec::new(),
            newest: (IVec3::MAX, None),
            dropped: 0,
        }
    }

    /// Notes that a place lies on an echo's arc; without room for its block, that is counted.
    pub(super) fn put_on_arc(&mut self, place_m: DVec3) {
        let (block, voxel) = self.cell_of(place_m);
        let found = self.block_at(block).or_else(|| self.add_block(block));
        match found {
            Some(index) => self.blocks[index].1[voxel].is_on_arc = true,
            None => self.dropped += 1,
        }
    }

    /// Counts an observation by ping `ping`, from 1, of a place on some arc; others are not kept.
    pub(super) fn observe(&mut self, place_m: DVec3, ping: u32, is_lit: bool) {
        let (block, voxel) = self.cell_of(place_m);
        let Some(index) = self.block_at(block) else {
            return;
        };
        let voxel = &mut self.blocks[index].1[voxel];
        if !voxel.is_on_arc || voxel.last_ping == ping {
            return;
        }
        voxel.last_ping = ping;
        let count = if is_lit {
            &mut voxel.hits
        } else {
            &mut voxel.misses
        };
        *count = count.saturating_add(1);
    }

    /// Centres of the voxels for which `holds`, in the order in which their blocks were made.
    pub(super) fn centers(&self, holds: impl Fn(&Voxel) -> bool) -> Vec<DVec3> {
        let mut centers = Vec::new();
        for (block, voxels) in &self.blocks {
            for (index, voxel) in voxels.iter().enumerate() {
                if holds(voxel) {
                    centers.push(self.center_m(*block, index));
                }
            }
        }
        centers
    }

    /// Places that found no room.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped
    }

    fn cell_of(&self, place_m: DVec3) -> (IVec3, usize) {
        let cell = (place_m / self.edge_m).floor().as_ivec3();
        let within = cell & ((1 << EDGE_BITS) - 1);
        let voxel = within.x | (within.y << EDGE_BITS) | (within.z << (2 * EDGE_BITS));
        (cell >> EDGE_BITS, voxel as usize)
    }

    fn center_m(&self, block: IVec3, voxel: usize) -> DVec3 {
        let mask = (1 << EDGE_BITS) - 1;
        let bits = voxel as i32;
        let within = IVec3::new(bits, bits >> EDGE_BITS, bits >> (2 * EDGE_BITS)) & mask;
        let cell = (block << EDGE_BITS) + within;
        (cell.as_dvec3() + 0.5) * self.edge_m
    }

    fn block_at(&mut self, block: IVec3) -> Option<usize> {
        if self.newest.0 != block {
            self.newest = (block, self.index.get(&block).copied());
        }
        self.newest.1
    }

    fn add_block(&mut self, block: IVec3) -> Option<usize> {
        let next = self.blocks.len();
        if next >= BLOCKS_MAX {
            return None;
        }
        let empty = Box::new([Voxel::default(); BLOCK_VOXELS]);
        self.blocks.push((block, empty));
        self.index.insert(block, next);
        self.newest = (block, Some(next));
        Some(next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ping_observes_a_voxel_once_and_only_on_arcs() {
        let mut voxels = Voxels::new(0.1);
        let place_m = DVec3::new(-0.05, 1.23, -7.91);
        voxels.observe(place_m, 1, true);
        voxels.put_on_arc(place_m);
        for (ping, is_lit) in [(1, true), (1, true), (2, false), (3, true)] {
            voxels.observe(place_m, ping, is_lit);
        }
        voxels.observe(place_m + 0.1, 4, true);
        let centers = voxels.centers(|voxel| (voxel.hits, voxel.misses) == (2, 1));
        assert_eq!(centers.len(), 1);
        assert!((centers[0] - place_m).abs().max_element() <= 0.05 + 1e-9);
        assert_eq!(voxels.dropped(), 0);
    }
}
