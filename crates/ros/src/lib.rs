//! CDR, the byte layout of ROS 2, and the few messages that recordings and the bus share.
//!
//! Values and bytes only: no node, no middleware, no package of ROS. [`definitions`] holds the
//! messages' texts, by which other programs decode them.

mod cdr;
pub mod definitions;
mod header;
pub mod odometry;

pub use cdr::{CdrError, CdrReader, CdrWriter};
pub use header::{Header, MAX_FRAME_ID_BYTES};
