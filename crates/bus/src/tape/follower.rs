//! The mapper's side: asks for what follows the last record that it has.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use serde::Serialize;
use serde_json::Value;
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Reply;

use super::message::{self, TapeMessageError, TapeRecord};
use crate::BusError;
use crate::bus::Link;

/// A query without an answer is asked again after so long.
const ANSWERED_WITHIN: Duration = Duration::from_secs(3);
/// Where nobody answers it is not asked more often.
const ASK_EVERY: Duration = Duration::from_millis(100);
/// Drivers of one node answer one query; there should be one.
const REPLY_QUEUE_LEN: usize = 16;

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
    counters: TapeFollowerCounters,
    first_fault: Option<String>,
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
            counters: TapeFollowerCounters::default(),
            first_fault: None,
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
        match replies.recv_timeout(limit) {
            Ok(reply) => Ok(self.take(&reply)),
            Err(RecvTimeoutError::Timeout) => {
                self.pending = Some(replies);
                Ok(None)
            }
            // It will be asked again.
            Err(RecvTimeoutError::Disconnected) => Ok(None),
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

    /// For how long the driver has owed an answer; `None` before the first ever. Time in which
    /// nothing was asked does not count.
    #[must_use]
    pub fn silent_for(&self) -> Option<Duration> {
        let owed = self
            .unanswered
            .map_or(Duration::ZERO, |asked| asked.elapsed());
        self.has_heard.then_some(owed)
    }

    /// What came of the questions so far.
    #[must_use]
    pub fn counters(&self) -> TapeFollowerCounters {
        self.counters
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

    fn take(&mut self, reply: &Reply) -> Option<Heard> {
        let sample = match reply.result() {
            Ok(sample) => sample,
            Err(error) => {
                let payload = error.payload().to_bytes();
                let words = String::from_utf8_lossy(&payload);
                // Words of zenoh when the time for an answer is over, too.
                tracing::debug!("the driver's tape: {words}");
                return None;
            }
        };
        let attachment = sample.attachment().map(|bytes| bytes.to_bytes());
        let payload = sample.payload().to_bytes().into_owned().into();
        match self.read(attachment.as_deref().unwrap_or_default(), &payload) {
            Ok(heard) => {
                self.has_heard = true;
                self.unanswered = None;
                // Answered: the next question is due at once.
                self.asked = None;
                self.counters.bytes += payload.len() as u64;
                heard
            }
            Err(error) => {
                self.counters.malformed += 1;
                tracing::debug!("answer of the driver left out: {error}");
                self.first_fault.get_or_insert_with(|| error.to_string());
                None
            }
        }
    }

    /// `None` if the answer has nothing new.
    fn read(
        &mut self,
        attachment: &[u8],
        payload: &bytes::Bytes,
    ) -> Result<Option<Heard>, TapeMessageError> {
        let head = message::decode_head(attachment)?;
        let mut records = message::decode(payload, head.count)?;
        let wrong = |words: &str| Err(TapeMessageError::Head(words.to_owned()));
        let Some(after) = head.first.checked_add(head.count) else {
            return wrong("its first number is too large");
        };
        let is_known = self
            .position
            .is_some_and(|(driver, _)| driver == head.driver);
        if !is_known && head.begin.is_none() {
            return wrong("a new driver, and no `begin`");
        }
        self.counters.answers += 1;
        let expected = match self.position {
            Some((_, next)) if is_known => next,
            _ => 0,
        };
        if after < expected {
            return Ok(None);
        }
        let known = usize::try_from(expected.saturating_sub(head.first)).unwrap_or(usize::MAX);
        records.drain(..known.min(records.len()));
        let missing = head.first.saturating_sub(expected);
        self.counters.restarts += u64::from(!is_known && self.position.is_some());
        self.counters.missing += missing;
        self.counters.records += records.len() as u64;
        self.counters.behind = head.next.saturating_sub(after);
        self.position = Some((head.driver, after));
        Ok(Some(Heard {
            driver: head.driver,
            begin: head.begin.filter(|_| !is_known),
            missing,
            first: after - records.len() as u64,
            records,
        }))
    }
}
