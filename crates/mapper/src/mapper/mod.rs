//! The face of the mapper.

mod allowance;
mod calibrator;
mod foretold;
mod intake;
mod published;
mod schedule;

mod status;
mod work;
mod workout;

use std::sync::Arc;

use echosplat_measurement::PingGeometry;
use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{PosedPing, Snapshot, Standing, Timestamp};
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::accumulate::history::History;
use crate::detect::bursts::Bursts;
use crate::detect::own_vehicle::OwnVehicle;
use crate::detect::profile::Levels;
use crate::detect::receiver::Receiver;
use crate::detect::repeats::Repeats;
use crate::detect::walkers::Walkers;
use crate::detect::working_range::WorkingRange;
use crate::drift::{Drift, PoseCorrections};
use crate::effort::{Counted, Task, TaskEnd, Tasks};
use crate::features::{AtWork, Cues, LeftOut, MapCues, decide};
use crate::mapper::workout::Workout;
use crate::progress::Progress;
use crate::seabed::Seabed;
use crate::spawn::gaussians::Gaussians;
use crate::world::World;
use crate::{ConfigError, MapperConfig};
pub use calibrator::{Calibrator, Questions};
use foretold::Foretelling;
pub use foretold::Foretold;
use published::{Print, Published};
pub use status::{InsertReport, MapperStatus, ReasonCounts};

/// Fraction of a typical strength; found.
/// A Gaussian spawned on a running map starts far below what a typical echo needs, so that it does not disturb what explains
/// the echo already, and is raised by what it explains.
const SPAWN_STRENGTH: f32 = 0.02;

