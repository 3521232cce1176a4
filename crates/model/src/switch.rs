//! Whether an optional part is at work.

use serde::{Deserialize, Serialize};

/// Whether a part is at work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Switch {
    /// Always.
    On,
    /// Never.
    Off,
    /// As what comes in asks for.
    #[default]
    Auto,
}
