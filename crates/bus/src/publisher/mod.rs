//! Publishes the map: deltas as they arise, snapshots for those who ask, and the place of its frame
//! where it is not in that of the poses.

mod answers;
mod deltas;
mod pace;
mod rounds;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Sender, bounded};
use echosplat_liveness::Heartbeat;
use echosplat_model::Snapshot;
use serde::Serialize;
use zenoh::Wait;
use zenoh::query::{Query, Queryable};

use crate::BusError;
use crate::bus::{Link, spawn};
use crate::delta::PublishedMap;
use answers::{AnswerThread, Asked};
use deltas::DeltaThread;
use pace::Pace;

/// Queries that wait to be answered; beyond that the newest goes unanswered and is asked again.
const QUERY_QUEUE_LEN: usize = 16;

/// What was published so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct MapPublisherCounters {
    /// Snapshots offered.
    pub snapshots_offered: u64,
    /// Snapshots replaced by a newer one before they were looked at.
    pub snapshots_replaced: u64,
    /// Deltas made.
    pub deltas: u64,
    /// Messages given to zenoh.
    pub messages: u64,
    /// Bytes of these.
    pub bytes: u64,
    /// Messages that zenoh refused. What it drops under congestion it does not tell; subscribers
    /// see it as a gap.
    pub messages_failed: u64,
    /// Bits per second that deltas may take of the link now.
    pub pace_bps: u64,
    /// Times that deltas were slowed since somebody missed some.
    pub slowed: u64,
    /// Gaussians left out because they cannot be.
    pub gaussians_unsound: u64,
    /// Times that the place of the map's own frame was told.
    pub static_transforms: u64,
    /// Queries answered.
    pub queries_answered: u64,
    /// Of these, answers that did not get to their end.
    pub queries_cut: u64,
    /// Queries with parameters that cannot be read.
    pub queries_refused: u64,
    /// Queries let go: the queue was full, or nothing was published yet.
    pub queries_dropped: u64,
}

/// Where the published map stands after a flush.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FlushReport {
    /// Of the map, if one was ever offered.
    pub epoch: Option<u64>,
    /// Of the final delta.
    pub sequence: u64,
}

/// Publishes the newest map offered, on threads of its own.
#[derive(Debug)]
pub struct MapPublisher {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    heartbeats: [Heartbeat; 2],
    _queryables: [Queryable<()>; 2],
}

#[derive(Debug)]
struct Shared {
    pace: Mutex<Pace>,
    /// Held while zenoh is given what waits for a link: in turn, or the last deltas, of the higher
    /// priority, would keep an answer waiting until zenoh ends the connection for it.
    turn: Mutex<()>,
    orders: Mutex<Orders>,
    ordered: Condvar,
    flushed: Condvar,
    published: Mutex<Option<Arc<PublishedMap>>>,
    sent: Mutex<Option<Sent>>,
    counters: Mutex<MapPublisherCounters>,
    queries_dropped: AtomicU64,
}

/// The newest snapshot of which something was sent, or that changed nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sent {
    /// Of the snapshot offered.
    pub sequence: u64,
    /// When zenoh was given the first message.
    pub at: Instant,
}

/// What the publishing thread is to do next.
#[derive(Debug, Default)]
struct Orders {
    snapshot: Option<Arc<Snapshot>>,
    flushes_asked: u64,
    flushes_done: u64,
    report: Option<FlushReport>,
    stop: bool,
}

impl Orders {
    /// Something that is not put off for the sake of bandwidth.
    fn is_urgent(&self) -> bool {
        self.stop || self.flushes_done < self.flushes_asked
    }
}

