//! How long what is left may take once the user asked for an end.

use std::time::{Duration, Instant};

use crate::signals::Stop;

/// The first Ctrl-C or SIGTERM ends a run within five seconds; what is done after mapping has the
/// rest of them.
const MAPPING: Duration = Duration::from_millis(2_500);
const ALL: Duration = Duration::from_millis(4_000);

/// When an end was asked for, if it was, and why the run cannot go on, if it cannot.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ending {
    asked: Option<Instant>,
    failure: Option<String>,
}

impl Ending {
    /// Of a run that cannot go on.
    pub(crate) fn of_failure(why: String) -> Self {
        let mut ending = Self::default();
        ending.fail(why);
        ending
    }

    /// To be called now and then.
    pub(crate) fn note(&mut self, stop: &Stop) {
        if self.asked.is_none() && stop.is_set() {
            self.asked = Some(Instant::now());
        }
    }

    /// A part that the run needs is gone: it ends as if somebody had asked for it.
    pub(crate) fn fail(&mut self, why: String) {
        self.asked.get_or_insert_with(Instant::now);
        self.failure.get_or_insert(why);
    }

    /// Why the run could not go on.
    pub(crate) fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    pub(crate) fn is_asked(&self) -> bool {
        self.asked.is_some()
    }

    /// Whether the mapper may be waited for no longer.
    pub(crate) fn is_mapping_overdue(&self) -> bool {
        self.asked.is_some_and(|asked| asked.elapsed() >= MAPPING)
    }

    /// `limit`, or less where an end was asked for.
    pub(crate) fn limited(&self, limit: Duration) -> Duration {
        match self.asked {
            Some(asked) => limit.min(ALL.saturating_sub(asked.elapsed())),
            None => limit,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_hurried_until_somebody_asks() {
        let mut ending = Ending::default();
        assert_eq!(ending.limited(Duration::from_secs(30)).as_secs(), 30);
        ending.asked = Instant::now().checked_sub(Duration::from_secs(3));
        assert!(ending.is_mapping_overdue());
        assert!(ending.limited(Duration::from_secs(30)) <= Duration::from_secs(1));
    }
}
