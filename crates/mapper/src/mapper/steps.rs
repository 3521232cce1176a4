//! The map refined while the dive goes on, a step at a time.

use super::status::{Budget, OptimizeReport};
use super::{Mapper, TAIL_PART};
use crate::assess::tails;
use crate::expectation::maximise;
use crate::history::Past;
use crate::parts::{Extent, MapCues, decide};

/// Most and least pings of one optimisation step, and about what it may cost in pairs: in a crowded
/// map many small steps sort out candidates sooner than a few large ones.
const MOST_PINGS: f64 = 512.0;
const LEAST_PINGS: f64 = 96.0;
const STEP_PAIRS: f64 = 2.5e6;
/// One part in so many of a step's pings are the newest.
const NEWEST_PART: usize = 4;
/// What a ping costs even if it sees no Gaussian, in pairs.
const LEAST_PAIRS_PER_LOOK: u64 = 1000;
/// A running map lets go of tails after so many steps, and of that judgement when it has seen
/// twice as many pings.
const STEPS_BETWEEN_DROPS: usize = 8;
/// Pings asked whether they see the newest echo, within so far of its middle.
const RETURN_SAMPLE: usize = 256;
const RETURN_RADIUS_M: f32 = 2.0;
/// Exponent of the multiplicative rule on part of the pings; ½ would be that of gamma speckle.
const PART_STEP: f32 = 0.35;

impl Mapper {
    /// Refines the map on the newest pings and some of the older ones, step by step, until the
    /// budget is used or a step finds nothing to look at.
    pub fn optimize(&mut self, budget: Budget) -> OptimizeReport {
        let mut report = OptimizeReport::default();
        while report.pairs < budget.pairs && self.gaussians.alive_count() > 0 {
            let pairs = self.step();
            report.pairs += pairs;
            report.iterations += 1;
            // No ping of use to look at: until new ones come, another step finds no more.
            if pairs == 0 {
                break;
            }
        }
        self.status.iterations += report.iterations;
        report
    }

    fn step(&mut self) -> u64 {
        self.decide();
        let (floor, at_work) = (self.floor(), self.at_work);
        let Some(world) = &self.world else { return 0 };
        let pings = self.history.pings();
        let affordable = STEP_PAIRS / self.pairs_per_ping.max(1.0);
        let count = affordable.clamp(LEAST_PINGS, MOST_PINGS) as usize;
        let newest = pings.len().saturating_sub(count / NEWEST_PART);
        let stride = (newest / (count - count / NEWEST_PART)).max(1);
        self.cursor += 1;
        let offset = self.cursor.wrapping_mul(7) % stride;
        let older = match at_work.reservoir {
            true => &pings[..newest],
            false => &[],
        };
        let older = older.iter().skip(offset).step_by(stride);
        let looked_at = older.chain(&pings[newest..]);
        let subset: Vec<&Past> = looked_at.filter(|past| self.is_of_use(past)).collect();
        let (evidence, gaussians) = (&world.evidence, &mut self.gaussians);
        let pairs = self
            .pool
            .install(|| maximise(evidence, gaussians, &subset, floor, PART_STEP, at_work));
        let looks = subset.len() as u64;
        self.worked(pairs, looks as usize);
        if self.cursor.is_multiple_of(STEPS_BETWEEN_DROPS) {
            self.drop_tails(TAIL_PART);
        }
        pairs.max(looks * LEAST_PAIRS_PER_LOOK)
    }

    /// What one look at a ping takes of a budget, as of the last work done.
    #[must_use]
    pub fn pairs_per_look(&self) -> f64 {
        self.pairs_per_ping.max(LEAST_PAIRS_PER_LOOK as f64)
    }

    /// Which parts the dive so far asks for.
    pub(super) fn decide(&mut self) {
        let voxel_m = self.world.as_ref().map_or(0.0, |w| w.evidence.voxel_m());
        let map = MapCues {
            voxel_m,
            return_share: self.return_share(),
            redundant: self.status.pings_redundant,
        };
        (self.at_work, self.left_out) = decide(&self.config.parts, &self.cues, map);
    }

    /// Share of the remembered pings that see the place of the newest echo.
    fn return_share(&self) -> f32 {
        let pings = self.history.pings();
        let Some(newest) = pings
            .iter()
            .rev()
            .find(|past| !past.profile.echoes.is_empty())
        else {
            return 1.0;
        };
        let place_m = newest.first_echo_m();
        let sample = pings.iter().step_by(pings.len() / RETURN_SAMPLE + 1);
        let (mut seen, mut all) = (0, 0);
        for past in sample {
            all += 1;
            seen += u32::from(past.fan.touches(place_m, RETURN_RADIUS_M));
        }
        seen as f32 / all as f32
    }

    /// Whether a ping says something of strengths: where it heard nothing, evidence has taken away
    /// what it could contradict.
    pub(super) fn is_of_use(&self, past: &Past) -> bool {
        self.at_work.empty == Extent::All || !past.profile.echoes.is_empty()
    }

    /// Lets go of candidates below `part` of their strongest neighbour.
    pub(super) fn drop_tails(&mut self, part: f32) {
        let Some(world) = &mut self.world else { return };
        let (gaussians, voxel_m) = (&self.gaussians, world.evidence.voxel_m());
        for slot in self.pool.install(|| tails(gaussians, voxel_m, part)) {
            let (block, voxel) = self.gaussians.home[slot];
            world.evidence.block_mut(block).bar(voxel, slot as u32);
            self.gaussians.remove(slot as u32);
        }
    }
}
