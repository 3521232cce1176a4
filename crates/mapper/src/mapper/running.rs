//! What is known of each Gaussian while the dive goes on: a running estimate of what all pings say
//! of it, brought up to date by a few of them at a time.
//!
//! Cost of a map: two sights for each ping that is new since the last one, not the whole dive.

use echosplat_model::GaussianId;

use super::Mapper;
use super::finish::OFFSET_STRIDE;
use crate::assess::{Demand, Finding, Rule, findings, judge};
use crate::expectation::Sum;
use crate::gaussians::Gaussians;
use crate::history::{Past, every};

/// Older pings looked at once more for each new one.
const OLDER_PER_NEW: usize = 1;
/// Fewest older pings looked at.
const FEWEST_OLDER: usize = 8;
/// Pings that an estimate is made of, about: older looks are forgotten as newer ones come, since the
/// map around the Gaussian has changed.
const REMEMBERED: usize = 768;

/// Estimates per slot.
#[derive(Debug, Default)]
pub(super) struct Running {
    estimates: Vec<Estimate>,
    /// Pings taken in when it was last brought up to date.
    through: u64,
    cursor: usize,
}

/// Of what all pings so far say of one Gaussian.
#[derive(Debug, Clone, Copy, Default)]
struct Estimate {
    of: GaussianId,
    /// How much of an estimate it is yet, 0 to 1: it starts from nothing.
    mass: f32,
    /// That much of it.
    finding: Finding,
    /// Whether the pings taken in last saw it.
    is_news: bool,
}

impl Estimate {
    /// Older looks, as many as if all had been made again, count `part`.
    fn blend(&mut self, older: Finding, part: f32) {
        self.finding = self.finding.times(1.0 - part);
        self.finding.join(&older.times(part));
        self.mass += part * (1.0 - self.mass);
    }

    /// New looks, made once each.
    fn add(&mut self, new: Finding) {
        self.finding.join(&new.times(self.mass));
    }

    fn whole(&self) -> Finding {
        self.finding.times(1.0 / self.mass)
    }
}

impl Running {
    /// What all pings so far say of a slot, if the last ones saw it.
    fn news(&self, slot: usize) -> Option<Finding> {
        let estimate = &self.estimates[slot];
        estimate.is_news.then(|| estimate.whole())
    }

    /// Takes in what older pings say, each for `older_stride`, and what new ones do.
    fn take_in(&mut self, gaussians: &Gaussians, older: &Looks, new: &Looks) {
        self.estimates
            .resize(gaussians.slot_count(), Estimate::default());
        for slot in gaussians.slots() {
            let estimate = &mut self.estimates[slot];
            if estimate.of != gaussians.id[slot] {
                *estimate = Estimate {
                    of: gaussians.id[slot],
                    ..Estimate::default()
                };
            }
            estimate.is_news = older.findings[slot].is_any() || new.findings[slot].is_any();
            estimate.blend(older.findings[slot].times(older.stride), older.part);
            estimate.add(new.findings[slot].times(new.stride));
        }
    }
}

/// What some pings say.
#[derive(Default)]
struct Looks {
    findings: Vec<Finding>,
    /// For how many each stands.
    stride: f32,
    /// Of as many as an estimate is made of.
    part: f32,
}

impl Mapper {
    /// Verdicts as of now, by the new pings and some older ones.
    pub(super) fn judge_running(&mut self) {
        let pings = self.history.pings();
        let taken_in = pings.len() as u64 + self.history.thinned();
        let fresh = (taken_in - self.running.through).min(pings.len() as u64) as usize;
        let (older, new) = pings.split_at(pings.len() - fresh);
        let count = (OLDER_PER_NEW * fresh).clamp(FEWEST_OLDER, REMEMBERED);
        let (older, older_pairs) = self.look_again(older, count, self.running.cursor);
        let (new, new_pairs) = self.look_again(new, REMEMBERED, 0);
        self.running.take_in(&self.gaussians, &older, &new);
        self.running.through = taken_in;
        self.running.cursor += 1;
        self.status.pairs += older_pairs + new_pairs;
        let voxel_m = self.world.as_ref().map_or(0.0, |w| w.evidence.voxel_m());
        let running = &self.running;
        let demand = Demand::of(&self.config, self.at_work);
        let gaussians = &mut self.gaussians;
        self.pool
            .install(|| judge(gaussians, |slot| running.news(slot), voxel_m, demand));
        self.doubt_underground();
    }

    /// At about `count` of `pings`, others at the next turn.
    fn look_again(&self, pings: &[Past], count: usize, turn: usize) -> (Looks, u64) {
        let stride = (pings.len() as f64 / count as f64).max(1.0);
        let sample = every(pings, turn as f64 * OFFSET_STRIDE % stride, stride);
        let Some(world) = &self.world else {
            return (Looks::default(), 0);
        };
        let scene = self.blurred_scene(world);
        let rule = Rule::of(&scene, &self.config);
        let (findings, pairs) = self.pool.install(|| findings(scene, &sample, rule));
        let remembered = pings.len().min(REMEMBERED);
        let looks = Looks {
            findings,
            stride: stride as f32,
            part: match pings.is_empty() {
                true => 1.0,
                false => (sample.len() as f32 / remembered as f32).min(1.0),
            },
        };
        (looks, pairs)
    }
}
