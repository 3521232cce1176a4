//! The face of the mapper.

mod births;
mod finish;
mod intake;
mod published;
mod running;
mod splitting;
mod status;
mod steps;
mod world;

use std::sync::Arc;

use echosplat_acoustics::Look;
use echosplat_model::glam::DVec3;
use echosplat_model::{PosedPing, Snapshot, Standing, Timestamp};
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::assess::{Demand, Rule, findings, judge};
use crate::expectation::Scene;
use crate::gaussians::{Gaussians, Verdict};
use crate::history::{History, every};
use crate::multiples::Multiples;
use crate::parts::{AtWork, Cues, LeftOut, MapCues, decide};
use crate::profile::Levels;
use crate::seabed::Seabed;
use crate::{ConfigError, MapperConfig};
use running::Running;
pub use status::{Budget, InsertReport, MapperStatus, OptimizeReport};
use world::World;

/// Noise is reckoned with at least this far below the strongest echo, so that a silent simulator
/// does not make darkness infinitely telling.
const LEAST_NOISE: f32 = 1e-4;
/// A Gaussian born on a running map starts far below what a typical echo needs, so that it does not
/// disturb what explains the echo already, and is raised by what it explains.
const NEWBORN_STRENGTH: f32 = 0.02;
/// Candidates below this part of their strongest neighbour are not worth further work.
const TAIL_PART: f32 = 0.05;

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

    /// Its threads. A caller who is one of them hands nothing over at each call.
    #[must_use]
    pub fn pool(&self) -> Arc<ThreadPool> {
        Arc::clone(&self.pool)
    }

    /// Gives each the other's threads. Which threads do the work does not change the map.
    pub fn swap_threads(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.pool, &mut other.pool);
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
            origin_m: self
                .world
                .as_ref()
                .map_or(DVec3::ZERO, |w| w.published_origin_m),
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
