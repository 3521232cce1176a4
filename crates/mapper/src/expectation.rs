//! Reflectivity by expectation-maximisation, and positions by Fisher scoring.
//!
//! An echo's energy is shared among all Gaussians on its arc; those that other pings see dark
//! give theirs up. The multiplicative step keeps strengths positive and has no learning rate.
//!
//! Cost of a pass: pings × Gaussians in a slice (about 100) × bins of a splat (about 12).

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use echosplat_acoustics::SymmetricMat3;
use echosplat_model::glam::Vec3;
use rayon::prelude::*;

use crate::evidence::Evidence;
use crate::field::Field;
use crate::gaussians::{Gaussians, Lobes};
use crate::history::Past;
use crate::parts::AtWork;
use crate::step::damped_step;
use crate::tally::Tally;
use crate::visibility::{Against, Moments, Row, Sight};

/// Sums are made per chunk and added in order, so that threads do not change them.
const CHUNKS: usize = 16;
/// Exponent for counts over that for gamma speckle.
const COUNTS_STEP: f32 = 2.0;

/// What a pass reads.
#[derive(Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub(crate) evidence: &'a Evidence,
    pub(crate) gaussians: &'a Gaussians,
    /// Least noise power to reckon with.
    pub(crate) floor: f32,
    /// Whether looks are as blurred as their poses may be off.
    pub(crate) is_blurred: bool,
    pub(crate) at_work: AtWork,
}

/// What is summed over pings for a Gaussian.
pub(crate) trait Sum: Default + Clone + Send {
    /// Adds what another chunk of pings found.
    fn join(&mut self, part: &Self);
}

/// Nothing is summed.
impl Sum for () {
    fn join(&mut self, (): &Self) {}
}

/// Sums of chunks, added in their order as they come. All at once would take more room than the map.
struct InOrder<T> {
    sums: Vec<T>,
    pairs: u64,
    next: usize,
    waiting: BTreeMap<usize, (Tally<T>, u64)>,
}

impl<T: Sum> InOrder<T> {
    fn new(slot_count: usize) -> Self {
        Self {
            sums: vec![T::default(); slot_count],
            pairs: 0,
            next: 0,
            waiting: BTreeMap::new(),
        }
    }

    fn add(&mut self, chunk: usize, part: (Tally<T>, u64)) {
        self.waiting.insert(chunk, part);
        while let Some((tally, pairs)) = self.waiting.remove(&self.next) {
            for (slot, sum) in tally.sums() {
                self.sums[slot].join(sum);
            }
            self.pairs += pairs;
            self.next += 1;
        }
    }
}

/// Runs `each` over every ping's sight, in chunks with a scratch space `W` each; gives the sums per
/// slot, added in the chunks' order, and pairs done.
pub(crate) fn over_pings<T: Sum, W: Default>(
    scene: Scene<'_>,
    pings: &[&Past],
    each: impl Fn(&mut Tally<T>, &mut W, &Past, &Sight) + Sync,
) -> (Vec<T>, u64) {
    let slot_count = scene.gaussians.slot_count();
    let field = Field::of(scene.evidence, scene.gaussians);
    let chunk = pings.len().div_ceil(CHUNKS).max(32);
    let of_chunk = |chunk: &[&Past]| {
        let (mut tally, mut scratch) = (Tally::new(slot_count), W::default());
        let (mut sight, mut pairs) = (Sight::default(), 0);
        for past in chunk {
            sight.look(past, scene, &field);
            each(&mut tally, &mut scratch, past, &sight);
            pairs += sight.pair_count();
        }
        (tally, pairs)
    };
    let chunks: Vec<&[&Past]> = pings.chunks(chunk).collect();
    let (next, total) = (AtomicUsize::new(0), Mutex::new(InOrder::new(slot_count)));
    rayon::broadcast(|_| {
        let take = || next.fetch_add(1, Ordering::Relaxed);
        let mut index = take();
        while let Some(chunk) = chunks.get(index) {
            let part = of_chunk(chunk);
            let mut total = total.lock().unwrap_or_else(PoisonError::into_inner);
            total.add(index, part);
            index = take();
        }
    });
    let total = total.into_inner().unwrap_or_else(PoisonError::into_inner);
    (total.sums, total.pairs)
}

/// Numerator and denominator of the multiplicative step, per side.
#[derive(Debug, Clone, Copy, Default)]
struct StepSums {
    pull: Lobes,
    weight: Lobes,
}

impl Sum for StepSums {
    fn join(&mut self, part: &Self) {
        self.pull.add(&part.pull);
        self.weight.add(&part.weight);
    }
}

