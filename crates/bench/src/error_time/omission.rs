//! What a bench did not run.

use serde::Serialize;

/// What was not run, and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Omission {
    /// In words.
    pub(crate) what: String,
    /// In words.
    pub(crate) why: String,
}

impl Omission {
    /// From words.
    #[must_use]
    pub(crate) fn new(what: impl Into<String>, why: impl Into<String>) -> Self {
        Self {
            what: what.into(),
            why: why.into(),
        }
    }
}
