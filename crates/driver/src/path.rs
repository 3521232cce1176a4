//! How long pings take from the read that completed them to the events' channel.

use std::time::Duration;

use serde::Serialize;

/// From 1 µs on, each step a quarter of an octave, up to 16 s.
const STEPS: usize = 97;
const STEPS_PER_OCTAVE: f64 = 4.0;

/// Milliseconds from the read of a ping's last byte to the ping's place in the events' channel: what
/// decoding, the tap and a wait for room take. Percentiles are within 19 %.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct PingPath {
    /// Half of all pings took no longer.
    pub p50: f64,
    /// 99 of 100 took no longer.
    pub p99: f64,
    /// 999 of 1000 took no longer.
    pub p99_9: f64,
    /// The longest.
    pub max: f64,
    /// Pings measured.
    pub measured: u64,
}

/// Counts by duration.
#[derive(Debug)]
pub(crate) struct PathTimes {
    counts: [u64; STEPS],
    total: u64,
    longest: Duration,
}

impl Default for PathTimes {
    fn default() -> Self {
        Self {
            counts: [0; STEPS],
            total: 0,
            longest: Duration::ZERO,
        }
    }
}

impl PathTimes {
    pub(crate) fn took(&mut self, duration: Duration) {
        let micros = duration.as_secs_f64() * 1e6;
        let step = (STEPS_PER_OCTAVE * micros.max(1.0).log2()).ceil() as usize;
        self.counts[step.min(STEPS - 1)] += 1;
        self.total += 1;
        self.longest = self.longest.max(duration);
    }

    /// `None` before the first ping.
    pub(crate) fn report(&self) -> Option<PingPath> {
        let max = self.longest.as_secs_f64() * 1e3;
        let within = |share: f64| {
            let wanted = (share * self.total as f64).ceil() as u64;
            let mut passed = 0;
            let step = self.counts.iter().position(|count| {
                passed += count;
                passed >= wanted
            });
            let step = step.unwrap_or(STEPS - 1) as f64;
            (1e-3 * (step / STEPS_PER_OCTAVE).exp2()).min(max)
        };
        (self.total > 0).then(|| PingPath {
            p50: within(0.5),
            p99: within(0.99),
            p99_9: within(0.999),
            max,
            measured: self.total,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_all_pings_and_the_longest_is_kept() {
        let mut times = PathTimes::default();
        assert_eq!(times.report(), None);
        for _ in 0..998 {
            times.took(Duration::from_micros(100));
        }
        times.took(Duration::from_millis(5));
        times.took(Duration::from_secs(60));
        let report = times.report().unwrap();
        assert!((0.1..0.12).contains(&report.p50), "{report:?}");
        assert!((5.0..6.0).contains(&report.p99_9), "{report:?}");
        assert_eq!((report.max, report.measured), (60_000.0, 1_000));
    }
}
