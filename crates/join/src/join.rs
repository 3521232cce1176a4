//! Pings joined with the poses of their echoes.
//!
//! No input or output and no clock: pings and poses come in as arguments, in order, from whoever
//! reads them, and what waits is bounded.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use echosplat_model::{
    LOOKAHEAD_S, Ping, Pose, PoseError, PoseLookupError, PosedPing, StampedPose, Switch, Timestamp,
    Trajectory, TrajectoryLimits, Twist,
};
use glam::DQuat;
use serde::{Deserialize, Serialize};

use crate::CompassDeviation;
use crate::covariance::{CovarianceCounters, CovarianceJudge, CovarianceRule, View};

/// How pings and poses are joined.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseJoinConfig {
    /// Most poses held; the oldest go first. A file's trajectory needs room for all of them.
    pub trajectory_capacity: usize,
    /// Longest time between two poses that is interpolated across, seconds.
    pub max_pose_gap_s: f64,
    /// A ping waits for the poses up to this much after its echo, seconds, so that their jitter can
    /// be told from motion and taken out; 0 only interpolates.
    pub lookahead_s: f64,
    /// Whether jitter of poses is taken out.
    pub smoothing: Switch,
    /// How the sensor is mounted: its pose in the vehicle's frame.
    pub vehicle_from_sensor: Pose,
    /// What the headings of poses are freed from as they come.
    pub compass: CompassDeviation,
    /// What is made of their covariances.
    pub covariances: CovarianceRule,
    /// Added to a ping's time before its pose is looked up, seconds.
    pub time_offset_s: f64,
    /// Most pings that wait for a pose; beyond that the newest is dropped and counted. Who can
    /// hold pings back asks [`PoseJoin::is_full`] first.
    pub waiting_capacity: usize,
    /// A ping is let go when one this much newer has come and its pose still has not, seconds of
    /// the pings' own time. Without it pings wait until poses come or end, which is right where
    /// pings are held back.
    pub max_wait_s: Option<f64>,
}

impl Default for PoseJoinConfig {
    fn default() -> Self {
        Self {
            trajectory_capacity: 20_000,
            max_pose_gap_s: 0.5,
            lookahead_s: LOOKAHEAD_S,
            smoothing: Switch::Auto,
            vehicle_from_sensor: Pose::IDENTITY,
            compass: CompassDeviation::default(),
            covariances: CovarianceRule::default(),
            time_offset_s: 0.0,
            waiting_capacity: 4096,
            max_wait_s: None,
        }
    }
}

/// A setting out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("pose.{key} is {found}; allowed is {allowed}")]
pub struct PoseJoinError {
    key: &'static str,
    found: String,
    allowed: &'static str,
}

/// Why a ping got no pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RejectReason {
    /// It lies before the oldest pose held.
    TooEarly,
    /// The poses around it are too far apart, or the estimator was reset between them.
    Gap,
    /// No pose that late came in time, or before the poses ended.
    NeverCame,
}

/// A ping that is left out of the map.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedPing {
    /// Which.
    pub ping: Arc<Ping>,
    /// Why.
    pub reason: RejectReason,
}

/// What becomes of a ping.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// With its pose, or left out and why.
    pub result: Result<PosedPing, RejectedPing>,
    /// Of its pose; 0 if it has none.
    pub epoch: u32,
    /// Set if the ping was not waited for any longer: the newest pose that was there then (the
    /// earliest time there is if none was). A replay waits as long, to come to the same verdict.
    pub let_go_at: Option<Timestamp>,
}

/// What became of every ping and pose. Received pings are either joined, rejected, dropped, or
/// still waiting.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct JoinCounters {
    /// Pings that came.
    pub pings_received: u64,
    /// Pings that got their pose.
    pub pings_joined: u64,
    /// Pings before the oldest pose.
    pub pings_too_early: u64,
    /// Pings between poses too far apart.
    pub pings_in_gap: u64,
    /// Pings whose pose never came.
    pub pings_pose_never_came: u64,
    /// Newest pings dropped because too many waited.
    pub pings_dropped_full: u64,
    /// Poses taken.
    pub poses_taken: u64,
    /// Poses with a number that is not finite, or a quaternion without length.
    pub poses_not_finite: u64,
    /// Poses not newer than the one before.
    pub poses_out_of_order: u64,
}

