//! What a stamp means beside those before it: newer, a late copy, or of a clock that began anew.
//!
//! Over two routes every message comes twice, the second time late; over a lossy one some overtake others. A message
//! that is no newer than the newest of its kind is of no use and left out. A clock that begins anew looks like a late
//! route at first, and is told by three things: its messages are no copies of what was heard, none of the old clock's
//! comes meanwhile, and it counts from no earlier than when the old clock was last heard.

use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};

use echosplat_join::StampClock;
use echosplat_model::Timestamp;

use super::message::{Message, Odometry};
use crate::clock::LeastDelay;

const NANOS_PER_MILLI: i64 = 1_000_000;
const NANOS_PER_SECOND: i64 = 1_000_000_000;
/// `time_boot_ms` wraps after 49.7 days.
const WRAP_MS: i64 = 1 << 32;
/// A message of one kind may lie behind those of others by this much: kinds are sent in turn, and links reorder.
const OVERTAKEN_NANOS: i64 = 2 * NANOS_PER_SECOND;
/// A message that arrives before it was sent, by more than a delay that was never less, is of another clock.
const AHEAD_NANOS: i64 = NANOS_PER_SECOND / 4;
/// So many messages of another clock, in their order, are for good.
const RUN_COUNT: u32 = 5;
/// A run that cannot have begun after the old clock was last heard has to last so long: the old clock may be silent for
/// a moment while a late route goes on.
const DOUBTFUL_RUN_NANOS: i64 = 3 * NANOS_PER_SECOND;
/// No route is later than what is remembered: seconds of a kind, and messages of it, 250 a second.
const REMEMBERED_NANOS: i64 = 65 * NANOS_PER_SECOND;
const REMEMBERED_COUNT: usize = 16_384;
/// A stamp that comes again with the same content is a copy; so many times, and the clock stands still.
const COPY_COUNT: u32 = 4;

/// Kinds of message, each with an order of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MessageKind {
    Attitude,
    Quaternion,
    Position,
    Odometry,
    SystemTime,
}

const KIND_COUNT: usize = 5;

/// What a stamp means. Times are nanoseconds on the sender's clock, unwrapped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    /// To be used.
    At(i64),
    /// A copy, or older than what its kind has told since: left out.
    Late,
    /// To be used; the clock began anew.
    Anew(i64),
}

/// Where a clock begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CountsFrom {
    /// 0 at power-up.
    Boot,
    /// 1970, as far as it was ever set.
    Unix,
}

/// The order of one clock's messages.
#[derive(Debug)]
pub(crate) struct Order {
    counts_from: CountsFrom,
    /// Whether arrival tells how late messages are; where the data have a clock of their own it does not.
    knows_arrival: bool,
    newest: Option<i64>,
    delay: LeastDelay,
    kinds: [Heard; KIND_COUNT],
    /// Before the clock began anew: a late route still brings that.
    former: [Heard; KIND_COUNT],
    behind: Option<Run>,
    ahead: Option<Run>,
}

/// What one kind has told, oldest first, each with what it said.
#[derive(Debug, Default)]
struct Heard {
    stamps: VecDeque<(i64, u64)>,
    copies: u32,
}

impl Heard {
    fn newest(&self) -> Option<i64> {
        self.stamps.back().map(|(stamp, _)| *stamp)
    }

    fn has(&self, stamp: i64, content: u64) -> bool {
        let first = self.stamps.partition_point(|(other, _)| *other < stamp);
        let same = self.stamps.range(first..);
        let mut same = same.take_while(|(other, _)| *other == stamp);
        same.any(|(_, other)| *other == content)
    }

    fn remember(&mut self, stamp: i64, content: u64) {
        self.copies = 0;
        self.stamps.push_back((stamp, content));
        let is_old = |(oldest, _): &(i64, u64)| stamp.saturating_sub(*oldest) > REMEMBERED_NANOS;
        while self.stamps.len() > REMEMBERED_COUNT || self.stamps.front().is_some_and(is_old) {
            self.stamps.pop_front();
        }
    }
}

/// Messages one after another that are not of the clock followed.
#[derive(Debug, Clone, Copy)]
struct Run {
    count: u32,
    first: i64,
    newest: i64,
    first_arrived: i64,
    newest_arrived: i64,
    /// Messages of the clock followed since it began.
    against: u32,
}

impl Run {
    fn begin(stamp: i64, arrived: i64) -> Self {
        Self {
            count: 1,
            first: stamp,
            newest: stamp,
            first_arrived: arrived,
            newest_arrived: arrived,
            against: 0,
        }
    }

