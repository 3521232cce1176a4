//! Clocks of sources on the host's clock, by when their messages arrive.

use echosplat_model::Timestamp;

const NANOS_PER_SECOND: i64 = 1_000_000_000;
/// How fast two quartz clocks drift apart at most, parts per million.
pub(crate) const DRIFT_PPM: i64 = 50;
/// A delay longer than the least by this is a stall of the link, or a clock set forward.
const SUSPECT_NANOS: i64 = NANOS_PER_SECOND / 2;
/// So many such delays in a row, at the source's own pace, are for good.
const SUSPECT_COUNT: u32 = 8;

/// Arrival is the stamp plus an offset plus a delay that is never negative; so the least difference
/// is the offset, and it may grow no faster than clocks drift.
#[derive(Debug, Clone, Default)]
pub(crate) struct LeastDelay {
    best: Option<Best>,
    suspects: Option<Suspects>,
}

#[derive(Debug, Clone, Copy)]
struct Best {
    stamp: i64,
    offset: i64,
}

#[derive(Debug, Clone, Copy)]
struct Suspects {
    count: u32,
    stamp: i64,
    arrival: i64,
    least: i64,
}

/// What drift may have added to an offset since.
pub(crate) fn drift_since(from_nanos: i64, to_nanos: i64) -> i64 {
    to_nanos.saturating_sub(from_nanos).saturating_abs() / 1_000_000 * DRIFT_PPM
}

impl LeastDelay {
    /// Takes the stamp of a message that came at `arrived`.
    pub(crate) fn observe(&mut self, stamp_nanos: i64, arrived: Timestamp) {
        let offset = arrived.nanos().saturating_sub(stamp_nanos);
        let Some(expected) = self.offset_at(stamp_nanos) else {
            return self.begin(stamp_nanos, offset);
        };
        let excess = offset.saturating_sub(expected);
        if excess <= 0 {
            self.begin(stamp_nanos, offset);
        } else if excess <= SUSPECT_NANOS {
            self.suspects = None;
        } else if let Some(least) = self.suspect(stamp_nanos, arrived.nanos(), offset) {
            self.begin(stamp_nanos, least);
        }
    }

    /// Host time minus the source's time, at a stamp of the source.
    pub(crate) fn offset_at(&self, stamp_nanos: i64) -> Option<i64> {
        let best = self.best?;
        Some(
            best.offset
                .saturating_add(drift_since(best.stamp, stamp_nanos)),
        )
    }

    fn begin(&mut self, stamp: i64, offset: i64) {
        self.best = Some(Best { stamp, offset });
        self.suspects = None;
    }

    /// The new offset once late messages come at the source's pace: a backlog comes all at once.
    fn suspect(&mut self, stamp: i64, arrival: i64, offset: i64) -> Option<i64> {
        let suspects = self.suspects.get_or_insert(Suspects {
            count: 0,
            stamp,
            arrival,
            least: offset,
        });
        suspects.count += 1;
        suspects.least = suspects.least.min(offset);
        let passed = stamp.saturating_sub(suspects.stamp);
        let arrived = arrival.saturating_sub(suspects.arrival);
        let at_its_pace = arrived.saturating_mul(2) >= passed;
        (suspects.count >= SUSPECT_COUNT && at_its_pace).then_some(suspects.least)
    }
}

/// Delays within which a source's Unix clock passes for the host's own: a network's, and what the
/// source takes to make a message; a little less than none, for clocks kept by NTP.
const OWN_DELAY_NANOS: std::ops::RangeInclusive<i64> =
    -NANOS_PER_SECOND / 50..=NANOS_PER_SECOND / 2;

/// A clock that may keep Unix time, or anything else.
#[derive(Debug, Clone, Default)]
pub(crate) struct UnknownClock {
    delay: LeastDelay,
}

impl UnknownClock {
    pub(crate) fn observe(&mut self, stamp_nanos: i64, arrived: Timestamp) {
        self.delay.observe(stamp_nanos, arrived);
    }

