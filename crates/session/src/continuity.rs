//! Which profiles go on from those before: what no checksum of 16 bits can tell.
//!
//! A profile whose number, time and settings go on from the last one is taken at once. One that
//! breaks with it (a gap, other settings, a reboot) is held until the next goes on from it; if the
//! next goes on from the last one instead, the held one was damage. So an intact profile is never
//! lost to the check, only one that breaks comes one interval late.
//!
//! One from before the last one is late if there is a place for it: its number is free, and its
//! time lies between those of its neighbours. On a link disorder is a few datagrams, in a log
//! whole blocks, anywhere since the first ping.

use crate::seen::Seen;

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
    pub(crate) fn pace(self) -> Option<f64> {
        self.is_forward()
            .then(|| self.millis as f64 / self.pings as f64)
    }

    /// Whether so many pings take about so long: within a factor of two and 5 ms.
    pub(crate) fn keeps(self, pace_ms: f64) -> bool {
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
    /// Taken: it was made before the last one, by so much.
    Late(Advance),
    /// Kept for the next to confirm.
    Held,
    Duplicate,
    /// From before the last one, and there is no place for it among those taken.
    Misplaced,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum HeldFate {
    Taken(Break),
    /// As [`Fate::Late`].
    Late(Advance),
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
/// So far before the first one of a stream, and only while it is young: later it is a restart.
const LATE_BEFORE_FIRST: i64 = 16;
const YOUNG_PINGS: i64 = 64;
/// So many on end without a place, that go on from one another, are a restart and not disorder.
const MISPLACED_RUN: u32 = 16;
/// The longest wait between the first two profiles that needs no confirmation.
const FIRST_INTERVAL_MILLIS: i64 = 10_000;
/// Kinds of settings that are remembered, the newest.
const MOST_SETTINGS: usize = 8;

/// One stream of profiles of one channel.
#[derive(Debug, Clone, Default)]
pub(crate) struct Continuity {
    is_log: bool,
    last: Option<Stamp>,
    /// Numbers of the first and the last one since the device started, across the wrap.
    first_number: i64,
    last_number: i64,
    /// Whether no pings were counted before `first_number`, so that lower ones are free.
    is_first_life: bool,
    seen: Seen,
    /// One stamp of each kind of settings that were confirmed.
    settings: Vec<Stamp>,
    pace_ms: Option<f64>,
    held: Option<Held>,
    misplaced: Option<(Stamp, u32)>,
}

#[derive(Debug, Clone, Copy)]
struct Held {
    stamp: Stamp,
    /// From the one before, if time went forward from it.
    pace_ms: Option<f64>,
    /// It has a place before the last one; only its settings are new.
    is_late: bool,
}

/// Where a profile from before the last one belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// Between two that were taken.
    Free,
    /// The same number was taken, with another time or in another order.
    Conflict,
    /// So far back that it is not known any more.
    Forgotten,
}

impl Continuity {
    /// `is_first` if no pings were counted before this stream.
    pub(crate) fn new(is_log: bool, is_first: bool) -> Self {
        Self {
            is_log,
            is_first_life: is_first,
            ..Self::default()
        }
    }

    pub(crate) fn judge(&mut self, stamp: Stamp) -> Verdict {
        let Some(last) = self.last else {
            return Verdict::this(Fate::Taken(self.take(stamp)));
        };
        if self.is_again(&last, &stamp) {
            return self.judge_again(stamp);
        }
        if let Some(verdict) = self.judge_by_held(&last, stamp) {
            return verdict;
        }
        self.judge_by_last(&last, stamp)
    }

    /// Whether it was taken already, or there is a place for it before the last one.
    pub(crate) fn has_place_for(&self, stamp: &Stamp) -> bool {
        let Some(last) = &self.last else {
            return true;
        };
        let step = Advance::between(last, stamp);
        let is_behind = step.is_behind() && self.may_be_late(step);
        self.is_again(last, stamp) || (is_behind && self.place_of(step, stamp) == Place::Free)
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

    /// Number and time are those of one that was taken, or all of it is the one held.
    fn is_again(&self, last: &Stamp, stamp: &Stamp) -> bool {
        let number = self.number_of(Advance::between(last, stamp));
        self.seen.millis_of(number) == Some(stamp.timestamp_ms)
            || self.held.is_some_and(|held| held.stamp == *stamp)
    }

    /// A log may hold a block twice; a live unit whose numbers and times all come again was
    /// restarted.
    fn judge_again(&mut self, stamp: Stamp) -> Verdict {
        match self.is_log {
            true => Verdict::this(Fate::Duplicate),
            false => self.judge_misplaced(stamp, Fate::Duplicate),
        }
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
            let held_fate = self.confirm(last, &held);
            let this = match held_fate {
                HeldFate::Late(_) => self.judge_by_last(last, stamp).this,
                _ => Fate::Taken(self.take(stamp)),
            };
            return Some(Verdict {
                this,
                held: Some(held_fate),
            });
        }
        if stamp.is_like(last) {
            return None;
        }
        // A third set of settings: they do change from ping to ping.
        let held_fate = self.confirm(last, &held);
        self.hold(stamp, Some(step), held.is_late);
        Some(Verdict {
            this: Fate::Held,
            held: Some(held_fate),
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
        match step.is_behind() && self.may_be_late(step) {
            true => self.judge_behind(step, stamp),
            false => self.hold_on(step, stamp, false),
        }
    }

    /// One from before the last one, `step` from it.
    fn judge_behind(&mut self, step: Advance, stamp: Stamp) -> Verdict {
        match self.place_of(step, &stamp) {
            Place::Free if self.knows_settings_of(&stamp) => {
                self.misplaced = None;
                self.note(&stamp, step);
                Verdict::this(Fate::Late(step))
            }
            Place::Free => self.hold_on(step, stamp, true),
            Place::Forgotten => Verdict::this(Fate::Misplaced),
            Place::Conflict => self.judge_misplaced(stamp, Fate::Misplaced),
        }
    }

    /// The next shall confirm this one; one that was held before it is not confirmed by it.
    fn hold_on(&mut self, step: Advance, stamp: Stamp, is_late: bool) -> Verdict {
        let dropped = self.held.map(|_| HeldFate::Dropped);
        let from_held = self
            .held
            .map(|held| Advance::between(&held.stamp, &stamp))
            .filter(|step| step.is_forward());
        self.hold(stamp, from_held.or(Some(step)), is_late);
        Verdict {
            this: Fate::Held,
            held: dropped,
        }
    }

    /// Whether disorder can be so large: in a log any since the first, on a link some datagrams.
    fn may_be_late(&self, step: Advance) -> bool {
        let within_log = self.is_log && self.number_of(step) >= self.first_number;
        within_log || (step.pings >= -LATE_PINGS && step.millis >= -LATE_MILLIS)
    }

    /// Where it belongs: its number must be free, and its time lie between its neighbours'.
    fn place_of(&self, step: Advance, stamp: &Stamp) -> Place {
        let number = self.number_of(step);
        if number >= self.first_number && !self.seen.remembers(number) {
            return Place::Forgotten;
        }
        let is_order = |earlier: u32, later: u32| later.wrapping_sub(earlier).cast_signed() >= 0;
        let millis = stamp.timestamp_ms;
        let before = self.seen.millis_before(number);
        let after = self.seen.millis_after(number);
        let is_free = self.seen.millis_of(number).is_none()
            && before.is_none_or(|before| is_order(before, millis))
            && after.is_none_or(|after| is_order(millis, after))
            && (number >= self.first_number || self.may_precede_first(step));
        match is_free {
            true => Place::Free,
            false => Place::Conflict,
        }
    }

    /// The first datagrams of a link change places like any others.
    fn may_precede_first(&self, step: Advance) -> bool {
        let number = self.number_of(step);
        let backwards = Advance {
            pings: -step.pings,
            millis: -step.millis,
        };
        self.is_first_life
            && number >= 0
            && number >= self.first_number - LATE_BEFORE_FIRST
            && self.last_number - self.first_number <= YOUNG_PINGS
            && self.pace_ms.is_none_or(|pace_ms| backwards.keeps(pace_ms))
    }

    /// Left out as `fate`, unless it is one of a row that only a restart explains.
    fn judge_misplaced(&mut self, stamp: Stamp, fate: Fate) -> Verdict {
        let goes_on = |before: &Stamp| Advance::between(before, &stamp).is_forward();
        let run = match self.misplaced {
            Some((before, run)) if goes_on(&before) => run + 1,
            _ => 1,
        };
        if run < MISPLACED_RUN {
            self.misplaced = Some((stamp, run));
            return Verdict::this(fate);
        }
        let dropped = self.held.take().map(|_| HeldFate::Dropped);
        Verdict {
            this: Fate::Taken(self.restart(stamp)),
            held: dropped,
        }
    }

    fn hold(&mut self, stamp: Stamp, step: Option<Advance>, is_late: bool) {
        let pace_ms = step.and_then(Advance::pace);
        self.held = Some(Held {
            stamp,
            pace_ms,
            is_late,
        });
    }

    /// The held one is taken, at its place.
    fn confirm(&mut self, last: &Stamp, held: &Held) -> HeldFate {
        if !held.is_late {
            return HeldFate::Taken(self.take(held.stamp));
        }
        self.held = None;
        let step = Advance::between(last, &held.stamp);
        self.note(&held.stamp, step);
        HeldFate::Late(step)
    }

    /// Goes on from `stamp`.
    fn take(&mut self, stamp: Stamp) -> Break {
        let Some(last) = self.last else {
            self.begin(&stamp);
            self.last = Some(stamp);
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
        if advance.millis < 0 {
            return self.restart(stamp);
        }
        self.held = None;
        self.misplaced = None;
        self.last = Some(stamp);
        if advance.pings < 1 {
            self.is_first_life = false;
            self.begin(&stamp);
            return Break::Renumbered(advance);
        }
        self.note(&stamp, advance);
        self.last_number = self.number_of(advance);
        Break::Forward(advance)
    }

    /// The device was restarted: `stamp` is the first of its new life.
    fn restart(&mut self, stamp: Stamp) -> Break {
        self.held = None;
        self.misplaced = None;
        self.is_first_life = false;
        self.begin(&stamp);
        self.last = Some(stamp);
        Break::Restart
    }

    fn begin(&mut self, stamp: &Stamp) {
        let number = i64::from(stamp.ping_number);
        (self.first_number, self.last_number) = (number, number);
        self.seen = Seen::from(number);
        let no_step = Advance {
            pings: 0,
            millis: 0,
        };
        self.note(stamp, no_step);
    }

    /// Remembers one that is taken, `step` from the last.
    fn note(&mut self, stamp: &Stamp, step: Advance) {
        let number = self.number_of(step);
        self.seen.insert(number, stamp.timestamp_ms, self.is_log);
        if !self.knows_settings_of(stamp) {
            if self.settings.len() == MOST_SETTINGS {
                self.settings.remove(0);
            }
            self.settings.push(*stamp);
        }
    }

    fn knows_settings_of(&self, stamp: &Stamp) -> bool {
        self.settings.iter().any(|known| stamp.is_like(known))
    }

    /// Across the wrap.
    fn number_of(&self, step: Advance) -> i64 {
        self.last_number.saturating_add(step.pings)
    }
}

impl Verdict {
    fn this(this: Fate) -> Self {
        Self { this, held: None }
    }
}

#[cfg(test)]
mod tests;
