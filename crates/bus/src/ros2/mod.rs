//! The map, the vehicle's odometry and its frames for ROS 2 with `rmw_zenoh`, as one of its nodes
//! would publish them, and poses taken from there.
//!
//! | topic | message | what |
//! |---|---|---|
//! | `/<prefix>/<node>/points` | `sensor_msgs/msg/PointCloud2` | what the map asserts |
//! | `/<prefix>/<node>/odometry` | `nav_msgs/msg/Odometry` | the vehicle at the newest ping that has a pose |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | `map` → `base_link` → `sonar_link`; `map` → `map_local` if the map has a frame of its own |
//!
//! Every second; every two where a cloud takes as long at [`crate::BusConfig::bandwidth_bps`].
//! `docs/live.md` says the same to those who use it. Deliberately absent: services, parameters,
//! actions, topics that remember their last message for who comes late (it is sent again anyway).

mod cloud;
mod fixes;
mod node;
mod poses;
mod rounds;

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use echosplat_liveness::Heartbeat;
use echosplat_model::{Pose, PoseCovariance, PosedPing, Snapshot, StampedPose};
use serde::Serialize;

use crate::bus::{Link, spawn};
use crate::{BusConfig, BusError};
pub(crate) use fixes::FixTopic;
pub(crate) use node::NodeSlot;
use node::Topics;
pub(crate) use poses::PoseTopic;
use rounds::Rounds;

/// What was put on topics of ROS so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct RosCounters {
    /// Clouds.
    pub clouds: u64,
    /// Confident Gaussians that the newest cloud had no room for.
    pub points_left_out: u64,
    /// Odometry messages.
    pub odometries: u64,
    /// Messages on `/tf`.
    pub transforms: u64,
    /// Messages that zenoh refused. What it drops under congestion it does not tell.
    pub failed: u64,
}

/// Publishes the newest of what it is given, on a thread of its own. Dropped, its node leaves.
#[derive(Debug)]
pub struct RosPublisher {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    heartbeat: Heartbeat,
    sensor_from_vehicle: Pose,
}

#[derive(Debug, Default)]
struct Shared {
    orders: Mutex<Orders>,
    ordered: Condvar,
    flushed: Condvar,
    counters: Mutex<RosCounters>,
}

/// The newest of all, and what the thread is to do.
#[derive(Debug, Default)]
struct Orders {
    map: Option<Arc<Snapshot>>,
    vehicle: Option<StampedPose>,
    flushes_asked: u64,
    flushes_done: u64,
    stop: bool,
}

impl Orders {
    fn is_urgent(&self) -> bool {
        self.stop || self.flushes_done < self.flushes_asked
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl RosPublisher {
    pub(crate) fn start(link: &Arc<Link>, vehicle_from_sensor: Pose) -> Result<Self, BusError> {
        let shared = Arc::new(Shared::default());
        let heartbeat = Heartbeat::new("bus-ros");
        let node = link.ros.node(link)?;
        let mut rounds = Rounds::new(link, &node, &shared, &heartbeat, vehicle_from_sensor)?;
        let beats = heartbeat.clone();
        let thread = spawn("bus-ros", move || beats.run_again(|| rounds.run()))?;
        Ok(Self {
            shared,
            thread: Some(thread),
            heartbeat,
            sensor_from_vehicle: vehicle_from_sensor.inverse(),
        })
    }

    /// Hands a newer map over; never waits.
    pub fn offer(&self, map: Arc<Snapshot>) {
        // A whole map may go with the one before: not while the lock is held.
        let before = lock(&self.shared.orders).map.replace(map);
        if before.is_none() {
            self.shared.ordered.notify_all();
        }
    }

    /// Hands over where the sonar was at a ping; never waits.
    pub fn posed(&self, posed: &PosedPing) {
        let vehicle = StampedPose {
            time: posed.ping.echo_time(posed.reference_range_m),
            world_from_vehicle: posed.world_from_sensor * self.sensor_from_vehicle,
            uncertainty: posed
                .uncertainty
                .map(|sigma| PoseCovariance::alike(sigma.position_m, sigma.attitude_rad)),
            epoch: 0,
        };
        // The thread waits for the first; then it comes back by itself.
        if lock(&self.shared.orders).vehicle.replace(vehicle).is_none() {
            self.shared.ordered.notify_all();
        }
    }

    /// Puts the newest of all on the topics now. Says whether that was done within `limit`.
    #[must_use]
    pub fn flush(&self, limit: Duration) -> bool {
        let deadline = Instant::now() + limit;
        let mut orders = lock(&self.shared.orders);
        orders.flushes_asked += 1;
        let ticket = orders.flushes_asked;
        self.shared.ordered.notify_all();
        while orders.flushes_done < ticket {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            let waited = self.shared.flushed.wait_timeout(orders, left);
            orders = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }

    /// Whether its thread is alive; it goes on after a panic.
    #[must_use]
    pub fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// What was published so far.
    #[must_use]
    pub fn counters(&self) -> RosCounters {
        *lock(&self.shared.counters)
    }
}

impl Drop for RosPublisher {
    /// Stops its thread without waiting for a link that holds it up.
    fn drop(&mut self) {
        lock(&self.shared.orders).stop = true;
        self.shared.ordered.notify_all();
        if let Some(thread) = self.thread.take().filter(JoinHandle::is_finished) {
            // A panic in it has been reported by the panic hook.
            let _ = thread.join();
        }
    }
}

/// # Errors
/// If ROS takes no such names.
pub(crate) fn check(config: &BusConfig) -> Result<(), BusError> {
    Topics::new(config).map(|_| ())
}
