//! Pings meet their poses: what comes from the source is guarded, goes into the join, and when each
//! ping arrived is remembered.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use echosplat_georeference::FoundOrigin;
use echosplat_join::{
    ArrivedPose, CompassDeviation, CovarianceCounters, CovarianceRule, GuardReport, Guarded,
    JoinCounters, PoseGuard, PoseJoin, PoseJoinConfig, StampClock, Verdict,
};
use echosplat_liveness::Heartbeat;
use echosplat_model::{Ping, PoseUncertainty, PosedPing, StampedPose, Timestamp};
use echosplat_pose::{PoseSource, PoseSourceStatus, ToldOrigin};
use echosplat_recording::mcap::Record;
use serde::Serialize;

use super::gnss::{Gnss, GnssReport};
use crate::clock;
use crate::config::Config;
use crate::decided::ping_let_go;
use crate::exit::Usage;
use crate::recorder::Recorder;

/// What happens to pings whose poses have not come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Patience {
    /// The sonar is held back: its clock is that of the data.
    HoldBack,
    /// They are left out once too many or too old: the sonar's clock is the host's.
    LetGo,
}

/// From the first to the newest of something, nanoseconds on its own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub(crate) struct Span {
    pub(crate) first_ns: i64,
    pub(crate) last_ns: i64,
}

impl Span {
    fn extended(span: Option<Self>, time: Timestamp) -> Option<Self> {
        let nanos = time.nanos();
        let first_ns = span.map_or(nanos, |span| span.first_ns.min(nanos));
        let last_ns = span.map_or(nanos, |span| span.last_ns.max(nanos));
        Some(Self { first_ns, last_ns })
    }
}

/// What became of poses and pings.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct PoseReport {
    /// By the join.
    #[serde(flatten)]
    pub(crate) join: JoinCounters,
    /// Pings that wait for a pose.
    pub(crate) waiting: usize,
    /// Of the poses.
    pub(crate) covariances: CovarianceCounters,
    /// By the source.
    pub(crate) source: PoseSourceStatus,
    /// By the guard.
    pub(crate) guard: GuardReport,
    /// By a satellite receiver, if one is configured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) gnss: Option<GnssReport>,
    /// Epoch of the poses at hand, and what their source says of its world.
    #[serde(skip)]
    pub(crate) told_origin: Option<(u32, ToldOrigin)>,
    /// By the receiver's fixes.
    #[serde(skip)]
    pub(crate) found_origins: Vec<FoundOrigin>,
    /// Times of the poses taken.
    pub(crate) pose_times: Option<Span>,
    /// Times of the pings that asked for one.
    pub(crate) ping_times: Option<Span>,
}

/// A ping with its pose.
pub struct Joined {
    /// The ping with its pose.
    pub posed: PosedPing,
    pub(crate) arrived: Instant,
    /// Of the pose; poses of two epochs make two maps.
    pub(crate) epoch: u32,
}

/// Pings in, posed pings out, in the order they came.
pub struct Poses {
    source: PoseSource,
    /// `None` for a file, which holds one track by its nature.
    guard: Option<PoseGuard>,
    join: PoseJoin,
    /// Of the pings that wait in the join, in their order.
    arrivals: VecDeque<Instant>,
    /// Pings that got their verdict when the clock went back.
    ready: VecDeque<Joined>,
    patience: Patience,
    recorder: Option<Recorder>,
    /// Poses taken so far.
    taken: u64,
    /// They are taken as the recording's marks say, and not as pings ask for them.
    follows_marks: bool,
    /// Whether poses are recorded here as they are taken.
    records_poses: bool,
    pose_times: Option<Span>,
    ping_times: Option<Span>,
    gnss: Option<Gnss>,
    epoch: EpochAtHand,
}

/// Seconds without a change of epoch, by source and guard: what the source tells then is of the world of the poses taken.
const EPOCH_LASTS_S: f64 = 2.0;

/// Of the newest pose that came, as its source has it, and of the newest that was taken.
#[derive(Debug, Clone, Copy, Default)]
struct EpochAtHand {
    came: Option<u32>,
    taken: Option<u32>,
    /// When either changed, by arrival.
    since: Timestamp,
    newest: Timestamp,
}

impl EpochAtHand {
    fn came(&mut self, arrived: &ArrivedPose) {
        self.newest = arrived.arrived;
        if self.came.replace(arrived.pose.epoch) != Some(arrived.pose.epoch) {
            self.since = self.newest;
        }
    }

