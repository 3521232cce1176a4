//! Tiles worked out: strengths, places, shapes and verdicts of their Gaussians from the pings that see them,
//! beside what stands around held still.
//!
//! The one process of estimation. Work is done in portions, on a draft; the map shows the tiles as they were until
//! the draft is done.
//!
//! Cost: about seven looks at each ping that sees the tiles, four where it starts from the map, fewer where more
//! would say nothing new.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use echosplat_model::glam::{Quat, Vec3};
use echosplat_model::{GaussianId, Standing, Switch};

use crate::MapperConfig;
use crate::accumulate::evidence::{BlockIndex, Horizon, TileIndex, VOXELS};
use crate::accumulate::finding::Finding;
use crate::accumulate::history::{Past, every};
use crate::classify::assess::{Demand, Desk, Rule, findings_of_ping, judge, tails};
use crate::mapper::schedule::{Action, INTERLEAVE, Start, actions};
use crate::parts::{AtWork, Extent, LeftOut};
use crate::refine::expectation::{
    Pass, Pull, StepSums, localise, maximise, pulls_of_ping, strengths_of_ping,
};
use crate::refine::inherit::{area_of, inherit, whole_area};
use crate::refine::scene::Scene;
use crate::refine::shape::align;
use crate::seabed::Seabed;
use crate::spawn::births;
use crate::spawn::gaussians::{Gaussians, Stage, Verdict};
use crate::spawn::kept::Kept;
use crate::world::World;

/// What all Gaussians start with, alike, of the strength that a typical echo needs.
const EVEN_STRENGTH: f32 = 0.2;
/// Candidates below this part of their strongest neighbour are not worth further work.
const TAIL_PART: f32 = 0.05;
/// Looks made at each ping, all steps together.
const LOOKS_PER_PING: f64 = 7.5;
/// A place that few looks lit, since it glints, is asked for less evidence.
const SPAWN_PART_OF_GLINTS: f32 = 0.667;
/// With more candidates than this, all that any side saw dark is doubted in full.
const MOST_PLACES: usize = 400_000;
/// Pairs of each Gaussian in one pass over the pings, beyond which more pings say nothing new.
const ENOUGH_PAIRS: f64 = 12_000.0;
/// The part of them that a start from the map needs, since the map knows the rest.
const ENOUGH_FROM_MAP: f64 = 0.125;
/// So many times fewer looks see every ping about once over all steps.
const NEVER_TWICE: f64 = LOOKS_PER_PING;
/// Steps of offset from one step to the next.
const OFFSET_STRIDE: f64 = 5.0;
/// Pings that tell how many pairs each has.
const SAMPLE: usize = 64;
/// Pairs of a portion, about 10 ms on two cores.
const PORTION_PAIRS: f64 = 2e6;

/// Where forgotten pings made this part of the looks, what is confident is held as it is: the others alone would
/// find its place less well.
const HELD_PART: f32 = 0.3;

/// Voxels of a block, a bit each.
type Mask = [u64; VOXELS / 64];

fn is(mask: &Mask, voxel: u16) -> bool {
    mask[usize::from(voxel) / 64] >> (voxel % 64) & 1 == 1
}

fn set(mask: &mut Mask, voxel: u16) {
    mask[usize::from(voxel) / 64] |= 1 << (voxel % 64);
}

/// What is going on.
#[derive(Debug)]
enum Doing {
    Strengthen(Pass<StepSums>, f32),
    Localise(Pass<Pull>),
    Assess(Pass<Finding>, Rule, f32),
}

/// Some tiles while they are worked out.
#[derive(Debug)]
pub(crate) struct Workout {
    /// Tiles, and how often each had been looked at.
    tiles: Vec<(TileIndex, f32)>,
    start: Start,
    /// Blocks in them, and the voxels that are worked out: candidates, and what was one before.
    blocks: Vec<(BlockIndex, Mask)>,
    pings: Vec<Arc<Past>>,
    draft: Gaussians,
    at_work: AtWork,
    demand: Demand,
    floor: f32,
    most_pairs: f64,
    voxel_m: f32,
    pairs_per_ping: f64,
    actions: VecDeque<Action>,
    doing: Option<Doing>,
    iterations: u64,
}

/// What a work-out is told beside the pings.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Terms<'a> {
    pub(crate) config: &'a MapperConfig,
    pub(crate) at_work: AtWork,
    /// Least noise power to reckon with.
    pub(crate) floor: f32,
    /// Strength that a typical echo needs of a Gaussian of one voxel.
    pub(crate) unit_strength: f32,
}

