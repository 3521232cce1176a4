//! The mapper's thread: pings in, posed, mapped, and handed on. Everything that shapes the map
//! happens here, in one order, on the pings' own clock.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use echosplat_driver::DriverEvent;
use echosplat_liveness::Heartbeat;
use echosplat_mapper::{Mapper, MapperConfig};
use echosplat_model::{Ping, PosedPing, Snapshot, Timestamp};
use echosplat_prediction::held_out::is_held_out;

use super::calibration;
use super::earlier::EarlierMaps;
use super::effort::Meter;
use super::frame_check::FrameCheck;
use super::gate::{Gate, Passage};
use super::latency::Latency;
use super::listening::Listening;
use super::outlet::{Moment, Outlet};
use super::places::Places;
use super::poses::{Joined, Poses};
use super::shared::{MapperReport, Phase, Shared, Spent};
use super::shedding::Shedding;
use super::track::PosesAsTheyCame;
use crate::processor;

/// Name of the thread; those of the mapper's pool begin with it.
pub(crate) const THREAD_NAME: &str = "mapper";

/// How long to wait for an event before looking at poses and flags again.
const IDLE: Duration = Duration::from_millis(20);

/// On the data's clock the sonar is held back while poses are late, but not for longer than this.
const PATIENCE: Duration = Duration::from_secs(5);

/// When no more pings come, poses still under way are waited for this long.
const LAST_POSES: Duration = Duration::from_secs(1);

/// Going through the whole dive once more says nothing until it is done; the longest dives take so
/// long on the smallest machines.
const FINISH: Duration = Duration::from_secs(3600);

/// Making maps to look at takes at most one part in so many of the thread's time, and less where
/// pings wait: those are the better map.
const SNAPSHOT_PAUSE: u32 = 3;
const SNAPSHOT_PAUSE_BEHIND: u32 = 12;

/// All the mapper's thread owns.
pub(crate) struct Worker {
    pub(crate) events: Receiver<DriverEvent>,
    /// Logs whose end has not come yet.
    pub(crate) inputs_left: usize,
    pub(crate) poses: Poses,
    pub(crate) mapper: Mapper,
    pub(crate) mapper_config: MapperConfig,
    /// Maps of epochs that are over.
    pub(crate) earlier: EarlierMaps,
    /// Where on Earth maps lie.
    pub(crate) places: Places,
    /// Asks whether poses can be read as they are; not in benches.
    pub(crate) frame_check: Option<FrameCheck>,
    pub(crate) calibration: calibration::Watch,
    /// Where the way is asked for.
    pub(crate) came: Option<PosesAsTheyCame>,
    pub(crate) shedding: Shedding,
    pub(crate) gate: Gate,
    pub(crate) outlet: Outlet,
    pub(crate) shared: Arc<Shared>,
    pub(crate) heartbeat: Heartbeat,
    pub(crate) snapshot_interval_s: f64,
    /// Every so many-th ping is kept from the map; 0 for none.
    pub(crate) hold_back_every: u64,
    pub(crate) state: State,
}

/// What changes as pings come.
#[derive(Debug)]
pub(crate) struct State {
    report: MapperReport,
    latency: Latency,
    /// What maps made only to be judged took.
    observing_s: f64,
    first_ping: Option<Timestamp>,
    next_snapshot_s: f64,
    next_snapshot_at: Instant,
    newest_snapshot_at: Option<Instant>,
    listening: Listening,
    /// Epoch of the poses that the map at hand is made of.
    epoch: Option<u32>,
    past_work: Spent,
    meter: Meter,
}

impl State {
    /// The first map is due with the first ping.
    pub(crate) fn new(begin: Instant) -> Self {
        Self {
            report: MapperReport::default(),
            latency: Latency::default(),
            observing_s: 0.0,
            first_ping: None,
            next_snapshot_s: 0.0,
            next_snapshot_at: begin,
            newest_snapshot_at: None,
            listening: Listening::default(),
            epoch: None,
            past_work: Spent::default(),
            meter: Meter::default(),
        }
    }
}

impl Worker {
    /// Maps until the sonar's events end; gives the finished map.
    ///
    /// Runs as one of the mapper's threads, so that its many small pieces of work begin at once.
    pub(crate) fn run(mut self) -> Arc<Snapshot> {
        self.beat_as_mapper_works();
        self.mapper.number(self.outlet.epoch(), 0);
        self.mapper.pool().install(move || self.map_all())
    }