impl JoinCounters {
    /// Pings left out of the map for want of a pose.
    #[must_use]
    pub fn pings_without_pose(&self) -> u64 {
        let rejected = self.pings_too_early + self.pings_in_gap + self.pings_pose_never_came;
        rejected + self.pings_dropped_full
    }
}

/// Pings in, posed pings out, in the same order; each gets one verdict, none is extrapolated.
#[derive(Debug)]
pub struct PoseJoin {
    config: PoseJoinConfig,
    trajectory: Trajectory,
    covariances: CovarianceJudge,
    waiting: VecDeque<Arc<Ping>>,
    newest_ping_time: Option<Timestamp>,
    poses_ended: bool,
    /// Pings that a dive did not wait for any longer, and the newest pose it had by then.
    let_go: HashMap<u64, Timestamp>,
    counters: JoinCounters,
}

/// Degrees, assumed: compensate a worse compass first.
/// A compass that deviates by more has to be compensated first.
const MOST_DEVIATION_DEG: f64 = 45.0;

/// Stands for "no pose yet".
const BEFORE_ALL_POSES: Timestamp = Timestamp::from_nanos(i64::MIN);

impl PoseJoin {
    /// # Errors
    /// Names the setting that is out of range.
    pub fn new(mut config: PoseJoinConfig) -> Result<Self, PoseJoinError> {
        config.check()?;
        let mount = config.vehicle_from_sensor;
        if let Some(mount) = Pose::checked(mount.rotation, mount.translation_m) {
            config.vehicle_from_sensor = mount;
        }
        Ok(Self {
            trajectory: Trajectory::new(TrajectoryLimits {
                capacity: config.trajectory_capacity,
                max_pose_gap_s: config.max_pose_gap_s,
            }),
            covariances: CovarianceJudge::new(config.covariances),
            config,
            waiting: VecDeque::new(),
            newest_ping_time: None,
            poses_ended: false,
            let_go: HashMap::new(),
            counters: JoinCounters::default(),
        })
    }

    /// A recorded dive's own [`Verdict::let_go_at`] by sequence: these pings wait exactly as long
    /// again, and no other is let go.
    pub fn let_go_again(&mut self, let_go: HashMap<u64, Timestamp>) {
        self.let_go = let_go;
    }

    /// Poses begin anew, on a clock that may have gone back. Pings that still wait should have
    /// got their verdict before: [`PoseJoin::finish`], then [`PoseJoin::poll`] until it is done.
    pub fn restart(&mut self) {
        self.trajectory = Trajectory::new(TrajectoryLimits {
            capacity: self.config.trajectory_capacity,
            max_pose_gap_s: self.config.max_pose_gap_s,
        });
        self.newest_ping_time = None;
        self.poses_ended = false;
    }

    /// Takes the next pose; what cannot be taken is counted.
    ///
    /// # Errors
    /// Says why it was left out.
    pub fn push_pose(&mut self, pose: StampedPose) -> Result<(), PoseError> {
        let pushed = self.trajectory.push(StampedPose {
            world_from_vehicle: self.config.compass.corrected(&pose.world_from_vehicle),
            uncertainty: self.covariances.usable(pose.uncertainty),
            ..pose
        });
        let counter = match pushed {
            Ok(()) => &mut self.counters.poses_taken,
            Err(PoseError::NotFinite) => &mut self.counters.poses_not_finite,
            Err(PoseError::OutOfOrder) => &mut self.counters.poses_out_of_order,
        };
        *counter += 1;
        pushed
    }

    /// Takes the next ping; `false` if too many wait, and it was dropped and counted.
    pub fn push_ping(&mut self, ping: Arc<Ping>) -> bool {
        self.counters.pings_received += 1;
        let time = ping.transmit_time();
        self.newest_ping_time = self.newest_ping_time.max(Some(time));
        if self.is_full() {
            self.counters.pings_dropped_full += 1;
            return false;
        }
        self.waiting.push_back(ping);
        true
    }

    /// Says that no further pose will come: pings that still wait get their verdict.
    pub fn finish(&mut self) {
        self.poses_ended = true;
    }

