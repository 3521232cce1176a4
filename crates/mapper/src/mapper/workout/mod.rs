//! Tiles worked out: strengths, places, shapes and verdicts of their Gaussians from the pings that see them,
//! beside what stands around held still.
//!
//! The one process of estimation. Work is done in portions, on a draft; the map shows the tiles as they were until
//! the draft is done.
//!
//! Cost: about nine visits to each ping that sees the tiles, four of them at few Gaussians; four where it starts from the map,
//! fewer where more would say nothing new, up to eight times as many where few pings see each place.

mod draft;
mod keep;
mod placing;

use std::collections::VecDeque;
use std::sync::Arc;

use echosplat_measurement::heard::Detail;
use echosplat_model::Reason;
use echosplat_model::glam::Vec3;
use rayon::prelude::*;

use crate::MapperConfig;
use crate::accumulate::evidence::{BlockIndex, TileIndex, VOXELS};
use crate::accumulate::fan::Reach;
use crate::accumulate::finding::Finding;
use crate::accumulate::history::{History, Keyframe, every};
use crate::classify::assess::{
    Desk, Rule, VerdictThresholds, findings_of_ping, idle, judge, side_lobes,
};
use crate::classify::certainty;
use crate::effort::{Counted, Task};
use crate::features::{AtWork, Extent, LeftOut};
use crate::mapper::schedule::{Action, Due, INTERLEAVE, Start, actions};
use crate::refine::expectation::{
    Done, Explained, Pace, Pass, Score, StepSums, localise, maximise, scores_of_ping,
    strengths_of_ping,
};
use crate::refine::field::Field;
use crate::refine::inherit::inherit;
use crate::refine::refill::{Candidate, refill};
use crate::refine::shape::align;
use crate::refine::terms::PassTerms;
use crate::seabed::Seabed;
use crate::spawn::gaussians::{Gaussians, Verdict};
use crate::spawn::split::split_confident;
use crate::world::World;
pub(crate) use keep::keep;

/// Fraction of the strongest neighbour; found.
/// Candidates below this fraction of their strongest neighbour are its side lobes, not worth further work.
const SIDE_LOBE_FRACTION: f32 = 0.05;
/// Fraction, found: half was tried.
/// While the dive goes on the steps of a work-out take at most this fraction of the pairs that its pings allowed, since what
/// it shows is as old when it is done.
const LAG: f64 = 0.25;
/// Visits, derived from the schedule.
/// Visits to each ping, all steps together, by how many Gaussians there are then.
const VISITS_PER_PING: f64 = 7.5;
/// Pairs a Gaussian; found.
/// Pairs of each Gaussian in one pass over the pings, beyond which more pings say nothing new to a step.
const ENOUGH_PAIRS: f64 = 6_000.0;
/// Pairs a Gaussian, found: a fifth of speckle.
/// Pairs of each Gaussian that a step has at least, if there are so many: some two dozen observations of a dozen bins. Speckle
/// leaves a step of fewer more than a fifth, and what is moved to and fro by that much is smeared along its arcs.
const LEAST_PAIRS_OF_STEP: f64 = 300.0;
/// Fraction; found.
/// The fraction of them that a step from the map needs, since the map knows the rest.
const ENOUGH_FROM_MAP: f64 = 0.125;
/// Pairs a Gaussian; found.
/// Pairs of each Gaussian beyond which more pings say nothing new to its verdict; the map knows nothing of that.
const ENOUGH_PAIRS_OF_VERDICTS: f64 = 12_000.0;
/// Ratio; derived.
/// With this thinning factor all steps together visit every ping about once.
const NEVER_TWICE: f64 = VISITS_PER_PING;
/// Pings, derived: prime to the interleave.
/// Steps of offset from one step to the next.
const OFFSET_STRIDE: f64 = 5.0;
/// Pings; bounds work.
/// Pings that tell how many pairs each has.
const SAMPLE: usize = 64;
/// Pairs, bounds latency: about 10 ms.
/// Pairs of a portion, about 10 ms on two cores; of a crowded map it has more, since it has at least two chunks of pings.
const PORTION_PAIRS: f64 = 2e6;

