//! Which profiles go on from those before: what no checksum of 16 bits can tell.
//!
//! A profile whose number, time and settings go on from the last one is taken at once. One that
//! breaks with it (a gap, other settings, a reboot) is held until the next goes on from it; if the
//! next goes on from the last one instead, the held one was damage. So an intact profile is never
//! lost to the check, only one that breaks comes one interval late.

/// What a profile says of when and how it was made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stamp {
    pub(crate) ping_number: u32,
    pub(crate) timestamp_ms: u32,
    pub(crate) start_mm: u32,
    pub(crate) length_mm: u32,
    pub(crate) bin_count: usize,
    pub(crate) sos_dmps: u16,
    pub(crate) ping_hz: u32,
    pub(crate) pulse_duration_s: f32,
}

impl Stamp {
    /// Same range and bins; sound, carrier and pulse within what a unit may trim by itself.
    /// Gain is left out: automatic gain walks from ping to ping.
    fn is_like(&self, other: &Self) -> bool {
        let near = |a: f64, b: f64| (a - b).abs() <= 0.02 * a.abs().max(b.abs());
        (self.start_mm, self.length_mm, self.bin_count)
            == (other.start_mm, other.length_mm, other.bin_count)
            && self.sos_dmps.abs_diff(other.sos_dmps) <= 20
            && near(self.ping_hz.into(), other.ping_hz.into())
            && near(self.pulse_duration_s.into(), other.pulse_duration_s.into())
    }
}

/// From one stamp to another, across the wrap of both counters (differences of half their span).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Advance {
    pub(crate) pings: i64,
    pub(crate) millis: i64,
}

impl Advance {
    pub(crate) fn between(from: &Stamp, to: &Stamp) -> Self {
        let signed = |from: u32, to: u32| i64::from(to.wrapping_sub(from).cast_signed());
        Self {
            pings: signed(from.ping_number, to.ping_number),
            millis: signed(from.timestamp_ms, to.timestamp_ms),
        }
    }

    fn is_forward(self) -> bool {
        self.pings >= 1 && self.millis >= 0
    }

    fn is_behind(self) -> bool {
        self.pings <= 0 && self.millis <= 0
    }

    /// Milliseconds per ping.
    fn pace(self) -> Option<f64> {
        self.is_forward()
            .then(|| self.millis as f64 / self.pings as f64)
    }

    /// Whether so many pings take about so long: within a factor of two and 5 ms.
    fn keeps(self, pace_ms: f64) -> bool {
        let expected_ms = self.pings as f64 * pace_ms;
        let millis = self.millis as f64;
        self.is_forward() && millis >= 0.5 * expected_ms - 5.0 && millis <= 2.0 * expected_ms + 5.0
    }
}

/// What becomes of a profile, and of the one that was held before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Verdict {
    pub(crate) this: Fate,
    /// `None` if none was held, or it is held on.
    pub(crate) held: Option<HeldFate>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fate {
    Taken(Break),
    /// Kept for the next to confirm.
    Held,
    Duplicate,
    Late,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HeldFate {
    Taken(Break),
    Dropped,
}

/// How a profile that is taken goes on from the one taken before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Break {
    /// The first of a stream.
    First,
    /// Number and time go on by so much.
    Forward(Advance),
    /// Time fell back: the device was restarted. The pace before that, in ms per ping.
    Restart,
    /// The number fell back and time did not: the device counts anew.
    Renumbered(Advance),
}

/// How far back a live stream's number and time may be put down to the link's order.
const LATE_PINGS: i64 = 256;
const LATE_MILLIS: i64 = 10_000;
/// So many late profiles on end that go on from one another are a reboot, not disorder: live
/// links disorder a few datagrams, log files whole blocks.
const LATE_RUN_LIVE: u32 = 16;
const LATE_RUN_LOG: u32 = 1024;
/// The longest wait between the first two profiles that needs no confirmation.
const FIRST_INTERVAL_MILLIS: i64 = 10_000;

/// One stream of profiles of one channel.
#[derive(Debug, Clone, Default)]
pub(crate) struct Continuity {
    is_log: bool,
    first: Option<Stamp>,
    last: Option<Stamp>,
    pace_ms: Option<f64>,
    held: Option<Held>,
    late: Option<(Stamp, u32)>,
}

