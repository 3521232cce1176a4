//! What there is no time or no memory for.

use std::time::{Duration, Instant};

use super::{Diagnosis, loss, warning};
use crate::pipeline::notices::Finding;
use crate::pipeline::shedding::SheddingReport;
use crate::pipeline::status::Status;

/// A machine that is only just too slow catches up and falls behind again, in turns of seconds to a
/// minute: it is one overload until nothing was given up for so long.
const QUIET: Duration = Duration::from_secs(60);
/// Where it has come back soon after that, twice as long each time, up to this.
const MOST_QUIET: Duration = Duration::from_secs(600);

/// Whether pings come faster than they are mapped.
#[derive(Debug)]
pub(super) struct Overload {
    /// When something was last given up.
    newest: Option<Instant>,
    /// How long nothing has to be given up until it is over.
    quiet: Duration,
    /// Whether, in this overload, maps and raw pings were not published either.
    publishing: bool,
}

impl Default for Overload {
    fn default() -> Self {
        Self {
            newest: None,
            quiet: QUIET,
            publishing: false,
        }
    }
}

impl Overload {
    /// Whether it is one at `now`. What a recorded dive gave up, its replay waits for.
    fn stands(&mut self, shedding: &SheddingReport, now: Instant) -> bool {
        let since = |then: Instant| now.saturating_duration_since(then);
        let was = self.newest.is_some_and(|newest| since(newest) < self.quiet);
        if (shedding.work || shedding.publishing) && !shedding.as_recorded {
            if !was {
                let is_soon = self
                    .newest
                    .is_some_and(|newest| since(newest) < 2 * self.quiet);
                self.quiet = match is_soon {
                    true => (2 * self.quiet).min(MOST_QUIET),
                    false => QUIET,
                };
                self.publishing = false;
            }
            self.newest = Some(now);
            self.publishing |= shedding.publishing;
        }
        self.newest.is_some_and(|newest| since(newest) < self.quiet)
    }
}

/// The one remedy that an owner has, with a time from ping to ping that is twice the one there is.
pub(super) fn fewer_pings(interval_s: f64) -> String {
    match interval_s > 0.0 && interval_s.is_finite() {
        true => format!(
            "for fewer pings set session.ping_interval_ms to {:.0} (they come every {:.0} ms) or more",
            (2e3 * interval_s).ceil(),
            1e3 * interval_s,
        ),
        false => "for fewer pings set session.ping_interval_ms higher".to_owned(),
    }
}

impl Diagnosis {
    pub(super) fn given_up(&mut self, status: &Status, now: Instant, findings: &mut Vec<Finding>) {
        let shedding = &status.report.shedding;
        if self.overload.stands(shedding, now) {
            let publishing = match self.overload.publishing {
                true => ", and maps and raw pings to look at are left out",
                false => "",
            };
            findings.push(warning(
                "overload",
                format!(
                    "pings come faster than this machine maps them: work on the map is put off until \
                     there is time{publishing}; evidence and the recording go on; {}",
                    fewer_pings(self.expectations.ping_interval_s)
                ),
            ));
        }
        if shedding.memory {
            findings.push(loss(
                "memory-full",
                format!(
                    "the service holds the {} MB of memory it may (pipeline.memory_bytes): pings are \
                     recorded and not mapped, {} so far; replay the recording where there is more",
                    status.memory_bytes / 1_000_000,
                    shedding.pings_without_memory
                ),
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::BASIC_TOML;

    fn shedding(work: bool) -> SheddingReport {
        SheddingReport {
            work,
            ..SheddingReport::default()
        }
    }

    /// How often it begins and whether it stands at the end, of seconds in which work is put off.
    fn told(seconds: u64, is_put_off: impl Fn(u64) -> bool) -> (u32, bool) {
        let (begin, mut overload) = (Instant::now(), Overload::default());
        let (mut stands, mut count) = (false, 0);
        for quarter in 0..4 * seconds {
            let now = begin + Duration::from_millis(250 * quarter);
            let stood = std::mem::replace(
                &mut stands,
                overload.stands(&shedding(is_put_off(quarter / 4)), now),
            );
            count += u32::from(stands && !stood);
        }
        (count, stands)
    }

    #[test]
    fn a_machine_that_catches_up_now_and_then_has_one_overload() {
        for every_s in [2, 3, 7, 20, 33, 59] {
            assert_eq!(told(600, |s| s % every_s == 0), (1, true), "{every_s}");
        }
        // Turns that are longer than it is quiet are learnt.
        for every_s in [75, 100, 119] {
            assert_eq!(told(3600, |s| s % every_s == 0).0, 2, "{every_s}");
        }
        // Two that have nothing to do with each other.
        assert_eq!(
            told(3600, |s| s < 2 || (1800..1802).contains(&s)),
            (2, false)
        );
        assert_eq!(told(200, |s| s < 9), (1, false));
        assert_eq!(told(200, |_| false), (0, false));
    }

    #[test]
    fn what_a_recorded_dive_gave_up_is_no_overload_of_its_replay() {
        let recorded = SheddingReport {
            as_recorded: true,
            publishing: true,
            ..shedding(true)
        };
        assert!(!Overload::default().stands(&recorded, Instant::now()));
    }

    #[test]
    fn the_remedy_is_one_that_an_owner_sees() {
        let words = fewer_pings(0.0172);
        assert!(
            words.contains("session.ping_interval_ms to 35 (they come every 17 ms)"),
            "{words}"
        );
        for words in [words, fewer_pings(0.0)] {
            let keys = words.split("session.").skip(1);
            for key in keys.map(|rest| rest.split(' ').next().unwrap_or_default()) {
                assert!(BASIC_TOML.contains(&format!("\n{key} = ")), "{key}");
            }
        }
        let documents = include_str!("../../../../../docs/troubleshooting.md");
        let row = documents
            .lines()
            .find(|line| line.starts_with("| `overload`"));
        assert!(
            row.is_some_and(|row| row.contains("session.ping_interval_ms")),
            "{row:?}"
        );
    }
}
