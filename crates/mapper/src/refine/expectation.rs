//! Reflectivity by expectation-maximisation, and positions by Fisher scoring.
//!
//! An echo's energy is shared among all Gaussians on its arc; those that other pings see dark
//! give theirs up. The multiplicative step keeps strengths positive and has no learning rate.
//!
//! Cost of a pass: pings × Gaussians in a slice (about 100) × bins of a splat (about 12).

use std::cell::RefCell;
use std::sync::Arc;

use echosplat_acoustics::SymmetricMat3;
use echosplat_acoustics::packed::MatrixRow;
use echosplat_model::glam::Vec3;
use rayon::current_num_threads;
use rayon::prelude::*;

use crate::accumulate::evidence::Evidence;
use crate::accumulate::history::Keyframe;
use crate::features::AtWork;
use crate::refine::field::Field;
use crate::refine::scene::Scene;
use crate::refine::step::damped_step;
use crate::refine::tally::{Sums, Tally};
use crate::refine::visibility::{Against, Moments, Sight};
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
    sums: Vec<T>,
    /// Most slots that a chunk of pings saw so far.
    most_seen: usize,
    pairs: u64,
}

thread_local! {
    /// What a ping sees takes room that the next ping can use.
    static SIGHT: RefCell<Sight> = RefCell::default();
}

impl<T: Sum + Sync> Pass<T> {
    /// Of the Gaussians as they are now.
    pub(crate) fn over(
        pings: Vec<Arc<Keyframe>>,
        evidence: &Evidence,
        gaussians: &Gaussians,
    ) -> Self {
        Self {
            pings,
            field: Field::of(evidence, gaussians),
            done: 0,
            sums: vec![T::default(); gaussians.slot_count()],
            most_seen: 0,
            pairs: 0,
        }
    }

    pub(crate) fn is_done(&self) -> bool {
        self.done == self.pings.len()
    }

    /// Runs `each` over the sights of at least `count` pings more, if so many are left, in chunks with a scratch space `W`
    /// each, whose sums are added in their order. Returns pairs done.
    pub(crate) fn advance<W: Default>(
        &mut self,
        scene: Scene<'_>,
        count: usize,
        each: impl Fn(&mut Tally<T>, &mut W, &Keyframe, &Sight) + Sync,
    ) -> u64 {
        let chunks = count.div_ceil(T::CHUNK).max(LEAST_CHUNKS);
        let end = (self.done + chunks * T::CHUNK).min(self.pings.len());
        let slot_count = scene.gaussians.slot_count();
        let of_chunk = |most_seen: usize, chunk: &[Arc<Keyframe>]| {
            let (mut tally, mut scratch) = (Tally::new(slot_count, most_seen), W::default());
            let (mut sight, mut pairs) = (SIGHT.take(), 0);
            for keyframe in chunk {
                sight.observe(keyframe, scene, &self.field);
                each(&mut tally, &mut scratch, keyframe, &sight);
                pairs += sight.pair_count();
            }
            SIGHT.set(sight);
            (tally.finish(), pairs)
        };
        let mut pairs = 0;
        // A few chunks at a time: all at once would take more room than the map.
        for chunks in self.pings[self.done..end].chunks(T::CHUNK * CHUNKS_AT_ONCE) {
            let most_seen = self.most_seen;
            let chunks = chunks.par_chunks(T::CHUNK);
            let parts: Vec<(Sums<T>, u64)> =
                chunks.map(|chunk| of_chunk(most_seen, chunk)).collect();
            let seen = parts.iter().map(|(sums, _)| sums.len());
            self.most_seen = seen.fold(most_seen, usize::max);
            pairs += parts
                .iter()
                .map(|(_, chunk_pairs)| chunk_pairs)
                .sum::<u64>();
            join(&mut self.sums, &parts);
        }
        self.done = end;
        self.pairs += pairs;
        pairs
    }

