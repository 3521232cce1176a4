//! Reflectivity by expectation-maximisation, and positions by Fisher scoring.
//!
//! An echo's energy is shared among all Gaussians on its arc; those that other pings see dark
//! give theirs up. The multiplicative step keeps strengths positive and has no learning rate.
//!
//! Cost of a pass: pings × Gaussians in a slice (about 100) × bins of a splat (about 12).

use std::cell::RefCell;
use std::sync::Arc;

use echosplat_measurement::SymmetricMat3;
use echosplat_measurement::heard::Detail;
pub(crate) use echosplat_measurement::heard::Score;
use echosplat_measurement::{lanes, simd_level};
use echosplat_model::glam::Vec3;
use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x8};
use rayon::current_num_threads;
use rayon::prelude::*;

use crate::accumulate::history::Keyframe;
use crate::effort::Counted;
use crate::features::AtWork;
use crate::refine::field::Field;
use crate::refine::step::damped_step;
use crate::refine::tally::{Sums, Tally};
use crate::refine::terms::PassTerms;
use crate::refine::visibility::Sight;
use crate::spawn::directional_reflectivity::DirectionalReflectivity;
use crate::spawn::gaussians::{Gaussians, Stage};
use crate::spawn::kept::Kept;

/// Chunks in memory at once; bounds memory.
const CHUNKS_AT_ONCE: usize = 8;
/// Chunks of a portion; layout.
/// A portion has at least so many, however many pairs they have: with one chunk one thread works and the others wait.
const LEAST_CHUNKS: usize = 2;
/// Exponent, literature: gamma speckle.
/// Exponent of the multiplicative rule for gamma speckle.
const FULL_STEP: f32 = 0.5;
/// Ratio, theory: below 2; the number found.
/// A fast step over a full one: over-relaxed, below the 2 up to which it converges.
const FAST: f32 = 1.8;
/// Fraction, found: 0.003 to 0.01 do alike.
/// Of what a pass tells of all faces, what it counts for each that it is like their mean. Observations along a surface see
/// one of its faces by a few per cent, and what they leave over would make it many times the others.
const ALIKE: f32 = 0.005;
/// Ratios, bound: speckle in few bins says no more.
/// A step changes a strength by no more than these.
const LEAST_FACTOR: f32 = 0.05;
/// The same upwards; bound.
const MOST_FACTOR: f32 = 20.0;
/// Gaussians whose step one thread makes at a time; layout.
const STEPPED: usize = 1024;
/// Ratio of exponents, literature: MLEM's is 1.
/// Exponent for counts over that for gamma speckle.
const COUNTS_STEP: f32 = 2.0;

/// How far a multiplicative step goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pace {
    Full,
    /// Nearly twice as far: fewer steps to converge, and more noise in what they end with.
    Fast,
}

/// What is summed over pings for a Gaussian.
pub(crate) trait Sum: Default + Clone + Send {
    /// Pings; layout.
    /// Sums are made per so many pings and added in order, so that threads do not change them.
    const CHUNK: usize = 32;

    /// Adds what another chunk of pings found.
    fn join(&mut self, other: &Self);
}

/// Sums over some pings, made a portion at a time: what one step of the estimation needs. However it is cut
/// into portions, the sums are the same.
#[derive(Debug)]
pub(crate) struct Pass<T> {
    pings: Vec<Arc<Keyframe>>,
    field: Field,
    /// Pings gone through.
    done: usize,
    /// By place in the field.
    sums: Vec<T>,
    /// Most places that a chunk of pings saw so far.
    most_seen: usize,
    pairs: u64,
}

thread_local! {
    /// What a ping sees takes room that the next ping can use.
    static SIGHT: RefCell<Sight> = RefCell::default();
}

impl<T: Sum + Sync> Pass<T> {
    /// Of the Gaussians as they are in `field`.
    pub(crate) fn over(pings: Vec<Arc<Keyframe>>, field: Field) -> Self {
        Self {
            pings,
            done: 0,
            sums: vec![T::default(); field.slots().len()],
            field,
            most_seen: 0,
            pairs: 0,
        }
    }

