//! The pipeline, one for `run`, `replay` and `demo`: the sonar's thread, a bounded queue, the
//! mapper's thread, and this one, which watches over both, tells of them and ends them in order.

mod album;
mod diagnosis;
mod drivers;
mod earlier;
mod ending;
mod frame_check;
mod gate;
mod keeper;
mod latency;
mod listening;
mod mapping;
mod notices;
mod outlet;
mod poses;
mod prediction;
mod shared;
mod status;
mod worker;

use std::collections::HashSet;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use crossbeam_channel::{Receiver, bounded};
use echosplat_bus::{AliveToken, Bus, MapPublisher};
use echosplat_driver::{DriverEvent, DriverStatus};
use echosplat_mapper::Mapper;
use echosplat_model::Snapshot;
use echosplat_recording::mcap::Record;
use echosplat_web::Feed as PageFeed;

use crate::clock;
use crate::config::Config;
use crate::exit::{Finish, Usage};
use crate::maps::{self, MapNotes};
use crate::recorder::Recorder;
use crate::signals::Stop;

pub(crate) use album::Album;
use album::AlbumWriter;
use diagnosis::Diagnosis;
pub(crate) use diagnosis::Expectations;
pub(crate) use drivers::{Drivers, Input};
use earlier::EarlierMaps;
use ending::Ending;
use frame_check::FrameCheck;
pub(crate) use gate::Gate;
use keeper::Keeper;
pub(crate) use mapping::Mapping;
use notices::Notices;
use outlet::Outlet;
pub(crate) use outlet::{Observed, Observer, Schedule};
pub(crate) use poses::{Patience, Poses, Span};
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
/// How often it is asked what is wrong.
const DIAGNOSIS_EVERY: Duration = Duration::from_millis(250);
/// The mapper's thread is asked for its part so long before.
const REPORT_TIME: Duration = Duration::from_millis(100);
/// How long publishing the final map may take.
const FLUSH_LIMIT: Duration = Duration::from_secs(30);
/// Those who lost part of the final map ask for it again within so long.
const LINGER: Duration = Duration::from_millis(500);
const MAX_LINGER: Duration = Duration::from_secs(5);

/// All a run needs that differs between commands.
pub(crate) struct Setup {
    /// The sonar, or logs one after another.
    pub(crate) inputs: Vec<Input>,
    pub(crate) poses: Poses,
    pub(crate) gate: Gate,
    /// `None` publishes nothing.
    pub(crate) bus: Option<Arc<Bus>>,
    pub(crate) recorder: Option<Recorder>,
    /// Pings that a recorded dive had no time for.
    pub(crate) shed: HashSet<u64>,
    /// Names this run's map; no two runs that somebody may follow have the same.
    pub(crate) epoch: u64,
    pub(crate) expectations: Expectations,
    pub(crate) hooks: Hooks,
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
    /// Shows what there is to show.
    pub(crate) page: Option<PageFeed>,
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
    let ending = run.watch(stop)?;
    run.conclude(&ending)
}

/// What the mapper's thread takes from, and gives to.
struct Feed {
    events: Receiver<DriverEvent>,
    inputs_left: usize,
    poses: Poses,
    gate: Gate,
    outlet: Outlet,
    shed: HashSet<u64>,
    earlier: EarlierMaps,
    frame_check: Option<FrameCheck>,
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
        mapper_config: config.mapper.clone(),
        earlier: feed.earlier,
        frame_check: feed.frame_check,
        shed: feed.shed,
        gate: feed.gate,
        outlet: feed.outlet,
        shared: Arc::clone(shared),
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
    keeper: Option<Keeper>,
    album: Option<AlbumWriter>,
    diagnosis: Diagnosis,
    notices: Notices,
    hooks: Hooks,
    begin: Instant,
    rates: RateMeter,
}

/// The role of a service in its liveliness token: it maps.
pub(crate) const ROLE: &str = "mapper";

