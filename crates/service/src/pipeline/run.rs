//! A run under way: its parts are started, watched over until the mapper has ended or may be waited
//! for no longer, and stopped.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::bounded;
use echosplat_bus::Bus;
use echosplat_liveness::Heartbeat;
use echosplat_model::Snapshot;
use echosplat_recording::ply::map_byte_count;

use super::album::AlbumWriter;
use super::calibration;
use super::diagnosis::Diagnosis;
use super::drivers::Drivers;
use super::earlier::EarlierMaps;
use super::effort::Publishing;
use super::ending::Ending;
use super::frame_check::FrameCheck;
use super::keeper::Keeper;
use super::notices::{Finding, Notices};
use super::places::Places;
use super::prediction::Prediction;
use super::published::Published;
use super::saving::Saving;
use super::shared::{Phase, Shared};
use super::status::{RateMeter, other_service};
use super::track::PosesAsTheyCame;
use super::worker::THREAD_NAME;
use super::{Hooks, Observer, Outlet, Part, Setup, Wiring, start_worker};
use crate::config::Config;
use crate::exit::Usage;
use crate::maps::{MapNotes, RunNotes};
use crate::recorder::Recorder;
use crate::signals::{LastWill, Stop};
use crate::supervisor::{Policy, Supervisor, Systemd};
use crate::{runtime, simd};

/// How often flags and heartbeats are looked at.
const TICK: Duration = Duration::from_millis(20);
const STATUS_EVERY: Duration = Duration::from_secs(1);
/// How often it is asked what is wrong.
const DIAGNOSIS_EVERY: Duration = Duration::from_millis(250);
/// The mapper's thread is asked for its part so long before.
const REPORT_TIME: Duration = Duration::from_millis(100);
/// Two services that ask for each other at the same moment find nobody; so long after the start one of
/// them still gives way.
const GIVES_WAY_WITHIN: Duration = Duration::from_secs(10);

/// A run under way.
pub(super) struct Run {
    pub(super) shared: Arc<Shared>,
    pub(super) drivers: Drivers,
    pub(super) worker: Option<JoinHandle<Option<Arc<Snapshot>>>>,
    pub(super) bus: Option<Arc<Bus>>,
    pub(super) published: Published,
    pub(super) recorder: Option<Recorder>,
    pub(super) keeper: Option<Keeper>,
    /// Where the vehicle's way goes, if it is kept.
    pub(super) track: Option<PathBuf>,
    pub(super) notes: RunNotes,
    pub(super) saving: Saving,
    pub(super) album: Option<AlbumWriter>,
    pub(super) diagnosis: Diagnosis,
    pub(super) notices: Notices,
    /// Stands all along.
    pub(super) known: Vec<Finding>,
    pub(super) supervisor: Supervisor,
    /// Of the thread that watches over all others.
    heartbeat: Heartbeat,
    pub(super) systemd: Systemd,
    pub(super) hooks: Hooks,
    pub(super) part: Part,
    /// What is known to be missing or wrong in what is read.
    pub(super) losses: Vec<String>,
    /// How long the map may be finished once a signal asked for an end.
    finish_within: Duration,
    pub(super) begin: Instant,
    pub(super) rates: RateMeter,
    pub(super) publishing: Publishing,
}

