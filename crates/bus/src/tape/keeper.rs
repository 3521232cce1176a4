//! The driver's side: keeps the newest records and answers who asks for them.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use echosplat_liveness::Heartbeat;
use echosplat_model::Timestamp;
use serde::Serialize;
use serde_json::Value;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::query::{Query, Queryable};

use super::message::{self, Head, TapeEntry, TapeRecord};
use crate::BusError;
use crate::bus::{Link, spawn};

/// Queries that wait; beyond that the newest goes unanswered and is asked again.
const QUERY_QUEUE_LEN: usize = 16;
/// What comes within so long goes out as one answer.
const GATHERED: Duration = Duration::from_millis(20);
/// A query that nothing came for is answered after so long, so that whoever asks knows that the
/// driver is there.
const HELD: Duration = Duration::from_millis(500);
/// How often it is said that mappers ask for what is gone.
const MISSED_TOLD_EVERY: Duration = Duration::from_secs(10);
/// What a record costs beside its bytes.
const RECORD_OVERHEAD_BYTES: usize = 48;
/// A longer piece of bytes becomes several records.
const MAX_PIECE_BYTES: usize = 32 << 10;
/// Room in a message for what stands beside the records.
const HEAD_BYTES: usize = 2048;

/// What became of the records.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct TapeKeeperCounters {
    /// Number of the oldest record that is kept.
    pub oldest: u64,
    /// Number that the next record gets.
    pub next: u64,
    /// Bytes that the records kept take.
    pub kept_bytes: u64,
    /// Number that a mapper asked for last: it has all before.
    pub taken_through: u64,
    /// Records that a mapper asked for and that were no longer kept.
    pub missed: u64,
    /// Answers given to zenoh.
    pub answers: u64,
    /// Answers that zenoh refused, or that could not be asked for in such words.
    pub answers_failed: u64,
    /// Queries let go since too many waited.
    pub queries_dropped: u64,
    /// Seconds since a mapper last asked.
    pub since_asked_s: Option<f64>,
}

/// Keeps the newest records of a driver, on a thread of its own that answers.
#[derive(Debug)]
pub struct TapeKeeper {
    shared: Arc<Shared>,
    heartbeat: Heartbeat,
    _queryable: Queryable<()>,
}

#[derive(Debug)]
struct Shared {
    driver: u64,
    begin: Value,
    /// Longest piece of bytes that becomes one record.
    piece_bytes: usize,
    kept: Mutex<Kept>,
}

#[derive(Debug)]
struct Kept {
    /// Encoded, in order.
    records: VecDeque<Vec<u8>>,
    limit_bytes: usize,
    bytes: usize,
    counters: TapeKeeperCounters,
    asked: Option<Instant>,
    missed_told: Option<Instant>,
}

impl Kept {
    fn push(&mut self, record: &TapeRecord) {
        let encoded = message::encode(record);
        self.bytes += encoded.len() + RECORD_OVERHEAD_BYTES;
        self.records.push_back(encoded);
        self.counters.next += 1;
        while self.bytes > self.limit_bytes
            && let Some(oldest) = self.records.pop_front()
        {
            self.bytes -= oldest.len() + RECORD_OVERHEAD_BYTES;
            self.counters.oldest += 1;
        }
    }

    /// Records from `from` on, as many as `limit_bytes` hold, and the number of the first.
    fn select(&self, from: u64, limit_bytes: usize) -> (u64, u64, Vec<u8>) {
        let first = from.clamp(self.counters.oldest, self.counters.next);
        let skipped = usize::try_from(first - self.counters.oldest).unwrap_or(usize::MAX);
        let (mut payload, mut count) = (Vec::new(), 0);
        for record in self.records.iter().skip(skipped) {
            if payload.len() + record.len() > limit_bytes {
                break;
            }
            payload.extend_from_slice(record);
            count += 1;
        }
        (first, count, payload)
    }

    /// A mapper that asks again and again for what is gone fills no log.
    fn tell_of_missing(&mut self, from: u64, first: u64) {
        let is_due = |told: Instant| told.elapsed() >= MISSED_TOLD_EVERY;
        if first > from && self.missed_told.is_none_or(is_due) {
            self.missed_told = Some(Instant::now());
            tracing::warn!(
                "a mapper asks for record {from}, and the oldest that is kept is {first}: {} records \
                 are missing on its map, {} in all that mappers asked for so far; --resume it from \
                 this driver's recording, or give bus.history_bytes more room",
                first - from,
                self.counters.missed
            );
        }
    }

