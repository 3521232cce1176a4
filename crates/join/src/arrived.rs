//! A pose, when it came, and whose clock the pings are on.

use echosplat_model::{StampedPose, Timestamp};

/// A pose and when it arrived on this host (Unix time).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArrivedPose {
    /// Stamped on the clock of the pings, as well as the source allows.
    pub pose: StampedPose,
    /// Of a pose from a file: its own stamp.
    pub arrived: Timestamp,
}

impl ArrivedPose {
    /// Of a pose from a file.
    #[must_use]
    pub fn at_its_stamp(pose: StampedPose) -> Self {
        let arrived = pose.time;
        Self { pose, arrived }
    }
}

/// Which clock the pings are on. Only sources that stamp with a clock since power-up ask.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StampClock {
    /// This host's: a real sonar. The source's clock is mapped to it.
    #[default]
    Host,
    /// The data's own: simulated or replayed. Stamps are taken as they are, or on the Unix time
    /// that the source itself gives for its clock.
    Data,
}
