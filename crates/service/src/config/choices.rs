//! What some settings may be.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// Whether a dive is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Calibrate {
    /// Nothing is estimated.
    Off,
    /// What is found is told.
    #[default]
    Tell,
}

/// What a recording is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RecordFormat {
    /// Everything: replays by itself, read by Foxglove and Rerun
    #[default]
    Mcap,
    /// What ROS knows, for `rosbags` and `evo`: bytes, poses, map and frame, without settings and events
    Ros,
    /// The sonar's frames only, read by `SonarView` and `PINGVerter`
    Svlog,
    /// Both, side by side
    Both,
}