    /// Bytes that whoever has all before `from` lacks, counted no further than `enough`.
    fn lacking(&self, from: u64, enough: usize) -> usize {
        let newer = self.counters.next.saturating_sub(from);
        let newer = usize::try_from(newer).unwrap_or(usize::MAX);
        let mut bytes = 0;
        for record in self.records.iter().rev().take(newer) {
            bytes += record.len();
            if bytes >= enough {
                break;
            }
        }
        bytes
    }
}

impl TapeKeeper {
    /// `driver` names this run; no two that a mapper may meet have the same. `begin` is told to
    /// every mapper before anything else.
    pub(crate) fn start(link: &Arc<Link>, driver: u64, begin: Value) -> Result<Self, BusError> {
        let message_bytes = link.config.max_message_bytes;
        let shared = Arc::new(Shared {
            driver,
            begin,
            piece_bytes: MAX_PIECE_BYTES.min(message_bytes / 4),
            kept: Mutex::new(Kept {
                records: VecDeque::new(),
                limit_bytes: link.config.history_bytes,
                bytes: 0,
                counters: TapeKeeperCounters::default(),
                asked: None,
                missed_told: None,
            }),
        });
        let heartbeat = Heartbeat::new("bus-tape");
        let (sender, queries) = bounded(QUERY_QUEUE_LEN);
        let in_callback = Arc::clone(&shared);
        let queryable = link
            .session
            .declare_queryable(link.keys.tape())
            .callback(move |query| {
                if sender.try_send(query).is_err() {
                    in_callback.lock().counters.queries_dropped += 1;
                }
            })
            .wait()
            .map_err(BusError::zenoh("offer the driver's tape"))?;
        let thread = Answers {
            shared: Arc::clone(&shared),
            key: link.keys.tape(),
            limit_bytes: message_bytes.saturating_sub(HEAD_BYTES),
            heartbeat: heartbeat.clone(),
        };
        let beats = heartbeat.clone();
        spawn("bus-tape", move || beats.run_again(|| thread.run(&queries)))?;
        Ok(Self {
            shared,
            heartbeat,
            _queryable: queryable,
        })
    }

    /// Keeps a record, in the place of the oldest where there is no room. Waits for nobody. Gives
    /// the number that the next one gets.
    pub fn append(&self, host_time: Timestamp, entry: TapeEntry) -> u64 {
        let mut kept = self.shared.lock();
        match entry {
            TapeEntry::Bytes(bytes) => {
                for piece in self.pieces(&bytes) {
                    let entry = TapeEntry::Bytes(piece);
                    kept.push(&TapeRecord { host_time, entry });
                }
            }
            entry => kept.push(&TapeRecord { host_time, entry }),
        }
        kept.counters.next
    }

    /// The bytes as [`TapeKeeper::append`] keeps them, each piece as one record that an answer has
    /// room for.
    pub fn pieces(&self, bytes: &Bytes) -> impl Iterator<Item = Bytes> + use<> {
        let (bytes, piece_bytes) = (bytes.clone(), self.shared.piece_bytes);
        (0..bytes.len()).step_by(piece_bytes).map(move |begin| {
            let end = bytes.len().min(begin + piece_bytes);
            bytes.slice(begin..end)
        })
    }

    /// What became of the records.
    #[must_use]
    pub fn counters(&self) -> TapeKeeperCounters {
        let kept = self.shared.lock();
        TapeKeeperCounters {
            kept_bytes: kept.bytes as u64,
            since_asked_s: kept.asked.map(|asked| asked.elapsed().as_secs_f64()),
            ..kept.counters
        }
    }

