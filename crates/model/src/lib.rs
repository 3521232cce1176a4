//! The vocabulary every part of `EchoSplat` shares: time, ping, pose, trajectory, gaussian, snapshot.
//!
//! Values only, checked where they are made so that they cannot be wrong later. This crate
//! deliberately has no sockets, no files, no clock, no threads and no mathematics of sound.
//!
//! Frames: the world is ENU (z up); vehicle and sensor are x forward, y left, z up (REP 103).
//! Units: SI and radians, named at the end of every field.

mod covariance;
mod gaussian;
mod ping;
mod pose;
mod rate_limit;
mod reason;
mod smoothing;
mod snapshot;
mod soundness;
mod switch;
mod time;
mod trajectory;

pub use covariance::PoseCovariance;
pub use gaussian::{Gaussian, GaussianId, Standing};
pub use ping::{MAX_BIN_COUNT, Ping, PingError, PingSettings, PosedPing};
pub use pose::{
    HALF_TURN_ABOUT_X, Pose, Twist, enu_from_flu, enu_from_ned, flu_from_flu, flu_from_frd,
};
pub use rate_limit::RateLimit;
pub use reason::{Reason, Unit, Why};
pub use smoothing::LEFT_OF_JITTER;
pub use snapshot::{Delta, Snapshot, TileKey};
pub use soundness::{
    INTENSITY_UNITS, MAX_ORIGIN_M, MAX_PLACE_M, MAX_REFLECTIVITY, SCALE_LIMITS_M, Unsound,
    is_origin,
};
pub use switch::Switch;
pub use time::Timestamp;
pub use trajectory::{
    LOOKAHEAD_S, PoseError, PoseLookupError, PoseUncertainty, StampedPose, Trajectory,
    TrajectoryLimits,
};

pub use glam;
