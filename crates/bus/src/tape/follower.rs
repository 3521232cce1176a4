//! The mapper's side: asks for what follows the last record that it has.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use serde::Serialize;
use serde_json::Value;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Reply};

use super::message::{self, Head, TapeMessageError, TapeRecord};
use super::trouble::TapeTrouble;
use crate::BusError;
use crate::bus::Link;

/// A query without an answer is asked again after so long.
const ANSWERED_WITHIN: Duration = Duration::from_secs(3);
/// Where nobody answers it is not asked more often.
const ASK_EVERY: Duration = Duration::from_millis(100);
/// Drivers of one node answer one query; there should be one.
const REPLY_QUEUE_LEN: usize = 16;
/// No driver is started again sooner than this: what changes its run more often is several drivers, or
/// none.
const RUN_AT_LEAST: Duration = Duration::from_secs(2);
/// What was wrong with an answer is what is wrong for so long.
const OF_LATE: Duration = Duration::from_secs(3);
/// Runs of drivers that were left for another are known by so many.
const MAX_EARLIER: usize = 16;

/// What came of the questions so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct TapeFollowerCounters {
    /// Questions asked.
    pub queries: u64,
    /// Answers that could be read.
    pub answers: u64,
    /// Answers that could not.
    pub malformed: u64,
    /// Records taken.
    pub records: u64,
    /// Bytes of their answers.
    pub bytes: u64,
    /// Records that the driver no longer kept.
    pub missing: u64,
    /// Drivers that took the place of the one before.
    pub restarts: u64,
    /// Records that the driver has and that are still to be asked for.
    pub behind: u64,
}

/// What an answer holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Heard {
    /// Names the driver's run.
    pub driver: u64,
    /// Of a driver that was not known before: what it told of itself.
    pub begin: Option<Value>,
    /// How many records are missing before these.
    pub missing: u64,
    /// Number of the first record here.
    pub first: u64,
    /// In order; none if nothing came.
    pub records: Vec<TapeRecord>,
}

/// Follows the tape of this node's driver. Whoever holds it calls [`TapeFollower::hear`] again and
/// again; between calls nothing is asked, which holds nobody up.
#[derive(Debug)]
pub struct TapeFollower {
    link: Arc<Link>,
    /// The driver, and the number of the record to ask for.
    position: Option<(u64, u64)>,
    pending: Option<Receiver<Reply>>,
    asked: Option<Instant>,
    /// Whether there ever was an answer.
    has_heard: bool,
    /// The first question since the last answer.
    unanswered: Option<Instant>,
    /// Of another run than the one that is followed, in the answers to the question under way.
    other: Option<Answer>,
    /// Where the run before this one was left, and when.
    before: Option<(u64, u64)>,
    changed: Option<Instant>,
    /// Runs that were left, or are none.
    earlier: VecDeque<u64>,
    counters: TapeFollowerCounters,
    first_fault: Option<String>,
    trouble: Option<(Instant, TapeTrouble)>,
}

/// One answer, read.
#[derive(Debug)]
struct Answer {
    head: Head,
    records: Vec<TapeRecord>,
    byte_count: u64,
}

impl TapeFollower {
    pub(crate) fn new(link: &Arc<Link>) -> Self {
        Self {
            link: Arc::clone(link),
            position: None,
            pending: None,
            asked: None,
            has_heard: false,
            unanswered: None,
            other: None,
            before: None,
            changed: None,
            earlier: VecDeque::new(),
            counters: TapeFollowerCounters::default(),
            first_fault: None,
            trouble: None,
        }
    }

    /// What is held already: of `driver` all records before number `next`.
    pub fn go_on_from(&mut self, driver: u64, next: u64) {
        self.position = Some((driver, next));
    }