    /// Whether the thread that answers is alive; it goes on after a panic.
    #[must_use]
    pub fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// Waits until a mapper has everything, or none has asked for `silence`, or `limit` is over.
    /// Says whether one has everything.
    #[must_use]
    pub fn wait_taken(&self, silence: Duration, limit: Duration) -> bool {
        let begin = Instant::now();
        loop {
            let counters = self.counters();
            if counters.taken_through >= counters.next {
                return true;
            }
            let silent_s = counters.since_asked_s.unwrap_or(f64::INFINITY);
            if silent_s > silence.as_secs_f64() || begin.elapsed() > limit {
                return false;
            }
            std::thread::sleep(GATHERED);
        }
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Somebody who waits for the records from a number on.
struct Waiting {
    query: Query,
    /// It knows this driver.
    is_known: bool,
    from: u64,
    since: Instant,
}

struct Answers {
    shared: Arc<Shared>,
    key: String,
    limit_bytes: usize,
    heartbeat: Heartbeat,
}

impl Answers {
    /// Ends with the queryable, whose callback holds the other end of the queue.
    fn run(&self, queries: &Receiver<Query>) {
        let mut waiting: VecDeque<Waiting> = VecDeque::new();
        loop {
            self.heartbeat.rest();
            let asked = match waiting.is_empty() {
                true => queries.recv().map_err(|_| RecvTimeoutError::Disconnected),
                false => queries.recv_timeout(GATHERED),
            };
            self.heartbeat.beat();
            match asked {
                Ok(query) => {
                    waiting.extend(self.read(query));
                    // A mapper that is behind need not wait for more to come together.
                    self.answer(&mut waiting, self.limit_bytes / 2);
                    if waiting.len() > QUERY_QUEUE_LEN {
                        waiting.pop_front();
                        self.shared.lock().counters.queries_dropped += 1;
                    }
                }
                Err(RecvTimeoutError::Timeout) => self.answer(&mut waiting, 1),
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn read(&self, query: Query) -> Option<Waiting> {
        let parameters = query.parameters();
        let number = |name| match parameters.get(name) {
            None => Ok(None),
            Some(text) => text.parse::<u64>().map(Some).map_err(|_| {
                format!("`{name}` is `{text}`; it must be a whole number, as in driver=1;from=0")
            }),
        };
        let read = number("driver").and_then(|driver| Ok((driver, number("from")?)));
        let (driver, from) = match read {
            Ok(read) => read,
            Err(words) => {
                self.shared.lock().counters.answers_failed += 1;
                // Whoever asked may have gone.
                let _ = query.reply_err(words).wait();
                return None;
            }
        };
        let is_known = driver == Some(self.shared.driver);
        let from = from.filter(|_| is_known).unwrap_or(0);
        let mut kept = self.shared.lock();
        kept.asked = Some(Instant::now());
        kept.counters.taken_through = kept.counters.taken_through.max(from);
        drop(kept);
        Some(Waiting {
            query,
            is_known,
            from,
            since: Instant::now(),
        })
    }

    /// Those who do not know the driver, lack so many bytes, or have waited long.
    fn answer(&self, waiting: &mut VecDeque<Waiting>, enough_bytes: usize) {
        for _ in 0..waiting.len() {
            let Some(who) = waiting.pop_front() else {
                return;
            };
            let lacks = self.shared.lock().lacking(who.from, enough_bytes);
            let is_due = !who.is_known || lacks >= enough_bytes || who.since.elapsed() >= HELD;
            match is_due {
                true => self.reply(&who),
                false => waiting.push_back(who),
            }
        }
    }

    /// Replies take the congestion control of the query, Block from our own follower: a slow link
    /// holds up this thread, and nobody else.
    fn reply(&self, who: &Waiting) {
        let (head, payload) = {
            let mut kept = self.shared.lock();
            let (first, count, payload) = kept.select(who.from, self.limit_bytes);
            kept.counters.missed += first.saturating_sub(who.from);
            let begin = (!who.is_known).then(|| self.shared.begin.clone());
            let next = kept.counters.next;
            kept.tell_of_missing(who.from, first);
            (
                Head::new(self.shared.driver, (first, count), next, begin),
                payload,
            )
        };
        let attachment = serde_json::to_vec(&head).unwrap_or_default();
        let sent = who
            .query
            .reply(self.key.clone(), payload)
            .encoding(Encoding::APPLICATION_OCTET_STREAM)
            .attachment(attachment)
            .wait();
        let counters = &mut self.shared.lock().counters;
        match sent {
            Ok(()) => counters.answers += 1,
            Err(_) => counters.answers_failed += 1,
        }
    }
}
