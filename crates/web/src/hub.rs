//! What the service's threads, ours and the browsers' tasks share.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use axum::body::Bytes;
use echosplat_bus::delta::PublishedMap;
use echosplat_model::{PosedPing, Snapshot, Timestamp};
use serde::Serialize;
use serde_json::Value;
use tokio::sync::{broadcast, oneshot};
use tokio_util::sync::CancellationToken;

use crate::pings::PingRing;
use crate::track::Track;

/// Messages of the map that a browser may be behind; of at most 64 kB, so 16 MB at most, shared.
const MAP_QUEUE_LEN: usize = 256;
/// Pings, poses and status that a browser may be behind; beyond that the oldest are lost.
const LIVE_QUEUE_LEN: usize = 128;
/// Most points of error against time that are kept.
const MAX_ERRORS: usize = 4096;

/// Something for every browser.
#[derive(Debug, Clone)]
pub(crate) enum Live {
    /// JSON.
    Text(Arc<str>),
    /// See [`crate::wire`].
    Binary(Bytes),
}

/// All of it.
#[derive(Debug)]
pub(crate) struct Hub {
    /// Cancelled when the page is no longer served: connections end.
    pub(crate) closing: CancellationToken,
    /// Browsers that are connected.
    watchers: AtomicUsize,
    pub(crate) orders: Mutex<Orders>,
    pub(crate) ordered: Condvar,
    pub(crate) maps: broadcast::Sender<Bytes>,
    pub(crate) live: broadcast::Sender<Live>,
    pub(crate) scene: Mutex<Scene>,
    status: Mutex<Option<Reported>>,
    pub(crate) counters: Counters,
}

/// What the map's thread is to do.
#[derive(Debug, Default)]
pub(crate) struct Orders {
    /// The newest map, kept for downloads.
    pub(crate) newest: Option<Arc<Snapshot>>,
    /// It is the last.
    pub(crate) is_final: bool,
    /// Counts maps offered.
    pub(crate) offered: u64,
    pub(crate) asked: Vec<oneshot::Sender<Arc<PublishedMap>>>,
    pub(crate) stop: bool,
}

/// What is seen of the sonar.
#[derive(Debug, Default)]
pub(crate) struct Scene {
    pub(crate) ring: PingRing,
    pub(crate) first_time: Option<Timestamp>,
    pub(crate) newest_pose: Option<PosedPing>,
    pub(crate) has_new_pose: bool,
    pub(crate) track: Track,
    pub(crate) errors: Vec<ErrorPoint>,
}

/// How far the map is from the truth at a moment of the dive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct ErrorPoint {
    pub(crate) dive_s: f64,
    /// Chamfer distance, metres.
    pub(crate) cd_m: Option<f64>,
    /// Hausdorff distance, metres.
    pub(crate) hd_m: Option<f64>,
}

#[derive(Debug, Clone)]
struct Reported {
    status: Arc<Value>,
    at: Instant,
}

/// What became of requests and messages.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) requests: AtomicU64,
    pub(crate) refused: AtomicU64,
    pub(crate) connections_refused: AtomicU64,
    pub(crate) deltas: AtomicU64,
    pub(crate) delta_bytes: AtomicU64,
    pub(crate) snapshots: AtomicU64,
    pub(crate) resyncs: AtomicU64,
    pub(crate) lagged: AtomicU64,
}

impl Counters {
    pub(crate) fn all(&self) -> [(&'static str, u64); 8] {
        [
            ("requests", &self.requests),
            ("requests_refused", &self.refused),
            ("connections_refused", &self.connections_refused),
            ("delta_messages", &self.deltas),
            ("delta_bytes", &self.delta_bytes),
            ("snapshots", &self.snapshots),
            ("resyncs", &self.resyncs),
            ("messages_lagged", &self.lagged),
        ]
        .map(|(name, counter)| (name, counter.load(Ordering::Relaxed)))
    }
}

pub(crate) fn count(counter: &AtomicU64, by: u64) {
    counter.fetch_add(by, Ordering::Relaxed);
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Hub {
    pub(crate) fn new() -> Self {
        Self {
            closing: CancellationToken::new(),
            watchers: AtomicUsize::new(0),
            orders: Mutex::default(),
            ordered: Condvar::new(),
            maps: broadcast::Sender::new(MAP_QUEUE_LEN),
            live: broadcast::Sender::new(LIVE_QUEUE_LEN),
            scene: Mutex::default(),
            status: Mutex::default(),
            counters: Counters::default(),
        }
    }

    pub(crate) fn has_watchers(&self) -> bool {
        self.watcher_count() > 0
    }

    pub(crate) fn watcher_count(&self) -> usize {
        self.watchers.load(Ordering::Relaxed)
    }

    /// Counts one browser as long as it lives.
    pub(crate) fn watch(self: &Arc<Self>) -> Watcher {
        self.watchers.fetch_add(1, Ordering::Relaxed);
        self.ordered.notify_all();
        Watcher(Arc::clone(self))
    }

    /// Asks the map's thread for the published state; comes once it has caught up.
    pub(crate) fn ask_for_map(&self) -> oneshot::Receiver<Arc<PublishedMap>> {
        let (sender, receiver) = oneshot::channel();
        let mut orders = lock(&self.orders);
        // Of browsers that have gone while there was no map.
        orders.asked.retain(|asked| !asked.is_closed());
        orders.asked.push(sender);
        drop(orders);
        self.ordered.notify_all();
        receiver
    }

    pub(crate) fn set_status(&self, status: Value) {
        let reported = Reported {
            status: Arc::new(status),
            at: Instant::now(),
        };
        *lock(&self.status) = Some(reported);
    }

    /// The newest status and how old it is, seconds.
    pub(crate) fn status(&self) -> Option<(Arc<Value>, f64)> {
        let reported = lock(&self.status).clone()?;
        Some((reported.status, reported.at.elapsed().as_secs_f64()))
    }

    pub(crate) fn tell(&self, live: Live) {
        // Without a browser nobody takes it.
        let _ = self.live.send(live);
    }

    pub(crate) fn stop(&self) {
        self.closing.cancel();
        lock(&self.orders).stop = true;
        self.ordered.notify_all();
    }
}

impl Scene {
    pub(crate) fn push_error(&mut self, point: ErrorPoint) {
        if self.errors.len() < MAX_ERRORS {
            self.errors.push(point);
        }
    }
}

/// A connected browser.
#[derive(Debug)]
pub(crate) struct Watcher(Arc<Hub>);

impl Drop for Watcher {
    fn drop(&mut self) {
        self.0.watchers.fetch_sub(1, Ordering::Relaxed);
        self.0.ordered.notify_all();
    }
}

/// Set while a request that is served one at a time goes on.
#[derive(Debug, Default)]
pub(crate) struct Busy(AtomicBool);

impl Busy {
    /// `None` if one goes on.
    pub(crate) fn begin(self: &Arc<Self>) -> Option<BusyGuard> {
        let was = self.0.swap(true, Ordering::Acquire);
        (!was).then(|| BusyGuard(Arc::clone(self)))
    }
}

/// Ends it.
#[derive(Debug)]
pub(crate) struct BusyGuard(Arc<Busy>);

impl Drop for BusyGuard {
    fn drop(&mut self) {
        self.0.0.store(false, Ordering::Release);
    }
}
