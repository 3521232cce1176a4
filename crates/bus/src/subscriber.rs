//! Follows a published map: the late joiner.
//!
//! Deltas are subscribed to and buffered first, then the snapshot is asked for, then deltas with a
//! larger sequence are applied. After a gap, a new epoch, the publisher's return, or a while of
//! silence it asks again, for what changed since. The publisher marks its last state `final`;
//! whoever holds that sequence without a gap holds the whole map, and whoever lost the mark learns
//! it from the next answer.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, bounded, never, select};
use echosplat_model::{GaussianId, Snapshot, Timestamp, Unsound};
use serde::Serialize;
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Reply};
use zenoh::sample::{Sample, SampleKind};

use crate::BusError;
use crate::bus::{Link, spawn};
use crate::delta::{AssemblerCounters, MapAssembler, Progress};
use crate::map_message::{DeltaCollector, MapMessage, SnapshotCollector};

/// Messages, and bytes of these, that wait to be read; beyond that the newest is dropped, which
/// shows as a gap.
const QUEUE_LEN: usize = 1024;
const QUEUE_BYTES: usize = 32 << 20;

/// Replies that wait to be read; beyond that their sender waits.
const REPLY_QUEUE_LEN: usize = 64;

/// Longest time between two questions while nobody answers.
const MAX_RETRY: Duration = Duration::from_millis(500);
const MIN_RETRY: Duration = Duration::from_millis(50);

/// Whether the publisher's token is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Liveliness {
    /// No token was seen yet.
    #[default]
    Unknown,
    /// The token is there.
    Alive,
    /// The token was there and has gone.
    Gone,
}

/// What happened so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct MapSubscriberCounters {
    /// Delta messages that came.
    pub messages_received: u64,
    /// Bytes of these and of answers.
    pub bytes_received: u64,
    /// Messages that cannot be read.
    pub messages_malformed: u64,
    /// Newest messages dropped because the queue was full.
    pub messages_dropped: u64,
    /// Deltas of which a chunk was missing.
    pub deltas_incomplete: u64,
    /// Gaussians left out because they cannot be; each time that one came.
    pub gaussians_unsound: u64,
    /// Questions asked.
    pub queries: u64,
    /// Questions without a whole answer.
    pub queries_failed: u64,
    /// Gaps, epochs and what was applied.
    #[serde(flatten)]
    pub assembler: AssemblerCounters,
}

/// Why the final map is not there.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "no final map within {limit:?}: it stands at {position:?} (epoch, sequence), publisher {liveliness:?}"
)]
pub struct MapWaitError {
    /// How long was waited.
    pub limit: Duration,
    /// Epoch and sequence that are there.
    pub position: Option<(u64, u64)>,
    /// Whether the publisher is there.
    pub liveliness: Liveliness,
}

/// The map of one publisher, kept up to date on a thread of its own.
#[derive(Debug)]
pub struct MapSubscriber {
    shared: Arc<Shared>,
    _deltas: Subscriber<()>,
    _liveliness: Subscriber<()>,
    _stop: Sender<()>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    queued_bytes: AtomicUsize,
    messages_received: AtomicU64,
    messages_dropped: AtomicU64,
}

#[derive(Debug)]
struct State {
    assembler: MapAssembler,
    counters: MapSubscriberCounters,
    liveliness: Liveliness,
    /// The map as it was last asked for, so that asking again costs nothing; `None` once it
    /// changed.
    newest: Option<Arc<Snapshot>>,
    first_unsound: Option<(GaussianId, Unsound)>,
    first_fault: Option<String>,
}