    /// What the driver says next, waiting for it no longer than `limit`. `None` if it says nothing
    /// or nobody answers, which [`TapeFollower::silent_for`] tells apart.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn hear(&mut self, limit: Duration) -> Result<Option<Heard>, BusError> {
        let replies = match self.pending.take() {
            Some(replies) => replies,
            None => match self.ask(limit)? {
                Some(replies) => replies,
                None => return Ok(None),
            },
        };
        let until = Instant::now() + limit;
        loop {
            match replies.recv_deadline(until) {
                Ok(reply) => {
                    if let Some(answer) = self.take(&reply) {
                        if let Some(other) = self.other.take() {
                            self.is_not_alone(other.head.driver);
                        }
                        return Ok(self.follow(answer));
                    }
                }
                Err(RecvTimeoutError::Timeout) => {
                    self.pending = Some(replies);
                    return Ok(None);
                }
                // All who are there have answered; what is lacking is asked for again.
                Err(RecvTimeoutError::Disconnected) => return Ok(self.change_over()),
            }
        }
    }

    /// Lets the driver know that all so far is here, without waiting for what it says; for the end of
    /// the tape.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn acknowledge(&mut self) -> Result<(), BusError> {
        self.asked = None;
        self.pending = self.ask(Duration::ZERO)?;
        Ok(())
    }

    /// For how long the driver has owed an answer; `None` before the first question. Time in which
    /// nothing was asked does not count.
    #[must_use]
    pub fn silent_for(&self) -> Option<Duration> {
        let owed = self
            .unanswered
            .map_or(Duration::ZERO, |asked| asked.elapsed());
        (self.has_heard || self.unanswered.is_some()).then_some(owed)
    }

    /// What came of the questions so far.
    #[must_use]
    pub fn counters(&self) -> TapeFollowerCounters {
        self.counters
    }

    /// What is wrong with what has answered of late, if anything is.
    #[must_use]
    pub fn trouble(&self) -> Option<&TapeTrouble> {
        let (at, trouble) = self.trouble.as_ref()?;
        (at.elapsed() < OF_LATE).then_some(trouble)
    }

    /// Turns the run away that was met last, since what it told in `begin` is nothing that can be
    /// followed: the one before is followed on.
    pub fn refuse(&mut self, why: String) {
        let refused = self.position.take();
        self.leave(refused);
        self.position = self.before.take();
        self.asked = Some(Instant::now());
        self.counters.restarts = self.counters.restarts.saturating_sub(1);
        self.malformed(why);
    }

    /// What was wrong with the first answer that could not be read.
    #[must_use]
    pub fn first_fault(&self) -> Option<&str> {
        self.first_fault.as_deref()
    }

    /// Not at once after a question that nobody answered.
    fn ask(&mut self, limit: Duration) -> Result<Option<Receiver<Reply>>, BusError> {
        if let Some(asked) = self.asked {
            let wait = ASK_EVERY.saturating_sub(asked.elapsed());
            if !wait.is_zero() {
                std::thread::sleep(wait.min(limit));
                return Ok(None);
            }
        }
        let now = Instant::now();
        self.asked = Some(now);
        self.unanswered.get_or_insert(now);
        self.counters.queries += 1;
        let key = self.link.keys.tape();
        let selector = match self.position {
            Some((driver, from)) => format!("{key}?driver={driver};from={from}"),
            None => key,
        };
        let (sender, replies) = bounded(REPLY_QUEUE_LEN);
        self.link
            .session
            .get(selector)
            // All answers bear one key: consolidating them would hide that there are several.
            .consolidation(ConsolidationMode::None)
            .congestion_control(CongestionControl::Block)
            .priority(Priority::DataHigh)
            .timeout(ANSWERED_WITHIN)
            .callback(move |reply| {
                // Fails once this side has stopped listening.
                let _ = sender.try_send(reply);
            })
            .wait()
            .map_err(BusError::zenoh("ask for the driver's tape"))?;
        Ok(Some(replies))
    }

    /// The answer of the driver that is followed, or of the first that is met.
    fn take(&mut self, reply: &Reply) -> Option<Answer> {
        let sample = match reply.result() {
            Ok(sample) => sample,
            Err(error) => {
                self.refused(&String::from_utf8_lossy(&error.payload().to_bytes()));
                return None;
            }
        };
        let attachment = sample.attachment().map(|bytes| bytes.to_bytes());
        let payload = sample.payload().to_bytes().into_owned().into();
        let answer = match self.read(attachment.as_deref().unwrap_or_default(), &payload) {
            Ok(answer) => answer,
            Err(error) => {
                let encoding = sample.encoding();
                self.malformed(match *encoding == Encoding::APPLICATION_OCTET_STREAM {
                    true => error.to_string(),
                    false => format!("{error} (its encoding is {encoding})"),
                });
                return None;
            }
        };
        let run = answer.head.driver;
        match self.position {
            Some((followed, _)) if followed == run => Some(answer),
            None if !self.earlier.contains(&run) => Some(answer),
            _ => {
                self.other = Some(answer);
                None
            }
        }
    }

    fn read(&self, attachment: &[u8], payload: &Bytes) -> Result<Answer, TapeMessageError> {
        let head = message::decode_head(attachment)?;
        let records = message::decode(payload, head.count)?;
        let (found, byte_count) = (head.after(), payload.len() as u64);
        match self.position {
            Some((driver, expected)) if driver == head.driver && found < expected => {
                return Err(TapeMessageError::Back { expected, found });
            }
            Some((driver, _)) if driver == head.driver => {}
            _ if head.begin.is_none() => return Err(TapeMessageError::NoBegin),
            _ => {}
        }
        Ok(Answer {
            head,
            records,
            byte_count,
        })
    }

    /// Nobody answers any more but another run: the driver was started again, unless that cannot be.
    fn change_over(&mut self) -> Option<Heard> {
        let other = self.other.take()?;
        let owed = self.unanswered.map(|asked| asked.elapsed());
        let is_silent = owed.is_some_and(|owed| owed >= ANSWERED_WITHIN);
        let was_left = self.earlier.contains(&other.head.driver);
        let is_soon = self
            .changed
            .is_some_and(|changed| changed.elapsed() < RUN_AT_LEAST);
        if is_soon || (was_left && !is_silent) {
            if was_left || self.counters.restarts > 0 {
                self.is_not_alone(other.head.driver);
            }
            return None;
        }
        self.earlier.retain(|run| *run != other.head.driver);
        let left = self.position.take();
        self.leave(left);
        self.before = left;
        self.counters.restarts += u64::from(left.is_some());
        self.follow(other)
    }

    /// Takes the answer in; `None` if it has nothing new.
    fn follow(&mut self, answer: Answer) -> Option<Heard> {
        let Answer {
            head,
            mut records,
            byte_count,
        } = answer;
        let expected = self.position.map_or(0, |(_, next)| next);
        let is_new = self.position.is_none();
        if is_new {
            self.changed = Some(Instant::now());
        }
        let after = head.after();
        let known = usize::try_from(expected.saturating_sub(head.first)).unwrap_or(usize::MAX);
        records.drain(..known.min(records.len()));
        let missing = head.first.saturating_sub(expected);
        self.has_heard = true;
        self.unanswered = None;
        if !records.is_empty() {
            // Answered: the next question is due at once.
            self.asked = None;
        }
        self.counters.answers += 1;
        self.counters.bytes += byte_count;
        self.counters.missing += missing;
        self.counters.records += records.len() as u64;
        self.counters.behind = head.next - after;
        self.position = Some((head.driver, after));
        Some(Heard {
            driver: head.driver,
            begin: head.begin.filter(|_| is_new),
            missing,
            first: after - records.len() as u64,
            records,
        })
    }

    fn leave(&mut self, position: Option<(u64, u64)>) {
        self.earlier.extend(position.map(|(run, _)| run));
        while self.earlier.len() > MAX_EARLIER {
            self.earlier.pop_front();
        }
    }

    /// Words in the place of an answer; zenoh's own say that the time for one is over.
    fn refused(&mut self, words: &str) {
        if words != "Timeout" {
            let words = words.chars().take(200).collect();
            self.trouble_is(TapeTrouble::Refused(words));
        }
    }

    fn malformed(&mut self, why: String) {
        self.counters.malformed += 1;
        self.first_fault.get_or_insert_with(|| why.clone());
        self.trouble_is(TapeTrouble::Unreadable(why));
    }

    fn is_not_alone(&mut self, other: u64) {
        if let Some((followed, _)) = self.position {
            self.trouble_is(TapeTrouble::OtherDriver { followed, other });
        }
    }

    fn trouble_is(&mut self, trouble: TapeTrouble) {
        self.trouble = Some((Instant::now(), trouble));
    }
}
