//! What was seen where by one choice of poses: the voxels along the arcs of all pings' ranges, and how
//! often observations of each found it lit, by block of time.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::Arc;

use echosplat_measurement::Beam;
use echosplat_model::{Ping, Pose};
use glam::{DQuat, DVec3, IVec3};

use super::lit::{Cell, LitPings};

/// Blocks of time; found.
/// Blocks of time that a window is cut into; each is predicted from the others.
pub const BLOCKS: usize = 20;
/// Blocks either side; found.
/// Blocks before and after the predicted one that are left out: what was seen a moment ago is seen
/// again with any poses.
const LEFT_OUT: usize = 1;
/// Observations at the common rate; found.
/// Observations that every voxel is given at the rate of all cells, so that few say little.
const PRIOR_OBSERVATIONS: f32 = 3.0;
/// Voxels in each direction; bounds memory.
/// Voxels reach so far in each direction.
const MOST_VOXELS: i32 = 1 << 20;

/// The block of the ping at `index` of `count`.
pub(super) fn block_of(index: usize, count: usize) -> usize {
    index * BLOCKS / count.max(1)
}

/// The blocks that say nothing of `block`.
pub(super) fn left_out(block: usize) -> std::ops::RangeInclusive<usize> {
    block.saturating_sub(LEFT_OUT)..=(block + LEFT_OUT).min(BLOCKS - 1)
}

/// Samples along each cell's arc, metres ahead and up; shape `[cells][samples]`.
#[derive(Debug)]
pub(super) struct Arcs(Vec<Vec<[f64; 2]>>);

impl Arcs {
    /// Samples a cell apart, as far up and down as the beam has half its strength.
    pub(super) fn new(lit: &LitPings, beam: &Beam) -> Self {
        let cell_m = lit.cell_m;
        let half_rad = f64::from(beam.elevation_half_width_rad());
        let arc = |cell: usize| {
            let range_m = (cell as f64 + 0.5) * cell_m;
            let count = (2.0 * half_rad * range_m / cell_m).ceil().max(1.0) as usize;
            let sample = |index: usize| {
                let elevation_rad = half_rad * ((2 * index + 1) as f64 / count as f64 - 1.0);
                [range_m * elevation_rad.cos(), range_m * elevation_rad.sin()]
            };
            (0..count).map(sample).collect()
        };
        Self((0..lit.cell_count).map(arc).collect())
    }
}

/// Observations of one voxel and how many found it lit, by block.
#[derive(Debug, Clone, Copy, Default)]
struct Observations {
    all: [u8; BLOCKS],
    lit: [u8; BLOCKS],
    /// Sums over all blocks.
    all_blocks: [u16; 2],
}

/// One of them.
#[derive(Debug, Clone, Copy)]
struct Observation {
    block: usize,
    is_lit: bool,
}

impl Observations {
    fn add(&mut self, observation: Observation) {
        // A full count keeps its share.
        if let Some(all) = self.all[observation.block].checked_add(1) {
            self.all[observation.block] = all;
            self.lit[observation.block] += u8::from(observation.is_lit);
            let [all, lit] = &mut self.all_blocks;
            *all += 1;
            *lit += u16::from(observation.is_lit);
        }
    }

    /// All observations and those that were lit, of the blocks that may tell of `block`.
    fn told(&self, block: usize) -> (f32, f32) {
        let told = |observations: &[u8; BLOCKS], of_all: u16| {
            let left_out = observations[left_out(block)].iter().copied();
            f32::from(of_all - left_out.map(u16::from).sum::<u16>())
        };
        let [all, lit] = self.all_blocks;
        (told(&self.all, all), told(&self.lit, lit))
    }
}

/// A window of pings with one choice of poses: for each ping and cell, the voxels along its arc.
pub(super) struct Evidence {
    blocks: Vec<usize>,
    observations: Vec<Observations>,
    /// Indices into `observations`, all cells' one after another.
    along: Vec<u32>,
    /// Where those of ping `p`'s cell `c` begin, at `p · cells + c`, and the end of the last.
    starts: Vec<usize>,
    cell_count: usize,
}

impl Evidence {
    /// Of poses `world_from_sensor`, one for each ping; one without observes nothing.
    pub(super) fn new(
        pings: &[Arc<Ping>],
        poses: &[Option<Pose>],
        lit: &LitPings,
        arcs: &Arcs,
    ) -> Self {
        let count = lit.cells.len();
        let mut evidence = Self {
            blocks: (0..count).map(|ping| block_of(ping, count)).collect(),
            observations: Vec::new(),
            along: Vec::new(),
            starts: vec![0],
            cell_count: lit.cell_count,
        };
        let origin = poses.iter().flatten().next();
        let origin_m = origin.map_or(DVec3::ZERO, |pose| pose.translation_m);
        let samples: usize = arcs.0.iter().map(Vec::len).sum();
        evidence.along.reserve_exact(samples * count);
        let mut voxels = Voxels::default();
        for (index, (ping, pose)) in pings.iter().zip(poses).enumerate() {
            let rays = pose.map(|pose| Rays::of(ping, &pose, origin_m, lit.cell_m));
            for (arc, state) in arcs.0.iter().zip(&lit.cells[index]) {
                if let Some(rays) = &rays
                    && *state != Cell::Unknown
                {
                    let observation = Observation {
                        block: evidence.blocks[index],
                        is_lit: *state == Cell::Lit,
                    };
                    evidence.observe(rays, arc, observation, &mut voxels);
                }
                evidence.starts.push(evidence.along.len());
            }
        }
        evidence
    }

