//! Who is told that a long step goes on.

use std::fmt;
use std::sync::Arc;

/// Called from any of the mapper's threads.
#[derive(Clone, Default)]
pub(crate) struct Progress(Option<Arc<dyn Fn() + Send + Sync>>);

impl Progress {
    pub(crate) fn told_to(tell: impl Fn() + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(tell)))
    }

    pub(crate) fn tell(&self) {
        if let Some(tell) = &self.0 {
            tell();
        }
    }
}

impl fmt::Debug for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Progress").field(&self.0.is_some()).finish()
    }
}
