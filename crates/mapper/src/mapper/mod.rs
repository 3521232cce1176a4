//! The face of the mapper.

mod births;
mod finish;
mod published;
mod running;
mod splitting;

use std::sync::Arc;

use echosplat_acoustics::{Look, SymmetricMat3};
use echosplat_model::glam::{DQuat, DVec3, Vec3};
use echosplat_model::{Gaussian, Pose, PosedPing, Snapshot, Standing, Timestamp};
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;

use crate::assess::{Demand, Rule, findings, judge, tails};
use crate::evidence::Evidence;
use crate::expectation::{Scene, maximise};
use crate::gaussians::{Gaussians, Verdict};
use crate::history::{
    History, Past, every, look_of, novelty, past_of, pose_blur, pulse_variance_m2,
};
use crate::multiples::Multiples;
use crate::parts::{AtWork, Cue, Cues, Extent, LeftOut, MapCues, decide};
use crate::profile::{Backdrop, Levels, Profile};
use crate::seabed::Seabed;
use crate::{ConfigError, MapperConfig};
use running::Running;

/// Half the beam's width at the far end is resolved; voxels stay within these bounds.
const VOXEL_LIMITS_M: (f64, f64) = (0.02, 0.5);
/// Noise is reckoned with at least this far below the strongest echo, so that a silent simulator
/// does not make darkness infinitely telling.
const LEAST_NOISE: f32 = 1e-4;
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
/// On the pings' clock, a slice does not wait longer than this to be complete.
const LONGEST_SLICE_S: f64 = 0.1;
/// Pings asked whether they see the newest echo, within so far of its middle.
const RETURN_SAMPLE: usize = 256;
const RETURN_RADIUS_M: f32 = 2.0;
/// Of the best evidence beside it, what a place must hold for another try while the dive goes on.
const LIFTED_PART: f32 = 0.8;
/// Of what an independent look says, which a turn by the beam's width or a move of 5 cm makes.
const LEAST_NOVELTY: f32 = 0.5;
/// A Gaussian born on a running map starts far below what a typical echo needs, so that it does not
/// disturb what explains the echo already, and is raised by what it explains.
const NEWBORN_STRENGTH: f32 = 0.02;
/// Exponent of the multiplicative rule on part of the pings; ½ would be that of gamma speckle.
const PART_STEP: f32 = 0.35;
/// Candidates below this part of their strongest neighbour are not worth further work.
const TAIL_PART: f32 = 0.05;

/// No place on Earth is further from any origin in use, and nothing under water as fast: metres, and
/// metres or radians a second.
const FURTHEST_M: f64 = 1e9;
const FASTEST: f64 = 1e3;
/// A ping whose pose leaves open this part of its range says nothing of any place.
const UNPLACED_PART: f64 = 0.25;
/// Voxels from the first ping that can still be counted in 32 bits.
const MOST_VOXELS: f64 = (1 << 30) as f64;

/// Work allowed, counted in Gaussian–bin pairs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Budget {
    /// The step that passes this many pairs is the last.
    pub pairs: u64,
}

/// What one ping did.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct InsertReport {
    /// Whether a slice of pings was taken in with this one.
    pub slice_taken_in: bool,
    /// Gaussians born.
    pub added: u64,
    /// Gaussians that darkness took.
    pub pruned: u64,
    /// Whether the ping was left out since its pose or settings are not finite.
    pub rejected: bool,
}

/// What an optimisation did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct OptimizeReport {
    /// Multiplicative steps made.
    pub iterations: u64,
    /// What was taken of the budget: pairs done, and at least a thousand for each ping looked at,
    /// since finding that there is nothing to see costs as much.
    pub pairs: u64,
}