/// Pairs, measured on a pier: 1.6.
/// A pair of an assessment takes as long as so many of a step.
const PAIRS_OF_A_FINDING: u64 = 2;
/// Pairs, measured on a pier: 40 to 80.
/// Work that needs the neighbours of every Gaussian and no ping takes as long as so many pairs of each: beginning and ending a
/// work-out, filling again, verdicts, shapes. Letting go of some takes far less and is not counted.
const PAIRS_OF_A_CHANGE: u64 = 50;

/// What a portion took.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Effort {
    /// Pairs of a ping and a Gaussian.
    pub(crate) pairs: u64,
    /// Steps' pairs that take as long as what was done beside those.
    pub(crate) beside_pairs: u64,
    /// What was looked at, whether or not it counts as work.
    pub(crate) counted: Counted,
}

impl Effort {
    fn of(counted: Counted) -> Self {
        Self {
            pairs: counted.pairs,
            beside_pairs: 0,
            counted,
        }
    }

    fn beside(candidates: u64, beside_pairs: u64) -> Self {
        Self {
            pairs: 0,
            beside_pairs,
            counted: Counted {
                candidates,
                ..Counted::default()
            },
        }
    }
}

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
    CountPairs,
    Strengthen(Pass<StepSums>, f32, Pace),
    Localise(Pass<Score>),
    Assess(Pass<Finding>, Rule, f32),
    Judge(Vec<Finding>, f32),
    /// Findings of those that are worked on; the verdicts are given.
    TellCertainty(Vec<Option<Finding>>),
}

/// Some tiles while they are worked out.
#[derive(Debug)]
pub(crate) struct Workout {
    /// Tiles, and how many observations each had.
    tiles: Vec<(TileIndex, f32)>,
    start: Start,
    /// Blocks in them, and the voxels that are worked out: candidates, and what was one before.
    blocks: Vec<(BlockIndex, Mask)>,
    /// Until the draft is filled again from them.
    candidates: Vec<Candidate>,
    pings: Vec<Arc<Keyframe>>,
    draft: Gaussians,
    /// Of the draft as it was in the last pass; none where Gaussians came or changed their shapes since.
    field: Option<Field>,
    /// Whether any moved since.
    has_moved: bool,
    at_work: AtWork,
    thresholds: VerdictThresholds,
    most_pairs: f64,
    /// The same were there no need to be done soon.
    most_pairs_in_full: f64,
    voxel_m: f32,
    pairs_per_ping: f64,
    actions: VecDeque<Action>,
    doing: Option<Doing>,
    /// What each slot explained since side lobes were last suppressed.
    explained: Explained,
    iterations: u64,
    /// Whether it visits fewer pings than it would if there were time.
    is_hurried: bool,
}

/// What a work-out is told beside the pings.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Terms<'a> {
    pub(crate) config: &'a MapperConfig,
    pub(crate) at_work: AtWork,
    /// Strength that a typical echo needs of a Gaussian of one voxel.
    pub(crate) unit_strength: f32,
}

/// Pairs that a work-out over so many pings may take.
fn most_pairs(config: &MapperConfig, is_live: bool, pings: usize) -> f64 {
    let in_full = config.workout_pairs as f64;
    match is_live {
        true => in_full.min(LAG * pings as f64 * config.work_pairs_per_ping as f64),
        false => in_full,
    }
}

