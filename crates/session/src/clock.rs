//! Device time without end, and where it lies on the host's clock.

use std::collections::VecDeque;

use echosplat_model::Timestamp;

use crate::continuity::{Advance, Break, Stamp};

const NANOS_PER_MILLI: i64 = 1_000_000;
const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// Counts pings and device time on across wraps and restarts; neither ever goes back.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct DeviceClock {
    sequence: u64,
    millis: i64,
    is_running: bool,
}

impl DeviceClock {
    /// Whether there was a profile yet.
    pub(crate) fn is_running(&self) -> bool {
        self.is_running
    }

    /// The stream's sequence and device time in nanoseconds at the profile taken, and the number
    /// of pings between it and the one before.
    pub(crate) fn advance(&mut self, how: Break, stamp: &Stamp) -> DeviceTime {
        let (pings, millis) = match how {
            Break::First => return self.begin(stamp),
            Break::Forward(advance) => (advance.pings, advance.millis),
            Break::Renumbered(advance) => (1, advance.millis),
            // What passed while it was off is unknown; one millisecond keeps the order.
            Break::Restart => (1, 1),
        };
        self.sequence = self.sequence.saturating_add(pings.max(1).unsigned_abs());
        self.millis = self.millis.saturating_add(millis.max(0));
        self.now(pings - 1)
    }

    /// Of a profile that comes late, `step` from the newest; nothing moves on.
    pub(crate) fn late(&self, step: Advance) -> DeviceTime {
        let millis = self.millis.saturating_add(step.millis);
        DeviceTime {
            sequence: self.sequence.saturating_add_signed(step.pings),
            nanos: millis.saturating_mul(NANOS_PER_MILLI),
            missing: 0,
        }
    }

    /// A stream begins: device time is the device's own, the sequence goes on.
    fn begin(&mut self, stamp: &Stamp) -> DeviceTime {
        let number = u64::from(stamp.ping_number);
        self.sequence = match self.is_running {
            true => number.max(self.sequence + 1),
            false => number,
        };
        self.millis = i64::from(stamp.timestamp_ms);
        self.is_running = true;
        self.now(0)
    }

    fn now(&self, missing: i64) -> DeviceTime {
        DeviceTime {
            sequence: self.sequence,
            nanos: self.millis.saturating_mul(NANOS_PER_MILLI),
            missing: missing.max(0).unsigned_abs(),
        }
    }
}

/// When a profile was made, by the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct DeviceTime {
    pub(crate) sequence: u64,
    pub(crate) nanos: i64,
    /// Pings between this one and the one before.
    pub(crate) missing: u64,
}

/// How long the least delay is remembered, in pieces: at 50 ppm of drift 1.5 ms.
const WINDOW_NANOS: i64 = 30 * NANOS_PER_SECOND;
const BUCKET_NANOS: i64 = 3 * NANOS_PER_SECOND;
/// A delay that no link has: the host's clock was set forward.
const STEP_NANOS: i64 = 60 * NANOS_PER_SECOND;
/// A delay that a link has for a while, or a clock for good.
const SUSPECT_NANOS: i64 = NANOS_PER_SECOND / 4;
/// So many in a row, arriving at the device's pace, are for good.
const SUSPECT_COUNT: u32 = 8;
/// Less than this the mapped time is kept from going back.
const ORDER_NANOS: i64 = 20 * NANOS_PER_MILLI;

/// Maps device time to the host's clock: arrival is transmit plus a delay that is never negative,
/// so the least difference seen (over a window, for drift) is the offset.
#[derive(Debug, Clone, Default)]
pub(crate) struct HostClock {
    /// Least offsets by when their piece of device time began; never empty once anchored.
    buckets: VecDeque<Bucket>,
    suspects: Option<Suspects>,
    last_nanos: Option<i64>,
}

#[derive(Debug, Clone, Copy)]
struct Bucket {
    since: i64,
    least: i64,
}

#[derive(Debug, Clone, Copy)]
struct Suspects {
    count: u32,
    device: i64,
    arrival: i64,
    least: i64,
}

/// A device time on the host's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct HostTime {
    pub(crate) time: Timestamp,
    /// Whether the clocks' relation changed for good with this one.
    pub(crate) stepped: bool,
}

impl HostClock {
    /// The device restarted: nothing known of its clock holds.
    pub(crate) fn forget(&mut self) {
        self.buckets.clear();
        self.suspects = None;
    }

    /// Where `device_nanos` lies on the host's clock, given that its profile came at `arrival`.
    pub(crate) fn map(&mut self, device_nanos: i64, arrival: Timestamp) -> HostTime {
        let arrival_nanos = arrival.nanos();
        let offset = arrival_nanos.saturating_sub(device_nanos);
        let stepped = match self.least() {
            Some(least) => self.has_stepped(offset, least, device_nanos, arrival_nanos),
            None => None,
        };
        if let Some(least) = stepped {
            self.forget();
            self.last_nanos = None;
            self.insert(device_nanos, least);
        } else {
            self.insert(device_nanos, offset);
        }
        let mapped = device_nanos.saturating_add(self.least().unwrap_or(offset));
        let (nanos, went_back) = self.in_order(mapped);
        self.last_nanos = Some(nanos);
        HostTime {
            time: Timestamp::from_nanos(nanos),
            stepped: stepped.is_some() || went_back,
        }
    }