/// Where the mapper stands.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct MapperStatus {
    /// Pings taken in.
    pub pings: u64,
    /// Pings left out as not finite, or as beyond all reach.
    pub pings_rejected: u64,
    /// Pings that are evidence of nothing: a receiver at its stop, nothing beyond the
    /// blanking, a pose that leaves everything open.
    pub pings_deaf: u64,
    /// Pings left out since the one before said nearly all of it.
    pub pings_redundant: u64,
    /// Pings let go from memory to make room.
    pub pings_thinned: u64,
    /// Gaussians that the map asserts as surface, as of the last snapshot.
    pub confident: u64,
    /// Gaussians published as ambiguous, as of the last snapshot.
    pub ambiguous: u64,
    /// Bins of echoes taken for others heard again at a fixed multiple of their range.
    pub bins_doubted: u64,
    /// All Gaussians held, published or not.
    pub candidates: u64,
    /// Blocks of evidence held.
    pub evidence_blocks: u64,
    /// Edge of an evidence voxel, metres.
    pub voxel_m: f32,
    /// Voxel looks done so far.
    pub voxel_looks: u64,
    /// Gaussian–bin pairs done so far.
    pub pairs: u64,
    /// Multiplicative steps made so far.
    pub iterations: u64,
    /// Mean power of the noise in the newest ping over the strongest echo, decibels.
    pub noise_db: f32,
}

/// From posed pings to a map.
#[derive(Debug)]
pub struct Mapper {
    config: MapperConfig,
    pool: Arc<ThreadPool>,
    world: Option<World>,
    levels: Levels,
    seabed: Seabed,
    multiples: Multiples,
    /// After a finish; more pings have all of them taken in anew.
    is_evidence_put_down: bool,
    history: History,
    gaussians: Gaussians,
    /// Pings of the slice that is being gathered, as they came.
    waiting: Vec<PosedPing>,
    last_look: Option<Look>,
    /// Which of the older pings the next step takes.
    cursor: usize,
    bars_lifted_at: usize,
    sequence: u64,
    unit_strength: f32,
    running: Running,
    /// As of the last work done.
    pairs_per_ping: f64,
    cues: Cues,
    at_work: AtWork,
    left_out: Vec<LeftOut>,
    status: MapperStatus,
}

/// What the first ping fixes: inside the mapper, coordinates start where it was and run along its
/// heading, so that a dive moved and turned as a whole gives the same map, moved and turned.
#[derive(Debug)]
struct World {
    origin_m: DVec3,
    /// World from the mapper's own axes, a turn about z.
    heading: DQuat,
    evidence: Evidence,
}

impl World {
    fn begun_by(first: &PosedPing, config: &MapperConfig) -> Self {
        let ahead = first.world_from_sensor.rotation * DVec3::X;
        Self {
            origin_m: first.world_from_sensor.translation_m,
            heading: DQuat::from_rotation_z(ahead.y.atan2(ahead.x)),
            evidence: Evidence::new(voxel_m(first, config)),
        }
    }

    /// The ping on the mapper's own axes.
    fn enter(&self, posed: &PosedPing) -> PosedPing {
        let into = self.heading.conjugate();
        let pose = &posed.world_from_sensor;
        PosedPing {
            world_from_sensor: Pose {
                translation_m: into * (pose.translation_m - self.origin_m),
                rotation: (into * pose.rotation).normalize(),
            },
            ..posed.clone()
        }
    }

    /// A Gaussian on the mapper's own axes, relative to the origin along the world's.
    fn leave(&self, gaussian: Gaussian) -> Gaussian {
        Gaussian {
            mean_m: (self.heading * gaussian.mean_m.as_dvec3()).as_vec3(),
            rotation: self.heading.as_quat() * gaussian.rotation,
            ..gaussian
        }
    }
}