impl Workout {
    /// Of these tiles. `left_out` is told what they do without.
    pub(crate) fn begin(
        world: &World,
        map: &Gaussians,
        history: &History,
        due: Due,
        terms: Terms<'_>,
        left_out: &mut Vec<LeftOut>,
    ) -> Self {
        let Due {
            tiles,
            start,
            is_live,
        } = due;
        let (evidence, voxel_m) = (&world.evidence, world.evidence.voxel_m());
        let radius_m = evidence.tile_radius_m();
        let centers_m: Vec<Vec3> = tiles
            .iter()
            .map(|&tile| evidence.tiles()[tile as usize].center_m)
            .collect();
        let sees = |keyframe: &&&Arc<Keyframe>| {
            let is_of_use =
                terms.at_work.empty == Extent::All || !keyframe.profile.echoes.is_empty();
            is_of_use
                && centers_m
                    .iter()
                    .any(|&at_m| keyframe.fan.touches(at_m, radius_m))
        };
        let reaches = |reach: &Reach| centers_m.iter().any(|&at_m| reach.touches(at_m, radius_m));
        let remembered = history.within_reach(history.pings().len(), reaches);
        let remembered: Vec<&Arc<Keyframe>> = remembered.collect();
        let pings = remembered.par_iter().filter(sees);
        let pings: Vec<Arc<Keyframe>> = pings.map(|&keyframe| Arc::clone(keyframe)).collect();
        let mut workout = Self {
            tiles: Vec::new(),
            start,
            blocks: Vec::new(),
            candidates: Vec::new(),
            draft: Gaussians::default(),
            field: None,
            has_moved: false,
            at_work: terms.at_work,
            thresholds: VerdictThresholds::of(terms.config, terms.at_work),
            most_pairs: most_pairs(terms.config, is_live, pings.len()),
            most_pairs_in_full: terms.config.workout_pairs as f64,
            pings,
            voxel_m,
            pairs_per_ping: 0.0,
            actions: actions(terms.config.workout_passes, start, terms.at_work),
            doing: Some(Doing::CountPairs),
            explained: Explained::default(),
            iterations: 0,
            is_hurried: false,
        };
        let skips_suppressed = is_live && start == Start::Map;
        workout.take_candidates(world, map, &tiles, skips_suppressed, terms, left_out);
        match start {
            Start::Even => {
                let draft = &workout.draft;
                let candidate = |slot: usize| (draft.home_m[slot], draft.home[slot]);
                workout.candidates = draft.slots().map(candidate).collect();
            }
            Start::Map => {
                let blocks = workout.blocks.iter();
                let known = blocks.flat_map(|&(block, _)| evidence.block(block).gaussians.iter());
                let known: Vec<u32> = known.map(|&(_, slot)| slot).collect();
                inherit(&mut workout.draft, map, &known, voxel_m);
            }
        }
        workout.take_background(world, map, &tiles);
        let observations = |tile: TileIndex| (tile, evidence.tiles()[tile as usize].observations);
        workout.tiles = tiles.into_iter().map(observations).collect();
        workout
    }

    /// Counts the pairs of some pings, and tells from them how many of all there is time for.
    fn count_pairs(&mut self, world: &World) -> Counted {
        let sample: Vec<Arc<Keyframe>> = self
            .pings
            .iter()
            .step_by(self.pings.len() / SAMPLE + 1)
            .map(Arc::clone)
            .collect();
        let count = sample.len();
        let mut pass = Pass::<StepSums>::over(sample, self.field(world));
        let counted = pass.advance(
            self.terms(false),
            count,
            Detail::Strength,
            |_, (): &mut (), _, _| (),
        );
        self.pairs_per_ping = counted.pairs as f64 / count.max(1) as f64;
        self.is_hurried =
            self.thinning_factor(self.most_pairs) > self.thinning_factor(self.most_pairs_in_full);
        if self.is_hurried {
            self.thresholds = self.thresholds.in_haste();
        }
        counted
    }

    fn terms(&self, is_blurred: bool) -> PassTerms {
        PassTerms {
            is_blurred,
            at_work: self.at_work,
        }
    }

    /// Whether what is under way is the last assessment.
    fn is_last_assessment(&self) -> bool {
        let is_assessment = |action: &Action| matches!(action, Action::Assess { .. });
        !self.actions.iter().any(is_assessment)
    }

    /// Thinning factor of a step: it takes one ping in so many of every [`INTERLEAVE`]-th; below 1 where there are few.
    fn thinning_factor(&self, most_pairs: f64) -> f64 {
        let fraction = match self.start {
            Start::Even => 1.0,
            Start::Map => ENOUGH_FROM_MAP,
        };
        let least = self.pairs_of_each() / (INTERLEAVE * fraction * LEAST_PAIRS_OF_STEP);
        let least = least.clamp(INTERLEAVE.recip(), 1.0);
        self.thinning_factor_to(most_pairs, fraction * ENOUGH_PAIRS, least)
    }

