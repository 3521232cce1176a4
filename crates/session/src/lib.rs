//! A conversation with one `OmniScan` 450, or with a log of one: bytes and time in; requests,
//! events and pings out.
//!
//! [`Session`] asks the device who it is and how to ping until profiles show that it heard, checks
//! what every profile means (not only its checksum), counts pings on across losses, wraps and
//! reboots, and puts each on the clock asked for. Used as a state machine: give it what came
//! ([`Session::receive`]) and what time it is ([`Session::handle_timeout`]); take what it wants
//! sent ([`Session::poll_transmit`]) and what happened ([`Session::poll_event`]).
//!
//! This crate deliberately has no sockets, no threads and no clock, and it does not reconnect:
//! whoever owns the link does, and tells it.

mod clock;
mod config;
mod continuity;
mod counters;
mod event;
mod handshake;
mod iso8601;
mod log_header;
mod profile;
mod seen;
mod session;
mod stream;
mod units;
mod words;

pub use config::{ClockSource, SessionConfig, SessionConfigError, Spreading};
pub use counters::{ProfilesRejected, SessionCounters};
pub use event::SessionEvent;
pub use session::Session;
pub use units::{UnitHeard, UnitLabel};