#[derive(Debug, Clone, Copy)]
struct Held {
    stamp: Stamp,
    /// From the one before, if time went forward from it.
    pace_ms: Option<f64>,
}

impl Continuity {
    pub(crate) fn new(is_log: bool) -> Self {
        Self {
            is_log,
            ..Self::default()
        }
    }

    pub(crate) fn judge(&mut self, stamp: Stamp) -> Verdict {
        let Some(last) = self.last else {
            self.first = Some(stamp);
            self.last = Some(stamp);
            return Verdict::this(Fate::Taken(Break::First));
        };
        if let Some(verdict) = self.judge_by_held(&last, stamp) {
            return verdict;
        }
        self.judge_by_last(&last, stamp)
    }

    /// Nothing more comes: whether the held one is taken after all, which it is if nothing but
    /// its distance speaks against it.
    pub(crate) fn release(&mut self) -> Option<HeldFate> {
        let held = self.held.take()?;
        let last = self.last?;
        let advance = Advance::between(&last, &held.stamp);
        if !(advance.is_forward() && held.stamp.is_like(&last)) {
            return Some(HeldFate::Dropped);
        }
        Some(HeldFate::Taken(self.take(held.stamp)))
    }

    fn judge_by_held(&mut self, last: &Stamp, stamp: Stamp) -> Option<Verdict> {
        let held = self.held?;
        let step = Advance::between(&held.stamp, &stamp);
        let own = |pace: Option<f64>| pace.is_some_and(|pace_ms| step.keeps(pace_ms));
        let from_last = Advance::between(last, &stamp);
        let lies_between = Advance::between(last, &held.stamp).is_forward()
            && step.is_forward()
            && self.pace_ms.is_some_and(|pace_ms| from_last.keeps(pace_ms));
        if !(own(self.pace_ms) || own(held.pace_ms) || lies_between) {
            return None;
        }
        if stamp.is_like(&held.stamp) {
            let held_break = self.take(held.stamp);
            let this = Fate::Taken(self.take(stamp));
            return Some(Verdict {
                this,
                held: Some(HeldFate::Taken(held_break)),
            });
        }
        if stamp.is_like(last) {
            return None;
        }
        // A third set of settings: they do change from ping to ping.
        let held_break = self.take(held.stamp);
        self.hold(stamp, Some(step));
        Some(Verdict {
            this: Fate::Held,
            held: Some(HeldFate::Taken(held_break)),
        })
    }

    fn judge_by_last(&mut self, last: &Stamp, stamp: Stamp) -> Verdict {
        let step = Advance::between(last, &stamp);
        let in_pace = match self.pace_ms {
            Some(pace_ms) => step.keeps(pace_ms),
            None => step.is_forward() && step.millis <= FIRST_INTERVAL_MILLIS,
        };
        if in_pace && stamp.is_like(last) {
            let dropped = self.held.take().map(|_| HeldFate::Dropped);
            return Verdict {
                this: Fate::Taken(self.take(stamp)),
                held: dropped,
            };
        }
        if (step.pings, step.millis) == (0, 0) {
            return Verdict::this(Fate::Duplicate);
        }
        if step.is_behind() && self.may_be_late(step, &stamp) {
            return self.judge_late(stamp);
        }
        let dropped = self.held.map(|_| HeldFate::Dropped);
        let from_held = self
            .held
            .map(|held| Advance::between(&held.stamp, &stamp))
            .filter(|step| step.is_forward());
        self.hold(stamp, from_held.or(Some(step)));
        Verdict {
            this: Fate::Held,
            held: dropped,
        }
    }

    fn may_be_late(&self, step: Advance, stamp: &Stamp) -> bool {
        let since_first = self.first.map(|first| Advance::between(&first, stamp));
        let within_log = self.is_log && since_first.is_some_and(|a| a.pings >= 0 && a.millis >= 0);
        within_log || (step.pings >= -LATE_PINGS && step.millis >= -LATE_MILLIS)
    }