    pub(crate) fn is_done(&self) -> bool {
        self.done == self.pings.len()
    }

    /// Runs `each` over the sights of at least `count` pings more, if so many are left, in chunks with a scratch space `W`
    /// each, whose sums are added in their order. Returns what was done.
    pub(crate) fn advance<W: Default>(
        &mut self,
        terms: PassTerms,
        count: usize,
        detail: Detail,
        each: impl Fn(&mut Tally<T>, &mut W, &Keyframe, &mut Sight) + Sync,
    ) -> Counted {
        let chunks = count.div_ceil(T::CHUNK).max(LEAST_CHUNKS);
        let end = (self.done + chunks * T::CHUNK).min(self.pings.len());
        let block_count = self.field.block_count();
        let of_chunk = |most_seen: usize, chunk: &[Arc<Keyframe>]| {
            let (mut tally, mut scratch) = (Tally::new(block_count, most_seen), W::default());
            let (mut sight, mut counted) = (SIGHT.take(), Counted::default());
            for keyframe in chunk {
                sight.observe(keyframe, terms, &self.field, detail);
                each(&mut tally, &mut scratch, keyframe, &mut sight);
                counted += Counted {
                    visits: 1,
                    candidates: sight.row_count(),
                    pairs: sight.pair_count(),
                    ..Counted::default()
                };
            }
            SIGHT.set(sight);
            (tally.finish(), counted)
        };
        let mut counted = Counted::default();
        // A few chunks at a time: all at once would take more room than the map.
        for chunks in self.pings[self.done..end].chunks(T::CHUNK * CHUNKS_AT_ONCE) {
            let most_seen = self.most_seen;
            let chunks = chunks.par_chunks(T::CHUNK);
            let parts: Vec<(Sums<T>, Counted)> =
                chunks.map(|chunk| of_chunk(most_seen, chunk)).collect();
            let seen = parts.iter().map(|(sums, _)| sums.len());
            self.most_seen = seen.fold(most_seen, usize::max);
            parts.iter().for_each(|&(_, of_chunk)| counted += of_chunk);
            join(&mut self.sums, &self.field, &parts);
        }
        self.done = end;
        self.pairs += counted.pairs;
        counted
    }

    /// Sums per slot, and what else it leaves.
    pub(crate) fn finish(self, slot_count: usize) -> (Vec<T>, Done) {
        let mut sums = vec![T::default(); slot_count];
        for (&slot, sum) in self.field.slots().iter().zip(self.sums) {
            sums[slot as usize] = sum;
        }
        let done = Done {
            field: self.field,
            pairs: self.pairs,
            pings: self.pings.len(),
        };
        (sums, done)
    }
}

/// What a pass leaves beside its sums.
#[derive(Debug)]
pub(crate) struct Done {
    /// As it was.
    pub(crate) field: Field,
    pub(crate) pairs: u64,
    /// Pings gone through.
    pub(crate) pings: usize,
}

/// Adds the sums of some chunks in their order; each thread those of some of the blocks.
fn join<T: Sum + Sync>(sums: &mut [T], field: &Field, parts: &[(Sums<T>, Counted)]) {
    let each = field.block_count().div_ceil(current_num_threads()).max(1);
    let (mut shares, mut rest, mut from) = (Vec::new(), sums, 0);
    for first in (0..field.block_count()).step_by(each) {
        let blocks = first..(first + each).min(field.block_count());
        let end = field.places(blocks.end - 1).end;
        let (share, others) = rest.split_at_mut(end - from);
        shares.push((blocks, from, share));
        (rest, from) = (others, end);
    }
    shares.into_par_iter().for_each(|(blocks, from, share)| {
        for (block, sums) in parts.iter().flat_map(|(sums, _)| sums.iter()) {
            if blocks.contains(&block) {
                let places = field.places(block);
                let of_block = &mut share[places.start - from..places.end - from];
                for (sum, other) in of_block.iter_mut().zip(sums) {
                    sum.join(other);
                }
            }
        }
    });
}

