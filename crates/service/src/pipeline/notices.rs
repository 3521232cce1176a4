//! What is wrong while it is: told once in a sentence that says what to do, kept in the status, and
//! told again when it is over.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use serde::Serialize;

/// A condition is over when it has not been found for so long.
const OVER_AFTER: Duration = Duration::from_millis(1500);

/// Something found wrong at one moment.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Finding {
    /// Names the condition; the same word in status and documents.
    pub(crate) code: Cow<'static, str>,
    /// What is wrong and what to do, one sentence.
    pub(crate) sentence: String,
    /// Whether the map or the recording lacks something for it: exit code 3.
    pub(crate) is_loss: bool,
}

/// A condition that stands, or stood.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Notice {
    pub(crate) code: Cow<'static, str>,
    pub(crate) sentence: String,
    /// Seconds since the start of the run when it was first told.
    pub(crate) since_s: f64,
    /// When it was over, likewise; `null` while it stands.
    pub(crate) until_s: Option<f64>,
    /// Times it was told.
    pub(crate) count: u64,
    pub(crate) is_loss: bool,
    #[serde(skip)]
    seen: Instant,
}

/// All conditions of a run, by code.
#[derive(Debug)]
pub(crate) struct Notices {
    begin: Instant,
    all: BTreeMap<Cow<'static, str>, Notice>,
}

impl Notices {
    pub(crate) fn new(begin: Instant) -> Self {
        Self {
            begin,
            all: BTreeMap::new(),
        }
    }

    /// Takes all that is found at `now`; tells of what is new and of what is over.
    #[cfg(test)]
    fn update(&mut self, findings: Vec<Finding>, now: Instant) {
        self.add(findings, now);
        self.end_old(now);
    }

    /// Tells of what has not been found for a while that it is over.
    pub(crate) fn end_old(&mut self, now: Instant) {
        let at_s = self.at_s(now);
        for notice in self.all.values_mut().filter(|n| n.until_s.is_none()) {
            if now.saturating_duration_since(notice.seen) > OVER_AFTER {
                notice.until_s = Some(at_s);
                tracing::info!(notice = &*notice.code, "over: {}", notice.sentence);
            }
        }
    }

    /// Takes what is found at `now`; tells of what is new.
    pub(crate) fn add(&mut self, findings: Vec<Finding>, now: Instant) {
        let at_s = self.at_s(now);
        for finding in findings {
            self.found(finding, now, at_s);
        }
    }

    fn at_s(&self, now: Instant) -> f64 {
        now.saturating_duration_since(self.begin).as_secs_f64()
    }

    fn found(&mut self, finding: Finding, now: Instant, at_s: f64) {
        let code = finding.code;
        let notice = self.all.entry(code.clone()).or_insert_with(|| Notice {
            code,
            sentence: String::new(),
            since_s: at_s,
            until_s: Some(at_s),
            count: 0,
            is_loss: false,
            seen: now,
        });
        notice.seen = now;
        notice.is_loss |= finding.is_loss;
        if notice.until_s.take().is_some() {
            notice.since_s = at_s;
            notice.count += 1;
            tracing::warn!(notice = &*notice.code, "{}", finding.sentence);
        }
        notice.sentence = finding.sentence;
    }

    /// Whether it was found of late.
    pub(crate) fn stands(&self, code: &str) -> bool {
        self.all.get(code).is_some_and(|n| n.until_s.is_none())
    }

    /// Those that stand, and those that stood.
    pub(crate) fn all(&self) -> Vec<Notice> {
        self.all.values().cloned().collect()
    }

    /// The sentence of the newest condition that stands.
    pub(crate) fn newest_standing(&self) -> Option<&str> {
        let standing = self.all.values().filter(|n| n.until_s.is_none());
        let newest = standing.max_by(|a, b| a.since_s.total_cmp(&b.since_s))?;
        Some(&newest.sentence)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finding(sentence: &str) -> Finding {
        Finding {
            code: "no-poses".into(),
            sentence: sentence.to_owned(),
            is_loss: true,
        }
    }

    #[test]
    fn a_condition_is_told_once_and_then_that_it_is_over() {
        let begin = Instant::now();
        let at = |s: f64| begin + Duration::from_secs_f64(s);
        let mut notices = Notices::new(begin);
        notices.update(vec![finding("a")], at(1.0));
        notices.update(vec![finding("b")], at(2.0));
        assert_eq!(notices.newest_standing(), Some("b"));
        notices.update(Vec::new(), at(3.0));
        assert_eq!(notices.newest_standing(), Some("b"), "a moment is no end");
        notices.update(Vec::new(), at(4.0));
        assert_eq!(notices.newest_standing(), None);
        let [notice] = &notices.all()[..] else {
            panic!("one condition")
        };
        assert_eq!((notice.count, notice.since_s), (1, 1.0));
        assert!(notice.until_s.is_some() && notice.is_loss);
    }
}
