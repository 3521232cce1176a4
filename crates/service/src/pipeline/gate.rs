//! Which pings of a stream are wanted: `--start`, `--end` and `--duration`, on the pings' clock; and of
//! logs, which may hold a ping twice, each ping once.

use std::collections::HashSet;
use std::hash::{DefaultHasher, Hash, Hasher};

use echosplat_model::{Ping, Timestamp};

/// Seconds count from the first ping of the stream.
#[derive(Debug, Clone, Default)]
pub(crate) struct Gate {
    first: Option<Timestamp>,
    /// Of the newest ping so far.
    newest_s: f64,
    start_s: f64,
    end_s: Option<f64>,
    /// The pings so far, where one may come twice.
    seen: Option<HashSet<u64>>,
}

/// What to do with a ping.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Passage {
    /// Before the start: left out.
    Early,
    /// Wanted.
    Open,
    /// Past the end: it and all after it are not wanted.
    Closed,
}

impl Gate {
    /// From `start_s` on, until `end_s` or for `duration_s`, whichever ends first.
    pub(crate) fn new(start_s: Option<f64>, end_s: Option<f64>, duration_s: Option<f64>) -> Self {
        let start_s = start_s.unwrap_or(0.0);
        let by_duration = duration_s.map(|duration_s| start_s + duration_s);
        Self {
            first: None,
            newest_s: 0.0,
            start_s,
            end_s: match (end_s, by_duration) {
                (Some(a), Some(b)) => Some(a.min(b)),
                (a, b) => a.or(b),
            },
            seen: None,
        }
    }

    /// The same for logs, of which one may be given twice, or one may hold another.
    pub(crate) fn taking_once(self) -> Self {
        Self {
            seen: Some(HashSet::new()),
            ..self
        }
    }

    /// Whether this ping came before: sent at the same time, with the same echoes.
    pub(crate) fn has_seen(&mut self, ping: &Ping) -> bool {
        let Some(seen) = &mut self.seen else {
            return false;
        };
        let mut hasher = DefaultHasher::new();
        ping.transmit_time().nanos().hash(&mut hasher);
        for power in ping.intensity() {
            hasher.write_u32(power.to_bits());
        }
        !seen.insert(hasher.finish())
    }

    /// The clock of the pings stepped: the stream's own time goes on with the next one.
    pub(crate) fn clock_stepped(&mut self) {
        self.first = None;
    }

    /// Decides on the next ping.
    pub(crate) fn pass(&mut self, time: Timestamp) -> Passage {
        let newest_s = self.newest_s;
        let first = *self.first.get_or_insert_with(|| time.offset_by(-newest_s));
        let at_s = time.seconds_since(first);
        self.newest_s = self.newest_s.max(at_s);
        if self.end_s.is_some_and(|end_s| at_s >= end_s) {
            return Passage::Closed;
        }
        // A late ping may be older than the first, which is no start asked for.
        if self.start_s > 0.0 && at_s < self.start_s {
            return Passage::Early;
        }
        Passage::Open
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wanted_counts_from_the_first_ping() {
        let mut gate = Gate::new(Some(1.0), Some(10.0), Some(2.0));
        let mut at = |s| gate.pass(Timestamp::from_secs_f64(100.0 + s));
        assert_eq!(at(0.0), Passage::Early);
        assert_eq!(at(1.0), Passage::Open);
        assert_eq!(at(2.9), Passage::Open);
        assert_eq!(at(3.0), Passage::Closed);
    }

    #[test]
    fn a_step_of_the_clock_neither_ends_nor_begins_anything() {
        let mut gate = Gate::new(None, None, Some(10.0));
        let at = |s| Timestamp::from_secs_f64(s);
        assert_eq!(gate.pass(at(5000.0)), Passage::Open);
        assert_eq!(gate.pass(at(5004.0)), Passage::Open);
        gate.clock_stepped();
        assert_eq!(gate.pass(at(1404.0)), Passage::Open);
        assert_eq!(gate.pass(at(1409.0)), Passage::Open);
        assert_eq!(gate.pass(at(1410.0)), Passage::Closed);
    }

    #[test]
    fn without_limits_everything_passes() {
        let mut gate = Gate::default();
        assert_eq!(gate.pass(Timestamp::ZERO), Passage::Open);
        assert_eq!(gate.pass(Timestamp::from_secs_f64(1e6)), Passage::Open);
    }
}
