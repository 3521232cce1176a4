//! Satellite receivers: fixes, and headings where a receiver tells true ones. They say where on Earth poses count from, and are
//! none themselves: they lack an attitude, and end under water.
//!
//! [`GnssSource`] takes them live, as NMEA over UDP or from a topic of ROS 2; [`fixes_of_svlog`] and [`fixes_of_mcap`] read
//! those that a log holds. What they say is `echosplat_georeference`'s to work out.

mod fix_message;
mod log;
mod source;
mod url;

pub use log::{GnssLog, fixes_of_mcap, fixes_of_svlog};
pub use source::{GnssSource, GnssStatus};
pub use url::{GNSS_URL_FORMS, GnssUrl, GnssUrlError};