    /// Whether its stamps are host time as they are.
    pub(crate) fn is_unix(&self, stamp_nanos: i64) -> bool {
        let least = self.delay.offset_at(stamp_nanos);
        least.is_some_and(|least| OWN_DELAY_NANOS.contains(&least))
    }

    /// What is added to a stamp of this clock.
    pub(crate) fn offset_nanos(&self, stamp_nanos: i64) -> i64 {
        match self.is_unix(stamp_nanos) {
            true => 0,
            false => self.delay.offset_at(stamp_nanos).unwrap_or(0),
        }
    }

    pub(crate) fn method(&self, stamp_nanos: i64) -> &'static str {
        match self.is_unix(stamp_nanos) {
            true => "unix",
            false => "arrival",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFFSET: i64 = 1_700_000_000 * NANOS_PER_SECOND;
    const STEP: i64 = 20_000_000;

    /// 0.3 ms, and three times of four up to 40 ms more; the same on every run.
    fn delay(i: i64) -> i64 {
        let noise = (i.wrapping_mul(2_654_435_761) >> 7) % 40;
        300_000 + if i % 4 == 1 { 0 } else { noise * 1_000_000 }
    }

    fn error_at(clock: &mut LeastDelay, i: i64, offset: i64) -> i64 {
        let stamp = i * STEP;
        let arrived = Timestamp::from_nanos(stamp + offset + delay(i));
        clock.observe(stamp, arrived);
        clock.offset_at(stamp).unwrap() - offset
    }

    #[test]
    fn drift_is_followed_both_ways_under_jitter() {
        for ppm in [-50, 0, 50] {
            let mut clock = LeastDelay::default();
            for i in 0..20_000 {
                let drift = i * STEP / 1_000_000 * ppm;
                let error = error_at(&mut clock, i, OFFSET + drift);
                assert!(i < 10 || error.abs() < 2_000_000, "{ppm}: {i}: {error}");
            }
        }
    }

    #[test]
    fn steps_of_the_host_are_followed_and_a_backlog_is_none() {
        for step_s in [3_600, -3_600, 3] {
            let mut clock = LeastDelay::default();
            (0..200).for_each(|i| _ = error_at(&mut clock, i, OFFSET));
            let stepped = OFFSET + step_s * NANOS_PER_SECOND;
            for i in 200..300 {
                let error = error_at(&mut clock, i, stepped);
                assert!(i < 215 || error.abs() < 5_000_000, "{step_s}: {i}: {error}");
            }
        }
        let mut clock = LeastDelay::default();
        (0..100).for_each(|i| _ = error_at(&mut clock, i, OFFSET));
        let arrived = Timestamp::from_nanos(220 * STEP + OFFSET);
        (100..220).for_each(|i| clock.observe(i * STEP, arrived));
        let error = clock.offset_at(220 * STEP).unwrap() - OFFSET;
        assert!(error.abs() < 1_000_000, "{error}");
    }

    #[test]
    fn a_clock_near_unix_time_is_taken_as_it_is() {
        let mut synchronised = UnknownClock::default();
        let mut since_boot = UnknownClock::default();
        for i in 0..10 {
            let arrived = Timestamp::from_nanos(OFFSET + i * STEP);
            synchronised.observe(arrived.nanos() - 150_000_000, arrived);
            since_boot.observe(i * STEP, arrived);
        }
        assert_eq!(synchronised.offset_nanos(OFFSET), 0);
        assert_eq!(since_boot.offset_nanos(9 * STEP), OFFSET);
        assert_eq!(
            (synchronised.method(OFFSET), since_boot.method(0)),
            ("unix", "arrival")
        );
    }

    #[test]
    fn extremes_do_not_overflow() {
        let mut clock = LeastDelay::default();
        for (stamp, arrived) in [(i64::MAX, i64::MIN), (0, i64::MAX), (i64::MIN, 0)] {
            clock.observe(stamp, Timestamp::from_nanos(arrived));
            let _ = clock.offset_at(i64::MAX);
        }
    }
}
