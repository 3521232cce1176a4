//! What a work-out begins with.

use echosplat_model::{Standing, Switch};
use rayon::prelude::*;

use super::{Mask, Terms, Workout, is, set};
use crate::accumulate::evidence::{BlockIndex, SectorWidth, TileIndex};
use crate::accumulate::fan::Reach;
use crate::features::LeftOut;
use crate::mapper::schedule::Start;
use crate::refine::places::Places;
use crate::spawn::from_evidence;
use crate::spawn::gaussians::{Gaussians, Stage, Verdict};
use crate::world::World;

/// Fraction of a typical strength; found.
/// What all Gaussians start with, alike, of the strength that a typical echo needs.
const EVEN_STRENGTH: f32 = 0.2;
/// Fraction of `spawn_evidence`; found.
/// Less evidence is asked of a place that few observations lit, since its returns are specular.
const SPAWN_FRACTION_OF_SPECULAR: f32 = 0.667;
/// Candidates; bounds work.
/// With more candidates than this, all that any azimuth sector saw dark is doubted in full.
const MOST_PLACES: usize = 400_000;
/// Fraction; found.
/// Where forgotten pings made this fraction of the observations, what is confident is held as it is: the others alone
/// would find its place less well.
const HELD_FRACTION: f32 = 0.3;

impl Workout {
    /// Every place of the tiles with enough evidence, all alike. With `skips_suppressed`, what the last work-out let go is
    /// left out unless the map has something within a voxel of it.
    pub(super) fn take_candidates(
        &mut self,
        world: &World,
        map: &Gaussians,
        tiles: &[TileIndex],
        skips_suppressed: bool,
        terms: Terms<'_>,
        left_out: &mut Vec<LeftOut>,
    ) {
        let evidence = &world.evidence;
        let spawn = terms.config.spawn_evidence;
        let places = |width: SectorWidth, enough: f32| -> Vec<(BlockIndex, Vec<u16>)> {
            let of_block = |&index: &BlockIndex| {
                let block = evidence.block(index);
                (
                    index,
                    from_evidence::candidates(evidence, block, width, enough),
                )
            };
            let of_tile = |&tile: &TileIndex| {
                let blocks = evidence.tiles()[tile as usize].blocks.par_iter();
                blocks.map(of_block)
            };
            tiles.par_iter().flat_map(of_tile).collect()
        };
        let mut found = match terms.at_work.specular_returns {
            true => places(SectorWidth::Eighth, SPAWN_FRACTION_OF_SPECULAR * spawn),
            false => places(SectorWidth::Quarter, spawn),
        };
        let mut count: usize = found.iter().map(|(_, voxels)| voxels.len()).sum();
        if terms.at_work.specular_returns
            && count > MOST_PLACES
            && terms.config.parts.glints == Switch::Auto
        {
            left_out.push(LeftOut::specular_returns_of_crowd(count));
            found = places(SectorWidth::Quarter, spawn);
            count = found.iter().map(|(_, voxels)| voxels.len()).sum();
        }
        let known = skips_suppressed.then(|| {
            let held = found.iter();
            let held = held.flat_map(|&(index, _)| evidence.block(index).gaussians.iter());
            let slots = held.map(|&(_, slot)| slot as usize);
            let worked = slots.filter(|&slot| map.stage[slot] == Stage::Worked);
            Places::of(worked.map(|slot| (slot, map.home_m[slot])), self.voxel_m)
        });
        let passed_over = |(index, voxels): &(BlockIndex, Vec<u16>)| {
            let (block, mut mask) = (evidence.block(*index), Mask::default());
            let Some(known) = &known else { return mask };
            for &voxel in voxels.iter().filter(|&&voxel| is(&block.suppressed, voxel)) {
                if !known.any_near(evidence.center_m(block.key, voxel.into())) {
                    set(&mut mask, voxel);
                }
            }
            mask
        };
        let passed_over: Vec<Mask> = found.par_iter().map(passed_over).collect();
        self.draft.reserve(count);
        let (scale_m, strength) = (0.5 * self.voxel_m, EVEN_STRENGTH * terms.unit_strength);
        for ((index, voxels), passed_over) in found.into_iter().zip(passed_over) {
            let (block, mut mask) = (evidence.block(index), Mask::default());
            let (key, is_held) = (block.key, self.hold(world, map, index));
            for &(voxel, _) in &block.gaussians {
                if !is(&is_held, voxel) {
                    set(&mut mask, voxel);
                }
            }
            for voxel in voxels {
                if is(&is_held, voxel) {
                    continue;
                }
                set(&mut mask, voxel);
                if is(&passed_over, voxel) {
                    continue;
                }
                let center_m = evidence.center_m(key, voxel.into());
                let slot = self
                    .draft
                    .spawn(center_m, (index, voxel), scale_m, strength);
                self.draft.verdict[slot as usize] = Verdict::ExplainedAway;
            }
            self.blocks.push((index, mask));
        }
    }

    /// Takes what is confident as it is where forgotten pings told much of it; its voxels.
    fn hold(&mut self, world: &World, map: &Gaussians, index: BlockIndex) -> Mask {
        let mut held = Mask::default();
        let tile = &world.evidence.tiles()[world.evidence.tile_of(index) as usize];
        if self.start == Start::Even
            || tile.forgotten_observations < HELD_FRACTION * tile.observations
        {
            return held;
        }
        for &(voxel, slot) in &world.evidence.block(index).gaussians {
            let is_confident =
                map.verdict[slot as usize] == Verdict::Published(Standing::Confident);
            if is_confident {
                set(&mut held, voxel);
                self.draft.adopt(map, slot as usize, Stage::Background);
            }
        }
        held
    }

    /// What was worked out before of the other tiles that the pings see.
    pub(super) fn take_background(&mut self, world: &World, map: &Gaussians, tiles: &[TileIndex]) {
        let evidence = &world.evidence;
        let radius_m = evidence.tile_radius_m();
        let reach = Reach::of(self.pings.iter().map(|keyframe| &keyframe.fan));
        for (index, tile) in evidence.tiles().iter().enumerate() {
            let is_seen = || {
                let mut pings = self.pings.iter();
                reach.touches(tile.center_m, radius_m)
                    && pings.any(|keyframe| keyframe.fan.touches(tile.center_m, radius_m))
            };
            if tile.worked_observations <= 0.0
                || tiles.contains(&(index as TileIndex))
                || !is_seen()
            {
                continue;
            }
            for &block in &tile.blocks {
                for &(_, slot) in &evidence.block(block).gaussians {
                    if map.stage[slot as usize] == Stage::Worked {
                        self.draft.adopt(map, slot as usize, Stage::Background);
                    }
                }
            }
        }
    }
}