impl Run {
    fn start(config: &Config, setup: Setup) -> anyhow::Result<Self> {
        let shared = Arc::new(Shared::new());
        if let (Some(bus), Some(recorder)) = (&setup.bus, &setup.recorder) {
            record_what_is_published(bus, recorder);
        }
        let (publisher, alive) = match &setup.bus {
            Some(bus) => (
                Some(Arc::new(bus.publish_map()?)),
                Some(bus.declare_alive(ROLE)?),
            ),
            None => (None, None),
        };
        let mut hooks = setup.hooks;
        let prediction = match config.pipeline.hold_back_every {
            0 => None,
            every => Some(Prediction::start(every, config.mapper.clone())?),
        };
        let notes = MapNotes {
            held_out_every: config.pipeline.hold_back_every,
            ..MapNotes::default()
        };
        let mut observers = Vec::from_iter(hooks.observer.take());
        let mut album = None;
        if let Some(asked) = hooks.album.take() {
            let (writer, observer) = asked.open(notes.clone())?;
            album = Some(writer);
            observers.push(observer);
        }
        let outlet = Outlet::new(setup.bus.clone(), publisher.clone(), observers);
        let outlet = outlet.predicting(prediction).shown_on(hooks.page.clone());
        let (sender, events) = bounded(config.pipeline.queue_pings);
        let drivers = Drivers::start(setup.inputs, setup.recorder.as_ref(), sender)?;
        let mount = config.pose.vehicle_from_sensor.pose();
        let feed = Feed {
            events,
            inputs_left: drivers.count(),
            poses: setup.poses,
            gate: setup.gate,
            outlet: outlet.of_epoch(setup.epoch),
            shed: setup.shed,
            earlier: EarlierMaps::beside(config.output.map.clone(), notes.clone()),
            frame_check: Some(FrameCheck::start(config.mapper.clone(), mount)?),
        };
        let worker = start_worker(config, feed, &shared)?;
        let begin = Instant::now();
        Ok(Self {
            shared,
            drivers,
            worker: Some(worker),
            bus: setup.bus,
            publisher,
            alive,
            recorder: setup.recorder,
            keeper: config.output.map.clone().map(|map| Keeper::new(map, notes)),
            album,
            diagnosis: Diagnosis::new(setup.expectations, begin),
            notices: Notices::new(begin),
            hooks,
            begin,
            rates: RateMeter::default(),
        })
    }

    /// Until the mapper's thread has ended, or may be waited for no longer: tells of both, and stops
    /// the sonar when it is time.
    fn watch(&mut self, stop: &Stop) -> anyhow::Result<Ending> {
        let (mut told, mut diagnosed) = (Instant::now(), Instant::now());
        let mut ending = Ending::default();
        while self.worker.as_ref().is_some_and(|w| !w.is_finished()) {
            std::thread::sleep(TICK);
            ending.note(stop);
            if ending.is_asked() || self.is_over() {
                self.shared.set_phase(Phase::InputEnded);
            }
            match self.shared.phase() {
                Phase::Running => self.drivers.go_on_to_next()?,
                Phase::InputEnded | Phase::Finishing => self.drivers.stop(),
            }
            if ending.is_mapping_overdue() {
                break;
            }
            if told.elapsed() + REPORT_TIME >= STATUS_EVERY {
                self.shared.ask_for_report();
            }
            if diagnosed.elapsed() >= DIAGNOSIS_EVERY {
                diagnosed = Instant::now();
                self.give_way()?;
                self.shared.ask_for_report();
                self.diagnose();
            }
            if told.elapsed() >= STATUS_EVERY {
                told = Instant::now();
                self.tell(false)?;
            }
            if let Some(keeper) = &mut self.keeper {
                keeper.tick(|| self.shared.newest_map());
            }
        }
        self.drivers.stop();
        Ok(ending)
    }
}

/// Two services that ask for each other at the same moment find nobody; so long after the start one of
/// them still gives way.
const GIVES_WAY_WITHIN: Duration = Duration::from_secs(10);

/// Deltas and the frame of the map go into the recording as they are published.
fn record_what_is_published(bus: &Bus, recorder: &Recorder) {
    let to = recorder.clone();
    bus.on_delta(Box::new(move |cloud, info| {
        to.record(clock::now(), Record::Delta { cloud, info });
    }));
    let to = recorder.clone();
    bus.on_static_transform(Box::new(move |transform| {
        to.record(clock::now(), Record::StaticTransform(transform));
    }));
}

impl Run {
    fn is_over(&mut self) -> bool {
        let status = self.drivers.status();
        self.hooks
            .is_over
            .as_mut()
            .is_some_and(|is_over| is_over(&status))
    }

    /// # Errors
    /// If another service of this name began at the same time, and this one is to end.
    fn give_way(&mut self) -> anyhow::Result<()> {
        let Some(bus) = self
            .bus
            .as_ref()
            .filter(|_| self.begin.elapsed() < GIVES_WAY_WITHIN)
        else {
            return Ok(());
        };
        let others = bus.others_alive(ROLE);
        match echosplat_bus::gives_way(&bus.zenoh_id(), &others) {
            false => Ok(()),
            true => {
                self.drivers.stop();
                Err(Usage::error(other_service(&others).unwrap_or_default()))
            }
        }
    }

