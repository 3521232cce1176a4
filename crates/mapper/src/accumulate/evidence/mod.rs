//! Evidence of presence per place: a sparse grid of voxels around whatever was ever lit.
//!
//! Each ping adds a log likelihood ratio, its observation, to every voxel in its beam: for an echo at the voxel's range,
//! against darkness there. Observations are weighted by what they say that the ping before did not, so that the sum
//! counts views rather than pings.
//!
//! Cost: pings/s × blocks in the slice (about 150 at 10 m and 5 cm voxels) × 512 voxels, of which rows off the beam are
//! passed over: 58,000 voxel observations a ping on the fence's survey.

mod block;
mod packed;
mod sector;

use std::collections::BTreeSet;
use std::sync::Arc;

use echosplat_measurement::PingGeometry;
use echosplat_model::glam::{IVec3, Vec3};
use foldhash::{HashMap, HashMapExt};
use rayon::prelude::*;

use crate::accumulate::fan::Reach;
use crate::accumulate::history::{History, Keyframe};
use crate::features::Extent;
use crate::progress::Progress;
pub(crate) use block::{Block, SectorWidth, Sums};

/// Voxels along a block; layout.
/// Voxels along the edge of a block, and blocks along the edge of a tile.
pub(crate) const BLOCK_EDGE: i32 = 8;
/// Voxels of a block; layout.
pub(crate) const VOXELS: usize = 512;
/// Blocks along a tile; layout.
const TILE_EDGE: i32 = 8;
/// Blocks a slice; bounds work.
/// Blocks of which each slice lays away what had no observations: few, so that azimuth sectors are not taken up again the
/// next moment.
const LAID_AWAY: usize = 16;
/// Divisor of a count; bounds memory.
/// What there is over this is the room for more: twice as much room would leave half of the memory of a large map
/// unused.
const SPARE_DIVISOR: usize = 8;
/// Room at least; bounds memory.
const LEAST_SPARE: usize = 64;
/// Index of a block in [`Evidence`].
pub(crate) type BlockIndex = u32;
/// Index of a tile in [`Evidence`].
pub(crate) type TileIndex = u32;

/// Room for so many more once `count` of something fill theirs.
pub(crate) fn spare(count: usize) -> usize {
    count / SPARE_DIVISOR + LEAST_SPARE
}

/// A cube of blocks, which is worked out as a whole.
#[derive(Debug)]
pub(crate) struct Tile {
    pub(crate) center_m: Vec3,
    pub(crate) blocks: Vec<BlockIndex>,
    /// Independent observations of it by all pings that heard anything.
    pub(crate) observations: f32,
    /// Of these observations, those of forgotten pings.
    pub(crate) forgotten_observations: f32,
    /// Observations there had been when its Gaussians were last worked out.
    pub(crate) worked_observations: f32,
    /// Observations there had been when they were last worked out anew, not from the map.
    pub(crate) even_observations: f32,
    /// Remembered pings with echoes that may see it.
    remembered_pings: u32,
    /// Whether it keeps only what its Gaussians need.
    is_left: bool,
}

impl Tile {
    /// Counts the observations of some pings; whether any may see it.
    fn count_observations<'a>(
        &mut self,
        pings: impl IntoIterator<Item = &'a Arc<Keyframe>>,
        radius_m: f32,
    ) -> bool {
        let mut is_near = false;
        for keyframe in pings {
            if !keyframe.fan.touches(self.center_m, radius_m) {
                continue;
            }
            is_near = true;
            if !keyframe.profile.echoes.is_empty() {
                self.observations += keyframe.weight;
                self.remembered_pings += 1;
                self.is_left = false;
            }
        }
        is_near
    }
}

/// The grid.
#[derive(Debug)]
pub(crate) struct Evidence {
    voxel_m: f32,
    blocks: Vec<Block>,
    /// Whose evidence changed since last asked.
    touched: BTreeSet<BlockIndex>,
    block_at: HashMap<IVec3, BlockIndex>,
    /// Of each block, its tile.
    tile_of: Vec<TileIndex>,
    tiles: Vec<Tile>,
    tile_at: HashMap<IVec3, usize>,
    /// Indices of blocks that are no more.
    free: Vec<BlockIndex>,
    /// The next of the blocks that is asked to lay away azimuth sectors, in turn.
    next_laid_away: usize,
    /// Remembered pings that it was told of, the oldest ones.
    told_pings: usize,
}

