//! Evidence of presence per place: a sparse grid of voxels around whatever was ever lit.
//!
//! Each look adds a log likelihood ratio to every voxel in its beam: for an echo at the voxel's
//! range, against darkness there. Looks are weighted by what they say that the one before did
//! not, so that the sum counts views rather than pings.
//!
//! Cost: pings/s × blocks in the slice (about 150 at 10 m and 5 cm voxels) × 512 voxels, of
//! which rows off the beam are passed over: about 20,000 voxel looks a ping.

use std::collections::{BTreeSet, HashMap};

use echosplat_acoustics::Look;
use echosplat_model::glam::{IVec3, Vec3};
use rayon::prelude::*;

use crate::history::Past;

/// Voxels along the edge of a block, and blocks along the edge of a tile.
pub(crate) const BLOCK_EDGE: i32 = 8;
pub(crate) const VOXELS: usize = 512;
const TILE_EDGE: i32 = 8;
/// Sides of a block that looks come from: east, west, north, south.
const SIDES: usize = 4;

/// Log likelihood ratio of a look on the beam's axis: an echo is seen from 95 % of looks at a
/// surface, and from about 57 % at a place that is only asked about because some arc of it was
/// lit: ln(0.95/0.57) and ln(0.05/0.43).
const LIT: f32 = 0.5;
const DARK: f32 = -2.15;
/// Darkness behind an echo may be its shadow.
const SHADOWED: f32 = 0.15 * DARK;
/// Beyond this many sigma from the axis a look says nothing clear.
const LOOK_SIGMAS_SQUARED: f32 = 1.4;
/// Places are found although the heading is off by this factor of variance: what a surface that
/// glints shows but once must not be lost to one bad pose.
const POSE_DOUBT: f32 = 6.0;
/// Darkness from one side weighs at most this much against what other sides saw.
const MOST_AGAINST: f32 = -2.0;
/// A block whose best voxel is this deep in darkness needs no more looks.
const SETTLED_EVIDENCE: f32 = -30.0;

const LANES: [f32; 8] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// Index of a block in [`Evidence`].
pub(crate) type BlockIndex = u32;

/// 8 × 8 × 8 voxels.
#[derive(Debug)]
pub(crate) struct Block {
    /// Position in units of blocks.
    pub(crate) key: IVec3,
    /// What was seen from each side.
    sides: [Side; SIDES],
    /// Slots of the Gaussians born here, by voxel.
    pub(crate) gaussians: Vec<(u16, u32)>,
    /// Voxels whose Gaussian was let go as the tail of a stronger one, a bit each.
    pub(crate) barred: [u64; VOXELS / 64],
    /// The most evidence of any voxel.
    pub(crate) best: f32,
    touched: bool,
}

/// Evidence of looks from one side: a structure seen from behind, where it hides itself, and one
/// that glints do not contradict their front.
#[derive(Debug, Default)]
enum Side {
    #[default]
    Unseen,
    /// Sum of log likelihood ratios per voxel, x fastest.
    Seen(Box<[f32; VOXELS]>),
    /// So dark everywhere that no more looks are needed and nothing need be remembered.
    Settled,
}

impl Side {
    fn is_settled(&self) -> bool {
        matches!(self, Self::Settled)
    }

    /// Sums per voxel, from nothing if it was unseen; `None` if settled.
    fn sums(&mut self) -> Option<&mut [f32; VOXELS]> {
        if let Self::Unseen = self {
            *self = Self::Seen(Box::new([0.0; VOXELS]));
        }
        match self {
            Self::Seen(sums) => Some(sums),
            _ => None,
        }
    }

    /// What a voxel counts together with the other sides: one that saw it dark, since the
    /// structure hides itself or glints elsewhere, contradicts them only so far.
    fn evidence(&self, voxel: usize) -> f32 {
        match self {
            Self::Unseen => 0.0,
            Self::Seen(sums) => sums[voxel].max(MOST_AGAINST),
            Self::Settled => MOST_AGAINST,
        }
    }

    /// Lets go of the sums when no place is left that could be anything.
    fn settle(&mut self) {
        if let Self::Seen(sums) = self {
            let best = sums.iter().copied().fold(f32::MIN, f32::max);
            if best < SETTLED_EVIDENCE {
                *self = Self::Settled;
            }
        }
    }
}

#[derive(Debug)]
struct Tile {
    center_m: Vec3,
    blocks: Vec<BlockIndex>,
}

/// The grid.
#[derive(Debug)]
pub(crate) struct Evidence {
    voxel_m: f32,
    blocks: Vec<Block>,
    block_at: HashMap<IVec3, BlockIndex>,
    tiles: Vec<Tile>,
    tile_at: HashMap<IVec3, usize>,
}

