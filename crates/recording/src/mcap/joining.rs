//! Whether what a further recording holds came before, goes on from that, or is something else.
//!
//! A record is known again by its time and its bytes. A recording whose records were not there before
//! goes on from the others if it does not go back in time, and if its pings can be put on the clock of
//! those before: each run of a dive on the device's own clock begins that anew.

use std::collections::HashSet;
use std::hash::{DefaultHasher, Hash, Hasher};

use echosplat_model::Timestamp;
use serde_json::Value;

use super::message::time_of;
use super::messages::Message;
use super::topic::Topic;

/// Bytes go back in time by less, seconds, unless a clock was set.
const DISORDER_S: f64 = 1.0;

/// What becomes of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fate {
    Taken,
    /// Until it is known whether the recording goes on from those before.
    Waits,
    Repeated,
    LeftOut,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum State {
    #[default]
    GoesOn,
    Undecided,
    Elsewhere,
}

/// What the parts so far held.
#[derive(Debug, Default)]
pub(super) struct Joining {
    /// Of what a dive is made of.
    seen: HashSet<u64>,
    /// Of the bytes taken last.
    newest: Option<Timestamp>,
    /// What the run said first that recorded the parts so far.
    run: Option<Value>,
    /// The same of the part at hand, if that is another.
    other_run: Option<Value>,
    state: State,
    /// The part at hand is not the first.
    is_further: bool,
    /// It holds some of what came before.
    overlaps: bool,
    /// It goes on, and another run recorded it.
    pub(super) is_another_run: bool,
    /// It has said where in the driver's tape it is.
    has_position: bool,
    /// Names the driver's run, and the number of its record that comes next.
    tape: Option<(u64, u64)>,
    goes_on_with_tape: bool,
}

impl Joining {
    /// Another part begins.
    pub(super) fn begin_part(&mut self) {
        self.state = State::Undecided;
        self.is_further = true;
        self.overlaps = false;
        self.is_another_run = false;
        self.other_run = None;
        self.goes_on_with_tape = false;
        self.has_position = false;
    }

    pub(super) fn judge(&mut self, topic: Topic, id: u64, message: &Message) -> Fate {
        let time = time_of(message.header.log_time);
        let is_of_dive = is_of_dive(topic);
        let is_new = match is_of_dive {
            true => self.seen.insert(id) || !self.is_further,
            false => !(self.overlaps && self.newest.is_some_and(|newest| time <= newest)),
        };
        if !is_new {
            self.overlaps = true;
            return Fate::Repeated;
        }
        if topic == Topic::Events {
            self.take_event(&message.data);
        }
        // Bytes are recorded as they come; what the mapper takes, such as poses, as late as it does.
        if topic != Topic::Raw {
            return match self.state {
                State::GoesOn => Fate::Taken,
                State::Undecided => Fate::Waits,
                State::Elsewhere => Fate::LeftOut,
            };
        }
        // What the parts before lost in their middle has no place any more.
        if self.overlaps && self.goes_back_to(time) {
            return Fate::LeftOut;
        }
        if self.state == State::Undecided {
            self.decide(time);
        }
        if self.state == State::Elsewhere {
            return Fate::LeftOut;
        }
        self.newest = Some(time);
        Fate::Taken
    }

    fn decide(&mut self, time: Timestamp) {
        let other_run = self.other_run.take().filter(|_| !self.goes_on_with_tape);
        if self.newest.is_none() {
            // No bytes came before: this is the first.
            self.run = other_run.or(self.run.take());
            self.state = State::GoesOn;
            return;
        }
        let is_log = |run: &Value| run["is_log"] == true;
        let has_a_clock_of_its_own = |other: &Value| {
            let is_on_device_clock = !is_log(other) && other["session"]["clock"] == "device";
            let run = self.run.as_ref();
            is_on_device_clock || run.is_some_and(|run| is_log(run) != is_log(other))
        };
        let is_other = other_run.as_ref().is_some_and(has_a_clock_of_its_own);
        self.state = match self.goes_back_to(time) || is_other {
            true => State::Elsewhere,
            false => State::GoesOn,
        };
        if self.state == State::GoesOn && other_run.is_some() {
            self.is_another_run = true;
            self.run = other_run;
        }
    }

    fn goes_back_to(&self, time: Timestamp) -> bool {
        let goes_back = |newest: Timestamp| newest.seconds_since(time) > DISORDER_S;
        self.newest.is_some_and(goes_back)
    }

    fn take_event(&mut self, event: &[u8]) {
        let event: Value = serde_json::from_slice(event).unwrap_or_default();
        if event["event"] == "begin" {
            match self.state {
                State::GoesOn => self.run = Some(event),
                _ => self.other_run = Some(event),
            }
        } else if let Some((driver, _)) = tape_position(&event)
            && self.state != State::GoesOn
        {
            self.goes_on_with_tape = self.tape.is_some_and(|(before, _)| before == driver);
        }
    }

    /// Whether the part at hand does not go on from those before.
    pub(super) fn is_elsewhere(&self) -> bool {
        self.state == State::Elsewhere
    }

    /// Counts a record that is taken, as the driver did.
    pub(super) fn count_taken(&mut self, topic: Topic) {
        if let (Some((_, next)), Topic::Raw | Topic::Link | Topic::Pose) = (&mut self.tape, topic) {
            *next += 1;
        }
    }

    /// What an event says of the driver's tape: how many of its records are missing before it if it
    /// goes on from what was read, and whether it is the first in its part that says so.
    pub(super) fn note_position(&mut self, event: &Value) -> Option<(u64, bool)> {
        let (driver, next) = tape_position(event)?;
        let is_first = !std::mem::replace(&mut self.has_position, true);
        let before = self.tape.replace((driver, next));
        let (_, counted) = before.filter(|(before, _)| *before == driver)?;
        Some((next.saturating_sub(counted), is_first))
    }
}

/// What a dive is made of, and not only what was told of it.
fn is_of_dive(topic: Topic) -> bool {
    matches!(
        topic,
        Topic::Raw | Topic::Link | Topic::Pose | Topic::Events
    )
}

fn tape_position(event: &Value) -> Option<(u64, u64)> {
    (event["event"] == "tape")
        .then(|| Some((event["driver"].as_u64()?, event["next"].as_u64()?)))
        .flatten()
}

/// Of the topic, the times and the bytes; of a pose the epoch too.
pub(super) fn identity(topic: Topic, message: &Message) -> u64 {
    let header = &message.header;
    let epoch = (topic == Topic::Pose).then_some(header.sequence);
    let mut hasher = DefaultHasher::new();
    (topic, epoch, header.log_time, header.publish_time).hash(&mut hasher);
    hasher.write(&message.data);
    hasher.finish()
}