impl Mapper {
    /// # Errors
    /// If a setting is out of range or the threads cannot be started.
    pub fn new(config: MapperConfig) -> Result<Self, ConfigError> {
        config.check()?;
        let pool = ThreadPoolBuilder::new()
            .num_threads(config.threads)
            .thread_name(|index| format!("mapper-{index}"))
            .build()
            .map_err(|error| ConfigError::Threads(error.to_string()))?;
        let (at_work, left_out) = decide(&config.parts, &Cues::default(), MapCues::default());
        Ok(Self {
            history: History::new(config.history_pings.max(2 * config.slice_pings)),
            seabed: Seabed::new(&config.beam),
            config,
            pool: Arc::new(pool),
            world: None,
            levels: Levels::default(),
            multiples: Multiples::default(),
            is_evidence_put_down: false,
            gaussians: Gaussians::default(),
            waiting: Vec::new(),
            last_look: None,
            cursor: 0,
            bars_lifted_at: 0,
            sequence: 0,
            unit_strength: 0.0,
            running: Running::default(),
            pairs_per_ping: 0.0,
            cues: Cues::default(),
            at_work,
            left_out,
            status: MapperStatus::default(),
        })
    }

    /// Takes in one ping. With its slice complete: noise and echoes of each ping in order of time,
    /// evidence along the arcs, and Gaussians where the evidence now says so. What a slice says does
    /// not depend on the order in which its pings come.
    pub fn insert(&mut self, posed: &PosedPing) -> InsertReport {
        if !is_usable(posed) || !self.is_within_reach(posed) {
            self.status.pings_rejected += 1;
            return InsertReport {
                rejected: true,
                ..InsertReport::default()
            };
        }
        self.status.pings += 1;
        if !self.is_evidence(posed) {
            self.status.pings_deaf += 1;
            return InsertReport::default();
        }
        self.waiting.push(posed.clone());
        if self.waiting.len() >= self.config.slice_pings || self.is_slice_overdue() {
            return self.take_in_slice();
        }
        InsertReport::default()
    }

    /// Whether the first ping that waits for a slice has waited long enough.
    fn is_slice_overdue(&self) -> bool {
        let time = |posed: &PosedPing| posed.ping.transmit_time();
        let ends = self.waiting.first().zip(self.waiting.last());
        ends.is_some_and(|(first, last)| time(last).seconds_since(time(first)) > LONGEST_SLICE_S)
    }

    /// What a ping must say that the last one taken in did not.
    fn least_novelty(&self) -> f32 {
        match self.at_work.redundant {
            Extent::All => 0.0,
            Extent::Useful => LEAST_NOVELTY,
            Extent::None => 1.0,
        }
    }

    /// Whether voxels and single precision reach as far as the ping is from the first.
    fn is_within_reach(&self, posed: &PosedPing) -> bool {
        let (origin_m, voxel_m) = self.origin_and_voxel_m(posed);
        let away_m = posed.world_from_sensor.translation_m - origin_m;
        away_m.abs().max_element() < MOST_VOXELS * f64::from(voxel_m)
    }

    /// As they are, or as they would be if the first ping that waits, or this one, began the map.
    fn origin_and_voxel_m(&self, posed: &PosedPing) -> (DVec3, f32) {
        if let Some(world) = &self.world {
            return (world.origin_m, world.evidence.voxel_m());
        }
        let first = self.waiting.first().unwrap_or(posed);
        let origin_m = first.world_from_sensor.translation_m;
        (origin_m, voxel_m(first, &self.config))
    }

    /// Whether a ping says anything of any place, before it waits for its slice: those that do not
    /// leave no trace.
    fn is_evidence(&mut self, posed: &PosedPing) -> bool {
        let (_, voxel_m) = self.origin_and_voxel_m(posed);
        let tolerance_m = tolerance_m(voxel_m, range_sigma_m(posed, &self.config));
        f64::from(tolerance_m) <= UNPLACED_PART * posed.ping.settings().range_length_m
            && self.levels.hears(&posed.ping, self.config.blanking_m)
    }

