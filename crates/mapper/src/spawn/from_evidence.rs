//! Gaussians are spawned and pruned by the evidence until they are worked out.

use rayon::prelude::*;

use crate::accumulate::evidence::{Block, BlockIndex, Evidence, SectorWidth, VOXELS};
use crate::spawn::gaussians::{Gaussians, Stage};

/// Nats, derived: even odds.
/// Evidence at which a Gaussian is pruned: doubt, not certainty, so that it does not flicker.
const DROP_EVIDENCE: f32 = 0.0;
/// Fraction; found.
/// Places with less than this fraction of the best evidence beside them are its surroundings:
/// nothing is spawned there, and with still less a Gaussian is pruned.
const SPAWN_FRACTION: f32 = 0.15;
/// Fraction, found: lower, against flicker.
const DROP_FRACTION: f32 = 0.1;

/// What the evidence now says of a block.
struct Change {
    index: BlockIndex,
    /// The most evidence of any voxel.
    best: f32,
    /// Slots without evidence enough to stay.
    to_prune: Vec<u32>,
    /// Voxels with enough to begin.
    to_spawn: Vec<u16>,
}

/// Spawns and prunes where evidence changed. What was worked out stays until it is again.
pub(crate) fn spawn_and_prune(
    evidence: &mut Evidence,
    gaussians: &mut Gaussians,
    spawn_evidence: f32,
    strength: f32,
) -> (u64, u64) {
    let scale_m = 0.5 * evidence.voxel_m();
    let touched: Vec<BlockIndex> = evidence.take_touched().into_iter().collect();
    let change = |&index: &BlockIndex| change(evidence, gaussians, index, spawn_evidence);
    let changes: Vec<Change> = touched.par_iter().filter_map(change).collect();
    let (mut added, mut pruned) = (0, 0);
    for change in changes {
        let Change {
            index,
            best,
            to_prune,
            to_spawn,
        } = change;
        let block = evidence.block_mut(index);
        block.most = best;
        if !to_prune.is_empty() {
            block.gaussians.retain(|(_, slot)| !to_prune.contains(slot));
        }
        for &slot in &to_prune {
            gaussians.remove(slot);
        }
        let key = block.key;
        pruned += to_prune.len() as u64;
        added += to_spawn.len() as u64;
        for voxel in to_spawn {
            let center_m = evidence.center_m(key, voxel.into());
            let slot = gaussians.spawn(center_m, (index, voxel), scale_m, strength);
            evidence.block_mut(index).gaussians.push((voxel, slot));
        }
    }
    (added, pruned)
}

fn change(
    evidence: &Evidence,
    gaussians: &Gaussians,
    index: BlockIndex,
    spawn_evidence: f32,
) -> Option<Change> {
    let block = evidence.block(index);
    if block.gaussians.is_empty() && block.most < spawn_evidence {
        return None;
    }
    let (sums, best) = evidence.of(block, SectorWidth::Quarter);
    let least = DROP_EVIDENCE.max(DROP_FRACTION * best);
    let is_to_prune = |&&(voxel, slot): &&(u16, u32)| {
        let is_spawned = gaussians.stage[slot as usize] == Stage::Spawned;
        is_spawned && !(sums[usize::from(voxel)] > least)
    };
    let to_prune = block.gaussians.iter().filter(is_to_prune);
    Some(Change {
        index,
        best,
        to_prune: to_prune.map(|&(_, slot)| slot).collect(),
        to_spawn: voxels_to_spawn(block, &sums, spawn_evidence.max(SPAWN_FRACTION * best)),
    })
}

/// Voxels of a block that hold enough evidence for a candidate, or a Gaussian and not too little.
pub(crate) fn candidates(
    evidence: &Evidence,
    block: &Block,
    width: SectorWidth,
    spawn_evidence: f32,
) -> Vec<u16> {
    let (sums, best) = evidence.of(block, width);
    let enough = spawn_evidence.max(SPAWN_FRACTION * best);
    let least = DROP_EVIDENCE.max(DROP_FRACTION * best);
    let mut is_held = [false; VOXELS];
    for &(voxel, _) in &block.gaussians {
        is_held[usize::from(voxel)] = true;
    }
    let stays = |voxel: &usize| sums[*voxel] >= enough || is_held[*voxel] && sums[*voxel] > least;
    (0..VOXELS)
        .filter(stays)
        .map(|voxel| voxel as u16)
        .collect()
}

/// Voxels of a block that the evidence now fills and that hold no Gaussian yet.
fn voxels_to_spawn(block: &Block, sums: &[f32; VOXELS], enough: f32) -> Vec<u16> {
    let mut held = block.suppressed;
    for &(voxel, _) in &block.gaussians {
        held[usize::from(voxel) / 64] |= 1 << (voxel % 64);
    }
    let is_free = |voxel: usize| held[voxel / 64] >> (voxel % 64) & 1 == 0;
    let full = (0..VOXELS).filter(|&voxel| sums[voxel] >= enough && is_free(voxel));
    full.map(|voxel| voxel as u16).collect()
}
