//! What is given up when the machine has no time or no memory for all: work on the map first, then
//! maps and pings to look at, then pings of the map. The recording holds all bytes, and every
//! decision that shapes the map, so that a replay comes to the same one.

use std::time::{Duration, Instant};

use echosplat_recording::mcap::Record;
use serde::Serialize;

use crate::clock;
use crate::decided::{self, Decided};
use crate::processor;
use crate::recorder::Recorder;

/// Shares of the mapper's queue at which work is put off, and below which it is done again.
const WORK: [f64; 2] = [0.125, 0.03];
/// The same of what there is to look at.
const PUBLISHING: [f64; 2] = [0.5, 0.125];
/// Fewer pings than this are no load, however short the queue is.
const FEW_PINGS: f64 = 4.0;
/// What is given up is so for at least this long, so that no recording fills with changes of mind.
const AT_LEAST: Duration = Duration::from_secs(1);
/// The kernel is asked so often how much memory is held.
const MEMORY_EVERY: Duration = Duration::from_millis(100);
/// A map is made so often even where nothing else is published: it is what an end would save.
const MAP_AT_LEAST_EVERY: Duration = Duration::from_secs(10);

/// Decides what is given up, or does as a recorded dive did.
pub(crate) struct Shedding {
    /// What a recorded dive decided, while its pings come again.
    before: Option<Decided>,
    /// `None` gives up nothing of its own.
    now: Option<Limits>,
    recorder: Option<Recorder>,
    work: Level,
    publishing: Level,
    /// Pings shed of late, not yet recorded: first and last.
    run: Option<(u64, u64)>,
    report: SheddingReport,
}

/// What is had an eye on.
struct Limits {
    /// The load, where the sonar waits for nobody.
    by_load: bool,
    memory: Memory,
}

/// What was given up, and is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub(crate) struct SheddingReport {
    /// What is given up is what a recorded dive gave up, and no load of this run's.
    pub(crate) as_recorded: bool,
    /// Work on the map is put off.
    pub(crate) work: bool,
    /// Neither maps nor raw pings are published.
    pub(crate) publishing: bool,
    /// The service holds as much memory as it may.
    pub(crate) memory: bool,
    /// Pings taken in without work on the map.
    pub(crate) pings_without_work: u64,
    /// Raw pings not published.
    pub(crate) pings_unpublished: u64,
    /// Pings left out of the map for want of memory.
    pub(crate) pings_without_memory: u64,
}

impl Shedding {
    /// Nothing is given up.
    pub(crate) fn none() -> Self {
        Self::new(None, None, None)
    }

    /// As the load and the memory are; without `by_load` whoever sends pings is held back instead.
    pub(crate) fn as_it_comes(by_load: bool, memory: u64, recorder: Option<Recorder>) -> Self {
        let memory = Memory {
            most_bytes: memory,
            is_full: false,
            next: Instant::now(),
        };
        Self::new(None, Some(Limits { by_load, memory }), recorder)
    }

    /// As a recorded dive did.
    pub(crate) fn as_before(decided: Decided) -> Self {
        Self::new(Some(decided), None, None)
    }

    /// The same while pings come that a recording holds; then by itself. Of memory no more is ever
    /// held than may be.
    pub(crate) fn resuming(self, decided: Decided) -> Self {
        Self {
            before: Some(decided),
            ..self
        }
    }

    fn new(before: Option<Decided>, now: Option<Limits>, recorder: Option<Recorder>) -> Self {
        Self {
            before,
            now,
            recorder,
            work: Level::of(WORK),
            publishing: Level::of(PUBLISHING),
            run: None,
            report: SheddingReport::default(),
        }
    }

    pub(crate) fn report(&self) -> SheddingReport {
        SheddingReport {
            as_recorded: self.before.is_some(),
            ..self.report
        }
    }