    /// Pairs of each Gaussian in one pass over all pings.
    fn pairs_of_each(&self) -> f64 {
        let gaussians = self.draft.alive_count().max(1) as f64;
        self.pings.len() as f64 * self.pairs_per_ping / gaussians
    }

    /// The same for the last assessment, at least 1: the map knows nothing of verdicts, and they are worth more work than
    /// pings allow.
    fn thinning_factor_of_verdicts(&self) -> f64 {
        self.thinning_factor_to(self.most_pairs_in_full, ENOUGH_PAIRS_OF_VERDICTS, 1.0)
    }

    /// Thinning factor, at least `least`: to stay within the work allowed, and since what has been seen often enough, by pairs
    /// of each Gaussian, gains nothing.
    fn thinning_factor_to(&self, most_pairs: f64, enough_pairs: f64, least: f64) -> f64 {
        let pings = self.pings.len() as f64;
        let within_work = VISITS_PER_PING * pings * self.pairs_per_ping / most_pairs;
        let enough = match self.at_work.converged {
            Extent::All => 0.0,
            Extent::Useful => self.pairs_of_each() / enough_pairs,
            Extent::None => NEVER_TWICE,
        };
        // At least some dozens of pings a step, however crowded the map.
        let most = (pings / (64.0 * INTERLEAVE)).max(1.0);
        within_work.max(enough).clamp(least, most)
    }

    pub(crate) fn tile_count(&self) -> u64 {
        self.tiles.len() as u64
    }

    #[cfg(test)]
    pub(crate) fn candidate_count(&self) -> usize {
        let slots = self.draft.slots();
        slots.filter(|&slot| self.draft.is_worked_on(slot)).count()
    }

    /// Thinning factors of steps and of verdicts.
    #[cfg(test)]
    pub(crate) fn thinning_factors(&self) -> (f64, f64) {
        (
            self.thinning_factor(self.most_pairs),
            self.thinning_factor_of_verdicts(),
        )
    }

    /// Whether nothing is left to do.
    pub(crate) fn is_done(&self) -> bool {
        self.doing.is_none() && self.actions.is_empty()
    }

    /// What the next portion is.
    pub(crate) fn task(&self) -> Task {
        match &self.doing {
            Some(Doing::CountPairs) => Task::Begin,
            Some(Doing::Strengthen(..)) => Task::Strengthen,
            Some(Doing::Localise(_)) => Task::Localise,
            Some(Doing::Assess(..)) => Task::Assess,
            Some(Doing::Judge(..) | Doing::TellCertainty(_)) => Task::Judge,
            None => match self.actions.front() {
                Some(Action::Strengthen { .. }) => Task::Strengthen,
                Some(Action::Localise) => Task::Localise,
                Some(Action::Assess { .. }) => Task::Assess,
                _ => Task::Change,
            },
        }
    }

    /// Does the next portion.
    pub(crate) fn advance(&mut self, world: &World, seabed: &Seabed) -> Effort {
        if let Some(doing) = self.doing.take() {
            return self.go_on(doing, world, seabed);
        }
        let Some(action) = self.actions.pop_front() else {
            return Effort::default();
        };
        let (held, change_pairs) = (self.held(), self.change_pairs());
        self.begin_action(action, world);
        match action {
            Action::Refill | Action::Split | Action::Align => Effort::beside(held, change_pairs),
            Action::SuppressSideLobes | Action::DropIdle => Effort::beside(held, 0),
            _ => Effort::default(),
        }
    }

    /// Pairs that take as long as a search around every Gaussian.
    pub(crate) fn change_pairs(&self) -> u64 {
        PAIRS_OF_A_CHANGE * self.held()
    }

    /// Gaussians of the draft.
    pub(crate) fn held(&self) -> u64 {
        self.draft.alive_count() as u64
    }