/// Sums of the multiplicative step, per face.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct StepSums {
    /// Numerator and denominator towards +x, +y, +z, −x, −y, −z.
    faces: [[f32; 2]; 6],
}

impl StepSums {
    /// Adds to the faces turned against `away`, a unit vector, by what each counts.
    #[inline(always)]
    fn add_facing(&mut self, away: Vec3, numerator: f32, weight: f32) {
        for (axis, along) in away.to_array().into_iter().enumerate() {
            let [of_numerator, of_weight] = &mut self.faces[axis + 3 * usize::from(along > 0.0)];
            let counts = along * along;
            *of_numerator += counts * numerator;
            *of_weight += counts * weight;
        }
    }

    fn of_faces(&self, which: usize) -> DirectionalReflectivity {
        let [x, y, z, west, south, down] = self.faces.map(|face| face[which]);
        DirectionalReflectivity {
            ahead: Vec3::new(x, y, z),
            behind: Vec3::new(west, south, down),
        }
    }

    fn numerator(&self) -> DirectionalReflectivity {
        self.of_faces(0)
    }

    /// How much its observations weigh: the denominator.
    pub(crate) fn weight(&self) -> DirectionalReflectivity {
        self.of_faces(1)
    }

    #[cfg(test)]
    pub(crate) fn of_weight(weight: f32) -> Self {
        Self {
            faces: [[0.0, weight]; 6],
        }
    }
}

impl Sum for StepSums {
    /// Pings whose sums one thread makes; layout.
    /// Joining sums takes as long as some twenty pings' share of them.
    const CHUNK: usize = 64;

    fn join(&mut self, other: &Self) {
        for (face, other) in self.faces.iter_mut().zip(&other.faces) {
            face[0] += other[0];
            face[1] += other[1];
        }
    }
}

/// Adds what a ping says to the sums of a multiplicative step.
pub(crate) fn strengths_of_ping(
    tally: &mut Tally<StepSums>,
    keyframe: &Keyframe,
    sight: &mut Sight,
    at_work: AtWork,
) {
    sight.against_prediction(at_work.speckle);
    let [shares, numerators] = sight.against();
    let rows = sight.rows();
    for run in sight.runs() {
        let sums = tally.of(run.block, run.count);
        for row in sight.heard_of(run) {
            let energy = keyframe.weight * rows.energy[row];
            let [numerator, weight] = [numerators, shares].map(|of| energy * rows.found(row, of));
            let sums = &mut sums[run.within(rows.place[row])];
            sums.add_facing(rows.range_axis_of(row), numerator, weight);
        }
    }
}

/// How many bins' power each slot explained in some steps, fractions of bins added up.
#[derive(Debug, Default)]
pub(crate) struct Explained {
    /// By slot; none where no ping of these steps saw it.
    bins: Vec<Option<f32>>,
    steps: usize,
}

impl Explained {
    /// Adds a step, each of whose pings stands for `stride`. Slots are those of the steps before.
    pub(crate) fn add(&mut self, gaussians: &Gaussians, sums: &[StepSums], stride: f32) {
        self.bins.resize(sums.len(), None);
        self.steps += 1;
        let bins = self.bins.par_iter_mut().with_min_len(STEPPED);
        bins.zip(&gaussians.strength)
            .zip(sums)
            .for_each(|((bins, strength), sums)| {
                let weight = sums.weight();
                if weight.sum() > 0.0 {
                    let share =
                        strength.ahead.dot(weight.ahead) + strength.behind.dot(weight.behind);
                    *bins.get_or_insert_default() += stride * share;
                }
            });
    }

