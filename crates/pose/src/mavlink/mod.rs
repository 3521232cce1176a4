//! Poses from `MAVLink`: bytes or JSON in, poses out.
//!
//! [`vehicle::Vehicle`] knows neither sockets nor clocks; `run` feeds it from a link (UDP, TCP,
//! serial), from a server's JSON on the bus, or from a log.

pub(crate) mod clock;
pub(crate) mod frames;
pub(crate) mod json;
pub(crate) mod message;
pub(crate) mod requests;
pub(crate) mod run;
pub(crate) mod vehicle;

#[cfg(test)]
mod tests;
