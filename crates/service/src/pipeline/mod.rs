//! The pipeline, one for `run`, `replay` and `demo`: the sonar's thread, a bounded queue, the
//! mapper's thread, and this one, which watches over all parts, tells of them and ends them in order.

mod album;
pub(crate) mod calibration;
mod conclusion;
mod diagnosis;
mod drivers;
mod earlier;
mod effort;
mod ending;
mod frame_check;
mod gate;
mod gnss;
mod keeper;
mod latency;
mod listening;
mod mapping;
mod notices;
mod outlet;
mod places;
mod poses;
mod prediction;
mod published;
mod run;
mod saving;
mod shared;
mod shedding;
mod status;
mod telling;
pub(crate) mod track;
mod worker;

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Instant;

use anyhow::Context;
use crossbeam_channel::Receiver;
use echosplat_bus::{Bus, DRIVER_ROLE, MAPPER_ROLE};
use echosplat_driver::{DriverEvent, DriverStatus};
use echosplat_georeference::Georeference;
use echosplat_liveness::Heartbeat;
use echosplat_mapper::Mapper;
use echosplat_model::Snapshot;
use echosplat_web::{Feed, Track};

use crate::config::Config;
use crate::exit::Finish;
use crate::recorder::Recorder;
use crate::signals::Stop;
use crate::split::{TapeReport, TapeState};
use crate::{files, maps};

pub(crate) use album::Album;
pub(crate) use diagnosis::{Diagnosis, Expectations, no_time, range_of};
pub(crate) use drivers::{Drivers, Input};
use earlier::EarlierMaps;
use ending::Ending;
use frame_check::FrameCheck;
pub(crate) use gate::{Gate, Passage};
pub(crate) use gnss::{Gnss, heard_of};
pub(crate) use keeper::Keeper;
pub(crate) use listening::Listening;
pub use mapping::Mapping;
pub(crate) use notices::{Finding, Notice, Notices};
use outlet::Outlet;
pub use outlet::{Moment, Observed, Observer, Schedule};
use places::Places;
pub(crate) use places::{contradiction, georeference_of, tell_separation};
pub use poses::{Joined, Poses};
pub(crate) use poses::{Patience, PoseReport, Span};
use run::Run;
pub(crate) use shared::{Link, Phase, Shared};
pub use shared::{MapperReport, Spent};
pub(crate) use shedding::Shedding;
pub(crate) use status::{RateMeter, Rates, STATUS_VERSION, Status};
use track::PosesAsTheyCame;
use worker::{THREAD_NAME, Worker};

/// All a run needs that differs between commands.
pub(crate) struct Setup {
    /// The sonar, or logs one after another.
    pub(crate) inputs: Vec<Input>,
    pub(crate) poses: Poses,
    pub(crate) gate: Gate,
    /// `None` publishes nothing.
    pub(crate) bus: Option<Arc<Bus>>,
    pub(crate) recorder: Option<Recorder>,
    pub(crate) shedding: Shedding,
    /// What is known to be missing or wrong in what is read, a sentence each.
    pub(crate) losses: Vec<String>,
    /// Names this run's map; no two runs that somebody may follow have the same.
    pub(crate) epoch: u64,
    /// Where on Earth the poses count from, by their epoch, as far as that is known beforehand.
    pub(crate) places: Vec<(u32, Georeference)>,
    pub(crate) expectations: Expectations,
    pub(crate) part: Part,
    pub(crate) hooks: Hooks,
}

/// Who says when the next ping comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Pace {
    /// The sonar.
    Live,
    /// A log's times.
    Replayed,
    /// The map: as soon as the last one is in it.
    AsMapped,
}

/// Which part of a dive's work the run does.
#[derive(Debug, Clone, Default)]
pub(crate) enum Part {
    /// All of it.
    #[default]
    Whole,
    /// It maps what a driver elsewhere hears, of which this tells.
    Mapper(TapeState),
}

impl Part {
    /// The roles of the service in its liveliness tokens.
    pub(crate) fn roles(&self) -> &'static [&'static str] {
        match self {
            Self::Whole => &[MAPPER_ROLE, DRIVER_ROLE],
            Self::Mapper(_) => &[MAPPER_ROLE],
        }
    }

    fn publishes_pings(&self) -> bool {
        matches!(self, Self::Whole)
    }

    fn tape(&self) -> Option<TapeReport> {
        match self {
            Self::Whole => None,
            Self::Mapper(tape) => Some(tape.read()),
        }
    }
}

