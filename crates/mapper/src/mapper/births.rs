//! Births and deaths: Gaussians follow the evidence.

use crate::evidence::{Block, Evidence, VOXELS};
use crate::gaussians::Gaussians;

/// Evidence that drops a Gaussian: doubt, not certainty, so that it does not flicker.
const DROP_EVIDENCE: f32 = 0.0;
/// Places with less than this part of the best evidence beside them are its surroundings: less
/// gives birth to nothing, and less still lets go.
const SPAWN_PART: f32 = 0.15;
const DROP_PART: f32 = 0.1;

/// Births and deaths where evidence changed.
pub(super) fn follow_evidence(
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
        let (key, best, sums) = (block.key, block.best, evidence.of(block));
        let block = evidence.block_mut(index);
        let least = DROP_EVIDENCE.max(DROP_PART * best);
        let before = block.gaussians.len();
        block.gaussians.retain(|&(voxel, slot)| {
            let stays = sums[usize::from(voxel)] > least;
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

/// Places that would hold a Gaussian if all evidence were followed.
pub(super) fn count(evidence: &Evidence, spawn_evidence: f32) -> usize {
    let blocks = evidence
        .blocks()
        .filter(|block| block.best >= spawn_evidence);
    let of_block = |block: &Block| {
        let enough = spawn_evidence.max(SPAWN_PART * block.best);
        let sums = evidence.of(block);
        sums.iter().filter(|&&sum| sum >= enough).count()
    };
    blocks.map(of_block).sum()
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
