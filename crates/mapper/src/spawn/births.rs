//! Births and deaths: Gaussians follow the evidence until they are worked out.

use crate::accumulate::evidence::{Block, Evidence, Horizon, VOXELS};
use crate::spawn::gaussians::{Gaussians, Stage};

/// Evidence that drops a Gaussian: doubt, not certainty, so that it does not flicker.
const DROP_EVIDENCE: f32 = 0.0;
/// Places with less than this part of the best evidence beside them are its surroundings: less
/// gives birth to nothing, and less still lets go.
const SPAWN_PART: f32 = 0.15;
const DROP_PART: f32 = 0.1;

/// Births and deaths where evidence changed. What was worked out stays until it is again.
pub(crate) fn follow_evidence(
    evidence: &mut Evidence,
    gaussians: &mut Gaussians,
    spawn_evidence: f32,
    strength: f32,
) -> (u64, u64) {
    let (mut added, mut pruned) = (0, 0);
    let scale_m = 0.5 * evidence.voxel_m();
    for index in evidence.take_touched() {
        let block = evidence.block(index);
        if block.gaussians.is_empty() && block.best < spawn_evidence {
            continue;
        }
        let (key, (sums, best)) = (block.key, evidence.of(block, Horizon::Quarters));
        let block = evidence.block_mut(index);
        let least = DROP_EVIDENCE.max(DROP_PART * best);
        let before = block.gaussians.len();
        block.gaussians.retain(|&(voxel, slot)| {
            let is_newborn = gaussians.stage[slot as usize] == Stage::Newborn;
            let stays = !is_newborn || sums[usize::from(voxel)] > least;
            if !stays {
                gaussians.remove(slot);
            }
            stays
        });
        pruned += (before - block.gaussians.len()) as u64;
        let enough = spawn_evidence.max(SPAWN_PART * best);
        for voxel in births(block, &sums, enough) {
            let center_m = evidence.center_m(key, voxel.into());
            let slot = gaussians.spawn(center_m, (index, voxel), scale_m, strength);
            evidence.block_mut(index).gaussians.push((voxel, slot));
            added += 1;
        }
    }
    (added, pruned)
}

/// Voxels of a block that hold enough evidence for a candidate, or a Gaussian and not too little.
pub(crate) fn candidates(
    evidence: &Evidence,
    block: &Block,
    horizon: Horizon,
    spawn_evidence: f32,
) -> Vec<u16> {
    let (sums, best) = evidence.of(block, horizon);
    let enough = spawn_evidence.max(SPAWN_PART * best);
    let least = DROP_EVIDENCE.max(DROP_PART * best);
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
fn births(block: &Block, sums: &[f32; VOXELS], enough: f32) -> Vec<u16> {
    let mut held = block.barred;
    for &(voxel, _) in &block.gaussians {
        held[usize::from(voxel) / 64] |= 1 << (voxel % 64);
    }
    let is_free = |voxel: usize| held[voxel / 64] >> (voxel % 64) & 1 == 0;
    let full = (0..VOXELS).filter(|&voxel| sums[voxel] >= enough && is_free(voxel));
    full.map(|voxel| voxel as u16).collect()
}