    fn beat_as_mapper_works(&mut self) {
        let heartbeat = self.heartbeat.clone();
        self.mapper.on_progress(move || heartbeat.beat());
    }

    fn map_all(mut self) -> Arc<Snapshot> {
        self.state.meter.watch(&mut self.mapper);
        loop {
            self.heartbeat.beat();
            match self.events.recv_timeout(IDLE) {
                Ok(event) => self.take(event),
                // A sonar's thread that hangs never lets go of its end.
                Err(RecvTimeoutError::Timeout) if self.shared.input_is_closed() => break,
                Err(RecvTimeoutError::Timeout) => self.map_what_is_posed(),
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if self.shared.report_is_wanted() {
                self.hand_over_report();
            }
        }
        self.finish()
    }

    fn take(&mut self, event: DriverEvent) {
        match event {
            DriverEvent::Ping { ping, frame } => self.take_ping(ping, frame),
            DriverEvent::Ended => self.input_ended(),
            DriverEvent::Mark(poses) => {
                self.poses.take_through(poses);
                self.map_what_is_posed();
            }
            DriverEvent::GoesOn => self.shedding.goes_on(),
            DriverEvent::ClockStepped => {
                self.gate.clock_stepped();
                self.poses.clock_stepped();
            }
            other => self.shared.link_event(other),
        }
    }

    fn input_ended(&mut self) {
        self.inputs_left = self.inputs_left.saturating_sub(1);
        if self.inputs_left == 0 {
            self.shared.set_phase(Phase::InputEnded);
        }
    }

    fn take_ping(&mut self, ping: Arc<Ping>, frame: Bytes) {
        let time = ping.transmit_time();
        self.state.report.pings_taken += 1;
        let (sequence, now) = (ping.sequence(), Instant::now());
        if self.shedding.leaves_out(sequence, now) {
            return self.state.report.pings_shed += 1;
        }
        if self.gate.has_seen(&ping) {
            return self.state.report.pings_repeated += 1;
        }
        self.state.listening.take(&ping);
        match self.gate.pass(time) {
            Passage::Open => {}
            Passage::Early => return self.state.report.pings_before_start += 1,
            Passage::Closed => {
                self.state.report.pings_after_end += 1;
                return self.shared.set_phase(Phase::InputEnded);
            }
        }
        if self.shedding.publishes_ping() {
            self.outlet.ping(&ping, frame);
        }
        self.wait_for_poses();
        if !self.poses.push(ping, Instant::now()) {
            self.shedding.left_out(sequence);
        }
        self.map_what_is_posed();
    }

    fn wait_for_poses(&mut self) {
        while self.poses.holds_back() {
            self.heartbeat.beat_allowing(PATIENCE);
            if !self.poses.wait_for_pose(PATIENCE) {
                return;
            }
            self.map_what_is_posed();
        }
    }

    fn map_what_is_posed(&mut self) {
        while let Some(joined) = self.poses.pop() {
            self.heartbeat.beat();
            self.map(&joined);
        }
    }

    fn map(&mut self, joined: &Joined) {
        let posed: &PosedPing = &joined.posed;
        let before = self.state.epoch.replace(joined.epoch);
        if before != Some(joined.epoch) {
            if before.is_some() {
                self.begin_new_map(posed.ping.transmit_time());
            }
            self.places.map_begins(self.outlet.epoch(), joined.epoch);
        }
        self.outlet.posed(posed);
        if let Some(frame_check) = &self.frame_check {
            frame_check.ping(posed);
        }
        if is_held_out(posed.ping.sequence(), self.hold_back_every) {
            return self.state.report.pings_held_out += 1;
        }
        self.put_off_work(posed.ping.sequence());
        let inserted = {
            let _span = tracing::trace_span!("mapped", ping = posed.ping.sequence()).entered();
            self.mapper.insert(posed)
        };
        if inserted.rejected {
            return self.state.report.pings_rejected += 1;
        }
        let time = posed.ping.transmit_time();
        if let Some(came) = &mut self.came {
            came.push(time, posed.world_from_sensor);
        }
        let state = &mut self.state;
        state.report.pings_mapped += 1;
        state.latency.arrived(joined.arrived);
        self.publish_if_due(time, inserted.slice_taken_in);
        self.note_published();
        if inserted.slice_taken_in {
            let has_time = !self.shedding.report().work;
            self.calibration.advance(&self.mapper, has_time);
        }
    }

    /// As the load is, or was: from this ping on, work on the map waits, or is done again.
    fn put_off_work(&mut self, ping: u64) {
        // What is no ping leaves the less room for pings.
        let marks = self.poses.marks_on_their_way();
        let capacity = self.events.capacity().unwrap_or(usize::MAX);
        let capacity = capacity.saturating_sub(marks).max(1);
        let queued = match self.poses.is_full() {
            true => capacity,
            false => self.events.len().saturating_sub(marks),
        };
        if self.shedding.work_at(ping, (queued, capacity)).is_some() {
            self.allow_work();
        }
    }

    fn allow_work(&mut self) {
        self.mapper.allow(match self.shedding.report().work {
            true => 0,
            false => self.mapper_config.work_pairs_per_ping,
        });
    }

    /// Poses of a new epoch have nothing to do with those before: the map so far is finished and
    /// kept apart, and another begins at `time`.
    fn begin_new_map(&mut self, time: Timestamp) {
        let mut mapper = match Mapper::new(self.mapper_config.clone()) {
            Ok(mapper) => mapper,
            Err(error) => return tracing::error!(%error, "no new map can be begun"),
        };
        let work = self.work();
        // This thread is one of the pool's: the map that goes on keeps it.
        mapper.swap_threads(&mut self.mapper);
        std::mem::swap(&mut mapper, &mut self.mapper);
        self.beat_as_mapper_works();
        self.state.meter.watch(&mut self.mapper);
        mapper.on_progress(|| {});
        mapper.on_task(|_| Box::new(|_| ()));
        self.allow_work();
        let state = &mut self.state;
        state.past_work = work;
        state.report.maps += 1;
        // The dive's own time goes on.
        state.first_ping = Some(time.offset_by(-state.report.dive_s));
        // The map that ends shall bear what was found of its place.
        self.places.look(&self.poses.report());
        let ended = self.outlet.epoch();
        self.outlet.begin_epoch();
        let newest = self.state.report.newest_sequence;
        self.mapper.number(self.outlet.epoch(), newest);
        if let Some(came) = &mut self.came {
            came.begin_anew();
        }
        if let Some(frame_check) = &self.frame_check {
            frame_check.begin_anew();
        }
        self.calibration.begin_anew();
        self.earlier.keep(mapper, ended);
    }

    fn note_published(&mut self) {
        if let Some(sent) = self.outlet.sent() {
            self.state.latency.published(sent.sequence, sent.at);
        }
    }

    /// A map is made when the pings' clock and the wall's both say so: a dive that is replayed
    /// fast does not make more maps than anybody can look at. Only a slice taken in can have changed
    /// it, and looking at it leaves no trace.
    fn publish_if_due(&mut self, time: Timestamp, has_changed: bool) {
        let state = &mut self.state;
        let first = *state.first_ping.get_or_insert(time);
        let dive_s = time.seconds_since(first);
        let age = state.newest_snapshot_at.map(|at| at.elapsed());
        let is_time = dive_s >= state.next_snapshot_s
            && Instant::now() >= state.next_snapshot_at
            && self.shedding.publishes_map(age);
        let is_due = has_changed && is_time;
        if !is_due && !self.outlet.is_observation_due(dive_s) {
            return;
        }
        let begin = Instant::now();
        let before = self.work();
        let snapshot = self.mapper.snapshot();
        if !is_due {
            self.state.observing_s += self.work().compute_s - before.compute_s;
        }
        self.hand_on(snapshot, dive_s);
        self.state.newest_snapshot_at = Some(begin);
        let pause = Duration::from_secs_f64(self.snapshot_interval_s);
        self.state.next_snapshot_s = dive_s + self.snapshot_interval_s;
        let rest = match self.is_behind() {
            true => SNAPSHOT_PAUSE_BEHIND,
            false => SNAPSHOT_PAUSE,
        };
        self.state.next_snapshot_at = begin + pause.max(begin.elapsed() * rest);
    }

    /// Whether more than half as many pings wait as may.
    fn is_behind(&self) -> bool {
        let capacity = self.events.capacity().unwrap_or(usize::MAX);
        self.events.len() > capacity / 2
    }

    fn hand_on(&mut self, snapshot: Arc<Snapshot>, dive_s: f64) -> Arc<Snapshot> {
        let work = self.work();
        self.state.report.newest_sequence = snapshot.sequence;
        let moment = Moment {
            dive_s,
            compute_s: work.compute_s,
            pairs: work.pairs,
            voxel_observations: work.voxel_observations,
            pings: self.mapper.status().pings,
        };
        {
            let _span = tracing::trace_span!("published", map = snapshot.sequence).entered();
            self.outlet.map(&snapshot, moment);
        }
        self.state.latency.offered(snapshot.sequence);
        self.shared.keep_map(&snapshot);
        self.state.report.snapshots += 1;
        self.state.report.dive_s = dive_s;
        snapshot
    }

    /// Maps made only to be judged do not count.
    fn work(&self) -> Spent {
        let (status, past) = (self.mapper.status(), self.state.past_work);
        Spent {
            compute_s: thread_seconds() - self.state.observing_s,
            pairs: past.pairs + status.pairs,
            voxel_observations: past.voxel_observations + status.voxel_observations,
        }
    }

    fn hand_over_report(&mut self) {
        self.shedding.record_run();
        self.state.report.shedding = self.shedding.report();
        self.state.report.mapper = self.mapper.status();
        self.state.report.left_out = self.mapper.left_out().to_vec();
        self.state.report.latency_s = self.state.latency.report();
        self.state.report.work = self.work();
        self.state.report.poses = self.poses.report();
        self.places.look(&self.state.report.poses);
        self.state.report.listening = self.state.listening.report();
        if let Some(frame_check) = &self.frame_check {
            frame_check.ring_until(self.state.report.mapper.rings_until_m);
            self.state.report.frames = frame_check.verdict();
        }
        self.state.report.calibration = self.calibration.found();
        let frame_check = self.frame_check.as_ref().map(FrameCheck::took);
        self.state.report.effort = self.state.meter.report(&[
            ("calibrate", self.calibration.took()),
            ("frame_check", frame_check.unwrap_or_default()),
        ]);
        self.state.report.prediction = self.outlet.predicted();
        self.shared.hand_over(self.state.report.clone());
    }

    /// What still waits for poses is given its last chance, then the whole dive is gone through.
    fn finish(mut self) -> Arc<Snapshot> {
        let deadline = Instant::now() + LAST_POSES;
        while self.poses.is_waiting() && Instant::now() < deadline {
            self.poses.wait_for_pose(IDLE);
            self.map_what_is_posed();
        }
        self.poses.finish();
        self.map_what_is_posed();
        self.shared.set_phase(Phase::Finishing);
        self.state.report.before_finish = self.work();
        self.hand_over_report();
        if let Some(frame_check) = self.frame_check.as_mut().filter(|_| self.inputs_left == 0) {
            frame_check.end();
        }
        // A beat would take back what is allowed.
        self.mapper.on_progress(|| {});
        self.heartbeat.beat_allowing(FINISH);
        if self.inputs_left == 0 {
            self.calibration.end(&self.mapper);
        }
        let snapshot = self.mapper.finish();
        if let Some(came) = self.came.take() {
            let corrections = self.mapper.pose_corrections();
            self.shared.keep_track(came.corrected(&corrections));
        }
        let first = self.state.first_ping.unwrap_or_default();
        let dive_s = match self.state.first_ping {
            Some(_) => snapshot.time.seconds_since(first),
            None => 0.0,
        };
        let last = self.hand_on(Arc::new(snapshot), dive_s);
        if let Some(frame_check) = &self.frame_check {
            frame_check.wait_for_last();
        }
        if self.inputs_left == 0 {
            self.calibration.wait();
        }
        self.hand_over_report();
        self.state.report.prediction = self.outlet.finish(&last, dive_s);
        self.shared.hand_over(self.state.report.clone());
        self.earlier.finish();
        last
    }
}

/// Of the mapper's threads; 0 where the kernel does not say.
fn thread_seconds() -> f64 {
    processor::thread_seconds(THREAD_NAME).unwrap_or(0.0)
}
