//! The end of a source's thread: it comes when the source is dropped.

use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, bounded};

/// Held by the source; dropped, it ends the thread.
#[derive(Debug)]
pub(crate) struct Stopper(#[expect(dead_code, reason = "held for its end")] Sender<()>);

/// Held by the thread.
#[derive(Debug, Clone)]
pub(crate) struct Stop(Receiver<()>);

pub(crate) fn stop_pair() -> (Stopper, Stop) {
    let (sender, receiver) = bounded(0);
    (Stopper(sender), Stop(receiver))
}

impl Stop {
    pub(crate) fn is_set(&self) -> bool {
        self.0.try_recv() == Err(TryRecvError::Disconnected)
    }

    /// Waits so long, or until the end; says whether it came.
    pub(crate) fn wait(&self, limit: Duration) -> bool {
        self.0.recv_timeout(limit) == Err(RecvTimeoutError::Disconnected)
    }
}
