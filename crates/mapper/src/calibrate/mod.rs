//! What is systematically wrong with poses and ranges: time offset, mount, compass and speed of sound, told by how
//! well the observations of landmarks of the map agree, and by how likely maps make pings that they were not made
//! of.
//!
//! The method is in `docs/develop/method.md`, section "Clock, mount, compass and sound". Nothing of it changes the map.

mod adjust;
mod landmarks;
pub(crate) mod linear;
mod moving;
mod parameters;
mod point;
pub(crate) mod sound;
mod sums;

pub(crate) use landmarks::{Landmarks, evenly, places};
pub(crate) use moving::{Moving, corrected, moving};
pub use parameters::{Calibration, Estimate};
pub(crate) use parameters::{Compass, Difference, RANGE, Step, Verdict};