    /// What the ping measured, before anything of the map.
    fn listen(&mut self, posed: &PosedPing) -> Past {
        let config = &self.config;
        let begun = || World::begun_by(posed, config);
        let world = self.world.get_or_insert_with(begun);
        let posed = &world.enter(posed);
        let look = look_of(posed, DVec3::ZERO, config);
        let blur = pose_blur(posed, config);
        let range_sigma_m = range_sigma_m(posed, config);
        let tolerance_m = tolerance_m(world.evidence.voxel_m(), range_sigma_m);
        let seabed = &mut self.seabed;
        let brightness = seabed.brightness();
        let ground = seabed.backdrop(&look, brightness);
        let mut profile = self
            .levels
            .profile(&posed.ping, tolerance_m.into(), &ground, config);
        let weight = match posed.ping.view() {
            Some(_) => 1.0,
            None => novelty(&look, self.last_look.as_ref()),
        };
        let (intensity, strongest) = (posed.ping.intensity(), self.levels.strongest());
        self.multiples
            .listen(&look, intensity, &profile, strongest, weight);
        self.status.bins_doubted +=
            doubt_multiples(&self.multiples, &look, intensity, &ground, &mut profile);
        let seabed = &mut self.seabed;
        self.pool
            .install(|| seabed.listen(&look, intensity, &profile));
        self.learn_unit_strength(&look, intensity, &profile.echoes);
        self.status.noise_db = 10.0 * (profile.noise / self.levels.strongest()).log10();
        self.cues.add(Cue {
            runs: profile.echoes.len(),
            weight,
            quarter: quarter_of(look.pose.axes.x_axis),
            blur_m: range_sigma_m,
            jitter_m: jitter_m(posed),
        });
        past_of(look, blur, profile, weight, brightness, posed)
    }

    /// The strength at which a Gaussian of one voxel would make the ping's strongest echo.
    fn learn_unit_strength(&mut self, look: &Look, intensity: &[f32], echoes: &[(u32, u32)]) {
        let Some(world) = &self.world else { return };
        let bins = echoes.iter().flat_map(|&(start, end)| start..end);
        let strongest =
            bins.max_by(|&a, &b| intensity[a as usize].total_cmp(&intensity[b as usize]));
        let Some(bin) = strongest else { return };
        let range_m = look.range_start_m + (bin as f32 + 0.5) * look.bin_length_m;
        let ahead = look.pose.position_m + look.pose.axes.x_axis * range_m;
        let round = SymmetricMat3::isotropic(0.5 * world.evidence.voxel_m());
        if let Some(splat) = look.project(ahead, &round) {
            let needed = intensity[bin as usize] / splat.energy;
            let before = if self.unit_strength > 0.0 {
                self.unit_strength
            } else {
                needed
            };
            self.unit_strength = before + 0.05 * (needed - before);
        }
    }

    /// Adds a ping to the history if it says something; whether it does.
    fn remember(&mut self, posed: &PosedPing) -> bool {
        let past = self.listen(posed);
        if past.weight < self.least_novelty() {
            self.status.pings_redundant += 1;
            return false;
        }
        self.last_look = Some(past.look);
        self.history.push(past);
        true
    }

    fn take_in_slice(&mut self) -> InsertReport {
        let mut slice = std::mem::take(&mut self.waiting);
        slice.sort_by_key(|posed| (posed.ping.transmit_time(), posed.ping.sequence()));
        let fresh = slice.iter().filter(|posed| self.remember(posed)).count();
        let Some(world) = &mut self.world else {
            return InsertReport::default();
        };
        let pings = self.history.pings();
        let start = pings.len() - fresh.min(pings.len());
        if pings.len() > 2 * self.bars_lifted_at + 256 {
            self.bars_lifted_at = pings.len();
            world.evidence.lift_bars(LIFTED_PART);
        }
        let extent = self.at_work.converged;
        let evidence = &mut world.evidence;
        let is_put_down = std::mem::take(&mut self.is_evidence_put_down);
        self.status.voxel_looks += self.pool.install(|| match is_put_down {
            true => {
                evidence.expect_glints(false);
                evidence.integrate_anew(pings, extent)
            }
            false => evidence.integrate(pings, start, extent),
        });
        let strength = NEWBORN_STRENGTH * self.unit_strength;
        let (added, pruned) = births::follow_evidence(
            evidence,
            &mut self.gaussians,
            self.config.spawn_evidence,
            strength,
        );
        InsertReport {
            slice_taken_in: true,
            added,
            pruned,
            rejected: false,
        }
    }

