//! A run on two machines: the driver on the vehicle, which talks to the sonar, records and maps
//! nothing, and the mapper, which is given over zenoh all that the driver heard, in its order, and
//! makes of it the map that one process would have made.
//!
//! What goes between is the dive's tape, as a recording holds it: bytes of the sonar before they are
//! decoded, the link's news and poses, each with the vehicle's time and a number. So a mapper goes on
//! from a recording by reading that first, and then asking the driver for what follows.

mod begin;
mod dive_log;
mod driver;
mod resumed;
mod status;
mod tape;
mod waiting;

pub(crate) use begin::Begin;
pub(crate) use driver::Vehicle;
pub(crate) use resumed::Resumed;
pub(crate) use tape::{TapeReport, TapeState, VehicleTape};