    /// Where `device_nanos` lies by what is known already; nothing is learnt from a profile that
    /// came late, nor is it put in order.
    pub(crate) fn place(&self, device_nanos: i64, arrival: Timestamp) -> Timestamp {
        match self.least() {
            Some(least) => Timestamp::from_nanos(device_nanos.saturating_add(least)),
            None => arrival,
        }
    }

    fn least(&self) -> Option<i64> {
        self.buckets.iter().map(|bucket| bucket.least).min()
    }

    /// The new least offset, if this one shows that the old one no longer holds.
    fn has_stepped(&mut self, offset: i64, least: i64, device: i64, arrival: i64) -> Option<i64> {
        let excess = offset.saturating_sub(least);
        if !(-STEP_NANOS..=STEP_NANOS).contains(&excess) {
            return Some(offset);
        }
        if excess <= SUSPECT_NANOS {
            self.suspects = None;
            return None;
        }
        let suspects = self.suspects.get_or_insert(Suspects {
            count: 0,
            device,
            arrival,
            least: offset,
        });
        suspects.count += 1;
        suspects.least = suspects.least.min(offset);
        let arrived = arrival.saturating_sub(suspects.arrival);
        let passed = device.saturating_sub(suspects.device);
        // A backlog arrives all at once; a changed clock at the device's pace.
        let for_good = suspects.count >= SUSPECT_COUNT && arrived.saturating_mul(2) >= passed;
        for_good.then_some(suspects.least)
    }

    fn insert(&mut self, device_nanos: i64, offset: i64) {
        match self.buckets.back_mut() {
            Some(newest) if device_nanos.saturating_sub(newest.since) < BUCKET_NANOS => {
                newest.least = newest.least.min(offset);
            }
            _ => self.buckets.push_back(Bucket {
                since: device_nanos,
                least: offset,
            }),
        }
        let too_old = device_nanos.saturating_sub(WINDOW_NANOS);
        while self.buckets.len() > 1 && self.buckets[0].since < too_old {
            self.buckets.pop_front();
        }
    }

    /// A better estimate may put a ping before the one ahead of it: by a little it is kept in
    /// order, by more it was wrong before and goes back, once.
    fn in_order(&self, mapped: i64) -> (i64, bool) {
        match self.last_nanos {
            Some(last) if mapped <= last => {
                let is_little = last.saturating_sub(mapped) <= ORDER_NANOS;
                match is_little {
                    true => (last.saturating_add(1_000), false),
                    false => (mapped, true),
                }
            }
            _ => (mapped, false),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL: i64 = 17 * NANOS_PER_MILLI;
    /// Host minus device.
    const OFFSET: i64 = 1_700_000_000 * NANOS_PER_SECOND;

    /// A delay of 0.3 ms and, most of the time, up to 40 ms more; the same on every run.
    fn delay(i: i64) -> i64 {
        let noise = (i.wrapping_mul(2_654_435_761) >> 7) % 40;
        300_000
            + if i % 4 == 1 {
                0
            } else {
                noise * NANOS_PER_MILLI
            }
    }

    fn feed(clock: &mut HostClock, i: i64, offset: i64) -> i64 {
        let device = i * INTERVAL;
        let arrival = Timestamp::from_nanos(device + offset + delay(i));
        let mapped = clock.map(device, arrival).time.nanos();
        mapped - (device + offset)
    }

    #[test]
    fn ten_pings_under_jitter_are_enough_for_five_milliseconds() {
        let mut clock = HostClock::default();
        for i in 0..5_000 {
            let error = feed(&mut clock, i, OFFSET);
            assert!(i < 10 || error.abs() < 5 * NANOS_PER_MILLI, "{i}: {error}");
        }
    }

    #[test]
    fn drift_of_fifty_ppm_is_followed_both_ways() {
        for ppm in [-50, 50] {
            let mut clock = HostClock::default();
            for i in 0..20_000 {
                let drift = i * INTERVAL / 1_000_000 * ppm;
                let error = feed(&mut clock, i, OFFSET + drift);
                assert!(i < 10 || error.abs() < 5 * NANOS_PER_MILLI, "{i}: {error}");
            }
        }
    }

    #[test]
    fn steps_of_the_host_by_an_hour_or_a_second_are_followed_within_ten_pings() {
        for step_s in [3_600, -3_600, 1, -1] {
            let mut clock = HostClock::default();
            for i in 0..200 {
                feed(&mut clock, i, OFFSET);
            }
            let stepped = OFFSET + step_s * NANOS_PER_SECOND;
            for i in 200..400 {
                let error = feed(&mut clock, i, stepped);
                let is_good = error.abs() < 5 * NANOS_PER_MILLI;
                assert!(i < 210 || is_good, "{step_s} s, {i}: {error}");
            }
        }
    }

    #[test]
    fn a_backlog_is_not_taken_for_a_step() {
        let mut clock = HostClock::default();
        for i in 0..100 {
            feed(&mut clock, i, OFFSET);
        }
        // The link stalls for two seconds and delivers all at once.
        let arrival = Timestamp::from_nanos(220 * INTERVAL + OFFSET);
        for i in 100..220 {
            let mapped = clock.map(i * INTERVAL, arrival);
            let error = mapped.time.nanos() - (i * INTERVAL + OFFSET);
            assert!(!mapped.stepped && error.abs() < 5 * NANOS_PER_MILLI);
        }
    }

    #[test]
    fn extremes_do_not_overflow() {
        let mut clock = HostClock::default();
        for (device, arrival) in [(i64::MAX, i64::MIN), (0, i64::MAX), (i64::MIN, 0)] {
            clock.map(device, Timestamp::from_nanos(arrival));
        }
    }
}
