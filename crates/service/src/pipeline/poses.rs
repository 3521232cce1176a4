//! Pings meet their poses: what comes from the source goes into the join, and when each ping
//! arrived is remembered.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use echosplat_bus::PoseCounters;
use echosplat_model::{Ping, PosedPing, StampedPose};
use echosplat_pose::{JoinCounters, PoseJoin, PoseJoinConfig, PoseSource};
use serde::Serialize;

use crate::config::PoseConfig;
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

/// What became of poses and pings.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub(crate) struct PoseReport {
    /// By the join.
    #[serde(flatten)]
    pub(crate) join: JoinCounters,
    /// Pings that wait for a pose.
    pub(crate) waiting: usize,
    /// By the subscription.
    pub(crate) bus: Option<PoseCounters>,
}

/// Pings in, posed pings out, in the order they came.
pub(crate) struct Poses {
    source: PoseSource,
    join: PoseJoin,
    /// Of the pings that wait in the join, in their order.
    arrivals: VecDeque<Instant>,
    patience: Patience,
    recorder: Option<Recorder>,
}

impl Poses {
    /// # Errors
    /// Names the setting that is out of range.
    pub(crate) fn new(
        config: &PoseConfig,
        source: PoseSource,
        patience: Patience,
        recorder: Option<Recorder>,
    ) -> anyhow::Result<Self> {
        let join = PoseJoin::new(PoseJoinConfig {
            trajectory_capacity: config.capacity.max(source.known_len()),
            max_pose_gap_s: config.max_pose_gap_s,
            lookahead_s: config.lookahead_s,
            smoothing: config.smoothing,
            vehicle_from_sensor: config.vehicle_from_sensor.pose(),
            time_offset_s: config.time_offset_s,
            waiting_capacity: config.waiting_pings,
            max_wait_s: (patience == Patience::LetGo).then_some(config.max_wait_s),
        })
        .map_err(Usage::error)?;
        Ok(Self {
            source,
            join,
            arrivals: VecDeque::new(),
            patience,
            recorder,
        })
    }

    /// A ping to be posed; one too many is dropped and counted.
    pub(crate) fn push(&mut self, ping: Arc<Ping>, arrived: Instant) {
        if self.join.push_ping(ping) {
            self.arrivals.push_back(arrived);
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
    pub(crate) fn next(&mut self) -> Option<(PosedPing, Instant)> {
        self.take_what_came();
        while let Some(verdict) = self.join.poll() {
            let arrived = self.arrivals.pop_front();
            match verdict {
                Ok(posed) => return Some((posed, arrived.unwrap_or_else(Instant::now))),
                Err(rejected) => tracing::debug!(
                    ping = rejected.ping.sequence(),
                    reason = ?rejected.reason,
                    "left out: no pose"
                ),
            }
        }
        None
    }

    /// Whether pings wait whose poses may yet come.
    pub(crate) fn is_waiting(&self) -> bool {
        self.join.waiting_len() > 0 && !self.source.is_ended()
    }

    /// No more poses are waited for: every ping gets its verdict.
    pub(crate) fn finish(&mut self) {
        self.join.finish();
    }

    pub(crate) fn report(&self) -> PoseReport {
        PoseReport {
            join: self.join.counters(),
            waiting: self.join.waiting_len(),
            bus: self.source.live_counters(),
        }
    }

    fn take_what_came(&mut self) {
        while let Some(pose) = self.source.try_next() {
            self.take(pose);
        }
        if self.source.is_ended() {
            self.join.finish();
        }
    }

    fn take(&mut self, pose: StampedPose) {
        if let Some(recorder) = &self.recorder {
            recorder.pose(&pose);
        }
        if let Err(error) = self.join.push_pose(pose) {
            tracing::debug!(%error, "pose left out");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::{PingSettings, Timestamp};
    use echosplat_pose::PoseUrl;

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
        let source = PoseSource::open(&PoseUrl::Tum(path), None).unwrap();
        let config = PoseConfig::default();
        let mut poses = Poses::new(&config, source, Patience::HoldBack, None).unwrap();
        for seconds in [0.5, 1.1, 1.2, 2.0] {
            poses.push(ping(seconds), Instant::now());
        }
        let mapped = std::iter::from_fn(|| poses.next()).count();
        let report = poses.report();
        assert_eq!((mapped, report.waiting), (2, 0));
        assert_eq!(report.join.pings_without_pose(), 2);
    }

    #[test]
    fn nobody_is_held_back_for_poses_that_never_come() {
        let config = PoseConfig {
            waiting_pings: 1,
            ..PoseConfig::default()
        };
        let mut poses = Poses::new(&config, PoseSource::None, Patience::HoldBack, None).unwrap();
        poses.push(ping(0.0), Instant::now());
        assert!(!poses.holds_back());
        assert!(poses.next().is_none());
        assert_eq!(poses.report().join.pings_pose_never_came, 1);
    }
}