    fn taken(&mut self, epoch: u32) {
        if self.taken.replace(epoch) != Some(epoch) {
            self.since = self.newest;
        }
    }

    /// The epoch of poses taken, if what the source tells by now is of their world.
    fn settled(&self, source_epoch: u32) -> Option<u32> {
        let lasts = self.newest.seconds_since(self.since) >= EPOCH_LASTS_S;
        self.taken
            .filter(|_| lasts && self.came == Some(source_epoch))
    }
}

impl Poses {
    /// Poses that are all there already, for pings that wait for them.
    ///
    /// # Errors
    /// Names the setting that is out of range.
    pub fn waited_for(config: &Config, source: PoseSource) -> anyhow::Result<Self> {
        Self::new(config, source, Patience::HoldBack, None)
    }

    /// # Errors
    /// Names the setting that is out of range.
    pub(crate) fn new(
        config: &Config,
        source: PoseSource,
        patience: Patience,
        recorder: Option<Recorder>,
    ) -> anyhow::Result<Self> {
        let (mapper, config) = (&config.mapper, &config.pose);
        let [b_deg, c_deg] = config.compass_deviation_deg;
        let join = PoseJoin::new(PoseJoinConfig {
            trajectory_capacity: config.capacity.max(source.known_len()),
            max_pose_gap_s: config.max_pose_gap_s,
            lookahead_s: config.lookahead_s,
            smoothing: config.smoothing,
            vehicle_from_sensor: config.vehicle_from_sensor.pose(),
            compass: CompassDeviation { b_deg, c_deg },
            covariances: CovarianceRule {
                covariances: config.covariances,
                prior: PoseUncertainty {
                    position_m: mapper.position_sigma_m,
                    attitude_rad: mapper.attitude_sigma_deg.to_radians(),
                },
                error_time_s: mapper.pose_error_time_s,
                fan_half_width_rad: mapper.beam.elevation_half_width_rad().into(),
            },
            time_offset_s: config.time_offset_s,
            waiting_capacity: config.waiting_pings,
            max_wait_s: (patience == Patience::LetGo).then_some(config.max_wait_s),
        })
        .map_err(Usage::error)?;
        let clock = match patience {
            Patience::HoldBack => StampClock::Data,
            Patience::LetGo => StampClock::Host,
        };
        Ok(Self {
            guard: source.is_live().then(|| PoseGuard::new(clock)),
            source,
            join,
            arrivals: VecDeque::new(),
            ready: VecDeque::new(),
            patience,
            recorder,
            taken: 0,
            follows_marks: false,
            records_poses: true,
            pose_times: None,
            ping_times: None,
            gnss: None,
            epoch: EpochAtHand::default(),
        })
    }

    /// The same, with a satellite receiver beside.
    pub(crate) fn beside(self, gnss: Option<Gnss>) -> Self {
        Self { gnss, ..self }
    }

    /// Of the receiver's task.
    pub(crate) fn gnss_heartbeat(&self) -> Option<&Heartbeat> {
        self.gnss.as_ref().and_then(Gnss::heartbeat)
    }

    /// The poses of a recorded dive, judged on the clock it was dived on, and pings let go exactly
    /// as then.
    pub(crate) fn of_recording(
        mut self,
        clock: StampClock,
        let_go: HashMap<u64, Timestamp>,
    ) -> Self {
        self.guard = Some(PoseGuard::new(clock));
        self.join.let_go_again(let_go);
        self.follows_marks = true;
        self
    }

    /// The poses of a dive whose driver is elsewhere: taken as its tape's marks say, recorded by
    /// whoever reads that, and judged if their source was live, on the clock of the pings. Pings that
    /// its recording says were let go are so exactly as then.
    pub(crate) fn of_tape(
        mut self,
        clock: StampClock,
        guards: bool,
        let_go: HashMap<u64, Timestamp>,
    ) -> Self {
        self.guard = guards.then(|| PoseGuard::new(clock));
        self.join.let_go_again(let_go);
        self.follows_marks = true;
        self.records_poses = false;
        self
    }

    /// Takes poses of a recorded dive until there were so many, as the dive had by then.
    pub(crate) fn take_through(&mut self, count: u64) {
        while self.follows_marks && self.taken < count {
            let Some(pose) = self.source.try_next() else {
                return;
            };
            self.take(pose);
        }
    }

