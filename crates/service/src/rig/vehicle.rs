//! The vehicle that carries a simulated sonar: its poses on the bus, in step with the pings.

use std::sync::Arc;
use std::time::{Duration, Instant};

use echosplat_bus::Bus;
use echosplat_model::{StampedPose, Timestamp};
use echosplat_simulator::Dive;

use crate::arguments::PoseClock;
use crate::clock;

/// Poses go out so long before the ping that needs them.
const AHEAD_S: f64 = 0.3;
/// The first ping of a client has poses before it, whoever took those sent earlier.
const BEFORE_S: f64 = 0.5;
/// Poses wait so long for somebody to take them; then they go out to whoever may be there.
const PATIENCE_S: f64 = 5.0;
/// Where pings do not go out in real time, they wait so long for somebody to take their poses.
const HOLD: Duration = Duration::from_secs(2);
/// Whether somebody takes them is asked this often.
const ASK_EVERY: Duration = Duration::from_millis(10);
/// Dive and host's clock that are further apart than what a sender may be behind no longer go
/// together: the machine stood still, or its clock was set.
const STEP_NANOS: u64 = 1_000_000_000;

/// Where poses go, and on which clock.
pub(crate) struct PosesTo {
    pub(crate) bus: Arc<Bus>,
    pub(crate) clock: PoseClock,
}

/// Publishes the dive's poses. Its times are the dive's. Nothing here waits.
pub(super) struct Vehicle {
    to: PosesTo,
    dive: Arc<Dive>,
    is_real_time: bool,
    /// The first pose that has not been sent.
    next: usize,
    /// Host time over dive time while the sonar pings, from the first ping on.
    host_offset_nanos: Option<i64>,
    /// Whether somebody takes poses, as last seen; and when that was asked.
    is_heard: bool,
    asked: Instant,
    began: Instant,
    clients: u64,
    /// Whether the sonar was asked to ping since [`Self::go_along`] was last called.
    pub(super) is_asked_again: bool,
    /// Whether pings are to wait.
    pub(super) waits: bool,
}

impl Vehicle {
    pub(super) fn new(to: PosesTo, dive: Arc<Dive>, is_real_time: bool) -> Self {
        let now = Instant::now();
        Self {
            to,
            dive,
            is_real_time,
            next: 0,
            host_offset_nanos: None,
            is_heard: false,
            asked: now,
            began: now,
            clients: 0,
            is_asked_again: false,
            waits: false,
        }
    }

    /// The sonar was silent and pings from `dive_time` on: the clocks are anchored anew.
    pub(super) fn begin(&mut self, dive_time: Timestamp) {
        self.host_offset_nanos = None;
        self.is_heard = false;
        self.began = Instant::now();
        self.waits = !self.is_real_time;
        self.go_back_before(dive_time);
    }

    /// Another client may have nothing yet of what was sent.
    fn go_back_before(&mut self, dive_time: Timestamp) {
        let from = dive_time.offset_by(-BEFORE_S);
        let poses = self.dive.reported_poses();
        self.next = poses.partition_point(|pose| pose.time < from);
    }

    /// Between pings, of which the one at `dive_time` is next.
    pub(super) fn go_along(&mut self, dive_time: Timestamp, clients_seen: u64) {
        if std::mem::take(&mut self.is_asked_again) && self.clients != clients_seen {
            self.clients = clients_seen;
            self.go_back_before(dive_time);
        }
        if self.waits {
            self.waits = !self.hears_somebody() && self.began.elapsed() < HOLD;
        }
        // What goes out before somebody takes it is lost to the pings that wait for it.
        if !self.waits {
            self.publish(dive_time);
        }
    }

    /// Right before the ping at `dive_time` goes out.
    pub(super) fn before_ping(&mut self, dive_time: Timestamp) {
        let offset_nanos = clock::now().nanos().saturating_sub(dive_time.nanos());
        let is_apart = |anchored: i64| {
            self.is_real_time && offset_nanos.saturating_sub(anchored).unsigned_abs() > STEP_NANOS
        };
        if self.host_offset_nanos.is_none_or(is_apart) {
            self.host_offset_nanos = Some(offset_nanos);
        }
        self.publish(dive_time);
    }

    /// Sends the poses up to a little after `dive_time`.
    fn publish(&mut self, dive_time: Timestamp) {
        let offset_nanos = match (self.to.clock, self.host_offset_nanos) {
            (PoseClock::Device, _) => 0,
            (PoseClock::Host, Some(offset_nanos)) => offset_nanos,
            (PoseClock::Host, None) => return,
        };
        let horizon = dive_time.offset_by(AHEAD_S);
        let dive = Arc::clone(&self.dive);
        let waiting = dive.reported_poses().get(self.next..).unwrap_or_default();
        for pose in waiting.iter().take_while(|pose| pose.time <= horizon) {
            let is_old = dive_time.seconds_since(pose.time) > PATIENCE_S;
            if !(self.hears_somebody() || is_old || !self.is_real_time) {
                return;
            }
            self.next += 1;
            let shifted = StampedPose {
                time: pose.time.offset_by_nanos(offset_nanos),
                ..*pose
            };
            if let Err(error) = self.to.bus.publish_pose(&shifted) {
                tracing::debug!(%error, "pose not published");
            }
        }
    }

    fn hears_somebody(&mut self) -> bool {
        if !self.is_heard && self.asked.elapsed() >= ASK_EVERY {
            self.asked = Instant::now();
            self.is_heard = self.to.bus.has_pose_subscriber();
        }
        self.is_heard
    }
}