    fn judge_late(&mut self, stamp: Stamp) -> Verdict {
        let goes_on = |before: &Stamp| Advance::between(before, &stamp).is_forward();
        let run = match self.late {
            Some((before, run)) if goes_on(&before) => run + 1,
            _ => 1,
        };
        let limit = if self.is_log {
            LATE_RUN_LOG
        } else {
            LATE_RUN_LIVE
        };
        if run < limit {
            self.late = Some((stamp, run));
            return Verdict::this(Fate::Late);
        }
        let dropped = self.held.take().map(|_| HeldFate::Dropped);
        Verdict {
            this: Fate::Taken(self.take(stamp)),
            held: dropped,
        }
    }

    fn hold(&mut self, stamp: Stamp, step: Option<Advance>) {
        let pace_ms = step.and_then(Advance::pace);
        self.held = Some(Held { stamp, pace_ms });
    }

    /// Goes on from `stamp`.
    fn take(&mut self, stamp: Stamp) -> Break {
        self.held = None;
        self.late = None;
        let Some(last) = self.last.replace(stamp) else {
            return Break::First;
        };
        let advance = Advance::between(&last, &stamp);
        if let Some(pace_ms) = advance.pace() {
            // A single pause or hurry is no pace: it moves by half at most.
            self.pace_ms = Some(self.pace_ms.map_or(pace_ms, |known_ms| {
                let nearer_ms = known_ms + 0.25 * (pace_ms - known_ms);
                nearer_ms.clamp(known_ms / 1.5, known_ms.max(1.0) * 1.5)
            }));
        }
        match advance {
            _ if advance.millis < 0 => {
                self.first = Some(stamp);
                Break::Restart
            }
            _ if advance.pings < 1 => {
                self.first = Some(stamp);
                Break::Renumbered(advance)
            }
            _ => Break::Forward(advance),
        }
    }
}