    /// In the mean of the steps, for all pings that they stand for; none where no ping saw the slot.
    pub(crate) fn mean(&self, slot: usize) -> Option<f32> {
        let bins = self.bins.get(slot).copied().flatten();
        bins.map(|bins| bins / self.steps as f32)
    }
}

/// One multiplicative step: for gamma speckle on power, `ρ ← ρ·(Σ A I/Î² / Σ A/Î)^½`. Each of the pings stands for
/// `stride` that are remembered; what forgotten ones told of a whole Gaussian counts as it was last summed up.
pub(crate) fn maximise(
    gaussians: &mut Gaussians,
    sums: &[StepSums],
    stride: f32,
    pace: Pace,
    at_work: AtWork,
) {
    let full = match at_work.speckle {
        true => FULL_STEP,
        false => COUNTS_STEP * FULL_STEP,
    };
    let exponent = match pace {
        Pace::Full => full,
        Pace::Fast => FAST * full,
    };
    let Gaussians {
        strength,
        known,
        stage,
        child_share,
        kept,
        ..
    } = gaussians;
    let chunks = strength
        .par_chunks_mut(STEPPED)
        .zip(known.par_chunks_mut(STEPPED));
    chunks.enumerate().for_each(|(chunk, (strength, known))| {
        dispatch!(simd_level::level(), simd => {
            let first = chunk * STEPPED;
            for (index, (strength, known)) in strength.iter_mut().zip(known.iter_mut()).enumerate() {
                let slot = first + index;
                if stage[slot] == Stage::Background {
                    continue;
                }
                let kept = kept[slot].as_deref().filter(|_| child_share[slot] >= 1.0);
                let (sums, kept) = (&sums[slot], kept.map(|kept| (kept, stride.recip())));
                *strength = stepped(simd, strength, sums, kept, exponent, at_work.specular);
                if at_work.specular {
                    let weight = sums.weight();
                    known.ahead |= weight.ahead.cmpgt(Vec3::ZERO);
                    known.behind |= weight.behind.cmpgt(Vec3::ZERO);
                }
            }
        });
    });
}

/// One Gaussian's faces after a step. What was kept counts with this factor.
#[inline(always)]
fn stepped<S: Simd>(
    simd: S,
    now: &DirectionalReflectivity,
    sums: &StepSums,
    kept: Option<(&Kept, f32)>,
    exponent: f32,
    is_specular: bool,
) -> DirectionalReflectivity {
    let strength = faces(simd, now);
    let (mut numerator, mut weight) = (faces(simd, &sums.numerator()), faces(simd, &sums.weight()));
    if let Some((kept, factor)) = kept {
        let kept_weight = faces(simd, &kept.weight) * factor;
        weight += kept_weight;
        numerator += numerator_to(faces(simd, &kept.strength), kept_weight, strength, exponent);
    }
    if is_specular {
        let all = weight.reduce_sum();
        let mean = (weight * strength).reduce_sum() / all;
        if mean.is_finite() {
            let none = f32x8::splat(simd, 0.0);
            let alike = weight
                .simd_gt(0.0)
                .select(f32x8::splat(simd, ALIKE * all), none);
            weight += alike;
            let mean = f32x8::splat(simd, mean);
            numerator += numerator_to(mean, alike, strength, exponent);
        }
    } else {
        // All faces of it as one.
        numerator = f32x8::splat(simd, numerator.reduce_sum());
        weight = f32x8::splat(simd, weight.reduce_sum());
    }
    let one = f32x8::splat(simd, 1.0);
    let is_told = weight.simd_gt(0.0);
    let factor = power(is_told.select(numerator / weight, one), exponent);
    let factor = is_told.select(factor.max(LEAST_FACTOR).min(MOST_FACTOR), one);
    // What is not finite leaves the strength as it was.
    let factor = factor.simd_eq(factor).select(factor, one);
    let [x, y, z, _, west, south, down, _] = (strength * factor).to_array();
    DirectionalReflectivity {
        ahead: Vec3::new(x, y, z),
        behind: Vec3::new(west, south, down),
    }
}