    /// The verdict on the oldest ping that waits; `None` if none waits or its pose may yet come.
    #[must_use]
    pub fn poll(&mut self) -> Option<Verdict> {
        let ping = Arc::clone(self.waiting.front()?);
        let is_looked_past = self.is_looked_past(&ping);
        let may_yet_come = self.may_yet_come(&ping);
        if may_yet_come && !is_looked_past {
            return None;
        }
        let found = self.posed(&ping);
        if may_yet_come && matches!(found, Err(PoseLookupError::NotYet)) {
            return None;
        }
        self.waiting.pop_front();
        let is_let_go = !is_looked_past && !self.poses_ended;
        let newest = || {
            self.trajectory
                .span()
                .map_or(BEFORE_ALL_POSES, |(_, newest)| newest)
        };
        let let_go_at = is_let_go.then(newest);
        let epoch = found.as_ref().map_or(0, |(_, epoch)| *epoch);
        let result = match found {
            Ok((posed, _)) => {
                self.counters.pings_joined += 1;
                Ok(posed)
            }
            Err(error) => Err(self.rejected(ping, error)),
        };
        Some(Verdict {
            result,
            epoch,
            let_go_at,
        })
    }

    fn rejected(&mut self, ping: Arc<Ping>, error: PoseLookupError) -> RejectedPing {
        let reason = match error {
            PoseLookupError::NotYet => RejectReason::NeverCame,
            PoseLookupError::TooEarly => RejectReason::TooEarly,
            PoseLookupError::Gap => RejectReason::Gap,
        };
        *self.counter_of(reason) += 1;
        RejectedPing { ping, reason }
    }

    fn counter_of(&mut self, reason: RejectReason) -> &mut u64 {
        match reason {
            RejectReason::TooEarly => &mut self.counters.pings_too_early,
            RejectReason::Gap => &mut self.counters.pings_in_gap,
            RejectReason::NeverCame => &mut self.counters.pings_pose_never_came,
        }
    }

    fn may_yet_come(&self, ping: &Ping) -> bool {
        if let Some(&until) = self.let_go.get(&ping.sequence()) {
            let newest = self.trajectory.span().map(|(_, newest)| newest);
            return !self.poses_ended && newest.unwrap_or(BEFORE_ALL_POSES) < until;
        }
        let waited_s = self
            .newest_ping_time
            .map_or(0.0, |newest| newest.seconds_since(ping.transmit_time()));
        let in_time = self.config.max_wait_s.is_none_or(|limit| waited_s <= limit);
        !self.poses_ended && in_time
    }

    /// The ping with the sensor's pose and motion, and the pose's epoch, when the echo from the middle of the recorded
    /// range met the surface.
    fn posed(&mut self, ping: &Arc<Ping>) -> Result<(PosedPing, u32), PoseLookupError> {
        let (reference_range_m, time) = self.reference(ping);
        let lookahead_s = self.config.lookahead_s;
        let smoothed = self
            .trajectory
            .smoothed_at(time, lookahead_s, self.config.smoothing)?;
        let vehicle = smoothed.pose;
        let mount = &self.config.vehicle_from_sensor;
        let world_from_sensor = vehicle.world_from_vehicle * *mount;
        let view = View {
            time,
            world_from_beam: world_from_sensor.rotation
                * DQuat::from_rotation_z(ping.beam_azimuth_rad().into()),
            range_m: reference_range_m,
            jitter: smoothed.jitter,
        };
        let posed = PosedPing {
            ping: Arc::clone(ping),
            world_from_sensor,
            twist: at_sensor(&smoothed.twist, mount),
            reference_range_m,
            uncertainty: self.covariances.of_ping(&self.trajectory, &view),
            jitter: smoothed.jitter,
        };
        Ok((posed, vehicle.epoch))
    }

    /// The middle of the recorded range and when its echo meets the surface, on the poses' clock.
    fn reference(&self, ping: &Ping) -> (f64, Timestamp) {
        let settings = ping.settings();
        let reference_range_m = settings.range_start_m + 0.5 * settings.range_length_m;
        let time = ping.echo_time(reference_range_m);
        (reference_range_m, time.offset_by(self.config.time_offset_s))
    }