impl Evidence {
    pub(crate) fn new(voxel_m: f32) -> Self {
        Self {
            voxel_m,
            blocks: Vec::new(),
            touched: BTreeSet::new(),
            block_at: HashMap::new(),
            tile_of: Vec::new(),
            tiles: Vec::new(),
            tile_at: HashMap::new(),
            free: Vec::new(),
            next_laid_away: 0,
            told_pings: 0,
        }
    }

    pub(crate) fn voxel_m(&self) -> f32 {
        self.voxel_m
    }

    pub(crate) fn block_count(&self) -> usize {
        self.blocks.len() - self.free.len()
    }

    pub(crate) fn block(&self, index: BlockIndex) -> &Block {
        &self.blocks[index as usize]
    }

    pub(crate) fn block_mut(&mut self, index: BlockIndex) -> &mut Block {
        &mut self.blocks[index as usize]
    }

    /// Evidence for each voxel of a block over all azimuth sectors, and the most of any.
    pub(crate) fn of(&self, block: &Block, width: SectorWidth) -> (Sums, f32) {
        let sums = block.evidence(width);
        (sums, sums.into_iter().fold(f32::MIN, f32::max))
    }

    /// Centre of a voxel of a block, z fastest.
    pub(crate) fn center_m(&self, key: IVec3, voxel: usize) -> Vec3 {
        let corner = key * BLOCK_EDGE;
        let offset = IVec3::new(
            (voxel / 64) as i32,
            (voxel / 8 % 8) as i32,
            (voxel % 8) as i32,
        );
        ((corner + offset).as_vec3() + 0.5) * self.voxel_m
    }

    /// Remembered pings that it was not told of yet.
    pub(crate) fn untold_pings(&self, history: &History) -> usize {
        history.pings().len() - self.told_pings
    }

    /// Takes in a slice of pings, at most so many of those it was not told of yet: new blocks along their lit arcs, which
    /// are told of every ping before as well, and evidence in the blocks there were. Returns voxel observations made, the
    /// work.
    pub(crate) fn integrate(&mut self, history: &History, most: usize, extent: Extent) -> u64 {
        let slice_start = self.told_pings;
        self.told_pings += most.min(self.untold_pings(history));
        let told_pings = self.told_pings;
        let slice = &history.pings()[slice_start..told_pings];
        let known = self.tiles.len();
        let wanted = self.wanted(slice).into_iter();
        let fresh: BTreeSet<BlockIndex> = wanted.map(|key| self.create(key)).collect();
        self.count_observations(known, history, slice_start);
        let mut near = self.near(slice);
        near.extend(&fresh);
        near.sort_unstable();
        near.dedup();
        // Only these are gone through, however large the map.
        let blocks = blocks_at(&mut self.blocks, &near);
        let voxel_m = self.voxel_m;
        let tell = |(index, block): (BlockIndex, &mut Block)| match fresh.contains(&index) {
            true => block.integrate_all(history, told_pings, voxel_m, extent),
            false => block.integrate(slice, voxel_m, extent),
        };
        let blocks = blocks.into_par_iter().with_min_len(16);
        let observations: Vec<u64> = blocks.map(tell).collect();
        let told = near.into_iter().zip(&observations);
        self.touched.extend(
            told.filter(|(_, observations)| **observations > 0)
                .map(|(index, _)| index),
        );
        self.lay_away();
        observations.iter().sum()
    }

    /// Some of the blocks in turn hold azimuth sectors in fewer bytes that had no observation since it was their turn
    /// last.
    fn lay_away(&mut self) {
        let count = self.blocks.len();
        for _ in 0..LAID_AWAY.min(count) {
            self.next_laid_away = (self.next_laid_away + 1) % count;
            self.blocks[self.next_laid_away].lay_away();
        }
    }

    /// Forgets all evidence and takes in every ping again. Returns voxel observations made.
    pub(crate) fn integrate_anew(
        &mut self,
        history: &History,
        extent: Extent,
        progress: &Progress,
    ) -> u64 {
        let known = self.tiles.len();
        for key in self.wanted(history.pings()) {
            self.create(key);
        }
        self.told_pings = history.pings().len();
        let (voxel_m, told_pings) = (self.voxel_m, self.told_pings);
        self.count_observations(known, history, told_pings);
        self.touched.extend(0..self.blocks.len() as BlockIndex);
        let blocks = self.blocks.par_iter_mut().with_min_len(16);
        blocks
            .map(|block| {
                progress.tell();
                block.forget();
                let observations = block.integrate_all(history, told_pings, voxel_m, extent);
                // Once for sectors with observations, and once for good.
                block.lay_away();
                block.lay_away();
                observations
            })
            .sum()
    }

