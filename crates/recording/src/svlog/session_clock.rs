//! When a session of a live log begins, and at what host time.
//!
//! A reader of the log takes a profile's time to be the session's `timestamp` plus the device time
//! since the session's first profile. Where that would leave the host's clock, by which poses are
//! stamped, another session has to begin.

use echosplat_model::Timestamp;

const NANOS_PER_MILLI: i64 = 1_000_000;
/// Device time may go back by so much among datagrams that overtook each other.
const REORDER_MS: i32 = 2_000;
/// A profile cannot arrive before its transmit: by more than this, the session's start was late.
const EARLY_NANOS: i64 = 5 * NANOS_PER_MILLI;
/// Later than this again and again: the clocks have drifted, or one was set.
const LATE_NANOS: i64 = 20 * NANOS_PER_MILLI;
/// So late a link rarely is: fewer profiles are enough to tell.
const VERY_LATE_NANOS: i64 = 250 * NANOS_PER_MILLI;
const LATE_COUNT: u32 = 64;
const VERY_LATE_COUNT: u32 = 8;

/// The clock of one session.
#[derive(Debug)]
pub(super) struct SessionClock {
    /// Host time at device time 0 of the session.
    base: Timestamp,
    newest_ms: u32,
    elapsed_ms: i64,
    late: Option<Late>,
}

/// A row of late profiles.
#[derive(Debug, Clone, Copy)]
struct Late {
    count: u32,
    least_nanos: i64,
    since: Timestamp,
    since_elapsed_ms: i64,
}

impl SessionClock {
    /// Of a session whose first profile was sent at `timestamp`.
    pub(super) fn new(timestamp: Timestamp, device_ms: u32) -> Self {
        Self {
            base: timestamp,
            newest_ms: device_ms,
            elapsed_ms: 0,
            late: None,
        }
    }

    /// Takes a profile; the host time of its transmit if it has to begin a session of its own.
    pub(super) fn insert(&mut self, device_ms: u32, arrival: Timestamp) -> Option<Timestamp> {
        // The counter wraps after 49.7 days, and goes on.
        let step_ms = device_ms.wrapping_sub(self.newest_ms).cast_signed();
        if step_ms < -REORDER_MS {
            return Some(arrival);
        }
        let elapsed_ms = self.elapsed_ms + i64::from(step_ms);
        if step_ms > 0 {
            self.elapsed_ms = elapsed_ms;
            self.newest_ms = device_ms;
        }
        let expected = self.base.offset_by_nanos(elapsed_ms * NANOS_PER_MILLI);
        let delay = arrival.nanos().saturating_sub(expected.nanos());
        if delay < -EARLY_NANOS {
            return Some(arrival);
        }
        let shift = self.shift(delay, arrival, elapsed_ms)?;
        Some(expected.offset_by_nanos(shift))
    }

    /// How much later everything is, once that is for good.
    fn shift(&mut self, delay: i64, arrival: Timestamp, elapsed_ms: i64) -> Option<i64> {
        if delay <= LATE_NANOS {
            self.late = None;
            return None;
        }
        let late = self.late.get_or_insert(Late {
            count: 0,
            least_nanos: delay,
            since: arrival,
            since_elapsed_ms: elapsed_ms,
        });
        late.count += 1;
        late.least_nanos = late.least_nanos.min(delay);
        let needed = match late.least_nanos > VERY_LATE_NANOS {
            true => VERY_LATE_COUNT,
            false => LATE_COUNT,
        };
        // A backlog arrives all at once; a changed clock at the device's pace.
        let arrived = arrival.nanos().saturating_sub(late.since.nanos());
        let passed = (elapsed_ms - late.since_elapsed_ms) * NANOS_PER_MILLI;
        let for_good = late.count >= needed && arrived.saturating_mul(2) >= passed;
        for_good.then_some(late.least_nanos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL_MS: u32 = 17;
    const START: i64 = 1_700_000_000_000_000_000;

    /// Arrival of the profile at `device_ms`, `delay_ms` after its transmit.
    fn arrival(device_ms: u32, delay_ms: i64) -> Timestamp {
        let millis = i64::from(device_ms) + delay_ms;
        Timestamp::from_nanos(START + millis * NANOS_PER_MILLI)
    }

    fn clock() -> SessionClock {
        SessionClock::new(arrival(0, 0), 0)
    }

    /// Profiles `from` to `to`, the new session's error in milliseconds and its place.
    fn feed(
        clock: &mut SessionClock,
        range: std::ops::Range<u32>,
        delay_ms: i64,
    ) -> Option<(u32, i64)> {
        range.into_iter().find_map(|index| {
            let device_ms = index * INTERVAL_MS;
            let began = clock.insert(device_ms, arrival(device_ms, delay_ms))?;
            let error = began.nanos() - arrival(device_ms, delay_ms).nanos();
            Some((index, error / NANOS_PER_MILLI))
        })
    }

    #[test]
    fn jitter_begins_no_session_and_a_stall_neither() {
        let mut clock = clock();
        for index in 1..1000_u32 {
            let delay_ms = i64::from(index * 7919 % 40);
            assert_eq!(feed(&mut clock, index..index + 1, delay_ms), None);
        }
        let stalled = arrival(1200 * INTERVAL_MS, 0);
        for index in 1000..1200 {
            assert_eq!(clock.insert(index * INTERVAL_MS, stalled), None);
        }
    }

    #[test]
    fn steps_of_the_hosts_clock_begin_one() {
        for (step_ms, within) in [(3_600_000, 8), (-3_600_000, 1), (30, 64), (-30, 1)] {
            let mut clock = clock();
            assert_eq!(feed(&mut clock, 1..100, 0), None);
            let (index, error_ms) = feed(&mut clock, 100..200, step_ms).unwrap();
            assert!(index < 100 + within, "{step_ms}: {index}");
            assert_eq!(error_ms, 0, "{step_ms}");
        }
    }

    #[test]
    fn a_restarted_device_begins_one_and_a_wrap_does_not() {
        let mut clock = clock();
        feed(&mut clock, 1..1000, 0);
        assert_eq!(
            clock.insert(40, arrival(17_100, 0)),
            Some(arrival(17_100, 0))
        );
        let mut clock = SessionClock::new(arrival(0, 0), u32::MAX - 16);
        for index in 1..100 {
            let device_ms = (u32::MAX - 16).wrapping_add(index * INTERVAL_MS);
            assert_eq!(
                clock.insert(device_ms, arrival(index * INTERVAL_MS, 0)),
                None
            );
        }
    }
}
