//! One stop for a task or a thread: a wait that ends when it comes.

use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use tokio_util::sync::CancellationToken;

/// Held by the task or the thread.
#[derive(Debug, Clone)]
pub(crate) struct Stop {
    asked: CancellationToken,
    abandoned: CancellationToken,
    /// Never carries anything: it disconnects when the [`Stopper`] is used or dropped.
    channel: Receiver<()>,
}

/// Held by the owner. Dropped, it stops the task or the thread too.
#[derive(Debug)]
pub(crate) struct Stopper {
    asked: CancellationToken,
    abandoned: CancellationToken,
    channel: Option<Sender<()>>,
}

pub(crate) fn stop_pair() -> (Stopper, Stop) {
    let (asked, abandoned) = (CancellationToken::new(), CancellationToken::new());
    let (sender, receiver) = bounded(0);
    let stopper = Stopper {
        asked: asked.clone(),
        abandoned: abandoned.clone(),
        channel: Some(sender),
    };
    let stop = Stop {
        asked,
        abandoned,
        channel: receiver,
    };
    (stopper, stop)
}

impl Stopper {
    pub(crate) fn stop(&mut self) {
        self.asked.cancel();
        self.channel = None;
    }

    /// Stops a link that hangs: should it ever go on, it must touch nothing any more, since another
    /// has its place. Its connection is ended: many devices serve one client at a time.
    pub(crate) fn abandon(&mut self) {
        self.abandoned.cancel();
        self.stop();
    }
}

impl Drop for Stopper {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Stop {
    pub(crate) fn is_set(&self) -> bool {
        self.asked.is_cancelled()
    }

    /// Until the stop comes.
    pub(crate) async fn asked(&self) {
        self.asked.cancelled().await;
    }

    /// Whether another has this one's place.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.abandoned.is_cancelled()
    }

    /// Cancelled when another has this one's place, for what it holds open.
    pub(crate) fn abandoned(&self) -> &CancellationToken {
        &self.abandoned
    }

    /// Disconnects when the stop comes; for `select!` of a thread.
    pub(crate) fn channel(&self) -> &Receiver<()> {
        &self.channel
    }

    /// A thread waits so long, or until the stop comes; says whether it has.
    pub(crate) fn wait(&self, duration: Duration) -> bool {
        // Only a disconnect ends it early: nothing is ever sent.
        let _ = self.channel.recv_timeout(duration);
        self.is_set()
    }
}
