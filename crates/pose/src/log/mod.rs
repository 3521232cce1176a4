//! Poses inside logs: `MAVLink` in wrapper packets of a `.svlog`, pose messages in a foreign MCAP.

mod found;
mod mcap;
mod svlog;

pub use self::found::LogPosesError;
pub use self::mcap::poses_of_mcap;
pub use self::svlog::poses_of_svlog;
