//! Poses from `MAVLink`: bytes or JSON in, poses out.
//!
//! [`fleet::Fleet`] and the [`vehicle::Vehicle`]s in it know neither sockets nor clocks; `run` feeds them from a link
//! (UDP, TCP, serial), from a server on the bus, or from a log.

pub(crate) mod beside;
pub(crate) mod clock;
pub(crate) mod fleet;
pub(crate) mod frames;
pub(crate) mod json;
pub(crate) mod message;
pub(crate) mod odometry;
pub(crate) mod order;
pub(crate) mod origin;
pub(crate) mod over_bus;
pub(crate) mod reckoning;
pub(crate) mod requests;
pub(crate) mod run;
pub(crate) mod told;
pub(crate) mod vehicle;

#[cfg(test)]
mod fleet_tests;
#[cfg(test)]
mod order_tests;
#[cfg(test)]
mod reckoning_tests;
#[cfg(test)]
mod tests;