    /// Finds what is wrong, and tells what is new of it.
    fn diagnose(&mut self) {
        if self.shared.phase() != Phase::Running {
            return;
        }
        let status = self.status(false);
        let now = Instant::now();
        let findings = self.diagnosis.findings(&status, now);
        for finding in &findings {
            self.record_notice(finding);
        }
        self.notices.update(findings, now);
    }

    fn record_notice(&self, finding: &notices::Finding) {
        if let Some(recorder) = &self.recorder
            && !self.notices.stands(finding.code)
        {
            let event = serde_json::json!({
                "event": "notice", "code": finding.code, "sentence": finding.sentence
            });
            recorder.record(clock::now(), Record::Event(event));
        }
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
        if let Some(page) = &self.hooks.page {
            page.status(status.clone());
        }
        // A bus that fails is no reason to stop mapping.
        if let Some(bus) = &self.bus
            && let Err(error) = bus.publish_status(&status)
        {
            tracing::debug!(%error, "status not published");
        }
        if let Some(recorder) = &self.recorder {
            recorder.record(clock::now(), Record::Status(status));
        }
        Ok(())
    }

    fn status(&mut self, is_final: bool) -> Status {
        // In this order, so that what was taken is never more than what was sent.
        let report = self.shared.report();
        let sonar = self.drivers.status();
        let others = self.bus.as_ref().map(|bus| bus.others_alive(ROLE));
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
            recording: self.recorder.as_ref().and_then(Recorder::counters),
            recording_fault: self.recorder.as_ref().and_then(Recorder::fault),
            map_fault: self
                .keeper
                .as_ref()
                .and_then(Keeper::fault)
                .map(str::to_owned)
                .or_else(|| self.album.as_ref().and_then(AlbumWriter::fault)),
            other_service: other_service(&others.unwrap_or_default()),
            notices: self.notices.all(),
            newest_notice: self.notices.newest_standing().map(str::to_owned),
            input_share: self.drivers.share_read(),
            ..Status::of(report, sonar)
        };
        let counters = [
            status.pings_received,
            status.report.pings_mapped,
            status.sonar.session.bytes_received,
        ];
        self.rates.measure(Instant::now(), counters);
        status.rates = self.rates.rates();
        status
    }

    /// Takes the finished map, or the map as it stands if there is no time for more, writes and
    /// publishes it whole, and tells the last of everything.
    fn conclude(mut self, ending: &Ending) -> anyhow::Result<Outcome> {
        let worker = self.worker.take().context("a run ends once")?;
        let worker_ended = worker.is_finished();
        let snapshot = match worker_ended {
            true => worker
                .join()
                .map_err(|_| anyhow!("the mapper's thread panicked; the log above says where"))?,
            false => self.map_as_it_stands(),
        };
        if let Some(finding) = diagnosis::frames(&self.status(false)) {
            self.record_notice(&finding);
            self.notices.update(vec![finding], Instant::now());
        }
        let written = self.write_map(&snapshot);
        let kept = match self.album.take().filter(|_| worker_ended) {
            Some(album) => album.finish(),
            None => Ok(()),
        };
        if let Some(page) = &self.hooks.page {
            page.map_is_final();
        }
        let is_published = self.publish_final(ending.limited(FLUSH_LIMIT));
        self.tell(true)?;
        let status = self.status(true);
        if let Some(recorder) = &self.recorder {
            recorder.finish();
        }
        if let Some(on_final) = self.hooks.on_final.take() {
            on_final(&snapshot);
        }
        if is_published && !ending.is_asked() {
            self.linger();
        }
        drop(self.alive);
        written?;
        kept?;
        Ok(Outcome { snapshot, status })
    }

    fn map_as_it_stands(&self) -> Arc<Snapshot> {
        tracing::warn!(
            "ended before the dive was gone through once more: the map is written as it stands; \
             `echosplat replay` of the recording finishes it"
        );
        let newest = self.shared.newest_map();
        newest.unwrap_or_else(|| Arc::new(maps::empty()))
    }

    fn write_map(&mut self, snapshot: &Snapshot) -> anyhow::Result<()> {
        let Some(keeper) = self.keeper.take() else {
            return Ok(());
        };
        if self.shared.report().pings_mapped == 0 {
            // An earlier map at the same place is worth more than nothing.
            tracing::warn!("no ping was mapped, so no map is written");
            return Ok(());
        }
        keeper.finish(snapshot)
    }

    fn publish_final(&self, limit: Duration) -> bool {
        let Some(publisher) = &self.publisher else {
            return false;
        };
        match publisher.flush(limit) {
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

fn other_service(others: &[String]) -> Option<String> {
    (!others.is_empty()).then(|| {
        format!(
            "another service maps under the same node ({}): both publish under one key; end one, or \
             give it a --node of its own",
            others.join(", ")
        )
    })
}