    /// A ping to be posed; `false` if it is one too many, and was dropped and counted.
    pub fn push(&mut self, ping: Arc<Ping>, arrived: Instant) -> bool {
        self.ping_times = Span::extended(self.ping_times, ping.transmit_time());
        let has_room = self.join.push_ping(ping);
        if has_room {
            self.arrivals.push_back(arrived);
        }
        has_room
    }

    /// How many marks of a tape are on their way, each with its pose.
    pub(crate) fn marks_on_their_way(&self) -> usize {
        self.source.taped_len()
    }

    /// Whether one more ping would be dropped.
    pub(crate) fn is_full(&self) -> bool {
        self.join.is_full()
    }

    /// Of a live source.
    pub(crate) fn heartbeat(&self) -> Option<&Heartbeat> {
        self.source.heartbeat()
    }

    /// The clock of the pings stepped: those that wait get their verdict, and poses begin anew.
    pub(crate) fn clock_stepped(&mut self) {
        if let Some(guard) = &mut self.guard {
            guard.clock_stepped();
            self.ping_times = None;
            self.restart();
        }
    }

    /// Whether the sonar is to be held back until poses have made room for another ping.
    pub(crate) fn holds_back(&self) -> bool {
        self.patience == Patience::HoldBack && self.join.is_full() && !self.source.is_ended()
    }

    /// Waits for a pose; says whether one came.
    pub(crate) fn wait_for_pose(&mut self, limit: Duration) -> bool {
        let pose = self.source.next_within(limit);
        let came = pose.is_some();
        pose.into_iter().for_each(|pose| self.take(pose));
        came
    }

    /// The next ping that has its pose; those that will never have one are counted.
    pub fn pop(&mut self) -> Option<Joined> {
        if let Some(gnss) = &mut self.gnss {
            gnss.take_what_came(|| self.source.lacks_north());
        }
        if self.source.is_live() {
            self.take_what_came();
        }
        loop {
            if let Some(joined) = self.ready.pop_front() {
                return Some(joined);
            }
            match self.join.poll() {
                Some(verdict) => self.judged(verdict),
                None if !self.take_one_more() => return None,
                None => {}
            }
        }
    }

    /// Whether pings wait whose poses may yet come.
    pub(crate) fn is_waiting(&self) -> bool {
        self.join.waiting_len() > 0 && !self.source.is_ended()
    }

    /// No more poses are waited for: every ping gets its verdict. Poses that no ping asked for are
    /// recorded all the same.
    pub(crate) fn finish(&mut self) {
        if !self.source.is_live() {
            self.take_what_came();
        }
        self.end_poses();
    }

    /// No more will come: those that the guard holds are judged as they are.
    fn end_poses(&mut self) {
        if let Some(mut guard) = self.guard.take() {
            guard.finish(&mut |guarded| self.taken(guarded));
            self.guard = Some(guard);
        }
        self.join.finish();
        self.gnss.iter_mut().for_each(Gnss::finish);
    }

    fn taken(&mut self, guarded: Guarded) {
        match guarded {
            Guarded::Pose(pose) => self.join_with(pose),
            Guarded::ClockWentBack => self.restart(),
        }
    }

    pub(crate) fn report(&self) -> PoseReport {
        let guard = self.guard.as_ref().map(PoseGuard::report).cloned();
        let source = self.source.status();
        let epoch = self.epoch.settled(source.epoch);
        PoseReport {
            join: self.join.counters(),
            waiting: self.join.waiting_len() + self.ready.len(),
            covariances: self.join.covariance_counters(),
            told_origin: epoch.zip(source.origin.clone()),
            found_origins: self.gnss.as_ref().map_or(Vec::new(), Gnss::found),
            gnss: self.gnss.as_ref().map(Gnss::report),
            source,
            guard: guard.unwrap_or_default(),
            pose_times: self.pose_times,
            ping_times: self.ping_times,
        }
    }

