//! What a driver hears, for a mapper on another machine: the bytes of the sonar, the link's news and
//! the poses, in one numbered order.
//!
//! The driver keeps the newest records, bounded in bytes ([`TapeKeeper`]); a mapper asks for what
//! follows the last one that it has ([`TapeFollower`]), and the driver answers once there is
//! something. So one mechanism carries what is new, what was missed while the link was away, and
//! what came before the mapper was started; whoever is slow asks less often, and the driver waits
//! for nobody. A record is lost only when it is older than what the driver keeps, and both ends
//! count that.

mod follower;
mod keeper;
mod message;
mod trouble;

pub use follower::{Heard, TapeFollower, TapeFollowerCounters};
pub use keeper::{TapeKeeper, TapeKeeperCounters};
pub use message::{TapeEntry, TapeMessageError, TapeRecord};
pub use trouble::TapeTrouble;

#[cfg(test)]
mod tests;