impl Workout {
    /// Of these tiles. `left_out` is told what they do without.
    pub(crate) fn begin(
        world: &World,
        map: &Gaussians,
        pings: &[Arc<Past>],
        tiles: Vec<TileIndex>,
        start: Start,
        terms: Terms<'_>,
        left_out: &mut Vec<LeftOut>,
    ) -> Self {
        let (evidence, voxel_m) = (&world.evidence, world.evidence.voxel_m());
        let radius_m = evidence.tile_radius_m();
        let centers_m: Vec<Vec3> = tiles
            .iter()
            .map(|&tile| evidence.tiles()[tile as usize].center_m)
            .collect();
        let sees = |past: &&Arc<Past>| {
            let is_of_use = terms.at_work.empty == Extent::All || !past.profile.echoes.is_empty();
            is_of_use
                && centers_m
                    .iter()
                    .any(|&at_m| past.fan.touches(at_m, radius_m))
        };
        let pings: Vec<Arc<Past>> = pings.iter().filter(sees).map(Arc::clone).collect();
        let mut workout = Self {
            tiles: Vec::new(),
            start,
            blocks: Vec::new(),
            pings,
            draft: Gaussians::default(),
            at_work: terms.at_work,
            demand: Demand::of(terms.config, terms.at_work),
            floor: terms.floor,
            most_pairs: terms.config.workout_pairs as f64,
            voxel_m,
            pairs_per_ping: 0.0,
            actions: actions(terms.config.workout_passes, start, terms.at_work),
            doing: None,
            iterations: 0,
        };
        workout.take_candidates(world, map, &tiles, terms, left_out);
        if start == Start::Map {
            let blocks = workout.blocks.iter();
            let known = blocks.flat_map(|&(block, _)| evidence.block(block).gaussians.iter());
            let known: Vec<u32> = known.map(|&(_, slot)| slot).collect();
            inherit(&mut workout.draft, map, &known, voxel_m);
        }
        workout.take_background(world, map, &tiles);
        let looks = |tile: TileIndex| (tile, evidence.tiles()[tile as usize].looks);
        workout.tiles = tiles.into_iter().map(looks).collect();
        workout.count_pairs(world);
        workout
    }

    /// Every place of the tiles with enough evidence, all alike.
    fn take_candidates(
        &mut self,
        world: &World,
        map: &Gaussians,
        tiles: &[TileIndex],
        terms: Terms<'_>,
        left_out: &mut Vec<LeftOut>,
    ) {
        let evidence = &world.evidence;
        let spawn = terms.config.spawn_evidence;
        let places = |horizon: Horizon, enough: f32| -> Vec<(BlockIndex, Vec<u16>)> {
            let blocks = tiles
                .iter()
                .flat_map(|&tile| evidence.tiles()[tile as usize].blocks.iter());
            let of_block = |&index: &BlockIndex| {
                let block = evidence.block(index);
                (index, births::candidates(evidence, block, horizon, enough))
            };
            blocks.map(of_block).collect()
        };
        let mut found = match terms.at_work.glints {
            true => places(Horizon::Eighths, SPAWN_PART_OF_GLINTS * spawn),
            false => places(Horizon::Quarters, spawn),
        };
        let count: usize = found.iter().map(|(_, voxels)| voxels.len()).sum();
        if terms.at_work.glints && count > MOST_PLACES && terms.config.parts.glints == Switch::Auto
        {
            left_out.push(LeftOut::glints_of_crowd(count));
            found = places(Horizon::Quarters, spawn);
        }
        let (scale_m, strength) = (0.5 * self.voxel_m, EVEN_STRENGTH * terms.unit_strength);
        for (index, voxels) in found {
            let (block, mut mask) = (evidence.block(index), Mask::default());
            let (key, is_held) = (block.key, self.hold(world, map, index));
            for &(voxel, slot) in &block.gaussians {
                if map.stage[slot as usize] == Stage::Worked && !is(&is_held, voxel) {
                    set(&mut mask, voxel);
                }
            }
            for voxel in voxels {
                if is(&is_held, voxel) {
                    continue;
                }
                let center_m = evidence.center_m(key, voxel.into());
                let slot = self
                    .draft
                    .spawn(center_m, (index, voxel), scale_m, strength);
                self.draft.verdict[slot as usize] = Verdict::ExplainedAway;
                set(&mut mask, voxel);
            }
            self.blocks.push((index, mask));
        }
    }

