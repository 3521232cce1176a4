//! What a log gives: poses in order, or why there are none.

use std::path::PathBuf;

use echosplat_join::ArrivedPose;

/// Why a log gives no poses.
#[derive(Debug, thiserror::Error)]
pub enum LogPosesError {
    /// It cannot be read.
    #[error("poses: cannot read {path}: {reason}", path = .path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },
    /// It is not what its name says, or damaged.
    #[error("poses: {path}: {reason}", path = .path.display())]
    Format {
        /// Which.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// There are none in it.
    #[error("{path} holds no poses: {reason}; give them with --poses F.tum", path = .path.display())]
    None {
        /// Which.
        path: PathBuf,
        /// What there is instead.
        reason: String,
    },
}

/// By time; of several of one time the first stays.
pub(super) fn in_order(mut poses: Vec<ArrivedPose>) -> Vec<ArrivedPose> {
    poses.sort_by_key(|pose| pose.pose.time);
    poses.dedup_by_key(|pose| pose.pose.time);
    poses
}
