//! Births and deaths: Gaussians follow the evidence.

use echosplat_model::glam::Vec3;

use crate::evidence::{Evidence, VOXELS};
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
    for index in evidence.take_touched() {
        let scale_m = 0.5 * evidence.voxel_m();
        let block = evidence.block_mut(index);
        let before = block.gaussians.len();
        let least = DROP_EVIDENCE.max(DROP_PART * block.best);
        let mut held = std::mem::take(&mut block.gaussians);
        held.retain(|&(voxel, slot)| {
            let stays = block.evidence(voxel.into()) > least;
            if !stays {
                gaussians.remove(slot);
            }
            stays
        });
        block.gaussians = held;
        pruned += (before - block.gaussians.len()) as u64;
        for (voxel, center_m) in births(evidence, index, spawn_evidence) {
            let slot = gaussians.spawn(center_m, (index, voxel), scale_m, strength);
            evidence.block_mut(index).gaussians.push((voxel, slot));
            added += 1;
        }
    }
    (added, pruned)
}

/// Voxels of a block that the evidence now fills and that hold no Gaussian yet.
fn births(evidence: &Evidence, index: u32, spawn_evidence: f32) -> Vec<(u16, Vec3)> {
    let block = evidence.block(index);
    let spawn_evidence = spawn_evidence.max(SPAWN_PART * block.best);
    let full = (0..VOXELS).filter(|&voxel| block.evidence(voxel) >= spawn_evidence);
    let free = full.filter(|&voxel| {
        let held = |&(other, _): &(u16, u32)| usize::from(other) == voxel;
        !block.gaussians.iter().any(held) && !block.is_barred(voxel)
    });
    free.map(|voxel| (voxel as u16, evidence.center_m(block.key, voxel)))
        .collect()
}
