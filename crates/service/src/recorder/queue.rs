//! What waits to be written: bounded in bytes, never waited for by those who put something in.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use echosplat_model::Timestamp;
use echosplat_recording::mcap::Record;

/// Most bytes that wait: at 58 pings/s of 600 bins, 100 poses/s and a map that changes at 4 Mbit/s
/// more than a minute of a full disk, at a size that a small companion computer spares.
pub(super) const MAX_QUEUED_BYTES: usize = 64 << 20;
/// What a record takes beside its bytes.
const OVERHEAD_BYTES: usize = 160;

/// The queue. Drop policy: what finds no room is left out and counted.
#[derive(Default)]
pub(super) struct Queue {
    state: Mutex<State>,
    news: Condvar,
}

#[derive(Default)]
struct State {
    records: VecDeque<(Timestamp, Record, usize)>,
    byte_count: usize,
    dropped_count: u64,
    closed: Option<Instant>,
}

/// What came out of the queue.
pub(super) enum Popped {
    Record(Timestamp, Record),
    /// Nothing within the limit.
    Nothing,
    /// Nothing, and nothing will come.
    Closed,
}

impl Queue {
    pub(super) fn push(&self, host_time: Timestamp, record: Record) {
        let size = size_of(&record);
        let mut state = self.lock();
        if state.closed.is_some() || state.byte_count + size > MAX_QUEUED_BYTES {
            state.dropped_count += 1;
            return;
        }
        state.byte_count += size;
        state.records.push_back((host_time, record, size));
        drop(state);
        self.news.notify_all();
    }

    /// The oldest, waiting for one at most so long.
    pub(super) fn pop(&self, limit: Duration) -> Popped {
        let state = self.lock();
        let is_idle = |state: &mut State| state.records.is_empty() && state.closed.is_none();
        let waited = self.news.wait_timeout_while(state, limit, is_idle);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        match state.records.pop_front() {
            Some((host_time, record, size)) => {
                state.byte_count -= size;
                Popped::Record(host_time, record)
            }
            None if state.closed.is_some() => Popped::Closed,
            None => Popped::Nothing,
        }
    }

    /// Waits, or until it is closed; since when it is.
    pub(super) fn wait_closed(&self, limit: Duration) -> Option<Instant> {
        let state = self.lock();
        let is_open = |state: &mut State| state.closed.is_none();
        let waited = self.news.wait_timeout_while(state, limit, is_open);
        waited.unwrap_or_else(PoisonError::into_inner).0.closed
    }

    /// Nothing is taken in any more.
    pub(super) fn close(&self) {
        self.lock().closed.get_or_insert_with(Instant::now);
        self.news.notify_all();
    }

    /// Lets go of all that waits, counted as dropped.
    pub(super) fn give_up(&self) {
        let mut state = self.lock();
        state.dropped_count += state.records.len() as u64;
        state.records.clear();
        state.byte_count = 0;
    }

    /// Bytes that wait, and how many records found no room.
    pub(super) fn state(&self) -> (u64, u64) {
        let state = self.lock();
        (state.byte_count as u64, state.dropped_count)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Bytes that a record takes in memory, and no less than on a disk.
pub(super) fn size_of(record: &Record) -> usize {
    let bytes = match record {
        // Pieces of one buffer share it, and together take little more than their bytes.
        Record::Raw(bytes) => bytes.len(),
        Record::StaticTransform(bytes) => bytes.len(),
        Record::Delta { cloud, info } => cloud.len() + info.len(),
        Record::Settings(text) => text.len(),
        // A tree of values takes several times its text.
        Record::Event(value) | Record::Status(value) => 4 * value.to_string().len(),
        Record::LinkUp | Record::LinkDown | Record::HalfFrameExpired | Record::Pose(_) => 0,
    };
    bytes + OVERHEAD_BYTES
}