/// The faces side by side; two lanes are empty.
#[inline(always)]
fn faces<S: Simd>(simd: S, of: &DirectionalReflectivity) -> f32x8<S> {
    let ([x, y, z], [west, south, down]) = (of.ahead.to_array(), of.behind.to_array());
    f32x8::simd_from(simd, [x, y, z, 0.0, west, south, down, 0.0])
}

/// The numerator that with the denominator `weight` would bring each face from `now` to `goal`.
#[inline(always)]
fn numerator_to<S: Simd>(
    goal: f32x8<S>,
    weight: f32x8<S>,
    now: f32x8<S>,
    exponent: f32,
) -> f32x8<S> {
    weight * power(goal / now.max(f32::MIN_POSITIVE), exponent.recip())
}

/// `xᵖ` of x ≥ 0; what is below the least normal number, or above the greatest, counts as it.
#[inline(always)]
fn power<S: Simd>(x: f32x8<S>, exponent: f32) -> f32x8<S> {
    if exponent == FULL_STEP {
        return x.sqrt();
    }
    if exponent == 1.0 / FULL_STEP {
        return x * x;
    }
    lanes::exp(lanes::ln(x.max(f32::MIN_POSITIVE).min(f32::MAX)) * exponent)
}

impl Sum for Score {
    fn join(&mut self, other: &Self) {
        self.gradient += other.gradient;
        self.nearer += other.nearer;
        self.information.join(&other.information);
    }
}

impl Sum for SymmetricMat3 {
    fn join(&mut self, other: &Self) {
        self.diagonal += other.diagonal;
        self.mixed += other.mixed;
    }
}

/// Adds what a ping says of each mean. Likelihood: gamma speckle, `∂ = (I − Î)/Î² · ∂Î`, information
/// `(∂Î/Î)²`.
pub(crate) fn scores_of_ping(tally: &mut Tally<Score>, keyframe: &Keyframe, sight: &mut Sight) {
    sight.find_moments();
    let rows = sight.rows();
    for run in sight.runs() {
        let sums = tally.of(run.block, run.count);
        for row in sight.heard_of(run) {
            let sums = &mut sums[run.within(rows.place[row])];
            sums.add(rows, row, &sight.moments(row), keyframe.weight);
        }
    }
}