    /// The recording has no more to say: what it last gave up is given up until the load says else.
    pub(crate) fn goes_on(&mut self) {
        self.before = None;
        self.work.shed = self.report.work.then(Instant::now);
    }

    /// Whether a ping is left out of the map before anything is made of it.
    pub(crate) fn leaves_out(&mut self, ping: u64, now: Instant) -> bool {
        let decided = self.before.as_ref();
        if decided.is_some_and(|decided| decided.leaves_out(ping)) {
            return true;
        }
        let Some(Limits { memory, .. }) = &mut self.now else {
            return false;
        };
        let is_full = memory.is_full(now);
        self.report.memory = is_full;
        if is_full {
            self.report.pings_without_memory += 1;
            self.left_out(ping);
        }
        is_full
    }

    /// A ping found no room.
    pub(crate) fn left_out(&mut self, ping: u64) {
        match &mut self.run {
            Some((_, last)) if last.checked_add(1) == Some(ping) => *last = ping,
            _ => {
                self.record_run();
                self.run = Some((ping, ping));
            }
        }
    }

    /// Records which pings were left out so far.
    pub(crate) fn record_run(&mut self) {
        if let Some((first, last)) = self.run.take() {
            self.record(decided::pings_shed(first, last));
        }
    }

    /// How full the mapper's queue is as it is about to take this ping in, 0 to 1 of `capacity`; says
    /// from which ping on work is put off or done again, if that changes here.
    pub(crate) fn work_at(
        &mut self,
        ping: u64,
        (queued, capacity): (usize, usize),
    ) -> Option<bool> {
        let change = match (&self.before, &self.now) {
            (Some(decided), _) => decided.work_at(ping),
            (None, Some(Limits { by_load: true, .. })) => self.weigh(ping, queued, capacity),
            (None, Some(_)) if self.report.work => {
                self.record(decided::work_shed(ping, false));
                Some(false)
            }
            (None, _) => None,
        };
        self.report.work = change.unwrap_or(self.report.work);
        self.report.pings_without_work += u64::from(self.report.work);
        change
    }

    fn weigh(&mut self, ping: u64, queued: usize, capacity: usize) -> Option<bool> {
        let (queued, capacity, now) = (queued as f64, capacity.max(1) as f64, Instant::now());
        let few = (FEW_PINGS / capacity).min(1.0);
        let share = queued / capacity;
        if let Some(is_shed) = self.publishing.changes(share, few, now) {
            self.report.publishing = is_shed;
            self.record(decided::publishing_shed(ping, is_shed));
        }
        let change = self.work.changes(share, few, now);
        if let Some(is_shed) = change {
            self.record(decided::work_shed(ping, is_shed));
        }
        change
    }

    /// Whether a raw ping is published.
    pub(crate) fn publishes_ping(&mut self) -> bool {
        self.report.pings_unpublished += u64::from(self.report.publishing);
        !self.report.publishing
    }

    /// Whether a map is made to be looked at, the last being so old.
    pub(crate) fn publishes_map(&self, age: Option<Duration>) -> bool {
        !self.report.publishing || age.is_none_or(|age| age >= MAP_AT_LEAST_EVERY)
    }

    fn record(&self, event: serde_json::Value) {
        if let Some(recorder) = &self.recorder {
            recorder.record(clock::now(), Record::Event(event));
        }
    }
}

/// Something that is given up from one share of the queue on, and back below another.
#[derive(Debug)]
struct Level {
    from: f64,
    below: f64,
    /// When it was last called for, while it is given up.
    shed: Option<Instant>,
}

impl Level {
    fn of([from, below]: [f64; 2]) -> Self {
        Self {
            from,
            below,
            shed: None,
        }
    }