fn lock(shared: &Shared) -> MutexGuard<'_, State> {
    shared.state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl MapSubscriber {
    pub(crate) fn start(link: &Arc<Link>) -> Result<Self, BusError> {
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                assembler: MapAssembler::new(link.config.max_gaussians),
                counters: MapSubscriberCounters::default(),
                liveliness: Liveliness::Unknown,
                newest: None,
                first_unsound: None,
                first_fault: None,
            }),
            changed: Condvar::new(),
            queued_bytes: AtomicUsize::new(0),
            messages_received: AtomicU64::new(0),
            messages_dropped: AtomicU64::new(0),
        });
        let (sender, samples) = bounded(QUEUE_LEN);
        let in_callback = Arc::clone(&shared);
        let deltas = link
            .session
            .declare_subscriber(link.keys.deltas())
            .callback(move |sample| in_callback.queue(sample, &sender))
            .wait()
            .map_err(BusError::zenoh("subscribe to the map"))?;
        let (wake, returned) = bounded(1);
        let liveliness = watch_liveliness(link, &shared, wake)?;
        let (stop, stopped) = bounded(0);
        let follower = Follower {
            link: Arc::clone(link),
            shared: Arc::clone(&shared),
            collector: DeltaCollector::new(link.config.max_gaussians),
            retry: MIN_RETRY,
            last_heard: Instant::now(),
            next_query: Instant::now(),
        };
        spawn("bus-follow", move || {
            follower.run(&samples, &returned, &stopped);
        })?;
        Ok(Self {
            shared,
            _deltas: deltas,
            _liveliness: liveliness,
            _stop: stop,
        })
    }

    /// The map as it stands, Gaussians in order of id; `None` before the first answer. Its
    /// sequence is that of the newest delta in it.
    #[must_use]
    pub fn newest(&self) -> Option<Arc<Snapshot>> {
        lock(&self.shared).newest()
    }

    /// Epoch and sequence of the map as it stands. Another epoch than before is another map: the
    /// one there was is gone whole, ids included.
    #[must_use]
    pub fn position(&self) -> Option<(u64, u64)> {
        lock(&self.shared).assembler.position()
    }

    /// Transmit time of the newest ping whose evidence is in the map as it stands.
    #[must_use]
    pub fn time(&self) -> Option<Timestamp> {
        lock(&self.shared).assembler.time()
    }

    /// How many Gaussians the map holds.
    #[must_use]
    pub fn gaussian_count(&self) -> usize {
        lock(&self.shared).assembler.gaussian_count()
    }

    /// Whether the map is whole and the publisher has flushed.
    #[must_use]
    pub fn is_final(&self) -> bool {
        lock(&self.shared).assembler.is_final()
    }

    /// Whether the publisher is there.
    #[must_use]
    pub fn liveliness(&self) -> Liveliness {
        lock(&self.shared).liveliness
    }

    /// What happened so far.
    #[must_use]
    pub fn counters(&self) -> MapSubscriberCounters {
        let state = lock(&self.shared);
        MapSubscriberCounters {
            messages_received: self.shared.messages_received.load(Ordering::Relaxed),
            messages_dropped: self.shared.messages_dropped.load(Ordering::Relaxed),
            assembler: state.assembler.counters(),
            ..state.counters
        }
    }

    /// The first Gaussian that was left out because it cannot be, and why.
    #[must_use]
    pub fn first_unsound(&self) -> Option<(GaussianId, Unsound)> {
        lock(&self.shared).first_unsound
    }

    /// What was wrong with the first message that could not be read.
    #[must_use]
    pub fn first_fault(&self) -> Option<String> {
        lock(&self.shared).first_fault.clone()
    }

    /// Waits until the map stands elsewhere than at `known`, or `limit` is over; gives where it
    /// stands.
    #[must_use]
    pub fn wait_beyond(&self, known: Option<(u64, u64)>, limit: Duration) -> Option<(u64, u64)> {
        let still = |state: &mut State| state.assembler.position() == known;
        let waited = self
            .shared
            .changed
            .wait_timeout_while(lock(&self.shared), limit, still);
        let state = waited.unwrap_or_else(PoisonError::into_inner).0;
        state.assembler.position()
    }

    /// Waits until the map is final, and gives it.
    ///
    /// # Errors
    /// If that takes longer than `limit`.
    pub fn wait_final(&self, limit: Duration) -> Result<Arc<Snapshot>, MapWaitError> {
        let pending = |state: &mut State| !state.assembler.is_final();
        let waited = self
            .shared
            .changed
            .wait_timeout_while(lock(&self.shared), limit, pending);
        let mut state = waited.unwrap_or_else(PoisonError::into_inner).0;
        let is_final = state.assembler.is_final();
        let newest = state.newest().filter(|_| is_final);
        newest.ok_or(MapWaitError {
            limit,
            position: state.assembler.position(),
            liveliness: state.liveliness,
        })
    }
}

