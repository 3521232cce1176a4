//! Holding what is replayed.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Holds a log or a recording where it is, and lets it go on; cheap to clone, all clones are one.
#[derive(Debug, Clone, Default)]
pub struct Pause(Arc<AtomicBool>);

impl Pause {
    /// Whether it is held.
    #[must_use]
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }

    /// Holds it, or lets it go on.
    pub fn set(&self, is_held: bool) {
        self.0.store(is_held, Ordering::Release);
    }
}

impl PartialEq for Pause {
    /// Whether both hold the same.
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}
