//! What a bench asks for.

use std::path::PathBuf;

use crate::runs::Spec;

/// A run to be made.
#[derive(Debug, Clone)]
pub(in crate::commands) struct Job {
    pub(in crate::commands) spec: Spec,
    /// Where its map is to be kept.
    pub(in crate::commands) map: Option<PathBuf>,
}
