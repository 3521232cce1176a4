//! The pipeline, one for `run`, `replay` and `demo`: the sonar's thread, a bounded queue, the
//! mapper's thread, and this one, which watches over both, tells of them and ends them in order.

mod drivers;
mod gate;
mod latency;
mod mapping;
mod outlet;
mod poses;
mod prediction;
mod shared;
mod status;
mod worker;

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use crossbeam_channel::{Receiver, bounded};
use echosplat_bus::{AliveToken, Bus, MapPublisher};
use echosplat_driver::{DriverConfig, DriverEvent, DriverStatus};
use echosplat_mapper::Mapper;
use echosplat_model::Snapshot;

use crate::config::Config;
use crate::exit::Finish;
use crate::maps;
use crate::recorder::Recorder;
use crate::signals::Stop;

use drivers::Drivers;
pub(crate) use gate::Gate;
pub(crate) use mapping::Mapping;
use outlet::Outlet;
pub(crate) use outlet::{Observed, Observer, Schedule};
pub(crate) use poses::{Patience, Poses};
use prediction::Prediction;
pub(crate) use prediction::{blank_bins, is_fitted_on, pair_of};
use shared::Shared;
pub(crate) use shared::{Phase, Work};
use status::RateMeter;
pub(crate) use status::Status;
use worker::{THREAD_NAME, Worker};

/// How often flags are looked at.
const TICK: Duration = Duration::from_millis(20);
const STATUS_EVERY: Duration = Duration::from_secs(1);
/// The mapper's thread is asked for its part so long before.
const REPORT_TIME: Duration = Duration::from_millis(100);
const SYNC_EVERY: Duration = Duration::from_millis(500);
/// How long publishing the final map may take.
const FLUSH_LIMIT: Duration = Duration::from_secs(30);
/// Those who lost part of the final map ask for it again within so long.
const LINGER: Duration = Duration::from_millis(500);
const MAX_LINGER: Duration = Duration::from_secs(5);

/// All a run needs that differs between commands.
pub(crate) struct Setup {
    /// The sonar, or logs one after another.
    pub(crate) drivers: Vec<DriverConfig>,
    pub(crate) poses: Poses,
    pub(crate) gate: Gate,
    /// `None` publishes nothing.
    pub(crate) bus: Option<Arc<Bus>>,
    pub(crate) recorder: Option<Recorder>,
    /// Names this run's map; no two runs that somebody may follow have the same.
    pub(crate) epoch: u64,
    pub(crate) hooks: Hooks,
}

/// What a command wants to know while it runs.
#[derive(Default)]
pub(crate) struct Hooks {
    /// Takes maps at some moments, on the mapper's thread.
    pub(crate) observer: Option<Observer>,
    /// Called once a second on the calling thread.
    pub(crate) on_status: Option<OnStatus>,
    /// Asked often: whether the sonar has nothing more to say.
    pub(crate) is_over: Option<IsOver>,
    /// Called with the final map once it is published, while others can still ask for it.
    pub(crate) on_final: Option<OnFinal>,
}

pub(crate) type OnStatus = Box<dyn FnMut(&Status)>;
pub(crate) type IsOver = Box<dyn FnMut(&DriverStatus) -> bool>;
pub(crate) type OnFinal = Box<dyn FnOnce(&Snapshot)>;

/// What a run came to.
pub(crate) struct Outcome {
    pub(crate) snapshot: Arc<Snapshot>,
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
/// If the mapper cannot be started, or the map cannot be written.
pub(crate) fn run(config: &Config, setup: Setup, stop: &Stop) -> anyhow::Result<Outcome> {
    if let Some(map) = &config.output.map {
        maps::prepare(map)?;
    }
    let mut run = Run::start(config, setup)?;
    run.watch(stop)?;
    let outcome = run.conclude()?;
    match &config.output.map {
        // An earlier map at the same place is worth more than nothing.
        Some(map) if outcome.status.report.pings_mapped == 0 => {
            tracing::warn!(map = %map.display(), "no ping was mapped, so no map is written");
        }
        Some(map) => maps::write(&outcome.snapshot, map)?,
        None => {}
    }
    Ok(outcome)
}

/// What the mapper's thread takes from, and gives to.
struct Feed {
    events: Receiver<DriverEvent>,
    inputs_left: usize,
    poses: Poses,
    gate: Gate,
    outlet: Outlet,
}

/// Starts the mapper and its thread.
fn start_worker(
    config: &Config,
    feed: Feed,
    shared: &Arc<Shared>,
) -> anyhow::Result<JoinHandle<Arc<Snapshot>>> {
    let worker = Worker {
        events: feed.events,
        inputs_left: feed.inputs_left,
        poses: feed.poses,
        mapper: Mapper::new(config.mapper.clone())?,
        gate: feed.gate,
        outlet: feed.outlet,
        shared: Arc::clone(shared),
        looks_per_ping: config.pipeline.looks_per_ping,
        pairs_per_ping: config.pipeline.pairs_per_ping,
        snapshot_interval_s: config.pipeline.snapshot_interval_s,
        hold_back_every: config.pipeline.hold_back_every,
        state: worker::State::new(Instant::now()),
    };
    std::thread::Builder::new()
        .name(THREAD_NAME.to_owned())
        .spawn(move || worker.run())
        .context("cannot start the mapper's thread")
}

/// A run under way.
struct Run {
    shared: Arc<Shared>,
    drivers: Drivers,
    worker: Option<JoinHandle<Arc<Snapshot>>>,
    bus: Option<Arc<Bus>>,
    publisher: Option<Arc<MapPublisher>>,
    alive: Option<AliveToken>,
    recorder: Option<Recorder>,
    hooks: Hooks,
    begin: Instant,
    rates: RateMeter,
}

impl Run {
    fn start(config: &Config, setup: Setup) -> anyhow::Result<Self> {
        let shared = Arc::new(Shared::new());
        let (publisher, alive) = match &setup.bus {
            Some(bus) => (
                Some(Arc::new(bus.publish_map()?)),
                Some(bus.declare_alive()?),
            ),
            None => (None, None),
        };
        let mut hooks = setup.hooks;
        let prediction = match config.pipeline.hold_back_every {
            0 => None,
            every => Some(Prediction::start(every, config.mapper.clone())?),
        };
        let outlet = Outlet::new(setup.bus.clone(), publisher.clone(), hooks.observer.take());
        let outlet = outlet.predicting(prediction);
        let (sender, events) = bounded(config.pipeline.queue_pings);
        let drivers = Drivers::start(setup.drivers, setup.recorder.as_ref(), sender)?;
        let feed = Feed {
            events,
            inputs_left: drivers.count(),
            poses: setup.poses,
            gate: setup.gate,
            outlet: outlet.of_epoch(setup.epoch),
        };
        let worker = start_worker(config, feed, &shared)?;
        Ok(Self {
            shared,
            drivers,
            worker: Some(worker),
            bus: setup.bus,
            publisher,
            alive,
            recorder: setup.recorder,
            hooks,
            begin: Instant::now(),
            rates: RateMeter::default(),
        })
    }