    /// With one more: one that is older begins another run, one further ahead than time has passed is of neither.
    fn with(self, stamp: i64, arrived: i64, knows_arrival: bool) -> Self {
        if stamp < self.newest.saturating_sub(OVERTAKEN_NANOS) {
            return Self::begin(stamp, arrived);
        }
        let passed = arrived.saturating_sub(self.newest_arrived).max(0);
        let furthest = self
            .newest
            .saturating_add(passed)
            .saturating_add(OVERTAKEN_NANOS);
        if knows_arrival && stamp > furthest {
            return self;
        }
        Self {
            count: self.count + 1,
            newest: stamp.max(self.newest),
            newest_arrived: arrived,
            ..self
        }
    }

    fn goes_on(&self) -> bool {
        self.count >= RUN_COUNT && self.newest > self.first
    }
}

impl Order {
    pub(crate) fn new(counts_from: CountsFrom, stamps: StampClock) -> Self {
        Self {
            counts_from,
            knows_arrival: stamps == StampClock::Host,
            newest: None,
            delay: LeastDelay::default(),
            kinds: Default::default(),
            former: Default::default(),
            behind: None,
            ahead: None,
        }
    }

    /// Of a `time_boot_ms`.
    pub(crate) fn step_boot_ms(
        &mut self,
        kind: MessageKind,
        boot_ms: u32,
        content: u64,
        arrived: Timestamp,
    ) -> Step {
        let stamp = self.unwrapped(boot_ms);
        self.step(kind, stamp, content, arrived)
    }

    /// A `time_boot_ms` in nanoseconds, on the turn that is nearest to the newest.
    pub(crate) fn unwrapped(&self, boot_ms: u32) -> i64 {
        let newest = self.newest.unwrap_or(0).div_euclid(NANOS_PER_MILLI);
        let mut unwrapped = newest.div_euclid(WRAP_MS) * WRAP_MS + i64::from(boot_ms);
        // A whole turn less by more than half is the next turn.
        if newest - unwrapped > WRAP_MS / 2 {
            unwrapped += WRAP_MS;
        } else if unwrapped - newest > WRAP_MS / 2 && unwrapped >= WRAP_MS {
            unwrapped -= WRAP_MS;
        }
        unwrapped.saturating_mul(NANOS_PER_MILLI)
    }

    /// The newest heard, nanoseconds.
    pub(crate) fn newest(&self) -> Option<i64> {
        self.newest
    }

    /// Of a stamp that does not wrap, nanoseconds. `content` stands for what the message says.
    pub(crate) fn step(
        &mut self,
        kind: MessageKind,
        stamp: i64,
        content: u64,
        arrived: Timestamp,
    ) -> Step {
        let Some(newest) = self.newest else {
            return self.take(kind, stamp, content, arrived);
        };
        if self.is_copy(kind, stamp, content) {
            return Step::Late;
        }
        if stamp > newest {
            return match self.is_ahead(stamp, arrived) {
                true => self.doubt_ahead(kind, stamp, content, arrived),
                false => self.take(kind, stamp, content, arrived),
            };
        }
        if newest.saturating_sub(stamp) > OVERTAKEN_NANOS {
            return self.doubt_behind(kind, stamp, content, arrived);
        }
        // An equal stamp of other content: the clock stands still, which others find out and tell.
        match self.kinds[kind as usize].newest() {
            Some(of_kind) if stamp < of_kind => Step::Late,
            _ => self.take(kind, stamp, content, arrived),
        }
    }

    /// How far a `time_boot_ms` lies before the newest heard, seconds; 0 if it does not.
    pub(crate) fn behind_s(&self, boot_ms: u32) -> f64 {
        let newest_ms = self.newest.unwrap_or(0) / NANOS_PER_MILLI;
        let behind_ms = newest_ms.rem_euclid(WRAP_MS) - i64::from(boot_ms);
        (behind_ms.max(0) as f64) * 1e-3
    }

    fn is_copy(&mut self, kind: MessageKind, stamp: i64, content: u64) -> bool {
        let heard = &mut self.kinds[kind as usize];
        let is_copy = heard.has(stamp, content) || self.former[kind as usize].has(stamp, content);
        let heard = &mut self.kinds[kind as usize];
        if is_copy && heard.newest() == Some(stamp) {
            heard.copies = heard.copies.saturating_add(1);
            return heard.copies < COPY_COUNT;
        }
        is_copy
    }

