//! Data time against wall time: when is it time for what is due?

use std::time::{Duration, Instant};

use echosplat_model::Timestamp;

/// Further behind than this is not caught up: the machine stood still, not the data.
const MAX_BEHIND: Duration = Duration::from_secs(1);

/// Plays data at so many times real time.
#[derive(Debug)]
pub(crate) struct Pace {
    /// 0 is without any wait.
    rate: f64,
    /// Steps of data time that are longer, or back, are passed without a wait.
    max_gap_s: f64,
    anchor: Option<Anchor>,
}

#[derive(Debug, Clone, Copy)]
struct Anchor {
    wall: Instant,
    data: Timestamp,
    /// Newest data time asked for.
    newest: Timestamp,
}

impl Pace {
    pub(crate) fn new(rate: f64, max_gap_s: f64) -> Self {
        Self {
            rate,
            max_gap_s,
            anchor: None,
        }
    }

    /// How long to wait at `now` for what is due at `data`; zero if it is time.
    pub(crate) fn wait(&mut self, data: Timestamp, now: Instant) -> Duration {
        if !(self.rate > 0.0) {
            return Duration::ZERO;
        }
        let fresh = Anchor {
            wall: now,
            data,
            newest: data,
        };
        let anchor = self.anchor.get_or_insert(fresh);
        let step_s = data.seconds_since(anchor.newest);
        if !(0.0..=self.max_gap_s).contains(&step_s) {
            *anchor = fresh;
        }
        anchor.newest = data;
        let due_s = data.seconds_since(anchor.data) / self.rate;
        let due = Duration::try_from_secs_f64(due_s).unwrap_or(Duration::ZERO);
        let passed = now.saturating_duration_since(anchor.wall);
        if passed > due + MAX_BEHIND {
            *anchor = fresh;
            return Duration::ZERO;
        }
        due.saturating_sub(passed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    #[test]
    fn twice_real_time_waits_half_as_long() {
        let start = Instant::now();
        let mut pace = Pace::new(2.0, 10.0);
        assert_eq!(pace.wait(at(100.0), start), Duration::ZERO);
        let later = start + Duration::from_millis(200);
        assert_eq!(pace.wait(at(101.0), later), Duration::from_millis(300));
        let due = start + Duration::from_millis(501);
        assert_eq!(pace.wait(at(101.0), due), Duration::ZERO);
    }

    #[test]
    fn gaps_steps_back_and_standstills_are_not_waited_for() {
        let start = Instant::now();
        let mut pace = Pace::new(1.0, 10.0);
        pace.wait(at(0.0), start);
        assert_eq!(pace.wait(at(1e6), start), Duration::ZERO);
        assert_eq!(pace.wait(at(5.0), start), Duration::ZERO);
        let much_later = start + Duration::from_secs(60);
        assert_eq!(pace.wait(at(6.0), much_later), Duration::ZERO);
        let next = pace.wait(at(6.5), much_later);
        assert_eq!(next, Duration::from_millis(500));
    }

    #[test]
    fn rate_zero_never_waits() {
        let mut pace = Pace::new(0.0, 10.0);
        for seconds in [0.0, 5.0, 1e9] {
            assert_eq!(pace.wait(at(seconds), Instant::now()), Duration::ZERO);
        }
    }
}
