//! What the thread that writes has done, for those who ask.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::RecorderCounters;

/// What the thread has done, for those who ask.
#[derive(Default)]
pub(super) struct Progress {
    state: Mutex<State>,
    ended: Condvar,
}

#[derive(Default)]
pub(super) struct State {
    pub(super) counters: RecorderCounters,
    pub(super) write_fault: Option<String>,
    sync_fault: Option<String>,
    /// Records written when the files were last seen.
    pub(super) seen_messages: u64,
    has_ended: bool,
}

impl Progress {
    pub(super) fn counters(&self) -> RecorderCounters {
        self.lock().counters
    }

    pub(super) fn fault(&self) -> Option<String> {
        let state = self.lock();
        state
            .write_fault
            .clone()
            .or_else(|| state.sync_fault.clone())
    }

    pub(super) fn seen(&self, messages: u64) {
        self.lock().seen_messages = messages;
    }

    /// The outcome of a sync; told when it changes.
    pub(super) fn synced(&self, failed: Option<String>) {
        let fault = failed.map(|error| {
            format!(
                "the recording is written but may not survive a power cut: {error}; check the disk"
            )
        });
        let before = std::mem::replace(&mut self.lock().sync_fault, fault.clone());
        match (before, fault) {
            (None, Some(fault)) => tracing::error!("{fault}"),
            (Some(_), None) => tracing::warn!("the recording survives a power cut again"),
            _ => {}
        }
    }

    /// Whether the thread ended within the limit.
    pub(super) fn wait_ended(&self, limit: Duration) -> bool {
        let waiting = |state: &mut State| !state.has_ended;
        let waited = self.ended.wait_timeout_while(self.lock(), limit, waiting);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.has_ended
    }

    pub(super) fn end(&self) {
        self.lock().has_ended = true;
        self.ended.notify_all();
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
