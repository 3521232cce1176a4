//! One stop for a thread: a wait that ends when it comes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};

/// Held by the thread.
#[derive(Debug, Clone)]
pub(crate) struct Stop {
    flag: Arc<AtomicBool>,
    /// Never carries anything: it disconnects when the [`Stopper`] is used or dropped.
    channel: Receiver<()>,
}

/// Held by the thread's owner. Dropped, it stops the thread too.
#[derive(Debug)]
pub(crate) struct Stopper {
    flag: Arc<AtomicBool>,
    channel: Option<Sender<()>>,
}

pub(crate) fn stop_pair() -> (Stopper, Stop) {
    let flag = Arc::new(AtomicBool::new(false));
    let (sender, receiver) = bounded(0);
    let stopper = Stopper {
        flag: Arc::clone(&flag),
        channel: Some(sender),
    };
    let stop = Stop {
        flag,
        channel: receiver,
    };
    (stopper, stop)
}

impl Stopper {
    pub(crate) fn stop(&mut self) {
        self.flag.store(true, Ordering::Release);
        self.channel = None;
    }
}

impl Drop for Stopper {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Stop {
    pub(crate) fn is_set(&self) -> bool {
        self.flag.load(Ordering::Acquire)
    }

    /// Disconnects when the stop comes; for `select!`.
    pub(crate) fn channel(&self) -> &Receiver<()> {
        &self.channel
    }

    /// Waits so long, or until the stop comes; says whether it has.
    pub(crate) fn wait(&self, duration: Duration) -> bool {
        // Only a disconnect ends it early: nothing is ever sent.
        let _ = self.channel.recv_timeout(duration);
        self.is_set()
    }
}