/// What a command wants to know while it runs.
#[derive(Default)]
pub(crate) struct Hooks {
    /// Takes maps at some moments, on the mapper's thread.
    pub(crate) observer: Option<Observer>,
    /// Maps of other moments of the dive, kept.
    pub(crate) album: Option<Album>,
    /// Called once a second on the calling thread.
    pub(crate) on_status: Option<OnStatus>,
    /// Asked often: whether the sonar has nothing more to say.
    pub(crate) is_over: Option<IsOver>,
    /// Called with the final map once it is published, while others can still ask for it.
    pub(crate) on_final: Option<OnFinal>,
    /// Takes where the sonar was, for a report.
    pub(crate) way: Option<Way>,
    /// Shows what there is to show.
    pub(crate) page: Option<Feed>,
    /// Of the threads of the page, which the run goes on without.
    pub(crate) page_heartbeats: Vec<Heartbeat>,
    /// What is known to be wrong before it begins, and stands all along.
    pub(crate) known: Vec<Finding>,
}

/// Where the sonar was; shared with whoever asks when the run is over.
pub(crate) type Way = Arc<Mutex<Track>>;
pub(crate) type OnStatus = Box<dyn FnMut(&Status)>;
pub(crate) type IsOver = Box<dyn FnMut(&DriverStatus) -> bool>;
pub(crate) type OnFinal = Box<dyn FnOnce(&Snapshot)>;

/// What a run came to.
pub(crate) struct Outcome {
    pub(crate) snapshot: Arc<Snapshot>,
    /// Where on Earth the map lies, if that is known.
    pub(crate) place: Option<Georeference>,
    pub(crate) status: Status,
}

impl Outcome {
    /// Whether all that came in went into the map, but for a few pings.
    pub(crate) fn finish(&self) -> Finish {
        match self.status.loss() {
            None => Finish::Done,
            Some(loss) => {
                tracing::warn!("finished but lossy: {loss}");
                Finish::Lossy
            }
        }
    }
}

/// Runs from the first ping to the written map.
///
/// # Errors
/// If the mapper cannot be started, the map cannot be written, or a part that the run needs hung or
/// failed; map and recording then hold what came before.
pub(crate) fn run(config: &Config, setup: Setup, stop: &Stop) -> anyhow::Result<Outcome> {
    if let Some(map) = &config.output.map {
        maps::prepare(map)?;
    }
    if let Some(track) = &config.output.track {
        files::prepare("--track", track)?;
    }
    let mut run = Run::start(config, setup)?;
    let finish_within = config.pipeline.finish_within();
    stop.run_begins(run.last_will(), run.heartbeat(), finish_within);
    let outcome = match run.heartbeat().survive(|| run.watch(stop)) {
        Ok(Ok(ending)) => run.conclude(&ending, stop),
        Ok(Err(error)) => {
            run.give_up();
            Err(error)
        }
        Err(panicked) => {
            stop.ask();
            run.stop_input();
            let why = format!("the part `run` failed, {panicked}");
            run.conclude(&Ending::of_failure(why), stop)
        }
    };
    stop.run_ends();
    outcome
}

/// What the mapper's thread takes from, and gives to.
struct Wiring {
    events: Receiver<DriverEvent>,
    inputs_left: usize,
    poses: Poses,
    gate: Gate,
    outlet: Outlet,
    shedding: Shedding,
    earlier: EarlierMaps,
    places: Places,
    frame_check: Option<FrameCheck>,
    calibration: calibration::Watch,
    /// Gathered where the way is written.
    came: Option<PosesAsTheyCame>,
}

/// Starts the mapper and its thread, which gives the finished map unless it panicked.
fn start_worker(
    config: &Config,
    wiring: Wiring,
    shared: &Arc<Shared>,
    heartbeat: Heartbeat,
) -> anyhow::Result<JoinHandle<Option<Arc<Snapshot>>>> {
    let worker = Worker {
        events: wiring.events,
        inputs_left: wiring.inputs_left,
        poses: wiring.poses,
        mapper: Mapper::new(config.mapper.clone())?,
        mapper_config: config.mapper.clone(),
        earlier: wiring.earlier,
        places: wiring.places,
        frame_check: wiring.frame_check,
        calibration: wiring.calibration,
        came: wiring.came,
        shedding: wiring.shedding,
        gate: wiring.gate,
        outlet: wiring.outlet,
        shared: Arc::clone(shared),
        heartbeat: heartbeat.clone(),
        snapshot_interval_s: config.pipeline.snapshot_interval_s,
        hold_back_every: config.pipeline.hold_back_every,
        state: worker::State::new(Instant::now()),
    };
    std::thread::Builder::new()
        .name(THREAD_NAME.to_owned())
        .spawn(move || heartbeat.run_once(|| worker.run()))
        .context("cannot start the mapper's thread")
}