    /// Whether there are poses as late as smoothing asks for.
    fn is_looked_past(&self, ping: &Ping) -> bool {
        let (_, time) = self.reference(ping);
        let wanted = time.offset_by(self.config.lookahead_s);
        self.trajectory
            .span()
            .is_some_and(|(_, newest)| newest >= wanted)
    }

    /// Whether one more ping would be dropped.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.waiting.len() >= self.config.waiting_capacity
    }

    /// How many pings wait.
    #[must_use]
    pub fn waiting_len(&self) -> usize {
        self.waiting.len()
    }

    /// The poses held.
    #[must_use]
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }

    /// What became of the covariances that poses came with.
    #[must_use]
    pub fn covariance_counters(&self) -> CovarianceCounters {
        self.covariances.counters()
    }

    /// What became of every ping and pose.
    #[must_use]
    pub fn counters(&self) -> JoinCounters {
        self.counters
    }
}

impl PoseJoinConfig {
    /// # Errors
    /// Names the first setting that is out of range.
    pub fn check(&self) -> Result<(), PoseJoinError> {
        let mount = self.vehicle_from_sensor;
        let mount_fits = Pose::checked(mount.rotation, mount.translation_m).is_some();
        let gap_fits = self.max_pose_gap_s > 0.0 && self.max_pose_gap_s <= 60.0;
        let lookahead_fits = (0.0..=1.0).contains(&self.lookahead_s);
        let CompassDeviation { b_deg, c_deg } = self.compass;
        let is_small = |angle_deg: &f64| angle_deg.abs() <= MOST_DEVIATION_DEG;
        let compass_fits = [b_deg, c_deg].iter().all(is_small);
        let offset_fits = self.time_offset_s.is_finite();
        let wait_fits = self
            .max_wait_s
            .is_none_or(|limit| limit > 0.0 && limit <= 3600.0);
        let poses_fit = (2..=1 << 26).contains(&self.trajectory_capacity);
        let pings_fit = (1..=1 << 20).contains(&self.waiting_capacity);
        let found = |value: &dyn std::fmt::Debug| format!("{value:?}");
        let checks = [
            (
                mount_fits,
                "vehicle_from_sensor",
                found(&mount),
                "finite, with a quaternion of some length",
            ),
            (
                gap_fits,
                "max_pose_gap_s",
                found(&self.max_pose_gap_s),
                "above 0, at most 60",
            ),
            (
                lookahead_fits,
                "lookahead_s",
                found(&self.lookahead_s),
                "0 to 1",
            ),
            (
                compass_fits,
                "compass",
                found(&self.compass),
                "-45 to 45 degrees each",
            ),
            (
                offset_fits,
                "time_offset_s",
                found(&self.time_offset_s),
                "a finite number",
            ),
            (
                wait_fits,
                "max_wait_s",
                found(&self.max_wait_s),
                "none, or above 0, at most 3600",
            ),
            (
                poses_fit,
                "trajectory_capacity",
                found(&self.trajectory_capacity),
                "2 to 67108864",
            ),
            (
                pings_fit,
                "waiting_capacity",
                found(&self.waiting_capacity),
                "1 to 1048576",
            ),
        ];
        let refused = checks.into_iter().find(|(fits, ..)| !fits);
        refused.map_or(Ok(()), |(_, key, found, allowed)| {
            Err(PoseJoinError {
                key,
                found,
                allowed,
            })
        })
    }
}

/// Motion of the vehicle, in its axes, as motion of the sensor, in the sensor's axes: both turn
/// alike, and `v_sensor = v_vehicle + ω × lever arm`.
fn at_sensor(vehicle: &Twist, vehicle_from_sensor: &Pose) -> Twist {
    let sensor_from_vehicle = vehicle_from_sensor.rotation.conjugate();
    let lever_m = vehicle_from_sensor.translation_m;
    let linear_mps = vehicle.linear_mps + vehicle.angular_radps.cross(lever_m);
    Twist {
        linear_mps: sensor_from_vehicle * linear_mps,
        angular_radps: sensor_from_vehicle * vehicle.angular_radps,
    }
}

#[cfg(test)]
mod tests;
