//! What is wrong with what comes from a driver elsewhere.

use super::{PATIENCE, warning};
use crate::pipeline::notices::Finding;
use crate::split::TapeReport;

/// A driver that has so many records more is not one that is heard as it hears.
const BEHIND: u64 = 200;

/// Why nothing can be said of sonar and poses, if so: the driver is silent, or what comes is of
/// earlier.
pub(super) fn finding(tape: &TapeReport) -> Option<Finding> {
    let silent_s = tape.silent_s.filter(|s| *s > PATIENCE.as_secs_f64());
    if let Some(silent_s) = silent_s {
        return Some(warning(
            "no-driver",
            format!(
                "the driver has not answered for {silent_s:.0} s: look at the link to the vehicle; \
                 what it hears meanwhile is kept there, and comes once it answers"
            ),
        ));
    }
    if tape.silent_s.is_none() && tape.resumed > 0 {
        return Some(warning(
            "reading-recording",
            format!(
                "{} records of the recording are read; then the driver is asked",
                tape.resumed
            ),
        ));
    }
    (tape.counters.behind > BEHIND).then(|| {
        warning(
            "catching-up",
            format!(
                "the mapper is {} records behind the driver, and catches up",
                tape.counters.behind
            ),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silent_driver_is_told_and_one_that_answers_is_not() {
        let heard = |silent_s, behind| {
            let mut report = TapeReport {
                silent_s,
                ..TapeReport::default()
            };
            report.counters.behind = behind;
            finding(&report).map(|finding| finding.code.into_owned())
        };
        assert_eq!(heard(Some(0.4), 0), None);
        assert_eq!(heard(Some(3.0), 0).as_deref(), Some("no-driver"));
        assert_eq!(heard(Some(0.1), 5000).as_deref(), Some("catching-up"));
    }
}