    fn take(&mut self, kind: MessageKind, stamp: i64, content: u64, arrived: Timestamp) -> Step {
        if self.newest.is_none_or(|newest| stamp > newest) {
            self.newest = Some(stamp);
            self.behind = None;
        }
        if let Some(run) = &mut self.ahead {
            run.against += 1;
            if run.against > 3 * run.count {
                self.ahead = None;
            }
        }
        let heard = &mut self.kinds[kind as usize];
        if heard.newest().is_none_or(|of_kind| stamp > of_kind) {
            heard.remember(stamp, content);
        }
        self.delay.observe(stamp, arrived);
        Step::At(stamp)
    }

    fn is_ahead(&self, stamp: i64, arrived: Timestamp) -> bool {
        let Some(least) = self.delay.offset_at(stamp).filter(|_| self.knows_arrival) else {
            return false;
        };
        let sent = stamp.saturating_add(least);
        sent.saturating_sub(arrived.nanos()) > AHEAD_NANOS
    }

    /// What comes before it was sent, again and again, has taken a shorter way than what was heard until now; a few
    /// among many are wrong.
    fn doubt_ahead(
        &mut self,
        kind: MessageKind,
        stamp: i64,
        content: u64,
        arrived: Timestamp,
    ) -> Step {
        let run = self.run_with(self.ahead, stamp, arrived);
        if !run.goes_on() {
            self.ahead = Some(run);
            return Step::Late;
        }
        self.ahead = None;
        self.take(kind, stamp, content, arrived)
    }

    fn run_with(&self, run: Option<Run>, stamp: i64, arrived: Timestamp) -> Run {
        match run {
            Some(run) => run.with(stamp, arrived.nanos(), self.knows_arrival),
            None => Run::begin(stamp, arrived.nanos()),
        }
    }

    fn doubt_behind(
        &mut self,
        kind: MessageKind,
        stamp: i64,
        content: u64,
        arrived: Timestamp,
    ) -> Step {
        let run = self.run_with(self.behind, stamp, arrived);
        let lasts = arrived
            .nanos()
            .saturating_sub(run.first_arrived)
            .saturating_abs();
        let is_anew = run.goes_on()
            && (self.may_have_begun_since(stamp, arrived) || lasts >= DOUBTFUL_RUN_NANOS);
        if !is_anew {
            self.behind = Some(run);
            return Step::Late;
        }
        self.former = std::mem::take(&mut self.kinds);
        self.newest = None;
        self.delay = LeastDelay::default();
        self.ahead = None;
        let stamp = self.counted_anew(stamp);
        self.take(kind, stamp, content, arrived);
        Step::Anew(stamp)
    }

    /// What a stamp is once the turns of the clock before are forgotten.
    fn counted_anew(&self, stamp: i64) -> i64 {
        match self.counts_from {
            CountsFrom::Boot => stamp.rem_euclid(WRAP_MS * NANOS_PER_MILLI),
            CountsFrom::Unix => stamp,
        }
    }

    /// Whether a clock that stands at `stamp` now was switched on after the newest message was sent. One that counts from
    /// 1970 is set to whatever it likes.
    fn may_have_begun_since(&self, stamp: i64, arrived: Timestamp) -> bool {
        if self.counts_from == CountsFrom::Unix {
            return true;
        }
        let newest = self.newest.unwrap_or(0);
        let Some(least) = self.delay.offset_at(newest).filter(|_| self.knows_arrival) else {
            return true;
        };
        let booted = arrived.nanos().saturating_sub(self.counted_anew(stamp));
        let last_sent = newest.saturating_add(least);
        booted >= last_sent.saturating_sub(OVERTAKEN_NANOS)
    }
}

/// Stands for what a message says, the stamp apart.
pub(crate) fn content_of(message: &Message) -> u64 {
    let mut hasher = DefaultHasher::new();
    let mut add = |values: &[f64]| values.iter().for_each(|v| v.to_bits().hash(&mut hasher));
    match message {
        Message::Attitude { ned_from_frd, .. } => add(&ned_from_frd.to_array()),
        Message::Position {
            position_ned_m,
            velocity_ned_mps,
            ..
        } => {
            add(&position_ned_m.to_array());
            add(&velocity_ned_mps.to_array());
        }
        Message::Odometry(odometry) => {
            let Odometry {
                position_m,
                frame_from_body,
                reset_counter,
                ..
            } = &**odometry;
            add(&position_m.to_array());
            add(&frame_from_body.to_array());
            add(&[f64::from(*reset_counter)]);
        }
        Message::SystemTime { unix_us, .. } => unix_us.hash(&mut hasher),
        Message::TimeSync { .. }
        | Message::Heartbeat { .. }
        | Message::GlobalOrigin(_)
        | Message::GlobalPosition { .. }
        | Message::Height(_)
        | Message::EstimateStatus { .. }
        | Message::PositionDelta { .. }
        | Message::Speed { .. } => {}
    }
    hasher.finish()
}