impl Evidence {
    pub(crate) fn new(voxel_m: f32) -> Self {
        Self {
            voxel_m,
            blocks: Vec::new(),
            block_at: HashMap::new(),
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

    /// Lets every place be a candidate again.
    pub(crate) fn lift_bars(&mut self) {
        for block in &mut self.blocks {
            if block.barred != [0; VOXELS / 64] {
                block.barred = [0; VOXELS / 64];
                block.touched = true;
            }
        }
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
    pub(crate) fn integrate(&mut self, history: &[Past], slice_start: usize) -> u64 {
        let known = self.blocks.len();
        for key in self.wanted(&history[slice_start..]) {
            self.create(key);
        }
        let slice = &history[slice_start..];
        let voxel_m = self.voxel_m;
        let touched = self.touched_by(slice);
        self.blocks
            .par_iter_mut()
            .zip(touched)
            .enumerate()
            .with_min_len(16)
            .map(|(index, (block, touched))| {
                if index >= known {
                    block.integrate(history, voxel_m)
                } else if touched {
                    block.integrate(slice, voxel_m)
                } else {
                    0
                }
            })
            .sum()
    }

    /// Forgets all evidence and takes in every ping again. Returns voxel looks done.
    pub(crate) fn integrate_anew(&mut self, history: &[Past]) -> u64 {
        for key in self.wanted(history) {
            self.create(key);
        }
        let voxel_m = self.voxel_m;
        let blocks = self.blocks.par_iter_mut().with_min_len(16);
        blocks
            .map(|block| {
                block.sides = Default::default();
                block.best = 0.0;
                block.touched = true;
                block.integrate(history, voxel_m)
            })
            .sum()
    }

    /// Blocks that any look of the slice may see, through the tiles.
    fn touched_by(&self, slice: &[Past]) -> Vec<bool> {
        let radius_m = 0.5 * 3f32.sqrt() * self.voxel_m * (BLOCK_EDGE * TILE_EDGE) as f32;
        let mut touched = vec![false; self.blocks.len()];
        for tile in &self.tiles {
            let near = slice
                .iter()
                .any(|past| past.fan.touches(tile.center_m, radius_m));
            if near {
                for &block in &tile.blocks {
                    touched[block as usize] = true;
                }
            }
        }
        touched
    }

    /// Tiles by their centres, with their blocks, in a fixed order.
    pub(crate) fn tiles(&self) -> impl Iterator<Item = (Vec3, impl Iterator<Item = &Block>)> {
        self.tiles.iter().map(|tile| {
            let blocks = tile.blocks.iter().map(|&index| self.block(index));
            (tile.center_m, blocks)
        })
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
        let mut indices = Vec::new();
        for (index, block) in self.blocks.iter_mut().enumerate() {
            if std::mem::take(&mut block.touched) {
                indices.push(index as BlockIndex);
            }
        }
        indices
    }

    /// Blocks that the lit arcs of a slice pass through and that do not exist, in order.
    fn wanted(&self, slice: &[Past]) -> BTreeSet<[i32; 3]> {
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
        self.blocks.push(Block {
            key,
            sides: Default::default(),
            gaussians: Vec::new(),
            barred: [0; VOXELS / 64],
            best: 0.0,
            touched: true,
        });
        self.block_at.insert(key, index);
        let tile_key = key.div_euclid(IVec3::splat(TILE_EDGE));
        let tile_m = self.voxel_m * (BLOCK_EDGE * TILE_EDGE) as f32;
        let tile = *self.tile_at.entry(tile_key).or_insert_with(|| {
            self.tiles.push(Tile {
                center_m: (tile_key.as_vec3() + 0.5) * tile_m,
                blocks: Vec::new(),
            });
            self.tiles.len() - 1
        });
        self.tiles[tile].blocks.push(index);
    }
}

/// The side a look comes from, by the direction towards its sensor.
fn side_of(towards_m: Vec3) -> usize {
    if towards_m.x.abs() > towards_m.y.abs() {
        usize::from(towards_m.x < 0.0)
    } else {
        2 + usize::from(towards_m.y < 0.0)
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

impl Block {
    pub(crate) fn is_barred(&self, voxel: usize) -> bool {
        self.barred[voxel / 64] >> (voxel % 64) & 1 == 1
    }

    /// Takes the Gaussian of a voxel away and lets none be born there until bars are lifted.
    pub(crate) fn bar(&mut self, voxel: u16, slot: u32) {
        self.gaussians.retain(|&(_, other)| other != slot);
        self.barred[usize::from(voxel) / 64] |= 1 << (voxel % 64);
    }

    fn center_m(&self, voxel_m: f32) -> Vec3 {
        (self.key.as_vec3() + 0.5) * (voxel_m * BLOCK_EDGE as f32)
    }

    /// Adds the evidence of `pings` in their order. Returns voxel looks done.
    fn integrate(&mut self, pings: &[Past], voxel_m: f32) -> u64 {
        let center_m = self.center_m(voxel_m);
        let radius_m = 0.5 * 3f32.sqrt() * voxel_m * BLOCK_EDGE as f32;
        let mut work = 0;
        for past in pings {
            if past.fan.touches(center_m, radius_m) {
                let side = side_of(past.look.pose.position_m - center_m);
                if !self.sides[side].is_settled() {
                    work += self.add(past, side, voxel_m);
                    self.touched = true;
                }
            }
        }
        if work > 0 {
            self.take_stock();
        }
        work
    }

    fn take_stock(&mut self) {
        for side in &mut self.sides {
            side.settle();
        }
        let voxels = (0..VOXELS).map(|voxel| self.evidence(voxel));
        self.best = voxels.fold(f32::MIN, f32::max);
    }

    /// Evidence for a voxel over all sides.
    pub(crate) fn evidence(&self, voxel: usize) -> f32 {
        self.sides.iter().map(|side| side.evidence(voxel)).sum()
    }

    /// Adds one look to every voxel in its beam.
    fn add(&mut self, past: &Past, side: usize, voxel_m: f32) -> u64 {
        let look = &past.look;
        let into_beam = look.pose.axes.transpose();
        let first_m = (self.key * BLOCK_EDGE).as_vec3() * voxel_m + 0.5 * voxel_m;
        let base = into_beam * (first_m - look.pose.position_m);
        let step = into_beam.x_axis * voxel_m;
        let sigma = look.beam.azimuth_sigma_rad();
        let beam_variance = sigma * sigma
            + look.azimuth_variance_rad2
            + POSE_DOUBT * past.blur.azimuth_variance_rad2;
        let voxel_variance_m2 = voxel_m * voxel_m / 12.0;
        let fan_tangent2 = (0.92 * look.beam.elevation_half_width_rad()).tan().powi(2);
        let per_bin = 1.0 / look.bin_length_m;
        let drift = look.pose.drift_per_m;
        let gain = [0.0, DARK, LIT, SHADOWED].map(|ratio| ratio * past.weight);
        let Some(evidence) = self.sides[side].sums() else {
            return 0;
        };
        let mut work = 0;
        for row in 0..64 {
            let (j, k) = ((row % 8) as f32, (row / 8) as f32);
            let start = base + (into_beam.y_axis * j + into_beam.z_axis * k) * voxel_m;
            // The middle of the row against the widest the beam can be on it.
            let middle = start + step * 3.5;
            let reach = 3.5 * step.y.abs() + voxel_m + 2.5 * sigma * middle.x.abs();
            if middle.y.abs() > reach || middle.x < -4.0 * voxel_m {
                continue;
            }
            work += 8;
            // Eight voxels side by side, in plain arrays that the compiler turns into vectors.
            let (mut clear, mut bin) = ([0f32; 8], [0f32; 8]);
            for i in 0..8 {
                let along = LANES[i];
                let (x, y, z) = (
                    start.x + step.x * along,
                    start.y + step.y * along,
                    start.z + step.z * along,
                );
                let lever2 = x * x + y * y;
                let range_m = (lever2 + z * z).sqrt();
                let late_m = range_m - look.pose.reference_range_m;
                let across_m = y - late_m * (drift.x + drift.y * x - drift.z * z);
                let variance_m2 = beam_variance * lever2 + voxel_variance_m2;
                let off = across_m * across_m / (LOOK_SIGMAS_SQUARED * variance_m2);
                let seen = x > 0.0 && z * z < fan_tangent2 * lever2;
                clear[i] = if seen { 1.0 - off } else { 0.0 };
                bin[i] = (range_m - look.range_start_m) * per_bin;
            }
            let row_evidence = &mut evidence[row * 8..row * 8 + 8];
            for i in 0..8 {
                if clear[i] > 0.0 && bin[i] >= 0.0 {
                    let state = past.profile.state.at(bin[i] as usize);
                    row_evidence[i] += clear[i] * gain[state as usize];
                }
            }
        }
        work
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_side_that_sees_nothing_contradicts_the_others_only_so_far() {
        let mut evidence = Evidence::new(0.05);
        evidence.create([0, 0, 0]);
        let block = evidence.block_mut(0);
        let seen_as = |ratio: f32| Side::Seen(Box::new([ratio; VOXELS]));
        block.sides[0] = seen_as(20.0);
        block.sides[1] = seen_as(-50.0);
        assert!((block.evidence(0) - 18.0).abs() < 1e-6);
        block.take_stock();
        assert!(block.sides[1].is_settled() && !block.sides[0].is_settled());
        assert!((block.evidence(0) - 18.0).abs() < 1e-6);
        block.sides[0] = seen_as(1.0);
        assert!(block.evidence(0) < 0.0);
    }

    #[test]
    fn looks_come_from_the_side_their_sensor_is_on() {
        let sides = [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y].map(side_of);
        assert_eq!(sides, [0, 1, 2, 3]);
    }
}