impl Shared {
    fn new(bandwidth_bps: u64) -> Self {
        Self {
            pace: Mutex::new(Pace::new(bandwidth_bps)),
            turn: Mutex::default(),
            orders: Mutex::default(),
            ordered: Condvar::new(),
            flushed: Condvar::new(),
            published: Mutex::default(),
            sent: Mutex::default(),
            counters: Mutex::default(),
            queries_dropped: AtomicU64::new(0),
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl MapPublisher {
    pub(crate) fn start(link: &Arc<Link>) -> Result<Self, BusError> {
        let shared = Arc::new(Shared::new(link.config.bandwidth_bps));
        let (sender, queries) = bounded(QUERY_QUEUE_LEN);
        let queryables = [
            take_queries(link, link.keys.snapshot(), Asked::Map, &shared, &sender)?,
            take_queries(
                link,
                link.keys.static_transform(),
                Asked::Frame,
                &shared,
                &sender,
            )?,
        ];
        let heartbeats = [Heartbeat::new("bus-map"), Heartbeat::new("bus-answers")];
        let [of_deltas, of_answers] = heartbeats.clone();
        let mut deltas = DeltaThread::new(Arc::clone(link), Arc::clone(&shared), of_deltas.clone());
        let answers = AnswerThread::new(Arc::clone(link), Arc::clone(&shared));
        let threads = vec![
            spawn("bus-map", move || of_deltas.run_again(|| deltas.run()))?,
            // Apart from the deltas, since a slow link holds an answer up.
            spawn("bus-answers", move || {
                of_answers.run_again(|| answers.run(&queries, &of_answers));
            })?,
        ];
        Ok(Self {
            shared,
            threads,
            heartbeats,
            _queryables: queryables,
        })
    }

    /// Hands a newer map over; never blocks. One not yet looked at is replaced and counted.
    pub fn offer(&self, snapshot: Arc<Snapshot>) {
        let replaced = lock(&self.shared.orders).snapshot.replace(snapshot);
        self.shared.ordered.notify_all();
        let mut counters = lock(&self.shared.counters);
        counters.snapshots_offered += 1;
        counters.snapshots_replaced += u64::from(replaced.is_some());
    }

    /// Publishes all that is pending, without the bandwidth's limit, with congestion control
    /// Block, and marked as final. The publisher must live on for a while to answer those to whom
    /// something was lost.
    ///
    /// # Errors
    /// If it takes longer than `limit`; it then goes on.
    pub fn flush(&self, limit: Duration) -> Result<FlushReport, BusError> {
        let deadline = Instant::now() + limit;
        let mut orders = lock(&self.shared.orders);
        orders.flushes_asked += 1;
        let ticket = orders.flushes_asked;
        self.shared.ordered.notify_all();
        while orders.flushes_done < ticket {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                let action = "publishing the final map";
                return Err(BusError::TimedOut { action, limit });
            }
            let waited = self.shared.flushed.wait_timeout(orders, left);
            orders = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        Ok(orders.report.unwrap_or(FlushReport {
            epoch: None,
            sequence: 0,
        }))
    }

    /// The newest snapshot that is on its way to subscribers; `None` before the first.
    #[must_use]
    pub fn sent(&self) -> Option<Sent> {
        *lock(&self.shared.sent)
    }

    /// Whether its threads are alive; both go on after a panic.
    #[must_use]
    pub fn heartbeats(&self) -> &[Heartbeat] {
        &self.heartbeats
    }

    /// What was published so far.
    #[must_use]
    pub fn counters(&self) -> MapPublisherCounters {
        let mut counters = *lock(&self.shared.counters);
        counters.queries_dropped += self.shared.queries_dropped.load(Ordering::Relaxed);
        let pace = lock(&self.shared.pace);
        counters.pace_bps = pace.bps(Instant::now()) as u64;
        counters.slowed = pace.slowed_count();
        counters
    }

    /// Whether a follower's link carries less than deltas may take.
    #[must_use]
    pub fn is_slowed(&self) -> bool {
        lock(&self.shared.pace).is_slowed()
    }

    /// When the newest answer was handed to zenoh; now while one is under way.
    #[must_use]
    pub fn answered(&self) -> Option<Instant> {
        lock(&self.shared.pace).answered(Instant::now())
    }
}

/// Queues what is asked on `key`; never waits.
fn take_queries(
    link: &Link,
    key: String,
    asked: fn(Query) -> Asked,
    shared: &Arc<Shared>,
    queries: &Sender<Asked>,
) -> Result<Queryable<()>, BusError> {
    let (shared, queries) = (Arc::clone(shared), queries.clone());
    let queryable = link.session.declare_queryable(key).callback(move |query| {
        if queries.try_send(asked(query)).is_err() {
            shared.queries_dropped.fetch_add(1, Ordering::Relaxed);
        }
    });
    queryable
        .wait()
        .map_err(BusError::zenoh("declare the queryable for the map"))
}

impl Drop for MapPublisher {
    /// Stops its threads without waiting for a link that holds one up.
    fn drop(&mut self) {
        lock(&self.shared.orders).stop = true;
        self.shared.ordered.notify_all();
        for thread in self.threads.drain(..).filter(JoinHandle::is_finished) {
            // A panic in it has been reported by the panic hook.
            let _ = thread.join();
        }
    }
}