impl Run {
    pub(super) fn start(config: &Config, mut setup: Setup) -> anyhow::Result<Self> {
        simd::tell();
        let shared = Arc::new(Shared::new());
        let published = Published::start(&setup, config.pose.vehicle_from_sensor.pose())?;
        let notes = RunNotes::from(notes(config));
        let place = config.output.map.clone().map(|map| (map, notes.clone()));
        let saving = Saving::new(&shared, setup.recorder.as_ref(), place.clone());
        let album = setup.hooks.album.take();
        let album = album.map(|asked| asked.open(notes.clone())).transpose()?;
        let (album, keeps) = album.unzip();
        let helpers = Helpers::start(config)?;
        let mut supervisor = supervisor(config, &setup, &helpers);
        supervisor.watch(runtime::heartbeat()?, Policy::Needed);
        supervisor.spare(published.heartbeats());
        supervisor.spare(album.iter().map(AlbumWriter::heartbeat));
        let outlet = outlet(&mut setup, &published, keeps, helpers.prediction);
        let (sender, events) = bounded(config.pipeline.queue_pings);
        let tap = setup.recorder.as_ref().map(Recorder::taps);
        let drivers = Drivers::start(setup.inputs, tap, sender)?;
        let pace = setup.expectations.pace;
        let wiring = Wiring {
            events,
            inputs_left: drivers.count(),
            poses: setup.poses,
            gate: setup.gate,
            outlet,
            shedding: setup.shedding,
            earlier: EarlierMaps::beside(place.clone()),
            places: Places::new(notes.clone(), setup.recorder.clone(), setup.places),
            frame_check: Some(helpers.frame_check),
            calibration: calibration::Watch::new(config, pace),
            came: config
                .output
                .track
                .as_ref()
                .map(|_| PosesAsTheyCame::new(config.pose.vehicle_from_sensor.pose())),
        };
        let mapper = Heartbeat::new(THREAD_NAME);
        supervisor.watch(&mapper, Policy::Needed);
        let worker = start_worker(config, wiring, &shared, mapper)?;
        let begin = Instant::now();
        let run = Self {
            shared,
            drivers,
            worker: Some(worker),
            bus: setup.bus,
            published,
            recorder: setup.recorder,
            keeper: place.map(|(map, notes)| Keeper::new(map, notes)),
            track: config.output.track.clone(),
            notes,
            saving,
            album,
            diagnosis: Diagnosis::new(setup.expectations, &config.pose, begin),
            known: std::mem::take(&mut setup.hooks.known),
            notices: Notices::new(begin),
            supervisor,
            heartbeat: own_heartbeat(config),
            systemd: Systemd::of_environment(),
            hooks: setup.hooks,
            part: setup.part,
            losses: setup.losses,
            finish_within: config.pipeline.finish_within(),
            begin,
            rates: RateMeter::default(),
            publishing: Publishing::default(),
        };
        run.systemd.ready();
        Ok(run)
    }

    /// What saves map and recording whatever the threads of the run are doing.
    pub(super) fn last_will(&self) -> LastWill {
        self.saving.last_will()
    }

    /// Of the thread that watches over all others, while it does.
    pub(super) fn heartbeat(&self) -> Heartbeat {
        self.heartbeat.clone()
    }

    /// Until the mapper's thread has ended, or may be waited for no longer: tells of all parts, and
    /// stops the sonar when it is time.
    pub(super) fn watch(&mut self, stop: &Stop) -> anyhow::Result<Ending> {
        let (mut told, mut diagnosed) = (Instant::now(), Instant::now());
        let mut ending = Ending::none(self.finish_within);
        while self.worker.as_ref().is_some_and(|w| !w.is_finished()) {
            std::thread::sleep(TICK);
            self.heartbeat.beat();
            ending.note(stop);
            self.supervise(&mut ending, stop);
            self.go_with_phase(&ending)?;
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
                self.keep_room(self.shared.newest_map().as_deref());
            }
            if told.elapsed() >= STATUS_EVERY {
                told = Instant::now();
                self.tell(false)?;
            }
            if let Some(keeper) = &mut self.keeper {
                keeper.tick(|| self.shared.newest_map());
            }
        }
        self.supervise(&mut ending, stop);
        self.stop_input();
        Ok(ending)
    }

    /// Has the recording leave room on the disk for this map.
    pub(super) fn keep_room(&self, map: Option<&Snapshot>) {
        if let (Some(recorder), Some(keeper), Some(map)) = (&self.recorder, &self.keeper, map) {
            recorder.keep_room(keeper.map(), map_byte_count(map.gaussians.len()));
        }
    }

    /// What follows is bounded once an end was asked for, and takes what it takes otherwise.
    pub(super) fn stop_input(&mut self) {
        self.heartbeat.rest();
        self.systemd.stopping();
        self.drivers.stop();
    }

    /// Begins the next input or ends the one at hand, as the run is.
    fn go_with_phase(&mut self, ending: &Ending) -> anyhow::Result<()> {
        if ending.is_asked() || self.is_over() {
            self.shared.set_phase(Phase::InputEnded);
        }
        match self.shared.phase() {
            Phase::Running => {
                self.drivers.replace_if_it_hangs()?;
                self.drivers.go_on_to_next()
            }
            Phase::InputEnded | Phase::Finishing => {
                self.systemd.stopping();
                self.drivers.stop();
                self.shared.close_input();
                Ok(())
            }
        }
    }

    /// Looks whether all parts are alive, and lets systemd know while they are.
    fn supervise(&mut self, ending: &mut Ending, stop: &Stop) {
        if let Some(heartbeat) = self.drivers.heartbeat() {
            self.supervisor.watch(heartbeat, Policy::Source);
        }
        let recording = self.recorder.as_ref().and_then(Recorder::heartbeats);
        if let Some([writes, syncs]) = &recording {
            self.supervisor.watch(writes, Policy::Recorder);
            self.supervisor.watch(syncs, Policy::Spared);
        }
        let now = Instant::now();
        let health = self.supervisor.look(now);
        self.systemd.tick(health.is_alive, now);
        self.note(health.findings, now);
        if let Some(why) = health.fatal {
            ending.fail(why);
            stop.ask();
        }
    }

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
        let is_new = self.begin.elapsed() < GIVES_WAY_WITHIN;
        let Some(bus) = self.bus.as_ref().filter(|_| is_new) else {
            return Ok(());
        };
        for role in self.part.roles() {
            let others = bus.others_alive(role);
            if echosplat_bus::gives_way(&bus.zenoh_id(), &others) {
                return Err(Usage::error(other_service(&others).unwrap_or_default()));
            }
        }
        Ok(())
    }

    /// Ends the run without its map.
    pub(super) fn give_up(mut self) {
        self.stop_input();
        if let Some(recorder) = &self.recorder {
            recorder.finish();
        }
    }
}

