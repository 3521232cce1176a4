//! The end of a dive: the map worked out anew from everything remembered.

use echosplat_model::{Snapshot, Switch};

use super::intake::doubt_multiples;
use super::{Mapper, NEWBORN_STRENGTH, TAIL_PART, births};
use crate::expectation::{localise, maximise, over_pings, pulls};
use crate::gaussians::{Lobes, Sides, Verdict};
use crate::history::{Past, every};
use crate::parts::{Extent, LeftOut};
use crate::shape::align;

/// What all Gaussians start with, alike.
const EVEN_STRENGTH: f32 = 0.2;
/// Looks made at each ping, all its steps together.
const FINISH_LOOKS_PER_PING: f64 = 7.5;
/// A step of a finished dive looks at every so many-th ping.
const INTERLEAVE: f64 = 8.0;
/// The last assessment looks at every so many-th ping.
const LAST_STRIDE: f64 = 3.0;
/// A place that few looks lit, since it glints, is asked for less evidence.
const SPAWN_PART_OF_GLINTS: f32 = 0.667;
/// With more candidates than this, all that any side saw dark is doubted in full.
const MOST_PLACES: usize = 400_000;
/// Steps after which tails are let go.
const ROUND_STEPS: usize = 4;
/// Pairs of each Gaussian in one pass over a dive, beyond which more pings say nothing new.
const ENOUGH_PAIRS: f64 = 12_000.0;
/// So many times fewer looks see every ping about once over all steps.
const NEVER_TWICE: f64 = FINISH_LOOKS_PER_PING;
/// Steps of offset from one step to the next.
pub(super) const OFFSET_STRIDE: f64 = 5.0;
/// Exponent of the multiplicative rule for gamma speckle.
const FULL_STEP: f32 = 0.5;

impl Mapper {
    /// Ends a dive: what is pending is taken in, and strengths, positions and shapes are worked out
    /// anew from the whole history, within about `finish_pairs`.
    pub fn finish(&mut self) -> Snapshot {
        if !self.waiting.is_empty() {
            self.take_in_slice();
        }
        self.decide();
        self.judge_anew();
        self.lift_bars();
        // Steps without end sharpen noise, so that a finished map starts even and stops early.
        let newborn = Lobes::even(EVEN_STRENGTH * self.unit_strength);
        self.gaussians.strength.fill(newborn);
        self.gaussians.known.fill(Sides::default());
        // Nor may it depend on when the map was looked at.
        self.gaussians.verdict.fill(Verdict::ExplainedAway);
        let steps = self.config.finish_passes;
        // Few looks sort out most candidates; the rest is worth all of them.
        self.pairs_per_ping = self.count_pairs_per_ping();
        self.sort_out(steps, 4.0 * INTERLEAVE);
        self.sort_out(steps, INTERLEAVE);
        for _ in 0..2 {
            self.localise_every(2.0);
            self.interleaved_steps(steps / 3, INTERLEAVE);
        }
        self.assess_every(2.0 * self.thinning());
        if self.at_work.splitting {
            self.split_confident();
            self.interleaved_steps(steps / 5, INTERLEAVE);
            self.drop_tails(TAIL_PART);
            self.localise_every(2.0);
        }
        self.interleaved_steps(steps / 8, INTERLEAVE);
        self.assess_every(LAST_STRIDE * self.thinning());
        if self.at_work.anisotropy
            && let Some(world) = &self.world
        {
            let (gaussians, voxel_m) = (&mut self.gaussians, world.evidence.voxel_m());
            self.pool.install(|| align(gaussians, voxel_m));
        }
        self.publish()
    }

    /// Judges every ping by what is now known of the seabed and of multiples, and sums up all evidence anew.
    fn judge_anew(&mut self) {
        let Some(world) = &mut self.world else { return };
        let as_heard = !self.seabed.is_there() && self.multiples.ratios().is_empty();
        if as_heard && !self.is_evidence_put_down {
            return;
        }
        for past in self.history.pings_mut() {
            let ground = self.seabed.backdrop(&past.look, past.brightness);
            let intensity: Vec<f32> = past.profile.intensity.iter().collect();
            past.profile.doubted = Box::default();
            past.profile.judge(&intensity, &ground);
            doubt_multiples(
                &self.multiples,
                &past.look,
                &intensity,
                &ground,
                &mut past.profile,
            );
        }
        let pings = self.history.pings();
        let extent = self.at_work.converged;
        let evidence = &mut world.evidence;
        self.status.voxel_looks += self.pool.install(|| evidence.integrate_anew(pings, extent));
        self.is_evidence_put_down = false;
    }

