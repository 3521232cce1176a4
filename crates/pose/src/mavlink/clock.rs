//! The vehicle's clock since boot on the host's clock: by `TIMESYNC`, else by the Unix time it says
//! it keeps, else by when its messages arrive.

use std::collections::VecDeque;

use echosplat_model::Timestamp;

use crate::clock::{LeastDelay, drift_since};
use echosplat_join::StampClock;

const NANOS_PER_SECOND: i64 = 1_000_000_000;
/// Questions whose answers are still taken.
const ASKED_COUNT: usize = 8;
/// Answers remembered, at one a second.
const ANSWER_COUNT: usize = 60;
/// A round trip longer than this says nothing.
const LONGEST_ROUND_TRIP: i64 = 2 * NANOS_PER_SECOND;
/// An answer counts no longer than this.
const LONGEST_SILENCE: i64 = 60 * NANOS_PER_SECOND;
/// Beyond what rounding to the millisecond and scheduling explain, clocks were set.
const STEP_NANOS: i64 = 10_000_000;
/// How far the vehicle's Unix time may be from ours: a link's delay. Farther, it was never set.
const UNIX_TOLERANCE: std::ops::RangeInclusive<i64> = -NANOS_PER_SECOND..=NANOS_PER_SECOND / 20;
/// 2001: less is no Unix time but time since boot.
const LEAST_UNIX_US: u64 = 1_000_000_000_000_000;

/// Whether microseconds are Unix time, as `MAVLink` tells them apart: by their size.
pub(crate) fn is_unix_us(time_us: u64) -> bool {
    time_us >= LEAST_UNIX_US
}

/// Maps nanoseconds since boot to host time.
#[derive(Debug, Default)]
pub(crate) struct VehicleClock {
    stamps: StampClock,
    arrival: LeastDelay,
    asked: VecDeque<i64>,
    answers: VecDeque<Answer>,
    /// The vehicle's Unix time minus its time since boot.
    unix: Option<i64>,
}

/// One answered `TIMESYNC`.
#[derive(Debug, Clone, Copy)]
struct Answer {
    boot: i64,
    /// Host minus vehicle, wrong by at most half the round trip.
    offset: i64,
    round_trip: i64,
}

impl Answer {
    /// How far its offset may be wrong by now.
    fn bound_at(&self, boot: i64) -> i64 {
        self.round_trip / 2 + drift_since(self.boot, boot)
    }
}

/// What is added to time since boot, and how that is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Offset {
    pub(crate) nanos: i64,
    pub(crate) method: &'static str,
}

impl VehicleClock {
    pub(crate) fn new(stamps: StampClock) -> Self {
        Self {
            stamps,
            ..Self::default()
        }
    }

    /// The vehicle booted: nothing known of its clock holds.
    pub(crate) fn forget(&mut self) {
        *self = Self::new(self.stamps);
    }

    /// A question to send now: `ts1`.
    pub(crate) fn ask(&mut self, now: Timestamp) -> i64 {
        if self.asked.len() == ASKED_COUNT {
            self.asked.pop_front();
        }
        self.asked.push_back(now.nanos());
        now.nanos()
    }

    /// An answer; others' questions on the same link are not ours.
    pub(crate) fn answered(&mut self, tc1: i64, ts1: i64, arrived: Timestamp) {
        let asked = self.asked.iter().position(|asked| *asked == ts1);
        let Some(index) = asked else { return };
        self.asked.remove(index);
        let round_trip = arrived.nanos().saturating_sub(ts1);
        if !(0..=LONGEST_ROUND_TRIP).contains(&round_trip) {
            return;
        }
        let answer = Answer {
            boot: tc1,
            offset: (ts1 + round_trip / 2).saturating_sub(tc1),
            round_trip,
        };
        let agrees = |old: &Answer| {
            let apart = old.offset.saturating_sub(answer.offset).saturating_abs();
            apart <= old.bound_at(tc1) + answer.bound_at(tc1) + STEP_NANOS
        };
        self.answers.retain(agrees);
        if self.answers.len() == ANSWER_COUNT {
            self.answers.pop_front();
        }
        self.answers.push_back(answer);
    }

    /// The vehicle's Unix time at a time since boot.
    pub(crate) fn says_unix(&mut self, unix_us: u64, boot: i64) {
        let nanos = i64::try_from(unix_us).map_or(i64::MAX, |us| us.saturating_mul(1_000));
        self.unix = is_unix_us(unix_us).then(|| nanos.saturating_sub(boot));
    }