/// From posed pings to a map.
#[derive(Debug)]
pub struct Mapper {
    config: MapperConfig,
    pool: Arc<ThreadPool>,
    world: Option<World>,
    receiver: Receiver,
    own_vehicle: OwnVehicle,
    bursts: Bursts,
    walkers: Walkers,
    levels: Levels,
    working_range: WorkingRange,
    seabed: Seabed,
    repeats: Repeats,
    history: History,
    gaussians: Gaussians,
    /// Pings of the slice that is being gathered, as they came.
    waiting: Vec<PosedPing>,
    last_geometry: Option<PingGeometry>,
    /// Tiles that are being worked out.
    workout: Option<Workout>,
    /// Work allowed and not yet done; below zero what the last portion took too much.
    credit_pairs: i64,
    epoch: u64,
    sequence: u64,
    published: Published,
    unit_strength: f32,
    cues: Cues,
    at_work: AtWork,
    left_out: Vec<LeftOut>,
    status: MapperStatus,
    progress: Progress,
    tasks: Tasks,
    foretold: Foretelling,
    drift: Drift,
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
        Ok(Self::with_threads(config, Arc::new(pool)))
    }

    fn with_threads(config: MapperConfig, pool: Arc<ThreadPool>) -> Self {
        let (at_work, left_out) = decide(&config.parts, &Cues::default(), MapCues::default());
        Self {
            history: History::new(config.history_pings.max(2 * config.slice_pings)),
            seabed: Seabed::new(&config.beam, config.parts.seabed),
            drift: Drift::new(config.parts.drift),
            config,
            pool,
            world: None,
            receiver: Receiver::default(),
            own_vehicle: OwnVehicle::default(),
            bursts: Bursts::default(),
            walkers: Walkers::default(),
            levels: Levels::default(),
            working_range: WorkingRange::default(),
            repeats: Repeats::default(),
            gaussians: Gaussians::default(),
            waiting: Vec::new(),
            last_geometry: None,
            workout: None,
            credit_pairs: 0,
            epoch: 1,
            sequence: 0,
            published: Published::default(),
            unit_strength: 0.0,
            cues: Cues::default(),
            at_work,
            left_out,
            status: MapperStatus::default(),
            progress: Progress::default(),
            tasks: Tasks::default(),
            foretold: Foretelling::default(),
        }
    }

    /// Its snapshots are of this epoch from now on, and count on from `sequence`.
    pub fn number(&mut self, epoch: u64, sequence: u64) {
        (self.epoch, self.sequence) = (epoch, sequence);
    }

    /// The map as it stands. Looking at it leaves no trace in later ones. It is held until the next, which copies what stayed.
    pub fn snapshot(&mut self) -> Arc<Snapshot> {
        let snapshot = Arc::new(self.publish());
        if let Some(print) = self.print() {
            self.published.keep(print, &snapshot);
        }
        snapshot
    }

    /// What published Gaussians are made with, once there is a first ping.
    fn print(&self) -> Option<Print> {
        Some(Print {
            unit: published::intensity_unit(self.unit_strength),
            placing: self.world.as_ref()?.placing(),
        })
    }

    /// Has `tell` called again and again, from any of the mapper's threads, while a step of [`Self::insert`] goes on that may
    /// take seconds: when all pings so far are judged or summed up anew. Who watches over the mapper knows by it that it works.
    pub fn on_progress(&mut self, tell: impl Fn() + Send + Sync + 'static) {
        self.progress = Progress::told_to(tell);
    }

    /// Has `begin` called when a task begins, and what it gives when that has ended, on the thread that called
    /// [`Self::insert`], [`Self::snapshot`] or [`Self::finish`]: who has a clock can tell what each takes.
    pub fn on_task(&mut self, begin: impl Fn(Task) -> TaskEnd + Send + Sync + 'static) {
        self.tasks.told_to(begin);
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

    fn publish(&mut self) -> Snapshot {
        let begun = self.tasks.begin(Task::Snapshot);
        let snapshot = self.copied();
        let counted = Counted {
            candidates: snapshot.gaussians.len() as u64,
            ..Counted::default()
        };
        self.tasks.end(begun, counted);
        snapshot
    }

    fn copied(&mut self) -> Snapshot {
        self.sequence += 1;
        let newest = self.history.newest();
        let intensity_unit = published::intensity_unit(self.unit_strength);
        let mut gaussians = Vec::new();
        if let Some(print) = self.print() {
            let (published, map) = (&mut self.published, &self.gaussians);
            gaussians = self.pool.install(|| published.of(map, print));
            let ground = self.seabed.published(intensity_unit);
            gaussians.extend(ground.into_iter().map(|ground| print.placing.leave(ground)));
        }
        let mut confident = 0;
        let reasons = gaussians.iter().map(|gaussian| {
            confident += u64::from(gaussian.standing == Standing::Confident);
            gaussian.why.reason
        });
        self.status.reasons = ReasonCounts::of(reasons);
        self.status.confident = confident;
        self.status.ambiguous = gaussians.len() as u64 - confident;
        Snapshot {
            epoch: self.epoch,
            sequence: self.sequence,
            time: newest.map_or(Timestamp::ZERO, |keyframe| keyframe.time),
            through_ping: newest.map_or(0, |keyframe| keyframe.sequence),
            origin_m: self
                .world
                .as_ref()
                .map_or(DVec3::ZERO, |w| w.published_origin_m),
            intensity_unit,
            gaussians,
        }
    }

    /// What poses were corrected by so far; after [`Self::finish`] what the whole dive says of each.
    #[must_use]
    pub fn pose_corrections(&self) -> PoseCorrections {
        self.drift.corrections(self.heading())
    }

    /// World from map.
    fn heading(&self) -> DQuat {
        self.world.as_ref().map_or(DQuat::IDENTITY, World::heading)
    }

    /// Where the mapper stands.
    #[must_use]
    pub fn status(&self) -> MapperStatus {
        MapperStatus {
            pings_forgotten: self.history.forgotten(),
            tiles_at_work: self.workout.as_ref().map_or(0, Workout::tile_count),
            candidates: self.gaussians.alive_count() as u64,
            evidence_blocks: self
                .world
                .as_ref()
                .map_or(0, |w| w.evidence.block_count() as u64),
            voxel_m: self.world.as_ref().map_or(0.0, |w| w.evidence.voxel_m()),
            rings_until_m: self.receiver.ringing().longest_m(),
            own_vehicle_m: self.own_vehicle.nearest_m(),
            ground_log_ratio: self.seabed.log_ratio(),
            water_surface_m: self.water_surface_m(),
            foretold: self.foretold.told(),
            drift: self.drift.told(self.heading()),
            tasks: self.tasks.counts(),
            ..self.status
        }
    }

    fn water_surface_m(&self) -> Option<f64> {
        let world = self.world.as_ref()?;
        Some(world.origin_m.z + f64::from(self.repeats.surface_m()?))
    }
}