    /// Forgets what all observations said and keeps the Gaussians: nothing can be worked out any more.
    pub(crate) fn forget_observations(&mut self) {
        self.blocks.iter_mut().for_each(Block::forget);
    }

    /// Blocks that any ping of the slice may see, through the tiles, which count their observations.
    fn near(&mut self, slice: &[Arc<Keyframe>]) -> Vec<BlockIndex> {
        let radius_m = self.tile_radius_m();
        let mut near = Vec::new();
        let reach = Reach::of(slice.iter().map(|keyframe| &keyframe.fan));
        for tile in &mut self.tiles {
            if reach.touches(tile.center_m, radius_m) && tile.count_observations(slice, radius_m) {
                near.extend(&tile.blocks);
            }
        }
        near
    }

    /// Counts what the first `count` pings saw of tiles that are new, from `first` on.
    fn count_observations(&mut self, first: usize, history: &History, count: usize) {
        let radius_m = self.tile_radius_m();
        for tile in &mut self.tiles[first..] {
            tile.count_observations(history.near(count, tile.center_m, radius_m), radius_m);
        }
    }

    /// Pings that are no longer remembered; it was told of them.
    pub(crate) fn forget(&mut self, pings: &[Arc<Keyframe>]) {
        self.told_pings -= pings.len();
        let radius_m = self.tile_radius_m();
        let has_echoes = |keyframe: &&Arc<Keyframe>| !keyframe.profile.echoes.is_empty();
        let pings: Vec<&Arc<Keyframe>> = pings.iter().filter(has_echoes).collect();
        let reach = Reach::of(pings.iter().map(|keyframe| &keyframe.fan));
        for tile in &mut self.tiles {
            if !reach.touches(tile.center_m, radius_m) {
                continue;
            }
            for keyframe in &pings {
                if keyframe.fan.touches(tile.center_m, radius_m) {
                    tile.forgotten_observations += keyframe.weight;
                    tile.remembered_pings = tile.remembered_pings.saturating_sub(1);
                }
            }
        }
    }

    /// Slots of the Gaussians of all tiles that any of the pings may see, in order.
    pub(crate) fn gaussians_seen_by(&self, pings: &[Arc<Keyframe>]) -> Vec<u32> {
        let radius_m = self.tile_radius_m();
        let reach = Reach::of(pings.iter().map(|keyframe| &keyframe.fan));
        let is_seen = |tile: &&Tile| {
            let touches = |keyframe: &Arc<Keyframe>| keyframe.fan.touches(tile.center_m, radius_m);
            reach.touches(tile.center_m, radius_m) && pings.iter().any(touches)
        };
        let blocks = self.tiles.iter().filter(is_seen).flat_map(|t| &t.blocks);
        let gaussians = blocks.flat_map(|&block| &self.block(block).gaussians);
        let mut slots: Vec<u32> = gaussians.map(|&(_, slot)| slot).collect();
        slots.sort_unstable();
        slots
    }

    /// Of tiles that no remembered ping sees any more, keeps only what is known of the places that hold Gaussians.
    /// Not while anything holds indices of blocks.
    pub(crate) fn leave(&mut self) {
        for index in 0..self.tiles.len() {
            let tile = &mut self.tiles[index];
            if tile.remembered_pings > 0 || tile.blocks.is_empty() || tile.is_left {
                continue;
            }
            tile.is_left = true;
            let blocks = std::mem::take(&mut tile.blocks);
            let (held, empty): (Vec<BlockIndex>, Vec<BlockIndex>) = blocks
                .into_iter()
                .partition(|&block| !self.blocks[block as usize].gaussians.is_empty());
            for &block in &held {
                self.blocks[block as usize].leave();
            }
            for block in empty {
                self.block_at.remove(&self.blocks[block as usize].key);
                self.blocks[block as usize] = Block::default();
                self.touched.remove(&block);
                self.free.push(block);
            }
            self.tiles[index].blocks = held;
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
            tile.worked_observations = 0.0;
            tile.even_observations = 0.0;
        }
    }

