//! One stop for a thread: a wait that ends when it comes.

use std::net::{Shutdown, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};

/// The connection at hand, so that it can be ended by somebody else than the thread that reads it.
type Connection = Arc<Mutex<Option<TcpStream>>>;

/// Held by the thread.
#[derive(Debug, Clone)]
pub(crate) struct Stop {
    flag: Arc<AtomicBool>,
    abandoned: Arc<AtomicBool>,
    connection: Connection,
    /// Never carries anything: it disconnects when the [`Stopper`] is used or dropped.
    channel: Receiver<()>,
}

/// Held by the thread's owner. Dropped, it stops the thread too.
#[derive(Debug)]
pub(crate) struct Stopper {
    flag: Arc<AtomicBool>,
    abandoned: Arc<AtomicBool>,
    connection: Connection,
    channel: Option<Sender<()>>,
}

pub(crate) fn stop_pair() -> (Stopper, Stop) {
    let flag = Arc::new(AtomicBool::new(false));
    let abandoned = Arc::new(AtomicBool::new(false));
    let connection = Connection::default();
    let (sender, receiver) = bounded(0);
    let stopper = Stopper {
        flag: Arc::clone(&flag),
        abandoned: Arc::clone(&abandoned),
        connection: Arc::clone(&connection),
        channel: Some(sender),
    };
    let stop = Stop {
        flag,
        abandoned,
        connection,
        channel: receiver,
    };
    (stopper, stop)
}

impl Stopper {
    pub(crate) fn stop(&mut self) {
        self.flag.store(true, Ordering::Release);
        self.channel = None;
    }

    /// Stops a thread that hangs: should it ever go on, it must touch nothing any more, since
    /// another has its place. Its connection is ended: many devices serve one client at a time.
    pub(crate) fn abandon(&mut self) {
        self.abandoned.store(true, Ordering::Release);
        let connection = self.connection.lock();
        let connection = connection.unwrap_or_else(PoisonError::into_inner).take();
        if let Some(connection) = connection {
            // It may have ended by itself.
            let _ = connection.shutdown(Shutdown::Both);
        }
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
        self.flag.load(Ordering::Acquire)
    }

    /// The thread talks over this connection now, or over none that others can end.
    pub(crate) fn talks_over(&self, connection: Option<TcpStream>) {
        let talks_over = self.connection.lock();
        *talks_over.unwrap_or_else(PoisonError::into_inner) = connection;
    }

    /// Whether another thread has this one's place.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.abandoned.load(Ordering::Acquire)
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