/// One multiplicative step over `pings`: for gamma speckle on power,
/// `ρ ← ρ·(Σ A I/Î² / Σ A/Î)^exponent`, with exponent ½ over all pings. Returns pairs done.
pub(crate) fn maximise(
    evidence: &Evidence,
    gaussians: &mut Gaussians,
    pings: &[&Past],
    floor: f32,
    exponent: f32,
    at_work: AtWork,
) -> u64 {
    let scene = Scene {
        evidence,
        gaussians,
        floor,
        is_blurred: false,
        at_work,
    };
    let (sums, pairs) = over_pings(scene, pings, |tally, against, past, sight| {
        step_of_ping(tally, against, past, sight);
    });
    let exponent = match at_work.speckle {
        true => exponent,
        false => COUNTS_STEP * exponent,
    };
    let strengths = gaussians.strength.par_iter_mut().with_min_len(1024);
    let sides = strengths.zip(&mut gaussians.known).zip(&sums);
    sides.for_each(|((strength, known), StepSums { pull, weight })| {
        if !at_work.specular {
            let even = step(Vec3::splat(pull.sum()), Vec3::splat(weight.sum()), exponent);
            strength.scale(even.x);
            return;
        }
        strength.ahead *= step(pull.ahead, weight.ahead, exponent);
        strength.behind *= step(pull.behind, weight.behind, exponent);
        known.ahead |= weight.ahead.cmpgt(Vec3::ZERO);
        known.behind |= weight.behind.cmpgt(Vec3::ZERO);
    });
    pairs
}

/// The factors of three sides; a side that no ping of the pass saw keeps its strength.
fn step(pull: Vec3, weight: Vec3, exponent: f32) -> Vec3 {
    let factor = |pull: f32, weight: f32| {
        if weight <= 0.0 {
            return 1.0;
        }
        let factor = (pull / weight).powf(exponent).clamp(0.05, 20.0);
        if factor.is_finite() { factor } else { 1.0 }
    };
    Vec3::new(
        factor(pull.x, weight.x),
        factor(pull.y, weight.y),
        factor(pull.z, weight.z),
    )
}

fn step_of_ping(
    tally: &mut Tally<StepSums>,
    against: &mut Vec<Against>,
    past: &Past,
    sight: &Sight,
) {
    sight.against_prediction(against);
    for (row, against) in sight.rows().iter().zip(against) {
        let towards = -row.splat.range_axis;
        let sums = tally.of(row.slot);
        sums.pull.add_facing(towards, past.weight * against.pull);
        sums.weight.add_facing(towards, past.weight * against.share);
    }
}

/// Gradient and Fisher information of the log likelihood in the mean of one Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Pull {
    pub(crate) gradient: Vec3,
    pub(crate) information: SymmetricMat3,
}

impl Pull {
    /// Adds a row of a ping: a mean moves its echo in range and across the beam.
    pub(crate) fn add(&mut self, row: &Row, moments: &Moments, weight: f32) {
        let splat = &row.splat;
        let lever = splat.azimuth_variance_rad2 * splat.lever_m;
        let across = splat.azimuth_axis * (-splat.azimuth_rad / lever);
        let along = splat.range_axis / splat.range_sigma_m;
        let [flat, tilt, bend] = moments.square.map(|sum| weight * sum);
        let [pull, push] = moments.residual.map(|sum| weight * sum);
        self.gradient += along * push + across * pull;
        let (by_along, by_across) = (along * bend + across * tilt, along * tilt + across * flat);
        let information = &mut self.information;
        information.diagonal += by_along * along + by_across * across;
        information.mixed += Vec3::new(
            by_along.y * along.z + by_across.y * across.z,
            by_along.x * along.z + by_across.x * across.z,
            by_along.x * along.y + by_across.x * across.y,
        );
    }
}

impl Sum for Pull {
    fn join(&mut self, part: &Self) {
        self.gradient += part.gradient;
        self.information.join(&part.information);
    }
}

impl Sum for SymmetricMat3 {
    fn join(&mut self, part: &Self) {
        self.diagonal += part.diagonal;
        self.mixed += part.mixed;
    }
}

/// Gradient and information of every Gaussian's mean over `pings`, per slot, and pairs done.
/// Likelihood: gamma speckle, `∂ = (I − Î)/Î² · ∂Î`, information `(∂Î/Î)²`.
pub(crate) fn pulls(scene: Scene<'_>, pings: &[&Past]) -> (Vec<Pull>, u64) {
    over_pings(
        scene,
        pings,
        |tally: &mut Tally<Pull>, moments, past, sight| {
            sight.moments(&past.look, moments);
            for (row, moments) in sight.rows().iter().zip(moments) {
                tally.of(row.slot).add(row, moments, past.weight);
            }
        },
    )
}

/// Moves every mean by one damped step towards where its echoes are, at most `limit_m`, and never
/// further than `leash_m` from its home. `prior_m` is how far a step is believed.
pub(crate) fn localise(gaussians: &mut Gaussians, pulls: &[Pull], prior_m: f32, leash_m: f32) {
    let slots: Vec<usize> = gaussians.slots().collect();
    for slot in slots {
        let pull = &pulls[slot];
        let Some(step) = damped_step(pull.gradient, &pull.information, prior_m) else {
            continue;
        };
        let home = gaussians.home_m[slot];
        let away = (gaussians.mean_m[slot] + step - home).clamp_length_max(leash_m);
        gaussians.mean_m[slot] = home + away;
    }
}