    /// Until the mapper's thread has ended: tells of both, and stops the sonar when it is time.
    fn watch(&mut self, stop: &Stop) -> anyhow::Result<()> {
        let (mut told, mut synced) = (Instant::now(), Instant::now());
        while self.worker.as_ref().is_some_and(|w| !w.is_finished()) {
            std::thread::sleep(TICK);
            if stop.is_set() || self.is_over() {
                self.shared.set_phase(Phase::InputEnded);
            }
            match self.shared.phase() {
                Phase::Running => self.drivers.go_on_to_next()?,
                Phase::InputEnded | Phase::Finishing => self.drivers.stop(),
            }
            if told.elapsed() + REPORT_TIME >= STATUS_EVERY {
                self.shared.ask_for_report();
            }
            if told.elapsed() >= STATUS_EVERY {
                told = Instant::now();
                self.tell(false)?;
            }
            if synced.elapsed() >= SYNC_EVERY
                && let Some(recorder) = &self.recorder
            {
                synced = Instant::now();
                recorder.sync();
            }
        }
        self.drivers.stop();
        Ok(())
    }
}

impl Run {
    fn is_over(&mut self) -> bool {
        let status = self.drivers.status();
        self.hooks
            .is_over
            .as_mut()
            .is_some_and(|is_over| is_over(&status))
    }

    /// Shows, records and publishes the status.
    fn tell(&mut self, is_final: bool) -> anyhow::Result<()> {
        let status = self.status(is_final);
        tracing::debug!(
            pings_received = status.pings_received,
            pings_mapped = status.report.pings_mapped,
            link = ?status.link.state,
            phase = ?status.phase,
            "status"
        );
        if let Some(on_status) = &mut self.hooks.on_status {
            on_status(&status);
        }
        let status = serde_json::to_value(&status)?;
        if let Some(recorder) = &self.recorder {
            recorder.event(&status);
        }
        // A bus that fails is no reason to stop mapping.
        if let Some(bus) = &self.bus
            && let Err(error) = bus.publish_status(&status)
        {
            tracing::debug!(%error, "status not published");
        }
        Ok(())
    }

    fn status(&mut self, is_final: bool) -> Status {
        let report = self.shared.report();
        let mut status = Status {
            phase: self.shared.phase(),
            is_final,
            wall_s: self.begin.elapsed().as_secs_f64(),
            link: self.shared.link(),
            publisher: self
                .publisher
                .as_ref()
                .map(|publisher| publisher.counters()),
            pings_not_published: self.bus.as_ref().map_or(0, |bus| bus.pings_dropped()),
            recording: self.recorder.as_ref().map(Recorder::counters),
            ..Status::of(report, self.drivers.status())
        };
        let counters = [
            status.pings_received,
            status.report.pings_mapped,
            status.sonar.session.bytes_received,
        ];
        status.rates = self.rates.measure(Instant::now(), counters);
        status
    }

    /// Takes the finished map, publishes it whole, and tells the last of everything.
    fn conclude(mut self) -> anyhow::Result<Outcome> {
        let worker = self.worker.take().context("a run ends once")?;
        let snapshot = worker
            .join()
            .map_err(|_| anyhow!("the mapper's thread panicked; the log above says where"))?;
        let is_published = self.publish_final();
        self.tell(true)?;
        let status = self.status(true);
        if let Some(recorder) = &self.recorder {
            recorder.finish();
        }
        if let Some(on_final) = self.hooks.on_final.take() {
            on_final(&snapshot);
        }
        if is_published {
            self.linger();
        }
        drop(self.alive);
        Ok(Outcome { snapshot, status })
    }

    fn publish_final(&self) -> bool {
        let Some(publisher) = &self.publisher else {
            return false;
        };
        match publisher.flush(FLUSH_LIMIT) {
            Ok(report) => tracing::debug!(?report, "the final map is published"),
            Err(error) => tracing::warn!(%error, "subscribers may not have the final map"),
        }
        true
    }

    /// Stays until nobody asks any more, within a limit.
    fn linger(&self) {
        let answered = || {
            let counters = self
                .publisher
                .as_ref()
                .map(|publisher| publisher.counters());
            counters.map_or(0, |counters| counters.queries_answered)
        };
        let begin = Instant::now();
        let mut before = u64::MAX;
        while before != answered() && begin.elapsed() < MAX_LINGER {
            before = answered();
            std::thread::sleep(LINGER);
        }
    }
}
