//! What a map says of pings that were kept from it.
//!
//! [`MapRenderer`] renders what a ping measures, from anywhere; [`held_out`] says how likely that makes
//! what was measured, and so how good a map is without a truth; [`frame_check`] tells from pings
//! whether their poses can be what they are read as. The running service judges itself by these.
//!
//! Deliberately absent: a truth, a clock, files, and the map's own making.

pub mod agreement;
pub mod alignment;
pub mod frame_check;
pub mod held_out;
mod pairs;
mod rendering;

pub use pairs::{blank_bins, pair_of};
pub use rendering::MapRenderer;
