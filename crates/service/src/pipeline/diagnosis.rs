//! From figures to sentences: what is wrong with what comes in, said so that the reader knows what to
//! do. Each condition is found within two seconds of its beginning; none is guessed from a map.

mod disk;
mod overload;
mod poses;
mod sonar;
mod stamps;
mod tape;

use std::collections::HashMap;
use std::time::{Duration, Instant};

use echosplat_session::SessionConfig;

use super::Pace;
use super::notices::Finding;
use super::status::Status;
use crate::config::PoseConfig;
use overload::Overload;
pub(crate) use poses::calibration;
pub(super) use sonar::finding_of_units;
pub(crate) use stamps::no_time;

/// Growth of a counter is news for so long.
const NEWS: Duration = Duration::from_millis(1200);
/// Longest wait for something that should come all the time.
const PATIENCE: Duration = Duration::from_millis(1500);

/// What the command knows and the status does not.
#[derive(Debug, Clone)]
pub(crate) struct Expectations {
    /// The sonar's URL, or that of the log.
    pub(crate) sonar: String,
    /// Who says when the next ping comes.
    pub(crate) pace: Pace,
    /// Between pings as configured, seconds.
    pub(crate) ping_interval_s: f64,
    /// Where bins begin and how far they reach as the device is asked for, metres.
    pub(crate) range_m: [f64; 2],
}

/// Where bins begin and how far they reach, metres, as this session asks the device.
pub(crate) fn range_of(session: &SessionConfig) -> [f64; 2] {
    [session.range_start_m, session.range_length_m]
}

/// Remembers what counters were, so that growth can be told.
#[derive(Debug)]
pub(crate) struct Diagnosis {
    expectations: Expectations,
    /// How pings are joined with poses.
    pose: PoseConfig,
    begin: Instant,
    /// When a driver elsewhere was last found to be silent.
    without_driver: Option<Instant>,
    /// When poses were last found to be missing altogether.
    without_poses: Option<Instant>,
    overload: Overload,
    grown: HashMap<&'static str, (u64, Option<Instant>)>,
}

impl Diagnosis {
    pub(crate) fn new(expectations: Expectations, pose: &PoseConfig, begin: Instant) -> Self {
        Self {
            expectations,
            pose: pose.clone(),
            begin,
            without_driver: None,
            without_poses: None,
            overload: Overload::default(),
            grown: HashMap::new(),
        }
    }

    /// All that is wrong at `now`.
    pub(crate) fn findings(&mut self, status: &Status, now: Instant) -> Vec<Finding> {
        let mut findings = Vec::new();
        let without_driver = status.tape.as_ref().and_then(tape::finding);
        match without_driver {
            // Nothing can be said of a sonar and poses that nobody tells of, nor before what the
            // driver kept has come.
            Some(finding) => {
                self.without_driver = Some(now);
                findings.push(finding);
            }
            None if self.is_driver_back_of_late(now) => {}
            None => {
                self.sonar(status, now, &mut findings);
                self.poses(status, now, &mut findings);
            }
        }
        findings.extend(status.tape.as_ref().and_then(tape::two_drivers));
        self.disk_and_queues(status, now, &mut findings);
        findings
    }

    fn is_driver_back_of_late(&self, now: Instant) -> bool {
        let silent = self.without_driver;
        silent.is_some_and(|silent| now.saturating_duration_since(silent) < PATIENCE)
    }

    /// Whether a counter grew of late.
    fn grows(&mut self, name: &'static str, value: u64, now: Instant) -> bool {
        let (before, at) = self.grown.entry(name).or_insert((0, None));
        if value > *before {
            *at = Some(now);
        }
        *before = value;
        at.is_some_and(|at| now.saturating_duration_since(at) < NEWS)
    }

    fn has_run_for(&self, duration: Duration, now: Instant) -> bool {
        now.saturating_duration_since(self.begin) >= duration
    }
}

fn loss(code: &'static str, sentence: String) -> Finding {
    Finding {
        code: code.into(),
        sentence,
        is_loss: true,
    }
}

fn warning(code: &'static str, sentence: String) -> Finding {
    Finding {
        code: code.into(),
        sentence,
        is_loss: false,
    }
}

#[cfg(test)]
mod advice;
#[cfg(test)]
mod tests;