impl Verdict {
    fn this(this: Fate) -> Self {
        Self { this, held: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamp(ping_number: u32, timestamp_ms: u32) -> Stamp {
        Stamp {
            ping_number,
            timestamp_ms,
            start_mm: 0,
            length_mm: 10_000,
            bin_count: 600,
            sos_dmps: 15_000,
            ping_hz: 451_127,
            pulse_duration_s: 2e-5,
        }
    }

    fn running(is_log: bool) -> Continuity {
        let mut continuity = Continuity::new(is_log);
        for i in 0..20 {
            let verdict = continuity.judge(stamp(100 + i, 5_000 + 25 * i));
            assert!(matches!(verdict.this, Fate::Taken(_)));
        }
        continuity
    }

    fn forward(pings: i64, millis: i64) -> Break {
        Break::Forward(Advance { pings, millis })
    }

    #[test]
    fn lost_profiles_and_a_long_outage_go_on_at_once() {
        let mut c = running(false);
        let after_loss = c.judge(stamp(124, 5_600));
        assert_eq!(after_loss.this, Fate::Taken(forward(5, 125)));
        let after_outage = c.judge(stamp(10_124, 255_600));
        assert_eq!(after_outage.this, Fate::Taken(forward(10_000, 250_000)));
    }

    #[test]
    fn a_pause_is_held_and_confirmed_by_the_next() {
        let mut c = running(false);
        assert_eq!(c.judge(stamp(120, 70_000)).this, Fate::Held);
        let next = c.judge(stamp(121, 70_025));
        assert_eq!(next.held, Some(HeldFate::Taken(forward(1, 64_525))));
        assert_eq!(next.this, Fate::Taken(forward(1, 25)));
        assert_eq!(
            c.judge(stamp(122, 70_050)).this,
            Fate::Taken(forward(1, 25))
        );
    }

    #[test]
    fn damage_in_number_time_or_settings_is_dropped_and_its_neighbours_kept() {
        let mut damaged = [stamp(120, 5_500); 4];
        damaged[0].ping_number ^= 1 << 14;
        damaged[1].timestamp_ms ^= 1 << 12;
        damaged[2].length_mm ^= 1 << 9;
        damaged[3].timestamp_ms &= !0xfff;
        for bad in damaged {
            let mut c = running(false);
            assert_eq!(c.judge(bad).this, Fate::Held, "{bad:?}");
            let next = c.judge(stamp(121, 5_525));
            assert_eq!(next.held, Some(HeldFate::Dropped), "{bad:?}");
            assert_eq!(next.this, Fate::Taken(forward(2, 50)));
        }
    }

    #[test]
    fn new_settings_are_confirmed_by_the_next_with_the_same_or_yet_others() {
        let mut c = running(false);
        let with_length = |n: u32, length_mm| Stamp {
            length_mm,
            ..stamp(100 + n, 5_000 + 25 * n)
        };
        assert_eq!(c.judge(with_length(20, 20_000)).this, Fate::Held);
        let third = c.judge(with_length(21, 30_000));
        assert_eq!(
            (third.this, third.held),
            (Fate::Held, Some(HeldFate::Taken(forward(1, 25))))
        );
        let same = c.judge(with_length(22, 30_000));
        assert_eq!(same.held, Some(HeldFate::Taken(forward(1, 25))));
        assert_eq!(same.this, Fate::Taken(forward(1, 25)));
    }

    #[test]
    fn falling_back_in_both_is_a_reboot_even_at_another_pace() {
        let mut c = running(false);
        c.judge(stamp(50_000, 1_252_500));
        assert_eq!(c.judge(stamp(0, 2_000)).this, Fate::Held);
        assert_eq!(c.judge(stamp(1, 2_200)).held, Some(HeldFate::Dropped));
        let third = c.judge(stamp(2, 2_400));
        assert_eq!(third.held, Some(HeldFate::Taken(Break::Restart)));
        assert_eq!(third.this, Fate::Taken(forward(1, 200)));
    }

    #[test]
    fn a_reboot_soon_after_power_up_is_told_from_disorder_by_going_on() {
        let mut c = Continuity::new(false);
        for i in 0..20 {
            c.judge(stamp(i, 25 * i));
        }
        let fates: Vec<Fate> = (0..19)
            .map(|i| c.judge(stamp(i, 10 + 25 * i)).this)
            .collect();
        assert!(fates[..15].iter().all(|&fate| fate == Fate::Late));
        assert_eq!(fates[15], Fate::Taken(Break::Restart));
        assert_eq!(fates[16], Fate::Taken(forward(1, 25)));
    }

    #[test]
    fn late_and_repeated_ones_are_left_out() {
        let mut c = running(false);
        assert_eq!(c.judge(stamp(119, 5_475)).this, Fate::Duplicate);
        assert_eq!(c.judge(stamp(112, 5_300)).this, Fate::Late);
        assert_eq!(c.judge(stamp(120, 5_500)).this, Fate::Taken(forward(1, 25)));
    }

    #[test]
    fn a_block_out_of_order_in_a_log_is_late_however_far_back() {
        let mut c = running(true);
        c.judge(stamp(40_100, 1_005_000));
        for i in 20..600 {
            assert_eq!(c.judge(stamp(100 + i, 5_000 + 25 * i)).this, Fate::Late);
        }
        let next = c.judge(stamp(40_101, 1_005_025)).this;
        assert_eq!(next, Fate::Taken(forward(1, 25)));
    }

    #[test]
    fn uneven_intervals_lose_nothing() {
        let mut c = running(false);
        let mut taken = 0;
        let mut millis = 5_475;
        for (i, interval) in (120..).zip([100, 12, 60, 9, 90, 25, 25, 14, 120, 25, 25]) {
            millis += interval;
            let verdict = c.judge(stamp(i, millis));
            taken += u32::from(matches!(verdict.this, Fate::Taken(_)));
            taken += u32::from(matches!(verdict.held, Some(HeldFate::Taken(_))));
        }
        assert_eq!(taken, 11);
    }

    #[test]
    fn both_counters_wrap() {
        let mut c = Continuity::new(false);
        for i in 0..40u32 {
            let verdict = c.judge(stamp(
                (u32::MAX - 10).wrapping_add(i),
                (u32::MAX - 300).wrapping_add(25 * i),
            ));
            assert!(matches!(verdict.this, Fate::Taken(_)));
            assert!(i == 0 || verdict.this == Fate::Taken(forward(1, 25)));
        }
    }

    #[test]
    fn the_last_one_of_a_log_is_not_lost_for_being_far() {
        let mut c = running(true);
        assert_eq!(c.judge(stamp(120, 70_000)).this, Fate::Held);
        assert_eq!(c.release(), Some(HeldFate::Taken(forward(1, 64_525))));
        assert_eq!(c.release(), None);
    }
}
