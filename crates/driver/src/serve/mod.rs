//! The other end of the link: an emulated device for any Ping client.
//!
//! Ping state is shared among all clients, as on a real unit: whoever asks starts and stops it for
//! all, answers go to the asker, profiles to everyone.

mod client;
mod clock;
mod listen;
mod outbox;
mod port;
#[cfg(unix)]
mod pty;
mod serial;
mod server;
mod simulated;
mod tcp;
mod udp;

use std::io;

use echosplat_model::Timestamp;
use serde::Serialize;

pub use listen::ListenUrl;
pub use server::{Server, serve};

/// A device that answers requests and makes profiles on its own clock, without sockets or time.
pub trait EmulatedDevice: Send {
    /// Handles one whole request frame at device time `now`; appends its answers to `out`.
    fn receive(&mut self, bytes: &[u8], now: Timestamp, out: &mut Vec<u8>);

    /// Device time at which the next frame is due unasked; `None` while not pinging.
    fn next_due(&self) -> Option<Timestamp>;

    /// Device time of the next profile; `None` while not pinging. The device's clock begins at 0,
    /// runs while there is one and stands while there is none.
    fn next_ping_due(&self) -> Option<Timestamp> {
        self.next_due()
    }

    /// Appends the frames due next to `out` and goes on to those after; of a lost ping, nothing.
    fn transmit(&mut self, out: &mut Vec<u8>);

    /// Called every few milliseconds, with the number of clients there were so far: for what goes
    /// along with the device. Must not wait.
    fn go_along(&mut self, _clients_seen: u64) {}

    /// Whether it has nothing more to send until it is stopped and started again.
    fn is_finished(&self) -> bool {
        false
    }
}

/// How a device is served.
#[derive(Debug, Clone, Copy, Default)]
pub struct ServeOptions {
    /// Times real time. 0 is as fast as the slowest client takes it (over UDP, which tells
    /// nothing, as fast as the socket does); above 0 a slow client loses whole profiles.
    pub rate: f64,
}

/// What a server has done, latest value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct ServeStatus {
    /// Clients now.
    pub clients: u64,
    /// Clients ever.
    pub clients_seen: u64,
    /// Intact request frames of all clients.
    pub requests: u64,
    /// Profiles the device made.
    pub pings: u64,
    /// Whether the device is pinging; false before it is asked to, after it is told to stop, and
    /// when it is finished.
    pub is_pinging: bool,
    /// Whether the device has nothing more to send, as at the end of a dive.
    pub is_finished: bool,
    /// Frames handed to clients.
    pub frames_sent: u64,
    /// Frames left out whole because a client was too slow.
    pub frames_dropped: u64,
}

/// Why a device cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address is taken.
    #[error("{url} is already in use: stop the other program or choose another port")]
    InUse {
        /// What was to be listened on.
        url: String,
    },
    /// The address cannot be listened on.
    #[error("{url} cannot be listened on: {source}")]
    Listen {
        /// What was to be listened on.
        url: String,
        /// What the system says.
        source: io::Error,
    },
    /// The rate is not a factor.
    #[error("rate is {0}; it must be 0 (as fast as possible) or more")]
    Rate(f64),
    /// The system gives no thread.
    #[error("the thread for the emulated device could not be started: {0}")]
    Thread(io::Error),
}