/// Threads that look at the map and its pings beside the mapper; the run goes on without them.
struct Helpers {
    frame_check: FrameCheck,
    prediction: Option<Prediction>,
}

impl Helpers {
    fn start(config: &Config) -> anyhow::Result<Self> {
        let mount = config.pose.vehicle_from_sensor.pose();
        Ok(Self {
            frame_check: FrameCheck::start(config.mapper.clone(), mount)?,
            prediction: match config.pipeline.hold_back_every {
                0 => None,
                every => Some(Prediction::start(every, config.mapper.clone())?),
            },
        })
    }
}

/// What is said in every map.
fn notes(config: &Config) -> MapNotes {
    MapNotes {
        held_out_every: config.pipeline.hold_back_every,
        georeference: config.georeference.georeference(),
        ..MapNotes::default()
    }
}

fn own_heartbeat(config: &Config) -> Heartbeat {
    let heartbeat = Heartbeat::new("run");
    heartbeat.set_limit(Duration::from_secs_f64(config.pipeline.hang_limit_s));
    heartbeat
}

/// Watches over what the run was set up with, and its helpers.
fn supervisor(config: &Config, setup: &Setup, helpers: &Helpers) -> Supervisor {
    let limit = Duration::from_secs_f64(config.pipeline.hang_limit_s);
    let mut supervisor = Supervisor::new(limit);
    let spared = setup.hooks.page_heartbeats.iter();
    let spared = spared.chain(setup.bus.iter().flat_map(|bus| bus.heartbeats()));
    let spared = spared.chain(helpers.prediction.iter().map(Prediction::heartbeat));
    let spared = spared.chain(setup.poses.gnss_heartbeat());
    supervisor.spare(spared.chain([helpers.frame_check.heartbeat()]));
    if let Some(heartbeat) = setup.poses.heartbeat() {
        supervisor.watch(heartbeat, Policy::Source);
    }
    supervisor
}

/// Where maps and pings go to.
fn outlet(
    setup: &mut Setup,
    published: &Published,
    keeps: Option<Observer>,
    prediction: Option<Prediction>,
) -> Outlet {
    let observers = setup.hooks.observer.take().into_iter().chain(keeps);
    let pings_to = setup.bus.clone().filter(|_| setup.part.publishes_pings());
    Outlet::new(pings_to, published.map.clone(), observers)
        .predicting(prediction)
        .told_to_ros(published.ros.clone())
        .shown_on(setup.hooks.page.clone())
        .with_way(setup.hooks.way.clone())
        .of_epoch(setup.epoch)
}