    /// Takes the time since boot of a message that came at `arrived`.
    pub(crate) fn observe(&mut self, boot: i64, arrived: Timestamp) {
        self.arrival.observe(boot, arrived);
    }

    /// What is added to `boot`.
    pub(crate) fn offset_at(&self, boot: i64) -> Offset {
        let of = |nanos, method| Offset { nanos, method };
        if self.stamps == StampClock::Data {
            return match self.unix {
                Some(unix) => of(unix, "system_time"),
                None => of(0, "data"),
            };
        }
        if let Some(answer) = self.best_answer(boot) {
            return of(answer.offset, "timesync");
        }
        let arrival = self.arrival.offset_at(boot).unwrap_or(0);
        match self.unix {
            Some(unix) if UNIX_TOLERANCE.contains(&(unix.saturating_sub(arrival))) => {
                of(unix, "system_time")
            }
            _ => of(arrival, "arrival"),
        }
    }

    /// The one that can be wrong by least: a short round trip, and not long ago.
    fn best_answer(&self, boot: i64) -> Option<&Answer> {
        let is_fresh = |answer: &&Answer| boot.saturating_sub(answer.boot) <= LONGEST_SILENCE;
        let fresh = self.answers.iter().filter(is_fresh);
        fresh.min_by_key(|answer| answer.bound_at(boot))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIX: i64 = 1_700_000_000 * NANOS_PER_SECOND;

    /// The vehicle's clock: so far behind the host's, and drifting.
    fn boot_at(host: i64, ppm: i64) -> i64 {
        let elapsed = host - UNIX;
        3 * NANOS_PER_SECOND + elapsed + elapsed / 1_000_000 * ppm
    }

    #[test]
    fn timesync_follows_drift_through_uneven_round_trips() {
        for ppm in [-50, 50] {
            let mut clock = VehicleClock::new(StampClock::Host);
            for second in 0..600 {
                let sent = UNIX + second * NANOS_PER_SECOND;
                // Out in 1 ms; back in 1 ms, or three times of four in up to 80 ms more.
                let back = 1_000_000 + (second % 4) * 20_000_000;
                let ts1 = clock.ask(Timestamp::from_nanos(sent));
                let tc1 = boot_at(sent + 1_000_000, ppm);
                let arrived = Timestamp::from_nanos(sent + 1_000_000 + back);
                clock.answered(tc1, ts1, arrived);
                let boot = boot_at(arrived.nanos(), ppm);
                let offset = clock.offset_at(boot);
                let error = boot + offset.nanos - arrived.nanos();
                assert_eq!(offset.method, "timesync");
                assert!(error.abs() < 2_000_000, "{ppm}: {second}: {error}");
            }
        }
    }

    #[test]
    fn answers_to_others_and_answers_after_a_step_are_told_apart() {
        let mut clock = VehicleClock::new(StampClock::Host);
        clock.answered(5, 17, Timestamp::from_nanos(UNIX));
        assert_eq!(clock.offset_at(5).method, "arrival");
        for step in [0, 3_600 * NANOS_PER_SECOND] {
            let sent = UNIX + step;
            let ts1 = clock.ask(Timestamp::from_nanos(sent));
            clock.answered(7, ts1, Timestamp::from_nanos(sent + 2_000_000));
            assert_eq!(clock.offset_at(7).nanos, sent + 1_000_000 - 7);
        }
    }

    #[test]
    fn unix_time_is_believed_only_near_the_hosts() {
        for (ahead_s, method) in [(0, "system_time"), (3_600, "arrival"), (-3_600, "arrival")] {
            let mut clock = VehicleClock::new(StampClock::Host);
            clock.observe(0, Timestamp::from_nanos(UNIX + 30_000_000));
            let unix = UNIX + ahead_s * NANOS_PER_SECOND;
            clock.says_unix((unix / 1_000) as u64, 0);
            assert_eq!(clock.offset_at(0).method, method, "{ahead_s}");
        }
        let mut replayed = VehicleClock::new(StampClock::Data);
        assert_eq!(
            replayed.offset_at(0),
            Offset {
                nanos: 0,
                method: "data"
            }
        );
        replayed.says_unix((UNIX / 1_000) as u64, 4);
        assert_eq!(replayed.offset_at(0).nanos, UNIX - 4);
    }
}