    /// Refines the map on the newest pings and some of the older ones, step by step, until the
    /// budget is used.
    pub fn optimize(&mut self, budget: Budget) -> OptimizeReport {
        let mut report = OptimizeReport::default();
        while report.pairs < budget.pairs && self.gaussians.alive_count() > 0 {
            report.pairs += self.step();
            report.iterations += 1;
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

    /// The map as it stands. Looking at it leaves no trace in what [`Mapper::finish`] gives.
    pub fn snapshot(&mut self) -> Snapshot {
        self.judge_running();
        self.publish()
    }

    fn scene<'a>(&'a self, world: &'a World) -> Scene<'a> {
        Scene {
            evidence: &world.evidence,
            gaussians: &self.gaussians,
            floor: self.floor(),
            is_blurred: false,
            at_work: self.at_work,
        }
    }

    /// What is asserted has to stand however far the poses may be off.
    fn blurred_scene<'a>(&'a self, world: &'a World) -> Scene<'a> {
        Scene {
            is_blurred: true,
            ..self.scene(world)
        }
    }

    /// Which parts the dive so far asks for.
    fn decide(&mut self) {
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
    fn is_of_use(&self, past: &Past) -> bool {
        self.at_work.empty == Extent::All || !past.profile.echoes.is_empty()
    }

    /// Its threads. A caller who is one of them hands nothing over at each call.
    #[must_use]
    pub fn pool(&self) -> Arc<ThreadPool> {
        Arc::clone(&self.pool)
    }

    /// What is not at work, and why.
    #[must_use]
    pub fn left_out(&self) -> &[LeftOut] {
        &self.left_out
    }

    /// Least noise power to reckon with.
    fn floor(&self) -> f32 {
        LEAST_NOISE * self.levels.strongest()
    }

    /// Lets go of candidates below `part` of their strongest neighbour.
    fn drop_tails(&mut self, part: f32) {
        let Some(world) = &mut self.world else { return };
        let (gaussians, voxel_m) = (&self.gaussians, world.evidence.voxel_m());
        for slot in self.pool.install(|| tails(gaussians, voxel_m, part)) {
            let (block, voxel) = self.gaussians.home[slot];
            world.evidence.block_mut(block).bar(voxel, slot as u32);
            self.gaussians.remove(slot as u32);
        }
    }

    /// Verdicts by every `stride`-th ping remembered, as if by all.
    fn assess_every(&mut self, stride: f64) {
        let Some(world) = &self.world else { return };
        let pings = every(self.history.pings(), 0.0, stride);
        let scene = self.blurred_scene(world);
        let rule = Rule::of(&scene, &self.config);
        let (findings, pairs) = self.pool.install(|| findings(scene, &pings, rule));
        self.status.pairs += pairs;
        let voxel_m = world.evidence.voxel_m();
        let finding_of = |slot: usize| Some(findings[slot].times(stride as f32));
        let demand = Demand::of(&self.config, self.at_work);
        let gaussians = &mut self.gaussians;
        self.pool
            .install(|| judge(gaussians, finding_of, voxel_m, demand));
        self.doubt_underground();
    }

    /// Nothing is seen through the ground.
    fn doubt_underground(&mut self) {
        let slots: Vec<usize> = self.gaussians.slots().collect();
        for slot in slots {
            if self.seabed.hides(self.gaussians.mean_m[slot]) {
                self.gaussians.verdict[slot] = Verdict::ExplainedAway;
            }
        }
    }

    fn publish(&mut self) -> Snapshot {
        self.sequence += 1;
        let newest = self.history.pings().last();
        let intensity_unit = published::intensity_unit(self.unit_strength);
        let mut gaussians = published::published(&self.gaussians, intensity_unit);
        gaussians.extend(self.seabed.published(intensity_unit));
        if let Some(world) = &self.world {
            for gaussian in &mut gaussians {
                *gaussian = world.leave(*gaussian);
            }
        }
        let confident = gaussians
            .iter()
            .filter(|g| g.standing == Standing::Confident)
            .count() as u64;
        self.status.confident = confident;
        self.status.ambiguous = gaussians.len() as u64 - confident;
        Snapshot {
            epoch: 1,
            sequence: self.sequence,
            time: newest.map_or(Timestamp::ZERO, |past| past.time),
            through_ping: newest.map_or(0, |past| past.sequence),
            origin_m: self.world.as_ref().map_or(DVec3::ZERO, |w| w.origin_m),
            intensity_unit,
            gaussians,
        }
    }

    /// Where the mapper stands.
    #[must_use]
    pub fn status(&self) -> MapperStatus {
        MapperStatus {
            pings_thinned: self.history.thinned(),
            candidates: self.gaussians.alive_count() as u64,
            evidence_blocks: self
                .world
                .as_ref()
                .map_or(0, |w| w.evidence.block_count() as u64),
            voxel_m: self.world.as_ref().map_or(0.0, |w| w.evidence.voxel_m()),
            ..self.status
        }
    }
}

/// Tells echoes that may be others heard again, and judges the ping without them. Returns their bins.
fn doubt_multiples(
    multiples: &Multiples,
    look: &Look,
    intensity: &[f32],
    ground: &Backdrop,
    profile: &mut Profile,
) -> u64 {
    let runs = multiples.runs(look, intensity, profile);
    if runs.is_empty() {
        return 0;
    }
    let bins = runs
        .iter()
        .map(|&(start, end)| u64::from(end - start))
        .sum();
    profile.doubted = runs.into();
    profile.judge(intensity, ground);
    bins
}

/// Whether nothing about a ping's pose could make the map not finite.
fn is_usable(posed: &PosedPing) -> bool {
    // Lengths, since the largest element of some that are none may be one.
    let pose = &posed.world_from_sensor;
    pose.rotation.is_normalized()
        && pose.translation_m.length() < FURTHEST_M
        && posed.twist.linear_mps.length() < FASTEST
        && posed.twist.angular_radps.length() < FASTEST
        && posed.reference_range_m.is_finite()
        && [posed.uncertainty, posed.jitter]
            .into_iter()
            .flatten()
            .all(|u| {
                u.position_m >= 0.0
                    && u.position_m < 1e3
                    && u.attitude_rad >= 0.0
                    && u.attitude_rad < 3.2
            })
}

/// One sigma of where its pose's jitter puts the middle of a ping's range, 0 if nobody looked.
fn jitter_m(posed: &PosedPing) -> f32 {
    let Some(jitter) = posed.jitter else {
        return 0.0;
    };
    jitter
        .position_m
        .hypot(jitter.attitude_rad * posed.reference_range_m) as f32
}

/// One sigma of an echo's range: pulse and pose.
fn range_sigma_m(posed: &PosedPing, config: &MapperConfig) -> f32 {
    let pulse_variance_m2 = pulse_variance_m2(posed.ping.settings());
    (pulse_variance_m2 + pose_blur(posed, config).range_variance_m2).sqrt()
}

/// Echoes light places this much nearer and farther.
fn tolerance_m(voxel_m: f32, range_sigma_m: f32) -> f32 {
    0.45 * voxel_m + 2.2 * range_sigma_m
}

/// Quarter of the horizon that a direction is in.
fn quarter_of(direction: Vec3) -> usize {
    usize::from(direction.x < 0.0) + 2 * usize::from(direction.y < 0.0)
}

fn voxel_m(first: &PosedPing, config: &MapperConfig) -> f32 {
    if config.resolution_m > 0.0 {
        return config.resolution_m as f32;
    }
    let width = f64::from(config.beam.azimuth_width_deg.to_radians());
    let resolved_m = 0.35 * width * first.ping.settings().range_end_m();
    resolved_m.clamp(VOXEL_LIMITS_M.0, VOXEL_LIMITS_M.1) as f32
}
