//! Our own two threads: one makes deltas of the newest map, one encodes pings and poses. Both rest
//! while no browser is connected.

use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use echosplat_bus::delta::PublishedMap;
use echosplat_bus::{BusConfig, MapEncoder};
use echosplat_liveness::Heartbeat;
use echosplat_model::Snapshot;
use serde_json::{Value, json};
use tokio::sync::oneshot;

use crate::hub::{Hub, Live, Scene, count, lock};
use crate::pings;
use crate::wire::{self, Kind};

/// Shortest time between two rounds of deltas.
const ROUND: Duration = Duration::from_millis(60);
/// A round is followed by so many times its own length of rest.
const REST: u32 = 4;
/// Time between two looks at pings and poses.
const LOOK: Duration = Duration::from_millis(40);

/// Makes deltas.
pub(crate) struct MapWorker {
    pub(crate) hub: Arc<Hub>,
    pub(crate) bus: BusConfig,
    /// Most that live deltas take of one browser's link.
    pub(crate) bandwidth_bps: u64,
    heartbeat: Heartbeat,
    state: Option<State>,
}

/// Of the map as browsers have it; given up with the last of them.
struct State {
    encoder: MapEncoder,
    /// What of [`crate::hub::Orders::offered`] it has.
    offered: u64,
    is_final: bool,
    is_told_final: bool,
}

/// One look at the orders.
struct Work {
    map: Option<(Arc<Snapshot>, u64, bool)>,
    asked: Vec<oneshot::Sender<Arc<PublishedMap>>>,
}

impl MapWorker {
    pub(crate) fn new(
        hub: Arc<Hub>,
        bus: BusConfig,
        bandwidth_bps: u64,
        heartbeat: Heartbeat,
    ) -> Self {
        Self {
            hub,
            bus,
            bandwidth_bps,
            heartbeat,
            state: None,
        }
    }

    /// Until the end; may be called again after a panic.
    pub(crate) fn run(&mut self) {
        while let Some(work) = self.next_work() {
            self.heartbeat.beat();
            let began = Instant::now();
            self.take(work);
            self.heartbeat.rest();
            self.rest(ROUND.max(began.elapsed() * REST));
        }
    }

    /// Waits until a browser wants something; `None` at the end.
    fn next_work(&mut self) -> Option<Work> {
        let mut orders = lock(&self.hub.orders);
        loop {
            if orders.stop {
                return None;
            }
            if !self.hub.has_watchers()
                && let Some(state) = self.state.take()
            {
                // Letting go of a map takes longer than anybody may hold the lock.
                drop(orders);
                drop(state);
                orders = lock(&self.hub.orders);
                continue;
            }
            let offered = self.state.as_ref().map_or(0, |state| state.offered);
            let is_behind = orders.offered > offered;
            let has_more = self.state.as_ref().is_some_and(|s| !s.encoder.is_drained());
            let is_asked = !orders.asked.is_empty() && orders.newest.is_some();
            if is_asked || self.hub.has_watchers() && (is_behind || has_more) {
                let newest = orders.newest.clone();
                let map = newest.filter(|_| is_behind);
                return Some(Work {
                    map: map.map(|map| (map, orders.offered, orders.is_final)),
                    asked: std::mem::take(&mut orders.asked),
                });
            }
            let waited = self.hub.ordered.wait(orders);
            orders = waited.unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn take(&mut self, work: Work) {
        let bus = &self.bus;
        let state = self.state.get_or_insert_with(|| State {
            encoder: MapEncoder::new(bus),
            offered: 0,
            is_final: false,
            is_told_final: false,
        });
        if let Some((map, offered, is_final)) = work.map {
            state.encoder.offer(map);
            state.offered = offered;
            state.is_told_final &= is_final;
            state.is_final = is_final;
        }
        // Whoever asks gets all there is, in the answer.
        let catches_up = !work.asked.is_empty();
        let bytes = self.bandwidth_bps as f64 / 8.0 * ROUND.as_secs_f64();
        let budget = (!catches_up && !state.is_final).then_some(bytes as usize);
        let messages = match state.is_final && !state.is_told_final {
            true => state.encoder.final_messages(),
            false => state.encoder.next_messages(budget),
        };
        state.is_told_final = state.is_final;
        let published = state.encoder.published().cloned().map(Arc::new);
        // Before the deltas go out, so that an answer misses none that its asker missed.
        if let Some(published) = published {
            for asked in work.asked {
                // Whoever asked may have gone.
                let _ = asked.send(Arc::clone(&published));
            }
        } else {
            lock(&self.hub.orders).asked.extend(work.asked);
        }
        if catches_up && self.hub.watcher_count() == 1 {
            return;
        }
        for sent in messages {
            let message = sent.message;
            let bytes = wire::binary(Kind::Delta, &message.attachment, &message.payload);
            count(&self.hub.counters.deltas, 1);
            count(&self.hub.counters.delta_bytes, bytes.len() as u64);
            // A browser may just have gone.
            let _ = self.hub.maps.send(bytes);
        }
    }

    /// Sleeps, unless somebody asks for the map.
    fn rest(&self, length: Duration) {
        let until = Instant::now() + length;
        let mut orders = lock(&self.hub.orders);
        while !orders.stop {
            let waits = orders.newest.is_some() && !orders.asked.is_empty();
            let left = until.saturating_duration_since(Instant::now());
            if waits || left.is_zero() {
                return;
            }
            let waited = self.hub.ordered.wait_timeout(orders, left);
            orders = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// Encodes pings and poses until the end.
pub(crate) fn show_scene(hub: &Hub, heartbeat: &Heartbeat) {
    while wait_for_watchers(hub) {
        heartbeat.beat();
        let (pings, pose) = {
            let mut scene = lock(&hub.scene);
            let is_new = std::mem::take(&mut scene.has_new_pose);
            let pose = is_new.then(|| pose_of(&scene)).flatten();
            (scene.ring.take(), pose)
        };
        for ping in pings {
            hub.tell(Live::Binary(pings::encode(&ping)));
        }
        if let Some(pose) = pose {
            hub.tell(Live::Text(pose.to_string().into()));
        }
        heartbeat.rest();
        std::thread::sleep(LOOK);
    }
}

/// False at the end.
fn wait_for_watchers(hub: &Hub) -> bool {
    let mut orders = lock(&hub.orders);
    while !orders.stop && !hub.has_watchers() {
        let waited = hub.ordered.wait(orders);
        orders = waited.unwrap_or_else(PoisonError::into_inner);
    }
    !orders.stop
}

/// The newest pose as a message; `None` before the first.
pub(crate) fn pose_of(scene: &Scene) -> Option<Value> {
    let posed = scene.newest_pose.as_ref()?;
    let time = posed.ping.transmit_time();
    let first = scene.first_time.unwrap_or(time);
    let pose = &posed.world_from_sensor;
    let q = pose.rotation;
    Some(json!({
        "kind": "pose",
        "dive_s": time.seconds_since(first),
        "time_ns": time.nanos(),
        "position_m": pose.translation_m.to_array(),
        "orientation_wxyz": [q.w, q.x, q.y, q.z],
        "range_end_m": posed.ping.settings().range_end_m(),
    }))
}
