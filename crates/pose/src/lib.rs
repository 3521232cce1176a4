//! Where poses come from, and which pose goes with which ping.
//!
//! [`PoseSource`] yields poses from a TUM file or from the bus, chosen by a [`PoseUrl`];
//! [`PoseJoin`], which does no input or output, keeps pings waiting until the pose at their echo
//! is known, and gives each exactly one verdict: posed, or left out and why.
//!
//! Deliberately absent: extrapolation, any guess at a pose, `MAVLink` and DVL.

mod join;
mod source;
mod url;

pub use join::{JoinCounters, PoseJoin, PoseJoinConfig, PoseJoinError, RejectReason, RejectedPing};
pub use source::{PoseSource, PoseSourceError};
pub use url::{PoseUrl, PoseUrlError};