    fn judged(&mut self, verdict: Verdict) {
        let arrived = self.arrivals.pop_front().unwrap_or_else(Instant::now);
        let sequence = match &verdict.result {
            Ok(posed) => posed.ping.sequence(),
            Err(rejected) => rejected.ping.sequence(),
        };
        if let (Some(recorder), Some(newest)) = (&self.recorder, verdict.let_go_at) {
            recorder.record(clock::now(), Record::Event(ping_let_go(sequence, newest)));
        }
        match verdict.result {
            Ok(posed) => {
                tracing::trace!(ping = sequence, "joined");
                self.ready.push_back(Joined {
                    posed,
                    arrived,
                    epoch: verdict.epoch,
                });
            }
            Err(rejected) => {
                tracing::debug!(ping = sequence, reason = ?rejected.reason, "left out: no pose");
            }
        }
    }

    /// Of a source that ends, one pose at a time and only for pings that need it: so a replay holds
    /// no more of the trajectory than the dive did.
    fn take_one_more(&mut self) -> bool {
        if self.source.is_live() || (self.follows_marks && !self.source.is_ended()) {
            return false;
        }
        if self.source.is_ended() {
            let were_waiting = self.join.waiting_len() > 0;
            self.end_poses();
            return were_waiting;
        }
        if self.join.waiting_len() == 0 {
            return false;
        }
        let pose = self.source.try_next();
        let came = pose.is_some();
        pose.into_iter().for_each(|pose| self.take(pose));
        came
    }

    fn take_what_came(&mut self) {
        while let Some(pose) = self.source.try_next() {
            self.take(pose);
        }
    }

    fn take(&mut self, arrived: ArrivedPose) {
        self.taken += 1;
        self.epoch.came(&arrived);
        let recorder = self.recorder.as_ref().filter(|_| self.records_poses);
        if let Some(recorder) = recorder {
            recorder.record_pose(&arrived);
        }
        let Some(mut guard) = self.guard.take() else {
            return self.join_with(arrived.pose);
        };
        guard.push(arrived, &mut |guarded| self.taken(guarded));
        self.guard = Some(guard);
    }

    fn join_with(&mut self, pose: StampedPose) {
        match self.join.push_pose(pose) {
            Ok(()) => {
                self.pose_times = Span::extended(self.pose_times, pose.time);
                self.epoch.taken(pose.epoch);
                self.gnss.iter_mut().for_each(|gnss| gnss.pose(&pose));
            }
            Err(error) => tracing::debug!(%error, "pose left out"),
        }
    }

    /// What waits gets its verdict from the poses that are there, and these are forgotten.
    fn restart(&mut self) {
        self.join.finish();
        while let Some(verdict) = self.join.poll() {
            self.judged(verdict);
        }
        self.join.restart();
        self.gnss.iter_mut().for_each(Gnss::finish);
        self.pose_times = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::PingSettings;
    use echosplat_pose::PoseUrl;

    use crate::inputs;

    fn ping(seconds: f64) -> Arc<Ping> {
        let settings = PingSettings {
            range_start_m: 0.0,
            range_length_m: 10.0,
            bin_count: 10,
            speed_of_sound_mps: 1500.0,
            frequency_hz: 0.0,
            pulse_duration_s: 0.0,
            gain_index: 0,
        };
        let time = Timestamp::from_secs_f64(seconds);
        Arc::new(Ping::new(0, time, settings, vec![0.0; 10]).unwrap())
    }

    #[test]
    fn a_file_gives_every_ping_its_verdict_at_once() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.tum");
        std::fs::write(&path, "1 0 0 0 0 0 0 1\n1.4 1 0 0 0 0 0 1\n").unwrap();
        let source = inputs::poses(&PoseUrl::Tum(path), None, StampClock::Data).unwrap();
        let config = Config::default();
        let mut poses = Poses::new(&config, source, Patience::HoldBack, None).unwrap();
        for seconds in [0.5, 1.1, 1.2, 2.0] {
            poses.push(ping(seconds), Instant::now());
        }
        let mapped = std::iter::from_fn(|| poses.pop()).count();
        let report = poses.report();
        assert_eq!((mapped, report.waiting), (2, 0));
        assert_eq!(report.join.pings_without_pose(), 2);
    }

    #[test]
    fn nobody_is_held_back_for_poses_that_never_come() {
        let mut config = Config::default();
        config.pose.waiting_pings = 1;
        let source = inputs::poses(&PoseUrl::None, None, StampClock::Data).unwrap();
        let mut poses = Poses::new(&config, source, Patience::HoldBack, None).unwrap();
        poses.push(ping(0.0), Instant::now());
        assert!(!poses.holds_back());
        assert!(poses.pop().is_none());
        assert_eq!(poses.report().join.pings_pose_never_came, 1);
    }
}
