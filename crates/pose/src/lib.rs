//! Where poses come from, and which pose goes with which ping.
//!
//! [`PoseSource`] yields poses from what a [`PoseUrl`] names: the bus, `MAVLink` over UDP, TCP, a
//! serial line or a server on the bus, a Water Linked DVL, or a TUM file; [`poses_of_svlog`] and
//! [`poses_of_mcap`] read those that a log holds. Each source turns what it hears into the frames
//! of this program and, where it stamps with a clock of its own, puts the stamps on the pings'
//! clock. [`PoseJoin`], which does no input or output, keeps pings waiting until the pose at their
//! echo is known, and gives each exactly one verdict: posed, or left out and why.
//!
//! Deliberately absent: any guess at a pose (a position is moved by its own velocity for half a
//! second at most). Sources do not judge whether poses make sense: [`PoseGuard`] does, between them
//! and the join.

mod advance;
mod arrived;
mod clock;
mod dvl;
mod fault;
mod guard;
mod join;
mod link;
mod log;
mod mavlink;
mod outlet;
mod source;
mod status;
mod stop;
mod url;

pub use arrived::{ArrivedPose, StampClock};
pub use guard::{GuardReport, Guarded, PoseGuard};
pub use join::{
    JoinCounters, PoseJoin, PoseJoinConfig, PoseJoinError, RejectReason, RejectedPing, Verdict,
};
pub use log::{LogPosesError, poses_of_mcap, poses_of_svlog};
pub use source::{LivePoses, PoseSource, PoseSourceError};
pub use status::PoseSourceStatus;
pub use url::{POSE_URL_FORMS, PoseUrl, PoseUrlError};
