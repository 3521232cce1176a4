//! How long what is left may take once the user asked for an end.

use std::time::{Duration, Instant};

use crate::signals::Stop;

/// Once an end was asked for, publishing the final map has so much longer than finishing it.
const PUBLISHING: Duration = Duration::from_millis(1_500);
/// A mapper of a run that cannot go on may never finish: it is waited for no longer than this.
const OF_FAILURE: Duration = Duration::from_millis(2_500);

/// When an end was asked for, if it was, and why the run cannot go on, if it cannot.
#[derive(Debug, Clone)]
pub(crate) struct Ending {
    /// How long the map may be finished once an end was asked for.
    finish_within: Duration,
    asked: Option<Instant>,
    failure: Option<String>,
}

impl Ending {
    /// Of a run that nobody has asked to end; from then on its map may be finished for so long.
    pub(crate) fn none(finish_within: Duration) -> Self {
        Self {
            finish_within,
            asked: None,
            failure: None,
        }
    }

    /// Of a run that cannot go on.
    pub(crate) fn of_failure(why: String) -> Self {
        let mut ending = Self::none(OF_FAILURE);
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
        self.finish_within = self.finish_within.min(OF_FAILURE);
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
        let asked = self.asked;
        asked.is_some_and(|asked| asked.elapsed() >= self.finish_within)
    }

    /// `limit`, or less where an end was asked for.
    pub(crate) fn limited(&self, limit: Duration) -> Duration {
        match self.asked {
            Some(asked) => {
                let all = self.finish_within + PUBLISHING;
                limit.min(all.saturating_sub(asked.elapsed()))
            }
            None => limit,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_hurried_until_somebody_asks() {
        let long = Duration::from_secs(30);
        let mut ending = Ending::none(Duration::from_millis(2_500));
        assert_eq!(ending.limited(long), long);
        ending.asked = Instant::now().checked_sub(Duration::from_secs(3));
        assert!(ending.is_mapping_overdue());
        assert!(ending.limited(long) <= Duration::from_secs(1));
        ending.finish_within = long;
        assert!(!ending.is_mapping_overdue());
        assert!(ending.limited(long) > Duration::from_secs(20));
        ending.fail("no disk".to_owned());
        assert!(ending.is_mapping_overdue());
    }
}