    /// Makes every place with enough evidence a candidate again.
    fn lift_bars(&mut self) {
        let Some(world) = &mut self.world else { return };
        let mut spawn = self.config.spawn_evidence;
        world.evidence.expect_glints(self.at_work.glints);
        if self.at_work.glints {
            let of_glints = SPAWN_PART_OF_GLINTS * spawn;
            let places = births::count(&world.evidence, of_glints);
            if places > MOST_PLACES && self.config.parts.glints == Switch::Auto {
                world.evidence.expect_glints(false);
                self.left_out.push(LeftOut::glints_of_crowd(places));
            } else {
                spawn = of_glints;
            }
        }
        world.evidence.begin_anew();
        let strength = NEWBORN_STRENGTH * self.unit_strength;
        births::follow_evidence(&mut world.evidence, &mut self.gaussians, spawn, strength);
        // What follows needs the room.
        world.evidence.put_down();
        self.is_evidence_put_down = true;
    }

    /// How many times fewer looks a finish makes do with, at least 1: to stay within its work, and
    /// since what has been seen often enough gains nothing.
    fn thinning(&self) -> f64 {
        let pings = self.history.pings().len() as f64;
        let pass = pings * self.pairs_per_ping;
        let within_work = FINISH_LOOKS_PER_PING * pass / self.config.finish_pairs as f64;
        let gaussians = self.gaussians.alive_count().max(1) as f64;
        let enough = match self.at_work.converged {
            Extent::All => 0.0,
            Extent::Useful => pass / (ENOUGH_PAIRS * gaussians),
            Extent::None => NEVER_TWICE,
        };
        // At least some dozens of looks a step, however crowded the map.
        let most = (pings / (64.0 * INTERLEAVE)).max(1.0);
        within_work.max(enough).clamp(1.0, most)
    }

    fn count_pairs_per_ping(&self) -> f64 {
        let Some(world) = &self.world else { return 0.0 };
        let pings = self.history.pings();
        let sample: Vec<&Past> = pings.iter().step_by(pings.len() / 64 + 1).collect();
        let scene = self.scene(world);
        let count = || over_pings::<(), ()>(scene, &sample, |_, (), _, _| ());
        let (_, pairs) = self.pool.install(count);
        pairs as f64 / sample.len().max(1) as f64
    }

    pub(super) fn worked(&mut self, pairs: u64, looks: usize) {
        self.status.pairs += pairs;
        if looks > 0 {
            self.pairs_per_ping = pairs as f64 / looks as f64;
        }
    }

    /// Steps in rounds, each of which lets go of what has become a tail.
    fn sort_out(&mut self, steps: usize, interleave: f64) {
        let mut left = steps;
        while left > 0 {
            let round = left.min(ROUND_STEPS);
            self.interleaved_steps(round, interleave);
            self.drop_tails(TAIL_PART);
            left -= round;
        }
    }

    /// Multiplicative steps, each over every `interleave`-th ping, the next over the ones beside.
    fn interleaved_steps(&mut self, steps: usize, interleave: f64) {
        let interleave = interleave * self.thinning();
        for step in 0..steps {
            // A stride through the offsets keeps neighbouring steps on different sweeps.
            let offset = (step as f64 * OFFSET_STRIDE) % interleave;
            let mut subset = every(self.history.pings(), offset, interleave);
            subset.retain(|past| self.is_of_use(past));
            let looks = subset.len();
            let (floor, at_work) = (self.floor(), self.at_work);
            let Some(world) = &self.world else { return };
            let (evidence, gaussians) = (&world.evidence, &mut self.gaussians);
            let pairs = self
                .pool
                .install(|| maximise(evidence, gaussians, &subset, floor, FULL_STEP, at_work));
            self.worked(pairs, looks);
            self.status.iterations += 1;
        }
    }

    fn localise_every(&mut self, stride: f64) {
        let Some(world) = &self.world else { return };
        let pings = every(self.history.pings(), 0.0, stride * self.thinning());
        let looks = pings.len();
        let voxel_m = world.evidence.voxel_m();
        let scene = self.scene(world);
        let (pulls, pairs) = self.pool.install(|| pulls(scene, &pings));
        localise(&mut self.gaussians, &pulls, 0.5 * voxel_m, voxel_m);
        self.worked(pairs, looks);
    }
}
