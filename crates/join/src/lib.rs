//! Which pose goes with which ping.
//!
//! [`PoseGuard`] follows one track of poses, and tells outliers and a second publisher from an
//! estimator that was reset; [`PoseJoin`] keeps pings waiting until the pose at their echo is known,
//! and gives each exactly one verdict: posed, or left out and why. What the covariances of poses mean for a ping is told
//! here too, from how they change.
//!
//! This crate deliberately has no sockets, no files and no clock: pings and poses come in as
//! arguments, each with the time that it arrived.

mod arrived;
mod compass;
mod covariance;
mod guard;
mod join;

pub use arrived::{ArrivedPose, StampClock};
pub use compass::CompassDeviation;
pub use covariance::{CovarianceCounters, CovarianceRule, Covariances};
pub use guard::{GuardReport, Guarded, PoseGuard};
pub use join::{
    JoinCounters, PoseJoin, PoseJoinConfig, PoseJoinError, RejectReason, RejectedPing, Verdict,
};
