//! What a work-out ends with.

use std::collections::{BTreeMap, VecDeque};

use echosplat_model::GaussianId;

use super::{Workout, is};
use crate::accumulate::evidence::BlockIndex;
use crate::mapper::schedule::Start;
use crate::spawn::gaussians::{Gaussians, Stage, Verdict};
use crate::spawn::kept::Kept;
use crate::world::World;

/// Fraction, derived: below 1, so due at the end.
/// What was worked out anew in haste counts as if it had a few observations less, so that the end of the data does it in
/// full, were it never observed again.
const HURRIED_FRACTION: f32 = 0.99;

impl Workout {
    /// Puts the draft in the map's place. Ids stay with their places, or at least with their blocks. Returns the
    /// steps made.
    pub(crate) fn put_in_place(self, world: &mut World, map: &mut Gaussians) -> u64 {
        let draft = &self.draft;
        let mut found: BTreeMap<(BlockIndex, u16), Vec<usize>> = BTreeMap::new();
        for slot in draft.slots().filter(|&slot| draft.is_worked_on(slot)) {
            if matches!(draft.verdict[slot], Verdict::Published(_)) {
                found.entry(draft.home[slot]).or_default().push(slot);
            }
        }
        for (index, mask) in &self.blocks {
            let block = world.evidence.block_mut(*index);
            let mut ids: BTreeMap<u16, VecDeque<GaussianId>> = BTreeMap::new();
            let mut kept: BTreeMap<u16, Vec<Kept>> = BTreeMap::new();
            block.gaussians.retain(|&(voxel, slot)| {
                let is_news = !is(mask, voxel);
                if !is_news {
                    let ids = ids.entry(voxel).or_default();
                    ids.push_back(map.id[slot as usize]);
                    let told = map.kept[slot as usize].as_deref();
                    kept.entry(voxel).or_default().extend(told);
                    map.remove(slot);
                }
                is_news
            });
            block.suppressed = *mask;
            let mut homeless = Vec::new();
            for (&(_, voxel), slots) in found.range((*index, 0)..=(*index, u16::MAX)) {
                block.suppressed[usize::from(voxel) / 64] &= !(1 << (voxel % 64));
                // As it is now: pings may have been forgotten since the draft began.
                let told = kept
                    .get(&voxel)
                    .and_then(|children| Kept::mean(children.iter()));
                for &slot in slots {
                    let placed = map.adopt(draft, slot, Stage::Worked);
                    map.kept[placed as usize] = told.map(Box::new);
                    block.gaussians.push((voxel, placed));
                    match ids.get_mut(&voxel).and_then(VecDeque::pop_front) {
                        Some(id) => map.id[placed as usize] = id,
                        None => homeless.push(placed),
                    }
                }
            }
            // What moved within the block is told as moved, not as gone and come.
            for (placed, id) in homeless.into_iter().zip(ids.into_values().flatten()) {
                map.id[placed as usize] = id;
            }
        }
        for &(tile, observations) in &self.tiles {
            let tile = world.evidence.tile_mut(tile);
            tile.worked_observations = observations;
            if self.start == Start::Even {
                tile.even_observations = match self.is_hurried {
                    true => HURRIED_FRACTION * observations,
                    false => observations,
                };
            }
        }
        self.iterations
    }
}