    fn begin_action(&mut self, action: Action, world: &World) {
        match action {
            Action::Strengthen {
                step,
                interleave,
                pace,
            } => {
                let interleave = interleave * self.thinning_factor(self.most_pairs);
                // A stride through the offsets keeps neighbouring steps on different sweeps.
                let pings = every(
                    &self.pings,
                    (step as f64 * OFFSET_STRIDE) % interleave,
                    interleave,
                );
                let pass = Pass::over(pings, self.field(world));
                self.doing = Some(Doing::Strengthen(pass, interleave as f32, pace));
            }
            Action::Localise => {
                let stride = (2.0 * self.thinning_factor(self.most_pairs)).max(1.0);
                let pings = every(&self.pings, 0.0, stride);
                let pass = Pass::over(pings, self.field(world));
                self.doing = Some(Doing::Localise(pass));
            }
            Action::Assess { stride } => {
                let thinning_factor = match self.is_last_assessment() {
                    true => self.thinning_factor_of_verdicts(),
                    false => self.thinning_factor(self.most_pairs).max(1.0),
                };
                let stride = stride * thinning_factor;
                let pings = every(&self.pings, 0.0, stride);
                let pass = Pass::over(pings, self.field(world));
                let rule = Rule::of(&self.draft, self.voxel_m, self.at_work, self.thresholds);
                self.doing = Some(Doing::Assess(pass, rule, stride as f32));
            }
            Action::SuppressSideLobes => {
                self.explained = Explained::default();
                self.change(|draft, voxel_m| {
                    draft.remove_all(&side_lobes(draft, voxel_m, SIDE_LOBE_FRACTION));
                });
            }
            Action::DropIdle => {
                let explained = std::mem::take(&mut self.explained);
                self.change(|draft, _| draft.remove_all(&idle(draft, &explained)));
            }
            Action::Refill => {
                let candidates = std::mem::take(&mut self.candidates);
                self.field = None;
                self.change(|draft, voxel_m| refill(draft, &candidates, voxel_m));
            }
            Action::Split => {
                self.field = None;
                split_confident(&mut self.draft, self.voxel_m);
            }
            Action::Align => {
                self.field = None;
                align(&mut self.draft, self.voxel_m);
            }
        }
    }

    /// Changes which Gaussians there are, and how many pairs a ping has with them.
    fn change(&mut self, change: impl FnOnce(&mut Gaussians, f32)) {
        let before = self.draft.alive_count().max(1) as f64;
        change(&mut self.draft, self.voxel_m);
        self.pairs_per_ping *= self.draft.alive_count() as f64 / before;
    }