    /// Observes the voxels along an arc, and numbers those that are new.
    fn observe(
        &mut self,
        rays: &Rays,
        arc: &[[f64; 2]],
        observation: Observation,
        voxels: &mut Voxels,
    ) {
        for voxel in arc.iter().filter_map(|sample| rays.voxel(*sample)) {
            let next = self.observations.len() as u32;
            let voxel = voxels.number(voxel, next);
            if voxel == next {
                self.observations.push(Observations::default());
            }
            self.observations[voxel as usize].add(observation);
            self.along.push(voxel);
        }
    }

    /// What other blocks saw along a cell's arc; `lit_rate` is that of all cells.
    pub(super) fn said(&self, ping: usize, cell: usize, lit_rate: f32) -> Said {
        let place = ping * self.cell_count + cell;
        let along = &self.along[self.starts[place]..self.starts[place + 1]];
        let (mut known, mut greatest) = (0, None);
        for &voxel in along {
            let (all, lit) = self.observations[voxel as usize].told(self.blocks[ping]);
            known += usize::from(all > 0.0);
            if lit > 0.0 {
                let share = (lit + PRIOR_OBSERVATIONS * lit_rate) / (all + PRIOR_OBSERVATIONS);
                greatest = Some(share.max(greatest.unwrap_or(0.0)));
            }
        }
        match greatest {
            Some(share) => Said::Lit(share),
            None if 2 * known > along.len() => Said::Dark,
            None => Said::Nothing,
        }
    }
}

/// What observations along an arc say of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Said {
    /// Most of it was not seen.
    Nothing,
    /// Most of it was seen, and all of that dark.
    Dark,
    /// Some of it was seen lit, the surest place in this share of observations.
    Lit(f32),
}

/// Numbers of voxels, in cubes: of an arc's samples the next mostly lies in the same.
#[derive(Default)]
struct Voxels {
    /// Index of each cube by its key.
    cubes: HashMap<u64, usize, BuildHasherDefault<Spread>>,
    /// Of each cube's voxels, x fastest; [`UNSEEN`] where nothing looked.
    numbers: Vec<[u32; CUBE_VOXELS]>,
    /// Key and index of the cube that was asked for last.
    last: Option<(u64, usize)>,
}

/// Log2 of voxels along a cube's edge; layout.
/// Voxels along the edge of a cube are two to the power of this.
const CUBE_SHIFT: i32 = 3;
/// Voxels of a cube; layout.
const CUBE_VOXELS: usize = 1 << (3 * CUBE_SHIFT);
/// Mark of a cube never seen; layout.
const UNSEEN: u32 = u32::MAX;

impl Voxels {
    /// The voxel's number, `next` if it had none.
    fn number(&mut self, voxel: IVec3, next: u32) -> u32 {
        let key = key(voxel >> CUBE_SHIFT);
        let cube = match self.last {
            Some((last, cube)) if last == key => cube,
            _ => *self.cubes.entry(key).or_insert_with(|| {
                self.numbers.push([UNSEEN; CUBE_VOXELS]);
                self.numbers.len() - 1
            }),
        };
        self.last = Some((key, cube));
        let [x, y, z] = (voxel & ((1 << CUBE_SHIFT) - 1)).to_array();
        let within = x | y << CUBE_SHIFT | z << (2 * CUBE_SHIFT);
        let number = &mut self.numbers[cube][within as usize];
        if *number == UNSEEN {
            *number = next;
        }
        *number
    }
}

/// One ping's fan in units of voxels.
struct Rays {
    position: DVec3,
    ahead: DVec3,
    up: DVec3,
}

impl Rays {
    /// Relative to `origin_m`.
    fn of(ping: &Ping, pose: &Pose, origin_m: DVec3, voxel_m: f64) -> Self {
        let beam_turn = DQuat::from_rotation_z(ping.beam_azimuth_rad().into());
        let rotation = pose.rotation * beam_turn;
        Self {
            position: (pose.translation_m - origin_m) / voxel_m,
            ahead: rotation * DVec3::X / voxel_m,
            up: rotation * DVec3::Z / voxel_m,
        }
    }

    /// The voxel that a sample lies in; `None` too far off.
    fn voxel(&self, [ahead_m, up_m]: [f64; 2]) -> Option<IVec3> {
        let place = self.position + self.ahead * ahead_m + self.up * up_m;
        // Positive, so that cutting off rounds down; what is no number, or far off, saturates.
        let from_edge = (place + f64::from(MOST_VOXELS)).as_ivec3();
        let is_near = place.cmpge(DVec3::splat(-f64::from(MOST_VOXELS))).all()
            && from_edge.cmplt(IVec3::splat(2 * MOST_VOXELS)).all();
        is_near.then_some(from_edge - MOST_VOXELS)
    }
}

/// Of a cube that is no further off than the furthest voxels.
fn key(cube: IVec3) -> u64 {
    let [x, y, z] = (cube + MOST_VOXELS).to_array().map(|i| i as u64);
    x << 42 | y << 21 | z
}

/// Spreads the bits of a cube's key; nobody chooses keys to collide.
#[derive(Default)]
struct Spread(u64);

impl Hasher for Spread {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(self.0 ^ u64::from(byte));
        }
    }

    fn write_u64(&mut self, key: u64) {
        // The golden ratio's bits; the upper half holds what all bits together make.
        let product = key.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = product ^ (product >> 32);
    }
}