    /// Sums per slot, pairs done and pings gone through.
    pub(crate) fn finish(self) -> (Vec<T>, u64, usize) {
        (self.sums, self.pairs, self.pings.len())
    }
}

/// Adds the sums of some chunks in their order; each thread those of some of the slots.
fn join<T: Sum + Sync>(sums: &mut [T], parts: &[(Sums<T>, u64)]) {
    let each = sums.len().div_ceil(current_num_threads()).max(1);
    let shares = sums.par_chunks_mut(each).enumerate();
    shares.for_each(|(share, sums)| {
        let first = share * each;
        for (slot, sum) in parts.iter().flat_map(|(sums, _)| sums.iter()) {
            if let Some(of_slot) = slot.checked_sub(first).and_then(|at| sums.get_mut(at)) {
                of_slot.join(sum);
            }
        }
    });
}

/// Numerator and denominator of the multiplicative step, per face.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct StepSums {
    numerator: DirectionalReflectivity,
    pub(crate) weight: DirectionalReflectivity,
}

impl Sum for StepSums {
    fn join(&mut self, other: &Self) {
        self.numerator.add(&other.numerator);
        self.weight.add(&other.weight);
    }
}

/// Adds what a ping says to the sums of a multiplicative step.
pub(crate) fn strengths_of_ping(
    tally: &mut Tally<StepSums>,
    against: &mut Vec<Against>,
    keyframe: &Keyframe,
    sight: &Sight,
) {
    sight.against_prediction(against);
    for (row, against) in sight.rows().iter().zip(against) {
        let towards = -row.splat.range_axis;
        let sums = tally.of(row.slot);
        sums.numerator
            .add_facing(towards, keyframe.weight * against.numerator);
        sums.weight
            .add_facing(towards, keyframe.weight * against.share);
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
        for ((bins, strength), StepSums { weight, .. }) in
            self.bins.iter_mut().zip(&gaussians.strength).zip(sums)
        {
            if weight.sum() > 0.0 {
                let share = strength.ahead.dot(weight.ahead) + strength.behind.dot(weight.behind);
                *bins.get_or_insert_default() += stride * share;
            }
        }
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
    let strengths = gaussians.strength.par_iter_mut().with_min_len(1024);
    let faces = strengths.zip(&mut gaussians.known).zip(&gaussians.stage);
    let faces = faces.zip(&gaussians.child_share).zip(&gaussians.kept);
    faces.zip(sums).for_each(
        |(((((strength, known), stage), child_share), kept), sums)| {
            let StepSums {
                mut numerator,
                mut weight,
            } = *sums;
            if *stage == Stage::Background {
                return;
            }
            if let Some(kept) = kept
                && *child_share >= 1.0
            {
                add_kept(
                    &mut numerator,
                    &mut weight,
                    kept,
                    strength,
                    stride,
                    exponent,
                );
            }
            if !at_work.specular {
                let even = step(
                    Vec3::splat(numerator.sum()),
                    Vec3::splat(weight.sum()),
                    exponent,
                );
                strength.scale(even.x);
                return;
            }
            add_alike(&mut numerator, &mut weight, strength, exponent);
            strength.ahead *= step(numerator.ahead, weight.ahead, exponent);
            strength.behind *= step(numerator.behind, weight.behind, exponent);
            known.ahead |= weight.ahead.cmpgt(Vec3::ZERO);
            known.behind |= weight.behind.cmpgt(Vec3::ZERO);
        },
    );
}

/// Adds what was kept to both sums of a step from `now`: alone it would bring the strength back to the kept one.
fn add_kept(
    numerator: &mut DirectionalReflectivity,
    weight: &mut DirectionalReflectivity,
    kept: &Kept,
    now: &DirectionalReflectivity,
    stride: f32,
    exponent: f32,
) {
    let mut kept_weight = kept.weight;
    kept_weight.scale(stride.recip());
    weight.add(&kept_weight);
    numerator.add(&numerator_to(&kept.strength, &kept_weight, now, exponent));
}

/// Adds to both sums that each face that was told of is like the mean of all, with the weight of [`ALIKE`].
fn add_alike(
    numerator: &mut DirectionalReflectivity,
    weight: &mut DirectionalReflectivity,
    now: &DirectionalReflectivity,
    exponent: f32,
) {
    let all = weight.sum();
    let mean = (weight.ahead.dot(now.ahead) + weight.behind.dot(now.behind)) / all;
    if !mean.is_finite() {
        return;
    }
    let if_told =
        |told: Vec3| Vec3::select(told.cmpgt(Vec3::ZERO), Vec3::splat(ALIKE * all), Vec3::ZERO);
    let alike = DirectionalReflectivity {
        ahead: if_told(weight.ahead),
        behind: if_told(weight.behind),
    };
    weight.add(&alike);
    numerator.add(&numerator_to(
        &DirectionalReflectivity::even(mean),
        &alike,
        now,
        exponent,
    ));
}

/// The numerator that with the denominator `weight` would bring each face from `now` to `goal`.
fn numerator_to(
    goal: &DirectionalReflectivity,
    weight: &DirectionalReflectivity,
    now: &DirectionalReflectivity,
    exponent: f32,
) -> DirectionalReflectivity {
    let ratio = |goal: Vec3, now: Vec3| {
        (goal / now.max(Vec3::splat(f32::MIN_POSITIVE))).powf(exponent.recip())
    };
    DirectionalReflectivity {
        ahead: weight.ahead * ratio(goal.ahead, now.ahead),
        behind: weight.behind * ratio(goal.behind, now.behind),
    }
}

/// The factors of three faces; a face that no ping of the pass saw keeps its strength.
fn step(numerator: Vec3, weight: Vec3, exponent: f32) -> Vec3 {
    let factor = |numerator: f32, weight: f32| {
        if weight <= 0.0 {
            return 1.0;
        }
        let factor = (numerator / weight).powf(exponent).clamp(0.05, 20.0);
        if factor.is_finite() { factor } else { 1.0 }
    };
    Vec3::new(
        factor(numerator.x, weight.x),
        factor(numerator.y, weight.y),
        factor(numerator.z, weight.z),
    )
}

/// Score and Fisher information: gradient and expected curvature of the log likelihood by the mean of one Gaussian, and what
/// the gradient changes by were all echoes a metre nearer, 1/m².
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Score {
    pub(crate) gradient: Vec3,
    pub(crate) information: SymmetricMat3,
    pub(crate) nearer: Vec3,
}

impl Score {
    /// Adds a row of the system matrix: a mean moves its echo in range and across the beam.
    pub(crate) fn add(&mut self, row: &MatrixRow, moments: &Moments, weight: f32) {
        let splat = &row.splat;
        let lever = splat.azimuth_variance_rad2 * splat.lever_m;
        let across = splat.azimuth_axis * (-splat.azimuth_rad / lever);
        let along = splat.range_axis / splat.range_sigma_m;
        let [flat, tilt, bend] = moments.square.map(|sum| weight * sum);
        let [residual, slope] = moments.residual.map(|sum| weight * sum);
        self.gradient += along * slope + across * residual;
        let (by_along, by_across) = (along * bend + across * tilt, along * tilt + across * flat);
        self.nearer -= by_along / splat.range_sigma_m;
        let information = &mut self.information;
        information.diagonal += by_along * along + by_across * across;
        information.mixed += Vec3::new(
            by_along.y * along.z + by_across.y * across.z,
            by_along.x * along.z + by_across.x * across.z,
            by_along.x * along.y + by_across.x * across.y,
        );
    }
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
pub(crate) fn scores_of_ping(
    tally: &mut Tally<Score>,
    moments: &mut Vec<Moments>,
    keyframe: &Keyframe,
    sight: &Sight,
) {
    sight.moments(&keyframe.geometry, moments);
    for (row, moments) in sight.rows().iter().zip(moments) {
        tally.of(row.slot).add(row, moments, keyframe.weight);
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
    use crate::accumulate::evidence::BlockIndex;
    use crate::accumulate::history::{History, geometry_of, keyframe_of, pose_blur};
    use crate::detect::profile::{Backdrop, Levels};
    use crate::features::{Cues, Features, MapCues, decide};
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
            let bright = poses().map(|pose| {
                let mut intensity = vec![NOISE; 600];
                let geometry = keyframe(intensity.clone(), pose).geometry;
                for &(at_m, strength) in truth {
                    let splat = geometry
                        .project(at_m, &SymmetricMat3::isotropic(SCALE_M))
                        .unwrap();
                    let bins = geometry.bins_of(&splat);
                    let mut energies = Vec::new();
                    geometry.spread(&splat, bins.clone(), &mut energies);
                    for (bin, energy) in bins.zip(energies) {
                        intensity[bin] += strength * energy;
                    }
                }
                keyframe(intensity, pose)
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

        fn scene(&self) -> Scene<'_> {
            let (at_work, _) = decide(&Features::default(), &Cues::default(), MapCues::default());
            Scene {
                evidence: &self.evidence,
                gaussians: &self.gaussians,
                is_blurred: false,
                at_work,
            }
        }

        fn sums<T: Sum + Sync, W: Default>(
            &self,
            each: impl Fn(&mut Tally<T>, &mut W, &Keyframe, &Sight) + Sync,
        ) -> Vec<T> {
            let mut pass = Pass::over(self.pings.clone(), &self.evidence, &self.gaussians);
            while !pass.is_done() {
                pass.advance(self.scene(), 1, &each);
            }
            pass.finish().0
        }

        fn step(&mut self) {
            let sums = self.sums(strengths_of_ping);
            let at_work = self.scene().at_work;
            maximise(&mut self.gaussians, &sums, 1.0, Pace::Full, at_work);
        }

        /// Log likelihood of gamma speckle, up to a constant.
        fn log_likelihood(&self) -> f64 {
            let field = Field::of(&self.evidence, &self.gaussians);
            let mut sight = Sight::default();
            let of_ping = |keyframe: &Arc<Keyframe>| {
                sight.observe(keyframe, self.scene(), &field);
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
            let sums = trial.sums(strengths_of_ping)[slot];
            let (mut weight, strength) =
                (sums.weight, DirectionalReflectivity::even(2.0 * STRENGTH));
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
        let faces = |x: f32, y: f32| DirectionalReflectivity {
            ahead: Vec3::new(x, y, 0.0),
            behind: Vec3::ZERO,
        };
        let ends = |y_numerator: f32, y_weight: f32| {
            let mut now = DirectionalReflectivity::even(1.0);
            for _ in 0..100 {
                // What these observations alone would have: 1 towards x, √(numerator/weight) towards y.
                let mut weight = faces(100.0, y_weight);
                let mut numerator = faces(
                    100.0 / now.ahead.x.powi(2),
                    y_numerator / now.ahead.y.powi(2),
                );
                add_alike(&mut numerator, &mut weight, &now, FULL_STEP);
                now.ahead *= step(numerator.ahead, weight.ahead, FULL_STEP);
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
        assert!(
            (hardly.z - 1.0).abs() < 1e-6,
            "a side that was never seen: {hardly}"
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
            let score = trial.sums(scores_of_ping)[slot].gradient;
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
            let mut pass = Pass::over(many.clone(), &trial.evidence, &trial.gaussians);
            while !pass.is_done() {
                pass.advance(trial.scene(), portion, strengths_of_ping);
            }
            let sums = pass.finish().0;
            sums[slot].numerator.sum().to_bits()
        };
        assert_eq!(sums(1), sums(1000));
    }
}