    fn go_on(&mut self, doing: Doing, world: &World, seabed: &Seabed) -> Effort {
        let count = (PORTION_PAIRS / self.pairs_per_ping.max(1.0)) as usize + 1;
        match doing {
            Doing::CountPairs => {
                let counted = self.count_pairs(world);
                // They are few, and no ping pays for them.
                Effort {
                    counted,
                    ..Effort::default()
                }
            }
            Doing::Strengthen(mut pass, stride, pace) => {
                let (terms, at_work) = (self.terms(false), self.at_work);
                let each = |tally: &mut _, (): &mut (), keyframe: &_, sight: &mut _| {
                    strengths_of_ping(tally, keyframe, sight, at_work);
                };
                let counted = pass.advance(terms, count, Detail::Strength, each);
                if pass.is_done() {
                    let (sums, done) = pass.finish(self.draft.slot_count());
                    self.worked(done);
                    self.explained.add(&self.draft, &sums, stride);
                    maximise(&mut self.draft, &sums, stride, pace, self.at_work);
                    self.iterations += 1;
                } else {
                    self.doing = Some(Doing::Strengthen(pass, stride, pace));
                }
                Effort::of(counted)
            }
            Doing::Localise(mut pass) => {
                let each = |tally: &mut _, (): &mut (), keyframe: &_, sight: &mut _| {
                    scores_of_ping(tally, keyframe, sight);
                };
                let counted = pass.advance(self.terms(false), count, Detail::Full, each);
                if pass.is_done() {
                    let (scores, done) = pass.finish(self.draft.slot_count());
                    self.worked(done);
                    self.has_moved = true;
                    localise(&mut self.draft, &scores, 0.5 * self.voxel_m, self.voxel_m);
                } else {
                    self.doing = Some(Doing::Localise(pass));
                }
                Effort::of(counted)
            }
            Doing::Assess(mut pass, rule, stride) => {
                let draft = &self.draft;
                let each = |tally: &mut _, desk: &mut Desk, keyframe: &_, sight: &mut _| {
                    findings_of_ping(tally, desk, keyframe, sight, draft, rule);
                };
                let count = count.div_ceil(PAIRS_OF_A_FINDING as usize);
                let counted = pass.advance(self.terms(true), count, Detail::Full, each);
                self.doing = Some(match pass.is_done() {
                    true => {
                        let (findings, done) = pass.finish(draft.slot_count());
                        self.field = Some(done.field);
                        Doing::Judge(findings, stride)
                    }
                    false => Doing::Assess(pass, rule, stride),
                });
                Effort {
                    beside_pairs: (PAIRS_OF_A_FINDING - 1) * counted.pairs,
                    ..Effort::of(counted)
                }
            }
            // In two portions, since each keeps pings waiting.
            Doing::Judge(findings, stride) => {
                let findings = self.judge(&findings, stride);
                self.doing = Some(Doing::TellCertainty(findings));
                Effort::beside(self.held(), self.change_pairs() / 2)
            }
            Doing::TellCertainty(findings) => {
                self.tell_certainty(&findings, seabed);
                Effort::beside(self.held(), self.change_pairs() - self.change_pairs() / 2)
            }
        }
    }

    fn worked(&mut self, done: Done) {
        if done.pings > 0 {
            self.pairs_per_ping = done.pairs as f64 / done.pings as f64;
        }
        self.field = Some(done.field);
    }

    /// Of the draft as it is now.
    fn field(&mut self, world: &World) -> Field {
        let has_moved = std::mem::take(&mut self.has_moved);
        match self.field.take() {
            Some(mut field) => {
                field.renew(&world.evidence, &self.draft, has_moved);
                field
            }
            None => Field::of(&world.evidence, &self.draft),
        }
    }

    /// Gives verdicts by these findings, of pings that each stand for `stride`. Returns what they come to with what forgotten
    /// pings told, for those that are worked on.
    fn judge(&mut self, findings: &[Finding], stride: f32) -> Vec<Option<Finding>> {
        let draft = &mut self.draft;
        let all_told = |(slot, finding): (usize, &Finding)| {
            let mut finding = finding.times(stride);
            if let Some(kept) = &draft.kept[slot] {
                finding.add(&kept.finding_of(draft.child_share[slot]));
            }
            draft.is_worked_on(slot).then_some(finding)
        };
        let findings: Vec<_> = findings.par_iter().enumerate().map(all_told).collect();
        judge(draft, |slot| findings[slot], self.voxel_m, self.thresholds);
        findings
    }

    /// Sets how sure each place is, by the verdicts given, and lets go of what the ground would hide.
    fn tell_certainty(&mut self, findings: &[Option<Finding>], seabed: &Seabed) {
        let draft = &mut self.draft;
        certainty::tell(draft, |slot| findings[slot], self.voxel_m);
        // Nothing is seen through the ground.
        for slot in 0..draft.slot_count() {
            if draft.alive[slot] && seabed.hides(draft.mean_m[slot]) {
                draft.verdict[slot] = Verdict::ExplainedAway;
                draft.why[slot].reason = Reason::BelowGround;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn haste_takes_part_of_what_pings_allow_and_the_end_of_the_data_all_that_may_be() {
        let config = MapperConfig {
            work_pairs_per_ping: 1000,
            workout_pairs: 1_000_000,
            ..MapperConfig::default()
        };
        let of = |is_live, pings| most_pairs(&config, is_live, pings);
        assert!((of(true, 100) - LAG * 1e5).abs() < 1.0);
        assert!((of(true, 100_000) - 1e6).abs() < 1.0);
        assert!((of(false, 100) - 1e6).abs() < 1.0);
    }
}
