//! Publishes the map: deltas as they arise, snapshots for those who ask.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, bounded};
use echosplat_model::{Delta, Snapshot};
use serde::Serialize;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{Query, Queryable};

use crate::bus::{Link, spawn};
use crate::delta::{PublishedMap, SnapshotDiffer, SnapshotRequest};
use crate::map_message::{Cut, WireMessage};
use crate::{BusError, point_cloud};

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
    /// Gaussians left out because a number was not finite.
    pub gaussians_unsound: u64,
    /// Queries answered.
    pub queries_answered: u64,
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
    _queryable: Queryable<()>,
}

#[derive(Debug, Default)]
struct Shared {
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

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl MapPublisher {
    pub(crate) fn start(link: &Arc<Link>) -> Result<Self, BusError> {
        let shared = Arc::new(Shared::default());
        let (sender, queries) = bounded(QUERY_QUEUE_LEN);
        let in_callback = Arc::clone(&shared);
        let queryable = link
            .session
            .declare_queryable(link.keys.snapshot())
            .callback(move |query| {
                if sender.try_send(query).is_err() {
                    in_callback.queries_dropped.fetch_add(1, Ordering::Relaxed);
                }
            })
            .wait()
            .map_err(BusError::zenoh("declare the queryable for the map"))?;
        let deltas = DeltaThread {
            link: Arc::clone(link),
            shared: Arc::clone(&shared),
            differ: SnapshotDiffer::new(link.config.tile_edge_m),
            offered: 0,
        };
        let answers = AnswerThread {
            link: Arc::clone(link),
            shared: Arc::clone(&shared),
        };
        let threads = vec![
            spawn("bus-map", move || deltas.run())?,
            // Apart from the deltas, since a slow link holds an answer up.
            spawn("bus-answers", move || answers.run(&queries))?,
        ];
        Ok(Self {
            shared,
            threads,
            _queryable: queryable,
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

    /// What was published so far.
    #[must_use]
    pub fn counters(&self) -> MapPublisherCounters {
        let mut counters = *lock(&self.shared.counters);
        counters.queries_dropped += self.shared.queries_dropped.load(Ordering::Relaxed);
        counters
    }
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

/// Makes deltas and sends them.
struct DeltaThread {
    link: Arc<Link>,
    shared: Arc<Shared>,
    differ: SnapshotDiffer,
    /// Sequence of the newest snapshot taken.
    offered: u64,
}

/// What one look at the orders gave.
struct Work {
    snapshot: Option<Arc<Snapshot>>,
    flushes: Option<u64>,
    stop: bool,
}

impl DeltaThread {
    fn run(mut self) {
        loop {
            let work = self.next_work();
            if let Some(snapshot) = work.snapshot {
                self.offered = snapshot.sequence;
                self.differ.offer(snapshot);
            }
            if let Some(ticket) = work.flushes {
                self.flush(ticket);
            } else if work.stop {
                return;
            } else {
                self.round();
            }
        }
    }

    /// Waits until there is something to publish, a flush, or the end.
    fn next_work(&self) -> Work {
        let mut orders = lock(&self.shared.orders);
        while !orders.is_urgent() && orders.snapshot.is_none() && self.differ.is_drained() {
            let waited = self.shared.ordered.wait(orders);
            orders = waited.unwrap_or_else(PoisonError::into_inner);
        }
        let flushes = orders.flushes_asked;
        Work {
            snapshot: orders.snapshot.take(),
            flushes: (orders.flushes_done < flushes).then_some(flushes),
            stop: orders.stop,
        }
    }

    /// One interval's worth of deltas, spread over the interval.
    fn round(&mut self) {
        let begin = Instant::now();
        let interval = Duration::from_secs_f64(self.link.config.publish_interval_s);
        let bits = self.link.config.bandwidth_bps as f64 * interval.as_secs_f64();
        let deltas = self.differ.next_deltas(Some((bits / 8.0) as usize));
        self.publish_state();
        self.send(&deltas, false);
        self.pause_until(begin + interval);
    }

    fn flush(&mut self, ticket: u64) {
        let deltas = self.differ.finish().unwrap_or_default();
        self.publish_state();
        self.send(&deltas, true);
        let published = self.differ.published();
        let mut orders = lock(&self.shared.orders);
        orders.flushes_done = ticket;
        orders.report = Some(FlushReport {
            epoch: published.map(PublishedMap::epoch),
            sequence: published.map_or(0, PublishedMap::sequence),
        });
        self.shared.flushed.notify_all();
    }

    /// Before the deltas go out: who asks in between gets them in the answer, and again as deltas
    /// of a sequence it has already. The other way round it would miss them.
    fn publish_state(&self) {
        let state = self.differ.published().cloned().map(Arc::new);
        *lock(&self.shared.published) = state;
    }

    fn send(&self, deltas: &[Delta], is_last: bool) {
        let cut = cut(&self.link);
        for (index, delta) in deltas.iter().enumerate() {
            let is_final = is_last && index + 1 == deltas.len();
            for message in cut.delta(delta, is_final) {
                self.put(&message, is_last);
            }
        }
        if deltas.is_empty() {
            self.note_sent();
        }
        let mut counters = lock(&self.shared.counters);
        counters.deltas += deltas.len() as u64;
        counters.gaussians_unsound = self.differ.unsound_count();
    }

    fn put(&self, message: &WireMessage, is_last: bool) {
        let byte_count = message.byte_count();
        let control = match is_last {
            true => CongestionControl::Block,
            false => CongestionControl::Drop,
        };
        let put = self
            .link
            .session
            .put(
                self.link.keys.delta(message.tile),
                message.payload.as_slice(),
            )
            .encoding(Encoding::from(point_cloud::ENCODING))
            .attachment(message.attachment.as_slice())
            .congestion_control(control)
            .priority(Priority::DataLow)
            .wait();
        {
            let mut counters = lock(&self.shared.counters);
            counters.messages += 1;
            counters.bytes += byte_count as u64;
            counters.messages_failed += u64::from(put.is_err());
        }
        if put.is_ok() {
            self.note_sent();
        }
        if !is_last {
            // Bursts are what a slow link drops.
            let seconds = 8.0 * byte_count as f64 / self.link.config.bandwidth_bps as f64;
            self.pause_until(Instant::now() + Duration::from_secs_f64(seconds));
        }
    }

    fn note_sent(&self) {
        let sequence = self.offered;
        let mut sent = lock(&self.shared.sent);
        if sent.is_none_or(|before| before.sequence != sequence) {
            *sent = Some(Sent {
                sequence,
                at: Instant::now(),
            });
        }
    }

    /// Sleeps, unless something urgent comes up.
    fn pause_until(&self, time: Instant) {
        let mut orders = lock(&self.shared.orders);
        while !orders.is_urgent() {
            let left = time.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            let waited = self.shared.ordered.wait_timeout(orders, left);
            orders = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

fn cut(link: &Link) -> Cut<'_> {
    Cut {
        max_message_bytes: link.config.max_message_bytes,
        frame_id: &link.config.frame_id,
    }
}

/// Answers those who ask for the map.
struct AnswerThread {
    link: Arc<Link>,
    shared: Arc<Shared>,
}

impl AnswerThread {
    /// Ends with the queryable, whose callback holds the other end of the queue.
    fn run(&self, queries: &Receiver<Query>) {
        for query in queries {
            let published = lock(&self.shared.published).clone();
            let parameters = query.parameters();
            let request = SnapshotRequest::parse(|name| parameters.get(name));
            match (request, published) {
                (Ok(request), Some(published)) => {
                    lock(&self.shared.counters).queries_answered += 1;
                    self.answer(&query, &published, &request);
                }
                (Err(error), _) => {
                    lock(&self.shared.counters).queries_refused += 1;
                    // Whoever asked may have gone.
                    let _ = query.reply_err(error.to_string()).wait();
                }
                (Ok(_), None) => lock(&self.shared.counters).queries_dropped += 1,
            }
        }
    }

    /// Replies take the congestion control of the query, Block from our own subscriber.
    fn answer(&self, query: &Query, published: &PublishedMap, request: &SnapshotRequest) {
        let answer = published.select(request);
        for message in cut(&self.link).answer(&answer) {
            let reply = query
                .reply(self.link.keys.snapshot(), message.payload)
                .encoding(Encoding::from(point_cloud::ENCODING))
                .attachment(message.attachment)
                .wait();
            if let Err(error) = reply {
                tracing::debug!("map query not answered to its end: {error}");
                return;
            }
        }
    }
}