    /// Takes what is confident as it is where forgotten pings told much of it; its voxels.
    fn hold(&mut self, world: &World, map: &Gaussians, index: BlockIndex) -> Mask {
        let mut held = Mask::default();
        let tile = &world.evidence.tiles()[world.evidence.tile_of(index) as usize];
        if self.start == Start::Even || tile.forgotten_looks < HELD_PART * tile.looks {
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
    fn take_background(&mut self, world: &World, map: &Gaussians, tiles: &[TileIndex]) {
        let evidence = &world.evidence;
        let radius_m = evidence.tile_radius_m();
        for (index, tile) in evidence.tiles().iter().enumerate() {
            let is_seen = || {
                let mut pings = self.pings.iter();
                pings.any(|past| past.fan.touches(tile.center_m, radius_m))
            };
            if tile.worked_looks <= 0.0 || tiles.contains(&(index as TileIndex)) || !is_seen() {
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

    fn count_pairs(&mut self, world: &World) {
        let sample: Vec<Arc<Past>> = self
            .pings
            .iter()
            .step_by(self.pings.len() / SAMPLE + 1)
            .map(Arc::clone)
            .collect();
        let count = sample.len();
        let mut pass = Pass::<StepSums>::over(sample, &world.evidence, &self.draft);
        let pairs = pass.advance(self.scene(world, false), count, |_, (): &mut (), _, _| ());
        self.pairs_per_ping = pairs as f64 / count.max(1) as f64;
    }

    fn scene<'a>(&'a self, world: &'a World, is_blurred: bool) -> Scene<'a> {
        Scene {
            evidence: &world.evidence,
            gaussians: &self.draft,
            floor: self.floor,
            is_blurred,
            at_work: self.at_work,
        }
    }

    /// How many times fewer looks do, at least 1: to stay within the work allowed, and since what has been seen
    /// often enough gains nothing.
    fn thinning(&self) -> f64 {
        let pings = self.pings.len() as f64;
        let pass = pings * self.pairs_per_ping;
        let within_work = LOOKS_PER_PING * pass / self.most_pairs;
        let gaussians = self.draft.alive_count().max(1) as f64;
        let enough = match self.at_work.converged {
            Extent::All => 0.0,
            Extent::Useful => {
                let part = match self.start {
                    Start::Even => 1.0,
                    Start::Map => ENOUGH_FROM_MAP,
                };
                pass / (part * ENOUGH_PAIRS * gaussians)
            }
            Extent::None => NEVER_TWICE,
        };
        // At least some dozens of looks a step, however crowded the map.
        let most = (pings / (64.0 * INTERLEAVE)).max(1.0);
        within_work.max(enough).clamp(1.0, most)
    }

    pub(crate) fn tile_count(&self) -> u64 {
        self.tiles.len() as u64
    }

    /// Whether nothing is left to do.
    pub(crate) fn is_done(&self) -> bool {
        self.doing.is_none() && self.actions.is_empty()
    }

    /// Does the next portion. Returns pairs done.
    pub(crate) fn advance(&mut self, world: &World, seabed: &Seabed) -> u64 {
        match self.doing.take() {
            Some(doing) => self.go_on(doing, world, seabed),
            None => {
                if let Some(action) = self.actions.pop_front() {
                    self.begin_action(action, world);
                }
                0
            }
        }
    }

    fn begin_action(&mut self, action: Action, world: &World) {
        let over = |offset: f64, stride: f64| every(&self.pings, offset, stride);
        match action {
            Action::Strengthen { step, interleave } => {
                let interleave = interleave * self.thinning();
                // A stride through the offsets keeps neighbouring steps on different sweeps.
                let pings = over((step as f64 * OFFSET_STRIDE) % interleave, interleave);
                let pass = Pass::over(pings, &world.evidence, &self.draft);
                self.doing = Some(Doing::Strengthen(pass, interleave as f32));
            }
            Action::Localise => {
                let pass = Pass::over(
                    over(0.0, 2.0 * self.thinning()),
                    &world.evidence,
                    &self.draft,
                );
                self.doing = Some(Doing::Localise(pass));
            }
            Action::Assess { stride } => {
                let stride = stride * self.thinning();
                let pass = Pass::over(over(0.0, stride), &world.evidence, &self.draft);
                let rule = Rule::of(&self.scene(world, true), self.demand);
                self.doing = Some(Doing::Assess(pass, rule, stride as f32));
            }
            Action::DropTails => {
                let before = self.draft.alive_count().max(1) as f64;
                for slot in tails(&self.draft, self.voxel_m, TAIL_PART) {
                    self.draft.remove(slot as u32);
                }
                self.pairs_per_ping *= self.draft.alive_count() as f64 / before;
            }
            Action::Split => self.split_confident(),
            Action::Align => align(&mut self.draft, self.voxel_m),
        }
    }

    fn go_on(&mut self, doing: Doing, world: &World, seabed: &Seabed) -> u64 {
        let count = (PORTION_PAIRS / self.pairs_per_ping.max(1.0)) as usize + 1;
        let pairs;
        match doing {
            Doing::Strengthen(mut pass, stride) => {
                pairs = pass.advance(self.scene(world, false), count, strengths_of_ping);
                if pass.is_done() {
                    let (sums, all, looks) = pass.finish();
                    self.worked(all, looks);
                    maximise(&mut self.draft, &sums, stride, self.at_work);
                    self.iterations += 1;
                } else {
                    self.doing = Some(Doing::Strengthen(pass, stride));
                }
            }
            Doing::Localise(mut pass) => {
                pairs = pass.advance(self.scene(world, false), count, pulls_of_ping);
                if pass.is_done() {
                    let (pulls, all, looks) = pass.finish();
                    self.worked(all, looks);
                    localise(&mut self.draft, &pulls, 0.5 * self.voxel_m, self.voxel_m);
                } else {
                    self.doing = Some(Doing::Localise(pass));
                }
            }
            Doing::Assess(mut pass, rule, stride) => {
                let draft = &self.draft;
                let each = |tally: &mut _, desk: &mut Desk, past: &_, sight: &_| {
                    findings_of_ping(tally, desk, past, sight, draft, rule);
                };
                pairs = pass.advance(self.scene(world, true), count, each);
                if pass.is_done() {
                    let (findings, ..) = pass.finish();
                    self.judge(&findings, stride, seabed);
                } else {
                    self.doing = Some(Doing::Assess(pass, rule, stride));
                }
            }
        }
        pairs
    }

    fn worked(&mut self, pairs: u64, looks: usize) {
        if looks > 0 {
            self.pairs_per_ping = pairs as f64 / looks as f64;
        }
    }

    fn judge(&mut self, findings: &[Finding], stride: f32, seabed: &Seabed) {
        let is_worked_on: Vec<bool> = (0..self.draft.slot_count())
            .map(|slot| self.draft.is_worked_on(slot))
            .collect();
        let told: Vec<Finding> = (0..self.draft.slot_count())
            .map(|slot| {
                let mut finding = findings[slot].times(stride);
                if let Some(kept) = &self.draft.kept[slot] {
                    finding.add(&kept.finding_of(self.draft.part[slot]));
                }
                finding
            })
            .collect();
        let finding_of = |slot: usize| is_worked_on[slot].then(|| told[slot]);
        judge(&mut self.draft, finding_of, self.voxel_m, self.demand);
        // Nothing is seen through the ground.
        for slot in 0..self.draft.slot_count() {
            if self.draft.alive[slot] && seabed.hides(self.draft.mean_m[slot]) {
                self.draft.verdict[slot] = Verdict::ExplainedAway;
            }
        }
    }

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
            block.barred = *mask;
            let mut homeless = Vec::new();
            for (&(_, voxel), slots) in found.range((*index, 0)..=(*index, u16::MAX)) {
                block.barred[usize::from(voxel) / 64] &= !(1 << (voxel % 64));
                // As it is now: pings may have been forgotten since the draft began.
                let told = kept.get(&voxel).and_then(|parts| Kept::mean(parts.iter()));
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
        for &(tile, looks) in &self.tiles {
            let tile = world.evidence.tile_mut(tile);
            tile.worked_looks = looks;
            if self.start == Start::Even {
                tile.even_looks = looks;
            }
        }
        self.iterations
    }

    /// Splits every whole confident Gaussian into the eight corners of its voxel.
    fn split_confident(&mut self) {
        let draft = &self.draft;
        let is_whole = |slot: &usize| draft.is_worked_on(*slot) && draft.part[*slot] >= 1.0;
        let is_sure =
            |slot: &usize| draft.verdict[*slot] == Verdict::Published(Standing::Confident);
        let confident: Vec<usize> = draft.slots().filter(is_whole).filter(is_sure).collect();
        for slot in confident {
            split(&mut self.draft, slot, 0.25 * self.voxel_m);
        }
    }
}

/// Adds what pings tell of each Gaussian that was worked out to what it keeps, before they are forgotten.
pub(crate) fn keep(
    world: &World,
    map: &mut Gaussians,
    pings: &[Arc<Past>],
    terms: Terms<'_>,
) -> u64 {
    let scene = |gaussians, is_blurred| Scene {
        evidence: &world.evidence,
        gaussians,
        floor: terms.floor,
        is_blurred,
        at_work: terms.at_work,
    };
    let count = pings.len();
    let mut pass = Pass::over(pings.to_vec(), &world.evidence, map);
    pass.advance(scene(map, false), count, strengths_of_ping);
    let (sums, pairs, _) = pass.finish();
    let rule = Rule::of(&scene(map, true), Demand::of(terms.config, terms.at_work));
    let mut pass = Pass::over(pings.to_vec(), &world.evidence, map);
    let each = |tally: &mut _, desk: &mut Desk, past: &_, sight: &_| {
        findings_of_ping(tally, desk, past, sight, map, rule);
    };
    pass.advance(scene(map, true), count, each);
    let (findings, more_pairs, _) = pass.finish();
    let whole = whole_area(world.evidence.voxel_m());
    for slot in 0..map.slot_count() {
        let is_told = sums[slot].weight.sum() > 0.0 || findings[slot].account.looks > 0.0;
        if map.alive[slot] && map.stage[slot] == Stage::Worked && is_told {
            let (area, part) = (area_of(map, slot) / whole, map.part[slot]);
            let kept = map.kept[slot].get_or_insert_default();
            kept.add(sums[slot].weight, &findings[slot], area, part);
        }
    }
    pairs + more_pairs
}

/// Of a Gaussian's strength for each of its eight parts: half as wide, each fills a quarter of
/// the solid angle, so eight of them at half the strength send back as much.
const PART_OF_STRENGTH: f32 = 0.5;
/// What one of the eight knows of where the surface is.
const PART_OF_INFORMATION: f32 = 0.125;

fn split(gaussians: &mut Gaussians, slot: usize, quarter_m: f32) {
    let (home, mean_m) = (gaussians.home[slot], gaussians.mean_m[slot]);
    let mut strength = gaussians.strength[slot];
    let (known, kept) = (gaussians.known[slot], gaussians.kept[slot].clone());
    strength.scale(PART_OF_STRENGTH);
    for corner in 0..8_u32 {
        let at_m = mean_m + corner_of(corner) * quarter_m;
        let part = match corner {
            0 => slot,
            _ => gaussians.spawn(at_m, home, quarter_m, 0.0) as usize,
        };
        gaussians.mean_m[part] = at_m;
        gaussians.home_m[part] = at_m;
        gaussians.set_shape(part, Quat::IDENTITY, Vec3::splat(quarter_m));
        gaussians.strength[part] = strength;
        gaussians.known[part] = known;
        gaussians.part[part] = PART_OF_INFORMATION;
        gaussians.kept[part] = kept.clone();
        gaussians.verdict[part] = Verdict::Published(Standing::Confident);
    }
}

/// Corner 0 to 7 of the cube from −1 to 1.
fn corner_of(corner: u32) -> Vec3 {
    let side = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
    Vec3::new(side(0), side(1), side(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_acoustics::{Beam, Look, LookPose, SymmetricMat3};
    use echosplat_model::glam::Mat3;

    #[test]
    fn eight_parts_send_back_what_the_whole_did() {
        let look = Look {
            pose: LookPose {
                position_m: Vec3::ZERO,
                axes: Mat3::IDENTITY,
                drift_per_m: Vec3::ZERO,
                reference_range_m: 5.0,
            },
            range_start_m: 0.0,
            bin_length_m: 0.02,
            bin_count: 500,
            range_variance_m2: 1e-4,
            azimuth_variance_rad2: 0.0,
            beam: Beam::default(),
        };
        let energy = |mean_m: Vec3, sigma_m: f32| {
            let splat = look.project(mean_m, &SymmetricMat3::isotropic(sigma_m));
            splat.unwrap().energy
        };
        let middle_m = Vec3::new(6.0, 0.01, 0.5);
        let parts: f32 = (0..8)
            .map(|corner| PART_OF_STRENGTH * energy(middle_m + corner_of(corner) * 0.0125, 0.0125))
            .sum();
        let whole = energy(middle_m, 0.025);
        // Together they are a little narrower than the whole, so the beam takes in more of them.
        assert!((parts / whole - 1.0).abs() < 0.1, "{parts} of {whole}");
    }
}
