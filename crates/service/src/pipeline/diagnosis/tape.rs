//! What is wrong with what comes from a driver elsewhere.

use echosplat_bus::TapeTrouble;

use super::{PATIENCE, warning};
use crate::pipeline::notices::Finding;
use crate::split::TapeReport;

/// A driver that has so many records more is not one that is heard as it hears.
const BEHIND: u64 = 200;

/// Why nothing can be said of sonar and poses, if so: the driver is silent, or what comes is of
/// earlier.
pub(super) fn finding(tape: &TapeReport) -> Option<Finding> {
    let silent_s = tape.silent_s.filter(|s| *s > PATIENCE.as_secs_f64());
    if let (Some(silent_s), Some(trouble)) = (silent_s, &tape.trouble) {
        return Some(warning(
            "driver-unreadable",
            format!("the driver has not been heard for {silent_s:.0} s: {trouble}"),
        ));
    }
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

/// Whether another driver answers beside the one that is followed.
pub(super) fn two_drivers(tape: &TapeReport) -> Option<Finding> {
    let trouble = tape.trouble.as_ref()?;
    let is_another = matches!(trouble, TapeTrouble::OtherDriver { .. });
    is_another.then(|| warning("two-drivers", trouble.to_string()))
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

    #[test]
    fn what_answers_and_cannot_be_followed_is_named() {
        let mut report = TapeReport {
            silent_s: Some(4.0),
            trouble: Some(TapeTrouble::Unreadable(
                "it ends within record 3".to_owned(),
            )),
            ..TapeReport::default()
        };
        let found = finding(&report).unwrap();
        assert_eq!(found.code, "driver-unreadable");
        assert!(
            found.sentence.contains("ends within record 3"),
            "{}",
            found.sentence
        );
        assert_eq!(two_drivers(&report), None);
        report.silent_s = Some(0.1);
        assert_eq!(finding(&report), None);
        let (followed, other) = (1, 2);
        report.trouble = Some(TapeTrouble::OtherDriver { followed, other });
        assert_eq!(two_drivers(&report).unwrap().code, "two-drivers");
    }
}