impl State {
    fn newest(&mut self) -> Option<Arc<Snapshot>> {
        if self.newest.is_none() {
            self.newest = self.assembler.to_snapshot().map(Arc::new);
        }
        self.newest.clone()
    }
}

impl Shared {
    /// Called by zenoh: never blocks.
    fn queue(&self, sample: Sample, samples: &Sender<Sample>) {
        self.messages_received.fetch_add(1, Ordering::Relaxed);
        let bytes = byte_count(&sample);
        let queued = self.queued_bytes.fetch_add(bytes, Ordering::Relaxed);
        let fits = queued.saturating_add(bytes) <= QUEUE_BYTES;
        if !fits || samples.try_send(sample).is_err() {
            self.queued_bytes.fetch_sub(bytes, Ordering::Relaxed);
            self.messages_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

fn byte_count(sample: &Sample) -> usize {
    sample.payload().len() + sample.attachment().map_or(0, zenoh::bytes::ZBytes::len)
}

/// Keeps the token's state; a token that came back may stand for another map.
fn watch_liveliness(
    link: &Arc<Link>,
    shared: &Arc<Shared>,
    returned: Sender<()>,
) -> Result<Subscriber<()>, BusError> {
    let shared = Arc::clone(shared);
    let on_sample = move |sample: Sample| {
        let mut state = lock(&shared);
        let is_back = state.liveliness == Liveliness::Gone && sample.kind() == SampleKind::Put;
        state.liveliness = match sample.kind() {
            SampleKind::Put => Liveliness::Alive,
            SampleKind::Delete => Liveliness::Gone,
        };
        if is_back {
            state.assembler.restart();
            state.newest = None;
        }
        shared.changed.notify_all();
        // Full means that it is about to be woken anyway.
        let _ = returned.try_send(());
    };
    let subscriber = link.session.liveliness();
    subscriber
        .declare_subscriber(link.keys.alive())
        .history(true)
        .callback(on_sample)
        .wait()
        .map_err(BusError::zenoh("watch the publisher's token"))
}

/// The thread that keeps the map.
struct Follower {
    link: Arc<Link>,
    shared: Arc<Shared>,
    collector: DeltaCollector,
    retry: Duration,
    last_heard: Instant,
    next_query: Instant,
}

impl Follower {
    fn run(mut self, samples: &Receiver<Sample>, returned: &Receiver<()>, stopped: &Receiver<()>) {
        let mut answer: Option<PendingAnswer> = None;
        let no_replies = never();
        loop {
            let wait = self.time_to_next_query(answer.is_some());
            if wait.is_zero() {
                answer = self.ask();
            }
            let replies = answer
                .as_ref()
                .map_or(&no_replies, |answer| &answer.replies);
            select! {
                recv(stopped) -> _ => return,
                recv(returned) -> _ => self.next_query = Instant::now(),
                recv(samples) -> sample => match sample {
                    Ok(sample) => self.take(&sample),
                    Err(_) => return,
                },
                recv(replies) -> reply => match reply {
                    Ok(reply) => self.collect(answer.as_mut(), &reply),
                    Err(_) => self.finish(answer.take()),
                },
                default(wait.max(MIN_RETRY / 10)) => {}
            }
        }
    }

    /// Zero when it is time to ask: a snapshot is needed, or nothing was heard for a while.
    fn time_to_next_query(&self, is_asking: bool) -> Duration {
        if is_asking {
            return MAX_RETRY;
        }
        let idle = Duration::from_secs_f64(self.link.config.idle_check_s);
        let due = match lock(&self.shared).assembler.needs_snapshot() {
            true => self.next_query,
            false => self.next_query.max(self.last_heard + idle),
        };
        due.saturating_duration_since(Instant::now())
    }

    fn ask(&mut self) -> Option<PendingAnswer> {
        // Doubles while nobody answers; an answer sets it back.
        self.next_query = Instant::now() + self.retry;
        self.retry = (self.retry * 2).min(MAX_RETRY);
        let request = {
            let mut state = lock(&self.shared);
            state.counters.queries += 1;
            state.assembler.request()
        };
        let selector = format!("{}?{}", self.link.keys.snapshot(), request.to_parameters());
        let (sender, replies) = bounded(REPLY_QUEUE_LEN);
        let asked = self
            .link
            .session
            .get(selector.trim_end_matches('?'))
            // All replies bear one key: consolidating them would keep one.
            .consolidation(ConsolidationMode::None)
            .congestion_control(CongestionControl::Block)
            // Below deltas, so that none is lost for an answer.
            .priority(Priority::Background)
            .timeout(Duration::from_secs_f64(self.link.config.query_timeout_s))
            .callback(move |reply| {
                // Fails once this side has stopped listening.
                let _ = sender.send(reply);
            })
            .wait();
        if let Err(error) = asked {
            tracing::debug!("map not asked for: {error}");
            return None;
        }
        Some(PendingAnswer {
            replies,
            collector: SnapshotCollector::new(self.link.config.max_gaussians),
        })
    }

    /// One delta message.
    fn take(&mut self, sample: &Sample) {
        let bytes = byte_count(sample);
        self.shared.queued_bytes.fetch_sub(bytes, Ordering::Relaxed);
        self.last_heard = Instant::now();
        let message = self.decode(sample);
        let completed = message.and_then(|message| self.collector.push(message));
        let mut state = lock(&self.shared);
        state.counters.deltas_incomplete = self.collector.incomplete_count();
        let Some((delta, is_final)) = completed else {
            return;
        };
        let progress = state.assembler.delta(delta, is_final);
        state.newest = None;
        if matches!(progress, Progress::Gap { .. } | Progress::NewEpoch { .. }) {
            tracing::debug!("map: {progress:?}");
            self.next_query = Instant::now();
            self.retry = MIN_RETRY;
        }
        self.shared.changed.notify_all();
    }

    fn decode(&self, sample: &Sample) -> Option<MapMessage> {
        let attachment = sample.attachment().map(zenoh::bytes::ZBytes::to_bytes);
        let attachment = attachment.unwrap_or_default();
        let message = MapMessage::decode(&sample.payload().to_bytes(), &attachment);
        let mut state = lock(&self.shared);
        state.counters.bytes_received += byte_count(sample) as u64;
        match message {
            Ok(message) => {
                state.counters.gaussians_unsound += message.unsound.len() as u64;
                let first = message.unsound.first().copied();
                state.first_unsound = state.first_unsound.or(first);
                Some(message)
            }
            Err(error) => {
                tracing::debug!("map message left out: {error}");
                state.counters.messages_malformed += 1;
                state.first_fault.get_or_insert_with(|| error.to_string());
                None
            }
        }
    }

    /// One message of the answer.
    fn collect(&self, answer: Option<&mut PendingAnswer>, reply: &Reply) {
        let message = match reply.result() {
            Ok(sample) => self.decode(sample),
            Err(error) => {
                let text = error.payload().to_bytes();
                let text: String = String::from_utf8_lossy(&text).chars().take(200).collect();
                tracing::debug!("map query refused: {text}");
                None
            }
        };
        if let (Some(answer), Some(message)) = (answer, message) {
            answer.collector.push(message);
        }
    }

    /// The query has ended, by answer or by time.
    fn finish(&mut self, answer: Option<PendingAnswer>) {
        let answer = answer.and_then(|answer| answer.collector.finish());
        let mut state = lock(&self.shared);
        let Some(answer) = answer else {
            state.counters.queries_failed += 1;
            return;
        };
        self.last_heard = Instant::now();
        self.retry = MIN_RETRY;
        state.newest = None;
        if state.assembler.snapshot(answer) == Progress::Unusable {
            self.next_query = Instant::now();
        }
        self.shared.changed.notify_all();
    }
}

/// A question that is being answered. Ends when zenoh drops the sender.
struct PendingAnswer {
    replies: Receiver<Reply>,
    collector: SnapshotCollector,
}
