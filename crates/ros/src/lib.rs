//! CDR, the byte layout of ROS 2, and the few messages that recordings and the bus share.
//!
//! Values and bytes only: no node, no middleware, no package of ROS. [`definitions`] holds the
//! messages' texts, by which other programs decode them; [`rmw_zenoh`] what the middleware of ROS 2
//! on zenoh writes beside them.

mod cdr;
pub mod definitions;
mod header;
mod nav_sat_fix;
pub mod odometry;
pub mod point_cloud2;
pub mod rmw_zenoh;
pub mod transform;

pub use cdr::{CdrError, CdrReader, CdrWriter};
pub use header::{Header, MAX_FRAME_ID_BYTES};
pub use nav_sat_fix::{COVARIANCE_UNKNOWN, NavSatFix};