/// Moves every mean by one damped step towards where its echoes are, at most `limit_m`, and never
/// further than `leash_m` from its home. `prior_m` is how far a step is believed.
pub(crate) fn localise(gaussians: &mut Gaussians, scores: &[Score], prior_m: f32, leash_m: f32) {
    let slots = gaussians
        .slots()
        .filter(|&slot| gaussians.is_worked_on(slot));
    let slots: Vec<usize> = slots.collect();
    for slot in slots {
        let score = &scores[slot];
        let Some(step) = damped_step(score.gradient, &score.information, prior_m) else {
            continue;
        };
        let home = gaussians.home_m[slot];
        let away = (gaussians.mean_m[slot] + step - home).clamp_length_max(leash_m);
        gaussians.mean_m[slot] = home + away;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MapperConfig;
    use crate::accumulate::evidence::{BlockIndex, Evidence};
    use crate::accumulate::history::{History, geometry_of, keyframe_of, pose_blur};
    use crate::detect::profile::{Backdrop, Levels};
    use crate::features::{Cues, Features, MapCues, decide};
    use echosplat_measurement::Element;
    use echosplat_measurement::twin::Twin;
    use echosplat_model::glam::DVec3;
    use echosplat_model::{Ping, PingSettings, Pose, PosedPing, Timestamp, Twist};

    const SCALE_M: f32 = 0.03;
    const NOISE: f32 = 1e-6;
    /// Echoes stand far above the noise.
    const STRENGTH: f32 = 3000.0;

    fn config() -> MapperConfig {
        MapperConfig {
            position_sigma_m: 1e-4,
            attitude_sigma_deg: 0.01,
            ..MapperConfig::default()
        }
    }

    fn keyframe(intensity: Vec<f32>, pose: Pose) -> Arc<Keyframe> {
        let settings = PingSettings {
            range_start_m: 0.0,
            range_length_m: 10.0,
            bin_count: intensity.len(),
            speed_of_sound_mps: 1500.0,
            frequency_hz: 450e3,
            pulse_duration_s: 5e-5,
            gain_index: 0,
        };
        let ping = Ping::new(0, Timestamp::ZERO, settings, intensity).unwrap();
        let posed = PosedPing {
            ping: Arc::new(ping),
            world_from_sensor: pose,
            twist: Twist::default(),
            reference_range_m: 5.0,
            uncertainty: None,
            jitter: None,
        };
        let (config, ground) = (config(), Backdrop::default());
        let geometry = geometry_of(&posed, DVec3::ZERO, &config);
        let profile =
            Levels::default().profile(&posed.ping, 0.05, &ground, Box::default(), &config);
        Arc::new(keyframe_of(
            geometry,
            pose_blur(&posed, &config),
            profile,
            1.0,
            0.0,
            &posed,
        ))
    }

    /// What pings measure of Gaussians at these places and strengths, two from poses a metre apart.
    struct Trial {
        evidence: Evidence,
        pings: Vec<Arc<Keyframe>>,
        gaussians: Gaussians,
    }

    fn poses() -> [Pose; 2] {
        [0.0, 1.0].map(|z| Pose::from_yaw_pitch_roll(0.0, 0.0, 0.0, DVec3::new(0.0, 0.0, z)))
    }

    impl Trial {
        fn new(truth: &[(Vec3, f32)]) -> Self {
            let round = SymmetricMat3::isotropic(SCALE_M);
            let element = |&(at_m, strength): &(Vec3, f32)| Element::even(at_m, round, strength);
            let elements: Vec<Element> = truth.iter().map(element).collect();
            let bright = poses().map(|pose| {
                let geometry = keyframe(vec![NOISE; 600], pose).geometry;
                let heard = Twin::of(&geometry, &elements).predicted(NOISE.into());
                keyframe(heard.iter().map(|&power| power as f32).collect(), pose)
            });
            let mut evidence = Evidence::new(0.05);
            let pings = bright.to_vec();
            let mut history = History::new(pings.len());
            pings
                .iter()
                .for_each(|keyframe| history.push(Keyframe::clone(keyframe)));
            evidence.integrate(&history, usize::MAX, crate::features::Extent::All);
            Self {
                evidence,
                pings,
                gaussians: Gaussians::default(),
            }
        }

        fn spawn(&mut self, at_m: Vec3, strength: f32) -> usize {
            let blocks = 0..self.evidence.block_count() as BlockIndex;
            let distance = |&index: &BlockIndex| {
                self.evidence
                    .center_of(self.evidence.block(index))
                    .distance(at_m)
            };
            let home = blocks
                .min_by(|a, b| distance(a).total_cmp(&distance(b)))
                .unwrap();
            self.gaussians.spawn(at_m, (home, 0), SCALE_M, strength) as usize
        }

        fn terms() -> PassTerms {
            let (at_work, _) = decide(&Features::default(), &Cues::default(), MapCues::default());
            PassTerms {
                is_blurred: false,
                at_work,
            }
        }

        fn sums<T: Sum + Sync, W: Default>(
            &self,
            each: impl Fn(&mut Tally<T>, &mut W, &Keyframe, &mut Sight) + Sync,
        ) -> Vec<T> {
            let field = Field::of(&self.evidence, &self.gaussians);
            let mut pass = Pass::over(self.pings.clone(), field);
            while !pass.is_done() {
                pass.advance(Self::terms(), 1, Detail::Full, &each);
            }
            pass.finish(self.gaussians.slot_count()).0
        }

        fn step_sums(&self) -> Vec<StepSums> {
            let at_work = Self::terms().at_work;
            self.sums(|tally, (): &mut (), keyframe, sight| {
                strengths_of_ping(tally, keyframe, sight, at_work);
            })
        }

        fn scores(&self) -> Vec<Score> {
            self.sums(|tally, (): &mut (), keyframe, sight| scores_of_ping(tally, keyframe, sight))
        }

        fn step(&mut self) {
            let sums = self.step_sums();
            let at_work = Self::terms().at_work;
            maximise(&mut self.gaussians, &sums, 1.0, Pace::Full, at_work);
        }

        /// Log likelihood of gamma speckle, up to a constant.
        fn log_likelihood(&self) -> f64 {
            let field = Field::of(&self.evidence, &self.gaussians);
            let mut sight = Sight::default();
            let of_ping = |keyframe: &Arc<Keyframe>| {
                sight.observe(keyframe, Self::terms(), &field, Detail::Strength);
                let bins = sight
                    .predicted
                    .iter()
                    .zip(keyframe.profile.intensity.iter());
                let bins = bins
                    .zip(&sight.bin_weight)
                    .map(|((&predicted, measured), &weight)| {
                        let (predicted, measured) = (f64::from(predicted), f64::from(measured));
                        -f64::from(weight) * (predicted.ln() + measured / predicted)
                    });
                bins.sum::<f64>()
            };
            self.pings.iter().map(of_ping).sum()
        }
    }

    #[test]
    fn steps_end_at_the_strength_that_explains_an_echo() {
        let at_m = Vec3::new(6.0, 0.01, 0.4);
        let mut trial = Trial::new(&[(at_m, STRENGTH)]);
        let slot = trial.spawn(at_m, 0.1 * STRENGTH);
        for _ in 0..100 {
            trial.step();
        }
        let towards = -at_m.normalize();
        let strength = trial.gaussians.strength[slot].seen(towards);
        assert!((strength / STRENGTH - 1.0).abs() < 0.05, "{strength}");
    }

    #[test]
    fn a_step_makes_what_was_measured_more_likely_and_an_empty_place_weaker() {
        let (there_m, empty_m) = (Vec3::new(6.0, 0.0, 0.4), Vec3::new(5.96, 0.0, 1.15));
        let mut trial = Trial::new(&[(there_m, STRENGTH)]);
        let (there, empty) = (
            trial.spawn(there_m, 0.3 * STRENGTH),
            trial.spawn(empty_m, 0.3 * STRENGTH),
        );
        let mut before = trial.log_likelihood();
        for _ in 0..20 {
            trial.step();
            let after = trial.log_likelihood();
            assert!(
                after >= before - 1e-3 * before.abs(),
                "{after} after {before}"
            );
            before = after;
        }
        let strength = |slot: usize| trial.gaussians.strongest(slot);
        assert!(
            strength(empty) < 0.2 * strength(there),
            "{}",
            strength(empty)
        );
    }

    #[test]
    fn what_forgotten_pings_told_holds_a_strength_as_far_as_it_weighs() {
        let at_m = Vec3::new(6.0, 0.01, 0.4);
        let after = |times: f32| {
            let mut trial = Trial::new(&[(at_m, STRENGTH)]);
            let slot = trial.spawn(at_m, 2.0 * STRENGTH);
            let sums = trial.step_sums()[slot];
            let (mut weight, strength) =
                (sums.weight(), DirectionalReflectivity::even(2.0 * STRENGTH));
            weight.scale(times);
            trial.gaussians.kept[slot] = Some(Box::new(Kept {
                strength,
                weight,
                ..Kept::default()
            }));
            for _ in 0..100 {
                trial.step();
            }
            trial.gaussians.strength[slot].seen(-at_m.normalize()) / STRENGTH
        };
        let (light, heavy) = (after(0.01), after(100.0));
        assert!((light - 1.0).abs() < 0.1, "{light}");
        assert!((heavy - 2.0).abs() < 0.1, "{heavy}");
    }

    #[test]
    fn a_face_that_hardly_any_observation_sees_is_like_the_others() {
        let ends = |y_numerator: f32, y_weight: f32| {
            let mut now = DirectionalReflectivity::even(1.0);
            for _ in 0..100 {
                // What these observations alone would have: 1 towards x, √(numerator/weight) towards y.
                let mut sums = StepSums::default();
                sums.faces[0] = [100.0 / now.ahead.x.powi(2), 100.0];
                sums.faces[1] = [y_numerator / now.ahead.y.powi(2), y_weight];
                now = dispatch!(simd_level::level(), simd => {
                    stepped(simd, &now, &sums, None, FULL_STEP, true)
                });
            }
            now.ahead
        };
        let hardly = ends(1.0, 0.01);
        assert!((hardly.x - 1.0).abs() < 0.01 && hardly.y < 2.0, "{hardly}");
        let well = ends(100.0 * 9.0, 100.0);
        assert!(
            (well.x - 1.0).abs() < 0.05 && (well.y - 3.0).abs() < 0.05,
            "{well}"
        );
    }

    #[test]
    fn what_stands_in_the_background_is_held_still() {
        let at_m = Vec3::new(6.0, 0.0, 0.4);
        let mut trial = Trial::new(&[(at_m, STRENGTH)]);
        let slot = trial.spawn(at_m, 0.1 * STRENGTH);
        trial.gaussians.stage[slot] = Stage::Background;
        trial.step();
        let strength = trial.gaussians.strongest(slot);
        assert_eq!(strength.to_bits(), (0.1 * STRENGTH).to_bits());
    }

    #[test]
    fn the_score_of_a_mean_is_the_slope_of_the_log_likelihood() {
        // So that no residual reaches the bound it is held to.
        const FAINT: f32 = 1e-3 * STRENGTH;
        let at_m = Vec3::new(6.0, 0.0, 0.4);
        for off_m in [Vec3::new(0.01, 0.0, 0.0), Vec3::new(-0.008, 0.01, 0.0)] {
            let mut trial = Trial::new(&[(at_m, FAINT)]);
            let slot = trial.spawn(at_m + off_m, FAINT);
            let score = trial.scores()[slot].gradient;
            for axis in [Vec3::X, Vec3::Y] {
                const STEP_M: f32 = 2e-3;
                let mut at = |by_m: f32| {
                    trial.gaussians.mean_m[slot] = at_m + off_m + axis * by_m;
                    trial.log_likelihood()
                };
                let slope = (at(STEP_M) - at(-STEP_M)) / f64::from(2.0 * STEP_M);
                let told = f64::from(score.dot(axis));
                let size = f64::from(score.length());
                assert!(
                    (told - slope).abs() < 0.1 * size,
                    "{axis}: {told} for {slope}"
                );
            }
        }
    }

    #[test]
    fn sums_do_not_depend_on_the_portions_they_are_made_in() {
        let at_m = Vec3::new(6.0, 0.0, 0.4);
        let mut trial = Trial::new(&[(at_m, STRENGTH)]);
        let slot = trial.spawn(at_m, STRENGTH);
        let many: Vec<Arc<Keyframe>> = trial
            .pings
            .iter()
            .cycle()
            .take(200)
            .map(Arc::clone)
            .collect();
        let sums = |portion: usize| {
            let field = Field::of(&trial.evidence, &trial.gaussians);
            let mut pass = Pass::over(many.clone(), field);
            while !pass.is_done() {
                let terms = Trial::terms();
                let each = |tally: &mut _, (): &mut (), keyframe: &_, sight: &mut _| {
                    strengths_of_ping(tally, keyframe, sight, terms.at_work);
                };
                pass.advance(terms, portion, Detail::Strength, each);
            }
            let sums = pass.finish(trial.gaussians.slot_count()).0;
            sums[slot].numerator().sum().to_bits()
        };
        assert_eq!(sums(1), sums(1000));
    }
}
