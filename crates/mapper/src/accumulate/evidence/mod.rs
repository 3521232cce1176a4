//! Evidence of presence per place: a sparse grid of voxels around whatever was ever lit.
//!
//! Each look adds a log likelihood ratio to every voxel in its beam: for an echo at the voxel's
//! range, against darkness there. Looks are weighted by what they say that the one before did
//! not, so that the sum counts views rather than pings.
//!
//! Cost: pings/s × blocks in the slice (about 150 at 10 m and 5 cm voxels) × 512 voxels, of
//! which rows off the beam are passed over: 63,000 voxel looks a ping on the fence's survey.

mod block;

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use echosplat_acoustics::Look;
use echosplat_model::glam::{IVec3, Vec3};
use rayon::prelude::*;

use crate::accumulate::history::Past;
use crate::parts::Extent;
pub(crate) use block::{Block, Horizon, Sums};

/// Voxels along the edge of a block, and blocks along the edge of a tile.
pub(crate) const BLOCK_EDGE: i32 = 8;
pub(crate) const VOXELS: usize = 512;
const TILE_EDGE: i32 = 8;
/// Index of a block in [`Evidence`].
pub(crate) type BlockIndex = u32;
/// Index of a tile in [`Evidence`].
pub(crate) type TileIndex = u32;

/// A cube of blocks, which is worked out as a whole.
#[derive(Debug)]
pub(crate) struct Tile {
    pub(crate) center_m: Vec3,
    pub(crate) blocks: Vec<BlockIndex>,
    /// Independent looks at it of the remembered pings that heard anything.
    pub(crate) looks: f32,
    /// Of these, those that its Gaussians were last worked out from.
    pub(crate) worked_looks: f32,
    /// Of these, those of the last time that they were worked out anew, not from the map.
    pub(crate) even_looks: f32,
}

/// The grid.
#[derive(Debug)]
pub(crate) struct Evidence {
    voxel_m: f32,
    blocks: Vec<Block>,
    /// Whose evidence changed since last asked, by block.
    touched: Vec<bool>,
    block_at: HashMap<IVec3, BlockIndex>,
    /// Of each block, its tile.
    tile_of: Vec<TileIndex>,
    tiles: Vec<Tile>,
    tile_at: HashMap<IVec3, usize>,
}

impl Evidence {
    pub(crate) fn new(voxel_m: f32) -> Self {
        Self {
            voxel_m,
            blocks: Vec::new(),
            touched: Vec::new(),
            block_at: HashMap::new(),
            tile_of: Vec::new(),
            tiles: Vec::new(),
            tile_at: HashMap::new(),
        }
    }

    pub(crate) fn voxel_m(&self) -> f32 {
        self.voxel_m
    }

    pub(crate) fn block_count(&self) -> usize {
        self.blocks.len()
    }

    pub(crate) fn block(&self, index: BlockIndex) -> &Block {
        &self.blocks[index as usize]
    }

    pub(crate) fn block_mut(&mut self, index: BlockIndex) -> &mut Block {
        &mut self.blocks[index as usize]
    }

    /// Evidence for each voxel of a block over all sides, and the most of any.
    pub(crate) fn of(&self, block: &Block, sides: Horizon) -> (Sums, f32) {
        let sums = block.evidence(sides);
        (sums, sums.into_iter().fold(f32::MIN, f32::max))
    }

    /// Centre of a voxel of a block.
    pub(crate) fn center_m(&self, key: IVec3, voxel: usize) -> Vec3 {
        let corner = key * BLOCK_EDGE;
        let offset = IVec3::new(
            (voxel % 8) as i32,
            (voxel / 8 % 8) as i32,
            (voxel / 64) as i32,
        );
        ((corner + offset).as_vec3() + 0.5) * self.voxel_m
    }

    /// Takes in a slice of looks, the newest of `history`: new blocks along their lit arcs, which
    /// are told of every remembered ping, and evidence in the blocks there were. Returns voxel
    /// looks done, the work.
    pub(crate) fn integrate(
        &mut self,
        history: &[Arc<Past>],
        slice_start: usize,
        extent: Extent,
    ) -> u64 {
        let known = self.blocks.len();
        for key in self.wanted(&history[slice_start..]) {
            self.create(key);
        }
        let slice = &history[slice_start..];
        let voxel_m = self.voxel_m;
        let near = self.near(slice);
        self.blocks
            .par_iter_mut()
            .zip(&mut self.touched)
            .zip(near)
            .enumerate()
            .with_min_len(16)
            .map(|(index, ((block, touched), near))| {
                let pings = match (index >= known, near) {
                    (true, _) => history,
                    (false, true) => slice,
                    (false, false) => return 0,
                };
                let work = block.integrate(pings, voxel_m, extent);
                *touched |= work > 0;
                work
            })
            .sum()
    }

    /// Forgets all evidence and takes in every ping again. Returns voxel looks done.
    pub(crate) fn integrate_anew(&mut self, history: &[Arc<Past>], extent: Extent) -> u64 {
        for key in self.wanted(history) {
            self.create(key);
        }
        let voxel_m = self.voxel_m;
        self.touched.fill(true);
        let blocks = self.blocks.par_iter_mut().with_min_len(16);
        blocks
            .map(|block| {
                block.forget();
                block.integrate(history, voxel_m, extent)
            })
            .sum()
    }