    pub(crate) fn center_of(&self, block: &Block) -> Vec3 {
        block.center_m(self.voxel_m)
    }

    /// Of the sphere around a block.
    pub(crate) fn block_radius_m(&self) -> f32 {
        block::radius_m(self.voxel_m)
    }

    /// Of the sphere around a tile.
    pub(crate) fn tile_radius_m(&self) -> f32 {
        self.block_radius_m() * TILE_EDGE as f32
    }

    /// Takes the blocks touched since last asked, in order of index.
    pub(crate) fn take_touched(&mut self) -> BTreeSet<BlockIndex> {
        std::mem::take(&mut self.touched)
    }

    /// Blocks that the lit arcs of a slice pass through and that do not exist, in order.
    fn wanted(&self, slice: &[Arc<Keyframe>]) -> BTreeSet<[i32; 3]> {
        let block_m = self.voxel_m * BLOCK_EDGE as f32;
        let mut wanted = BTreeSet::new();
        for keyframe in slice {
            for &(start, end) in &keyframe.profile.echoes {
                let steps = ((end - start) as f32 * keyframe.geometry.bin_length_m
                    / (0.5 * block_m))
                    .ceil();
                for step in 0..=steps as u32 {
                    let bin = start as f32 + (end - start) as f32 * step as f32 / steps.max(1.0);
                    let range_m =
                        keyframe.geometry.range_start_m + bin * keyframe.geometry.bin_length_m;
                    arc_points(&keyframe.geometry, range_m, 0.5 * block_m, |point_m| {
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

    fn create(&mut self, [z, y, x]: [i32; 3]) -> BlockIndex {
        let key = IVec3::new(x, y, z);
        let index = self.free.pop().unwrap_or_else(|| {
            if self.blocks.len() == self.blocks.capacity() {
                self.blocks.reserve_exact(spare(self.blocks.len()));
            }
            self.blocks.push(Block::default());
            self.tile_of.push(0);
            self.blocks.len() as BlockIndex - 1
        });
        self.blocks[index as usize] = Block::new(key);
        self.touched.insert(index);
        self.block_at.insert(key, index);
        let tile_key = key.div_euclid(IVec3::splat(TILE_EDGE));
        let tile_m = self.voxel_m * (BLOCK_EDGE * TILE_EDGE) as f32;
        let tile = *self.tile_at.entry(tile_key).or_insert_with(|| {
            self.tiles.push(Tile {
                center_m: (tile_key.as_vec3() + 0.5) * tile_m,
                blocks: Vec::new(),
                observations: 0.0,
                forgotten_observations: 0.0,
                remembered_pings: 0,
                is_left: false,
                worked_observations: 0.0,
                even_observations: 0.0,
            });
            self.tiles.len() - 1
        });
        self.tiles[tile].blocks.push(index);
        self.tile_of[index as usize] = tile as TileIndex;
        index
    }
}

/// Points on the arc at `range_m`, a beam's width to both sides included, at most `step_m` apart
/// along it.
fn arc_points(geometry: &PingGeometry, range_m: f32, step_m: f32, mut each: impl FnMut(Vec3)) {
    let half = geometry.beam.elevation_half_width_rad();
    let steps = (2.0 * half * range_m / step_m).ceil().max(1.0) as u32;
    let side_m = geometry.beam.azimuth_sigma_rad() * range_m;
    let axes = geometry.pose.axes;
    for step in 0..=steps {
        let elevation = half * (2.0 * step as f32 / steps as f32 - 1.0);
        let (sin, cos) = elevation.sin_cos();
        for side in [-side_m, 0.0, side_m] {
            let q = Vec3::new(range_m * cos, side, range_m * sin);
            each(geometry.pose.position_m + axes * q);
        }
    }
}

/// The blocks at indices that ascend.
fn blocks_at<'a>(
    blocks: &'a mut [Block],
    indices: &[BlockIndex],
) -> Vec<(BlockIndex, &'a mut Block)> {
    let (mut rest, mut next) = (blocks.iter_mut(), 0);
    let find = |&index: &BlockIndex| {
        let block = rest.nth((index - next) as usize)?;
        next = index + 1;
        Some((index, block))
    };
    indices.iter().filter_map(find).collect()
}
