//! The driver's part of a run: the sonar is talked to, poses are taken, both are recorded and kept
//! for mappers; no map is made.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, bounded};
use echosplat_bus::{AliveToken, Bus, DRIVER_ROLE, TapeKeeper, gives_way};
use echosplat_driver::{DriverConfig, DriverEvent};
use echosplat_join::ArrivedPose;
use echosplat_liveness::{Drill, Heartbeat};
use echosplat_model::Timestamp;
use echosplat_pose::PoseSource;

use super::begin::Begin;
use super::dive_log::DiveLog;
use super::status::VehicleStatus;
use crate::config::Config;
use crate::exit::{Finish, Usage};
use crate::pipeline::{
    Diagnosis, Drivers, Expectations, Finding, Gate, Input, IsOver, Listening, MapperReport,
    Notices, Pace, Passage, RateMeter, STATUS_VERSION, Shared, Status, range_of,
};
use crate::recorder::Recorder;
use crate::runtime;
use crate::signals::Stop;
use crate::supervisor::{Policy, Supervisor, Systemd};
use crate::{clock, inputs, logging, processor};

/// How long to wait for a ping before poses and flags are looked at again.
const TICK: Duration = Duration::from_millis(5);
/// How often it is asked what is wrong.
const DIAGNOSIS_EVERY: Duration = Duration::from_millis(250);
const STATUS_EVERY: Duration = Duration::from_secs(1);
/// Poses of a file go out once pings are this near, seconds: later than any ping asks for.
const FILE_AHEAD_S: f64 = 5.0;
/// After the last ping, poses still under way are waited for this long.
const LAST_POSES: Duration = Duration::from_secs(1);
/// A mapper that has not asked for so long is not there: it is not waited for at the end.
const GONE_AFTER: Duration = Duration::from_secs(2);
/// How long mappers may take for the rest of the tape, where an end was asked for and where the
/// sonar has no more to say.
const REST_ASKED: Duration = Duration::from_secs(4);
const REST: Duration = Duration::from_secs(30);
/// Two that ask for each other at the same moment find nobody; so long after the start one gives way.
const GIVES_WAY_WITHIN: Duration = Duration::from_secs(10);

/// What a driver is started with.
pub(crate) struct Vehicle<'a> {
    pub(crate) config: &'a Config,
    pub(crate) driver: DriverConfig,
    pub(crate) poses: PoseSource,
    pub(crate) bus: &'a Arc<Bus>,
    /// Whether the sonar has nothing more to say, of one that is simulated.
    pub(crate) is_over: Option<IsOver>,
}

impl Vehicle<'_> {
    /// Until asked to end, or the sonar has nothing more to say.
    ///
    /// # Errors
    /// If something cannot be started, or a part that the dive needs is gone.
    pub(crate) fn run(self, stop: &Stop) -> anyhow::Result<Finish> {
        let mut run = Run::start(self)?;
        let saved = run.recorder.clone();
        let last_will = move || saved.iter().for_each(Recorder::finish);
        let finish_within = Duration::ZERO; // There is no map.
        stop.run_begins(Box::new(last_will), run.heartbeat.clone(), finish_within);
        let watched = run.watch(stop);
        let finish = run.conclude(stop);
        stop.run_ends();
        watched.and(finish)
    }
}

struct Run<'a> {
    bus: &'a Arc<Bus>,
    keeper: Arc<TapeKeeper>,
    log: DiveLog,
    recorder: Option<Recorder>,
    drivers: Drivers,
    events: Receiver<DriverEvent>,
    poses: PoseSource,
    /// Taken from a file, and not near enough yet.
    next_pose: Option<ArrivedPose>,
    gate: Gate,
    newest_ping: Option<Timestamp>,
    is_over: Option<IsOver>,
    /// Pings past `--duration` have come.
    is_closed: bool,
    shared: Shared,
    listening: Listening,
    diagnosis: Diagnosis,
    notices: Notices,
    supervisor: Supervisor,
    systemd: Systemd,
    heartbeat: Heartbeat,
    begin: Instant,
    rates: RateMeter,
    pings_taken: u64,
    alive: Option<AliveToken>,
}

