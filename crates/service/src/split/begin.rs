//! What a driver tells first, and where in its tape a recording is.

use echosplat_join::StampClock;
use echosplat_session::{ClockSource, SessionConfig};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::pipeline::Patience;
use crate::recorder::BEGIN;

/// Name of the event that says which record of the driver's tape comes next in a recording.
const POSITION: &str = "tape";

/// How the sonar is asked and understood, for whoever decodes what it sent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Begin {
    event: String,
    is_log: bool,
    pub(crate) session: SessionConfig,
    /// The sonar's URL.
    #[serde(default)]
    pub(crate) sonar: String,
    /// Whether poses come from a live source and are to be judged; a file holds one track.
    #[serde(default = "yes")]
    pub(crate) guards_poses: bool,
    /// The dive ends after so long, by the pings' clock.
    #[serde(default)]
    pub(crate) duration_s: Option<f64>,
}

fn yes() -> bool {
    true
}

impl Begin {
    pub(crate) fn new(session: &SessionConfig, sonar: String, guards_poses: bool) -> Self {
        Self {
            event: BEGIN.to_owned(),
            is_log: false,
            session: session.clone(),
            sonar,
            guards_poses,
            duration_s: None,
        }
    }

    /// The same for a dive that ends after so long.
    pub(crate) fn lasting(self, duration_s: Option<f64>) -> Self {
        Self { duration_s, ..self }
    }

    /// What a driver told, or a recording begins with; `None` if it is something else, or of a log.
    pub(crate) fn read(event: &Value) -> Option<Self> {
        let begin: Self = serde_json::from_value(event.clone()).ok()?;
        let is_sound = begin.event == BEGIN && !begin.is_log && begin.session.check().is_ok();
        is_sound.then_some(begin)
    }

    pub(crate) fn to_value(&self) -> Value {
        json!(self)
    }

    /// Whose clock the pings are on, and what that means for those whose poses are late.
    pub(crate) fn clock(&self) -> (Patience, StampClock) {
        match self.session.clock {
            ClockSource::Device => (Patience::HoldBack, StampClock::Data),
            ClockSource::Host => (Patience::LetGo, StampClock::Host),
        }
    }
}

/// The event that says that record `next` of this driver's tape comes next.
pub(super) fn position_event(driver: u64, next: u64) -> Value {
    json!({ "event": POSITION, "driver": driver, "next": next })
}

/// The driver and the number, if the event is one of those.
pub(super) fn position_of(event: &Value) -> Option<(u64, u64)> {
    (event["event"] == POSITION)
        .then(|| Some((event["driver"].as_u64()?, event["next"].as_u64()?)))
        .flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_driver_tells_is_read_as_it_was_and_other_events_are_not() {
        let session = SessionConfig {
            bin_count: 700,
            ..SessionConfig::default()
        };
        let begin = Begin::new(&session, "tcp://a:1".to_owned(), false);
        assert_eq!(Begin::read(&begin.to_value()), Some(begin.clone()));
        let mut wrong = begin.to_value();
        wrong["session"]["bin_count"] = json!(1);
        assert_eq!(Begin::read(&wrong), None);
        let mut log = begin.to_value();
        log["is_log"] = json!(true);
        assert_eq!(Begin::read(&log), None);
        let event = position_event(u64::MAX, 3);
        assert_eq!(position_of(&event), Some((u64::MAX, 3)));
        assert_eq!(position_of(&begin.to_value()), None);
    }
}