    /// Whether it is given up from now on, if that changes.
    fn changes(&mut self, share: f64, few: f64, now: Instant) -> Option<bool> {
        let was_shed = self.shed.is_some();
        if share >= self.from.max(few) {
            self.shed = Some(now);
        }
        let has_lasted = |shed: Instant| now.saturating_duration_since(shed) >= AT_LEAST;
        if share < self.below.max(0.5 * few) && self.shed.is_some_and(has_lasted) {
            self.shed = None;
        }
        let is_shed = self.shed.is_some();
        (is_shed != was_shed).then_some(is_shed)
    }
}

/// How much memory the process may hold.
#[derive(Debug)]
struct Memory {
    most_bytes: u64,
    is_full: bool,
    next: Instant,
}

impl Memory {
    fn is_full(&mut self, now: Instant) -> bool {
        if now >= self.next {
            self.next = now + MEMORY_EVERY;
            self.is_full = processor::memory_bytes() >= self.most_bytes;
        }
        self.is_full
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_goes_before_publishing_and_comes_back_after_it() {
        let (mut work, mut publishing) = (Level::of(WORK), Level::of(PUBLISHING));
        let begin = Instant::now();
        let mut seen = Vec::new();
        for (after_s, share) in [(0, 0.1), (1, 0.2), (2, 0.6), (3, 0.3), (5, 0.1), (9, 0.0)] {
            let now = begin + Duration::from_secs(after_s);
            let _ = (
                work.changes(share, 0.0, now),
                publishing.changes(share, 0.0, now),
            );
            seen.push((work.shed.is_some(), publishing.shed.is_some()));
        }
        let neither = (false, false);
        let expected = [
            neither,
            (true, false),
            (true, true),
            (true, true),
            (true, false),
            neither,
        ];
        assert_eq!(seen, expected);
    }

    #[test]
    fn what_is_given_up_stays_so_for_a_while() {
        let mut work = Level::of(WORK);
        let begin = Instant::now();
        assert_eq!(work.changes(1.0, 0.0, begin), Some(true));
        assert_eq!(work.changes(0.0, 0.0, begin + AT_LEAST / 2), None);
        assert_eq!(work.changes(0.0, 0.0, begin + AT_LEAST), Some(false));
    }

    #[test]
    fn one_ping_in_a_short_queue_is_no_load() {
        let mut work = Level::of(WORK);
        assert_eq!(
            work.changes(1.0 / 8.0, FEW_PINGS / 8.0, Instant::now()),
            None
        );
    }

    #[test]
    fn a_dive_that_is_resumed_gives_up_what_its_recording_says_and_then_what_the_load_says() {
        let full = (10, 10);
        for by_load in [false, true] {
            let mut decided = Decided::default();
            decided.take(&decided::work_shed(2, true));
            decided.take(&decided::pings_shed(4, 5));
            let shedding = Shedding::as_it_comes(by_load, u64::MAX, None);
            let mut shedding = shedding.resuming(decided);
            let now = Instant::now();
            let left_out: Vec<u64> = (1..7).filter(|&p| shedding.leaves_out(p, now)).collect();
            assert_eq!(left_out, [4, 5]);
            // Its pings come as fast as they are taken: a full queue is no load.
            let changes = [1, 2, 3].map(|ping| shedding.work_at(ping, full));
            assert_eq!(changes, [None, Some(true), None]);
            shedding.goes_on();
            assert!(!shedding.leaves_out(4, now));
            let change = shedding.work_at(7, full);
            assert_eq!(change, if by_load { None } else { Some(false) });
            assert_eq!(shedding.report().work, by_load);
        }
    }

    #[test]
    fn without_memory_pings_are_left_out_and_counted() {
        let mut shedding = Shedding::as_it_comes(true, 1, None);
        assert!(shedding.leaves_out(7, Instant::now()));
        assert_eq!(shedding.run, Some((7, 7)));
        assert_eq!(shedding.report().pings_without_memory, 1);
        let mut roomy = Shedding::as_it_comes(true, u64::MAX, None);
        assert!(!roomy.leaves_out(7, Instant::now()));
    }
}