impl<'a> Run<'a> {
    fn start(vehicle: Vehicle<'a>) -> anyhow::Result<Self> {
        let Vehicle {
            config,
            driver,
            poses,
            bus,
            is_over,
        } = vehicle;
        let url = driver.url.to_string();
        let begin = Begin::new(&driver.session, url.clone(), poses.is_live())
            .lasting(config.output.duration_s);
        let recorder = inputs::recorder_of_tape(config, &begin)?;
        let name = clock::now().nanos().unsigned_abs();
        let keeper = Arc::new(bus.keep_tape(name, begin.to_value())?);
        let log = DiveLog::new(name, Arc::clone(&keeper), recorder.clone());
        let alive = bus.declare_alive(DRIVER_ROLE)?;
        let expectations = Expectations {
            sonar: url,
            pace: Pace::Live,
            ping_interval_s: driver.session.expected_interval_s(),
            range_m: range_of(&driver.session),
        };
        let limit = Duration::from_secs_f64(config.pipeline.hang_limit_s);
        let heartbeat = Heartbeat::new("run");
        heartbeat.set_limit(limit);
        let mut supervisor = Supervisor::new(limit);
        supervisor.spare(bus.heartbeats().into_iter().chain([keeper.heartbeat()]));
        supervisor.watch(runtime::heartbeat()?, Policy::Needed);
        if let Some(of_poses) = poses.heartbeat() {
            supervisor.watch(of_poses, Policy::Source);
        }
        let (sender, events) = bounded(config.pipeline.queue_pings);
        let taps = log.clone();
        let tap = Arc::new(move || taps.raw_tap());
        let drivers = Drivers::start(vec![Input::link(driver)], Some(tap), sender)?;
        let begin = Instant::now();
        let run = Self {
            bus,
            keeper,
            log,
            recorder,
            drivers,
            events,
            poses,
            next_pose: None,
            gate: Gate::new(None, None, config.output.duration_s),
            newest_ping: None,
            is_over,
            is_closed: false,
            shared: Shared::new(),
            listening: Listening::default(),
            diagnosis: Diagnosis::new(expectations, &config.pose, begin),
            notices: Notices::new(begin),
            supervisor,
            systemd: Systemd::of_environment(),
            heartbeat,
            begin,
            rates: RateMeter::default(),
            pings_taken: 0,
            alive: Some(alive),
        };
        run.systemd.ready();
        Ok(run)
    }

    fn watch(&mut self, stop: &Stop) -> anyhow::Result<()> {
        let (mut told, mut diagnosed) = (Instant::now(), Instant::now());
        while !stop.is_set() && !self.is_closed && !self.dive_is_over() {
            self.heartbeat.beat();
            self.hear(TICK);
            self.drivers.replace_if_it_hangs()?;
            self.supervise()?;
            if diagnosed.elapsed() >= DIAGNOSIS_EVERY {
                diagnosed = Instant::now();
                self.give_way()?;
                self.diagnose();
            }
            if told.elapsed() >= STATUS_EVERY {
                told = Instant::now();
                self.tell(false);
            }
        }
        Ok(())
    }

    /// Takes what came from the sonar, waiting for it no longer than `limit`, and the poses.
    fn hear(&mut self, limit: Duration) {
        let first = self.events.recv_timeout(limit).ok();
        let rest: Vec<_> = self.events.try_iter().collect();
        for event in first.into_iter().chain(rest) {
            self.take(event);
        }
        self.take_poses();
    }

    fn take(&mut self, event: DriverEvent) {
        match event {
            DriverEvent::Ping { ping, frame } => {
                self.pings_taken += 1;
                self.listening.take(&ping);
                self.is_closed |= self.gate.pass(ping.transmit_time()) == Passage::Closed;
                self.newest_ping = self.newest_ping.max(Some(ping.transmit_time()));
                self.bus.publish_ping(frame, clock::now());
            }
            DriverEvent::ClockStepped => {
                self.gate.clock_stepped();
                self.newest_ping = None;
            }
            other => self.shared.link_event(other),
        }
    }

    /// Of a live source all that came; of a file those that pings are near.
    fn take_poses(&mut self) {
        let horizon = self
            .newest_ping
            .map(|newest| newest.offset_by(FILE_AHEAD_S));
        let is_live = self.poses.is_live();
        while let Some(pose) = self.next_pose.take().or_else(|| self.poses.try_next()) {
            if is_live || horizon.is_some_and(|horizon| pose.pose.time <= horizon) {
                self.log.pose(&pose);
            } else {
                self.next_pose = Some(pose);
                return;
            }
        }
    }

    fn dive_is_over(&mut self) -> bool {
        let Some(is_over) = &mut self.is_over else {
            return false;
        };
        is_over(&self.drivers.status())
    }

    /// # Errors
    /// If a part is gone without which there is no dive.
    fn supervise(&mut self) -> anyhow::Result<()> {
        if let Some(heartbeat) = self.drivers.heartbeat() {
            self.supervisor.watch(heartbeat, Policy::Source);
        }
        if let Some([writes, syncs]) = self.recorder.as_ref().and_then(Recorder::heartbeats) {
            self.supervisor.watch(&writes, Policy::Recorder);
            self.supervisor.watch(&syncs, Policy::Spared);
        }
        let now = Instant::now();
        let health = self.supervisor.look(now);
        self.systemd.tick(health.is_alive, now);
        self.notices.add(health.findings, now);
        match health.fatal {
            Some(why) => Err(anyhow::anyhow!(
                "{why}; the recording holds what came before"
            )),
            None => Ok(()),
        }
    }