    /// Blocks that any look of the slice may see, through the tiles, which count their looks.
    fn near(&mut self, slice: &[Arc<Past>]) -> Vec<bool> {
        let radius_m = self.tile_radius_m();
        let mut near = vec![false; self.blocks.len()];
        for tile in &mut self.tiles {
            let touching = slice
                .iter()
                .filter(|past| past.fan.touches(tile.center_m, radius_m));
            let mut is_near = false;
            for past in touching {
                is_near = true;
                if !past.profile.echoes.is_empty() {
                    tile.looks += past.weight;
                }
            }
            if is_near {
                for &block in &tile.blocks {
                    near[block as usize] = true;
                }
            }
        }
        near
    }

    /// Pings that are no longer remembered.
    pub(crate) fn forget(&mut self, pings: &[Arc<Past>]) {
        let radius_m = self.tile_radius_m();
        for past in pings.iter().filter(|past| !past.profile.echoes.is_empty()) {
            for tile in &mut self.tiles {
                if past.fan.touches(tile.center_m, radius_m) {
                    tile.looks = (tile.looks - past.weight).max(0.0);
                }
            }
        }
    }

    pub(crate) fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    pub(crate) fn tile_mut(&mut self, index: TileIndex) -> &mut Tile {
        &mut self.tiles[index as usize]
    }

    pub(crate) fn tile_of(&self, block: BlockIndex) -> TileIndex {
        self.tile_of[block as usize]
    }

    /// Makes every tile be worked out again.
    pub(crate) fn doubt_all(&mut self) {
        for tile in &mut self.tiles {
            tile.worked_looks = 0.0;
            tile.even_looks = 0.0;
        }
    }

    pub(crate) fn center_of(&self, block: &Block) -> Vec3 {
        block.center_m(self.voxel_m)
    }

    /// Of the sphere around a block.
    pub(crate) fn block_radius_m(&self) -> f32 {
        0.5 * 3f32.sqrt() * self.voxel_m * BLOCK_EDGE as f32
    }

    /// Of the sphere around a tile.
    pub(crate) fn tile_radius_m(&self) -> f32 {
        self.block_radius_m() * TILE_EDGE as f32
    }

    /// Takes the blocks touched since last asked, in order of index.
    pub(crate) fn take_touched(&mut self) -> Vec<BlockIndex> {
        let touched = self.touched.iter_mut().enumerate();
        touched
            .filter_map(|(index, touched)| std::mem::take(touched).then_some(index as BlockIndex))
            .collect()
    }

    /// Blocks that the lit arcs of a slice pass through and that do not exist, in order.
    fn wanted(&self, slice: &[Arc<Past>]) -> BTreeSet<[i32; 3]> {
        let block_m = self.voxel_m * BLOCK_EDGE as f32;
        let mut wanted = BTreeSet::new();
        for past in slice {
            for &(start, end) in &past.profile.echoes {
                let steps =
                    ((end - start) as f32 * past.look.bin_length_m / (0.5 * block_m)).ceil();
                for step in 0..=steps as u32 {
                    let bin = start as f32 + (end - start) as f32 * step as f32 / steps.max(1.0);
                    let range_m = past.look.range_start_m + bin * past.look.bin_length_m;
                    arc_points(&past.look, range_m, 0.5 * block_m, |point_m| {
                        let key = (point_m / block_m).floor().as_ivec3();
                        if !self.block_at.contains_key(&key) {
                            wanted.insert([key.z, key.y, key.x]);
                        }
                    });
                }
            }
        }
        wanted
    }

    fn create(&mut self, [z, y, x]: [i32; 3]) {
        let key = IVec3::new(x, y, z);
        let index = self.blocks.len() as BlockIndex;
        self.blocks.push(Block::new(key));
        self.touched.push(true);
        self.block_at.insert(key, index);
        let tile_key = key.div_euclid(IVec3::splat(TILE_EDGE));
        let tile_m = self.voxel_m * (BLOCK_EDGE * TILE_EDGE) as f32;
        let tile = *self.tile_at.entry(tile_key).or_insert_with(|| {
            self.tiles.push(Tile {
                center_m: (tile_key.as_vec3() + 0.5) * tile_m,
                blocks: Vec::new(),
                looks: 0.0,
                worked_looks: 0.0,
                even_looks: 0.0,
            });
            self.tiles.len() - 1
        });
        self.tiles[tile].blocks.push(index);
        self.tile_of.push(tile as TileIndex);
    }
}

/// Points on the arc at `range_m`, a beam's width to both sides included, at most `step_m` apart
/// along it.
fn arc_points(look: &Look, range_m: f32, step_m: f32, mut each: impl FnMut(Vec3)) {
    let half = look.beam.elevation_half_width_rad();
    let steps = (2.0 * half * range_m / step_m).ceil().max(1.0) as u32;
    let side_m = look.beam.azimuth_sigma_rad() * range_m;
    let axes = look.pose.axes;
    for step in 0..=steps {
        let elevation = half * (2.0 * step as f32 / steps as f32 - 1.0);
        let (sin, cos) = elevation.sin_cos();
        for side in [-side_m, 0.0, side_m] {
            let q = Vec3::new(range_m * cos, side, range_m * sin);
            each(look.pose.position_m + axes * q);
        }
    }
}