    /// # Errors
    /// If another driver of this name began at the same time, and this one is to end.
    fn give_way(&mut self) -> anyhow::Result<()> {
        if self.begin.elapsed() > GIVES_WAY_WITHIN {
            return Ok(());
        }
        let others = self.bus.others_alive(DRIVER_ROLE);
        match gives_way(&self.bus.zenoh_id(), &others) {
            false => Ok(()),
            true => Err(Usage::error(format!(
                "another driver runs under the same node ({}): end it, or give this one a --node \
                 of its own",
                others.join(", ")
            ))),
        }
    }

    fn diagnose(&mut self) {
        let now = Instant::now();
        let mut report = MapperReport::default();
        report.pings_taken = self.pings_taken;
        report.listening = self.listening.report();
        report.poses.source = self.poses.status();
        let mut status = Status::of(report, self.drivers.status());
        status.rates = self.rates.rates();
        status.recording = self.recorder.as_ref().and_then(Recorder::counters);
        status.recording_fault = self.recorder.as_ref().and_then(Recorder::fault);
        status.bus_unreached = self.bus.unreached();
        let findings: Vec<Finding> = self.diagnosis.findings(&status, now);
        self.notices.add(findings, now);
        self.notices.end_old(now);
    }

    fn tell(&mut self, is_final: bool) -> VehicleStatus {
        let status = self.status(is_final);
        let wrong = self.notices.newest_standing().map(str::to_owned);
        self.systemd.status(&wrong.unwrap_or_else(|| status.line()));
        tracing::debug!(
            pings_heard = status.sonar.session.pings,
            records = status.tape.next,
            "status"
        );
        // A bus that fails is no reason to end the dive.
        let told = serde_json::to_value(&status).map(|status| {
            if let Some(recorder) = &self.recorder {
                let record = echosplat_recording::mcap::Record::Status(status.clone());
                recorder.record(clock::now(), record);
            }
            self.bus.publish_driver_status(&status)
        });
        if !matches!(told, Ok(Ok(()))) {
            tracing::debug!("status not published");
        }
        status
    }

    fn status(&mut self, is_final: bool) -> VehicleStatus {
        let sonar = self.drivers.status();
        let session = &sonar.session;
        let counters = [session.pings, self.pings_taken, session.bytes_received];
        self.rates.measure(Instant::now(), counters);
        VehicleStatus {
            status_version: STATUS_VERSION,
            role: DRIVER_ROLE,
            time_ns: clock::now().nanos(),
            is_final,
            wall_s: self.begin.elapsed().as_secs_f64(),
            rates: self.rates.rates(),
            link: self.shared.link(true),
            sonar,
            poses: self.poses.status(),
            tape: self.log.counters(),
            pings_not_published: self.bus.pings_dropped(),
            recording: self.recorder.as_ref().and_then(Recorder::counters),
            recording_fault: self.recorder.as_ref().and_then(Recorder::fault),
            parts: self.supervisor.reports(),
            drill: Drill::armed().map(ToString::to_string),
            log_lines_dropped: logging::lines_dropped(),
            notices: self.notices.all(),
            memory_bytes: processor::memory_bytes(),
        }
    }

    /// Stops the sonar, and stays while a mapper takes the rest.
    fn conclude(mut self, stop: &Stop) -> anyhow::Result<Finish> {
        self.heartbeat.rest();
        self.systemd.stopping();
        let was_asked = stop.is_set();
        self.drivers.stop();
        let ended = Instant::now();
        let waits = self.poses.is_live() && !was_asked;
        self.hear(TICK);
        while waits && ended.elapsed() < LAST_POSES {
            self.hear(TICK);
        }
        self.log.end(clock::now());
        let limit = if was_asked { REST_ASKED } else { REST };
        if !self.keeper.wait_taken(GONE_AFTER, limit) && self.log.counters().answers > 0 {
            tracing::warn!("the mapper has not taken all of the dive: its map lacks the end");
        }
        let status = self.tell(true);
        if let Some(recorder) = &self.recorder {
            recorder.finish();
        }
        self.alive = None;
        logging::print(&status.account());
        let lost = status
            .recording
            .map_or(0, |recording| recording.lost_messages);
        Ok(match lost + status.tape.missed {
            0 => Finish::Done,
            _ => Finish::Lossy,
        })
    }
}
