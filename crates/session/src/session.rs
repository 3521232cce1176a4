//! The session: frames to messages, messages to events, time-outs to requests.

mod profiles;

use std::collections::VecDeque;

use bytes::Bytes;
use echosplat_firmware_protocol::{
    Decoder, DeviceInformation, Event, Frame, Message, ParseError, SkipReason, Skipped, id,
    product_of_message,
};
use echosplat_model::{RateLimit, Timestamp};

use crate::config::SessionConfig;
use crate::counters::SessionCounters;
use crate::event::SessionEvent;
use crate::handshake::Handshake;
use crate::log_header::{self, LogJson};
use crate::stream::Stream;
use crate::units::{Settled, UnitHeard, Units};
use crate::words::{printable, with_count};

/// A half frame that has not grown for so long will not be completed.
const HALF_FRAME_S: f64 = 0.25;
/// Requests that nobody fetches: the oldest go first.
const MAX_OUTGOING: usize = 16;

/// Where the bytes of a session come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// A device that is asked and answers.
    Live,
    /// A log that names its own base of time.
    Log,
    /// What a live session was given, given again.
    Replay,
}

/// What has been warned of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Warned {
    NoProfiles,
    UnknownType,
    Disputed,
    LogWithoutTime,
    LogBackInTime,
}

/// One conversation with a device, or one log.
#[derive(Debug)]
pub struct Session {
    decoder: Box<Decoder>,
    core: Core,
}

/// All but the decoder, which lends its frames while this handles them.
#[derive(Debug)]
struct Core {
    kind: Kind,
    config: SessionConfig,
    /// None when only listening.
    handshake: Option<Handshake>,
    units: Units,
    /// Profiles that wait to show which unit they are of, and when they came.
    waiting: Vec<(Bytes, Timestamp)>,
    stream: Stream,
    events: VecDeque<SessionEvent>,
    outgoing: VecDeque<Vec<u8>>,
    counters: SessionCounters,
    identity: Option<DeviceInformation>,
    /// Another product that messages came from.
    other_product: Option<&'static str>,
    newest_log_time: Option<Timestamp>,
    warned: Vec<Warned>,
    first_refusal: Option<String>,
    nacks_told: RateLimit,
    texts_told: RateLimit,
    identities_told: RateLimit,
    /// When bytes last came, and the latest time told.
    last_bytes: Timestamp,
    now: Timestamp,
}

impl Session {
    /// Begins to ask for identity and settings. `config` is one that `check` accepts.
    #[must_use]
    pub fn new(config: SessionConfig, now: Timestamp) -> Self {
        let handshake = Handshake::new(&config, now);
        let mut session = Self::with(Kind::Live, config, Some(handshake), now);
        session.core.send_what_is_due(now);
        session
    }

    /// Sends nothing: the bytes are those of a log (`.svlog`), whose session packets give the base
    /// of time. Transmit times are on the log's clock whatever `config.clock` says; where a
    /// session gives no time, they are the device's own.
    #[must_use]
    pub fn listening(config: SessionConfig, now: Timestamp) -> Self {
        Self::with(Kind::Log, config, None, now)
    }

    /// What a live session was given, given again: the same bytes at the same times, the same
    /// links lost and restored, and [`Session::expire_half_frame`] where the live one said that
    /// it gave one up. Then the pings are the same, bit for bit, and so are the warnings about
    /// them. Sends nothing, and gives up no half frame by itself.
    #[must_use]
    pub fn replaying(config: SessionConfig, now: Timestamp) -> Self {
        Self::with(Kind::Replay, config, None, now)
    }

    fn with(
        kind: Kind,
        config: SessionConfig,
        handshake: Option<Handshake>,
        now: Timestamp,
    ) -> Self {
        let stream = Stream::new(kind == Kind::Log);
        Self {
            decoder: Box::default(),
            core: Core {
                kind,
                config,
                handshake,
                units: Units::default(),
                waiting: Vec::new(),
                stream,
                events: VecDeque::new(),
                outgoing: VecDeque::new(),
                counters: SessionCounters::default(),
                identity: None,
                other_product: None,
                newest_log_time: None,
                warned: Vec::new(),
                first_refusal: None,
                nacks_told: RateLimit::new(),
                texts_told: RateLimit::new(),
                identities_told: RateLimit::new(),
                last_bytes: now,
                now,
            },
        }
    }

    /// Takes the next bytes of the link, which came at `now`, cut anywhere. Queues some ten events
    /// at most per frame in them: fetch the events before giving more.
    pub fn receive(&mut self, bytes: &[u8], now: Timestamp) {
        let core = &mut self.core;
        core.clock_is(now);
        core.last_bytes = now;
        core.counters.bytes_received += bytes.len() as u64;
        self.decoder
            .feed(bytes, &mut |event| core.handle(&event, now));
    }

    /// Does what is due at `now`: asks again, gives up a half frame. May be called at any time.
    /// Says whether it gave up a half frame, which whoever wants to replay the session must know.
    pub fn handle_timeout(&mut self, now: Timestamp) -> bool {
        self.core.clock_is(now);
        let is_due = self.half_frame_expires_at().is_some_and(|due| due <= now);
        if is_due {
            self.expire_half_frame(now);
        }
        self.core.send_what_is_due(now);
        is_due
    }

    /// Gives up the half frame that is pending, if there is one: its rest did not come.
    pub fn expire_half_frame(&mut self, now: Timestamp) {
        let core = &mut self.core;
        core.clock_is(now);
        core.last_bytes = now;
        self.decoder.expire(&mut |event| core.handle(&event, now));
    }

    /// When [`Session::handle_timeout`] next has something to do.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        let core = &self.core;
        let half_frame = self.half_frame_expires_at();
        let handshake = core.handshake.as_ref();
        let asking = handshake.and_then(|handshake| handshake.poll_timeout(&core.config));
        half_frame.into_iter().chain(asking).min()
    }

    /// The next frame to send.
    pub fn poll_transmit(&mut self) -> Option<Vec<u8>> {
        self.core.outgoing.pop_front()
    }

    /// The next event.
    pub fn poll_event(&mut self) -> Option<SessionEvent> {
        self.core.events.pop_front()
    }

    /// The link is gone: what was half received or not yet sent is forgotten, nothing is asked.
    pub fn link_lost(&mut self, now: Timestamp) {
        self.end_stream(now);
        self.core.outgoing.clear();
        if let Some(handshake) = &mut self.core.handshake {
            handshake.suspend();
        }
    }

    /// The link is back: identity and settings are asked for again.
    pub fn link_restored(&mut self, now: Timestamp) {
        let core = &mut self.core;
        core.clock_is(now);
        core.outgoing.clear();
        if core.handshake.is_some() {
            core.handshake = Some(Handshake::new(&core.config, now));
        }
        core.send_what_is_due(now);
    }

    /// Queues `enable = 0` and asks nothing any more. Does nothing when only listening.
    pub fn stop(&mut self, now: Timestamp) {
        let core = &mut self.core;
        core.clock_is(now);
        if let Some(handshake) = &mut core.handshake {
            core.outgoing.clear();
            core.outgoing.extend(handshake.stop(&core.config));
        }
    }

    /// The bytes end here: the pending half frame is let go and counted, a profile that waited for
    /// the next is settled.
    pub fn finish(&mut self, now: Timestamp) {
        self.end_stream(now);
    }

    /// What came and what became of it, since the session was made.
    #[must_use]
    pub fn counters(&self) -> SessionCounters {
        self.core.counters
    }

    /// What the device said it is, once it has.
    #[must_use]
    pub fn identity(&self) -> Option<DeviceInformation> {
        self.core.identity
    }

    /// The units whose profiles came, the one that is mapped first. Others are told of from their third
    /// profile on.
    #[must_use]
    pub fn units(&self) -> Vec<UnitHeard> {
        self.core.units.heard()
    }

    /// Whether the configuration says which of several units is mapped.
    #[must_use]
    pub fn chooses_a_unit(&self) -> bool {
        self.core.config.chooses_a_unit()
    }

    /// The device that is no `OmniScan` 450, if what is connected says that it is one or sends what only
    /// one of those sends.
    #[must_use]
    pub fn other_product(&self) -> Option<&'static str> {
        let says = self
            .core
            .identity
            .filter(|identity| !identity.is_omniscan_450());
        let said = says.and_then(|identity| identity.product());
        said.or(self.core.other_product)
    }

    /// What the first profile refused for its settings or scale says, and what is allowed, as in
    /// `speed of sound 0 m/s; allowed is 1300 to 1700 m/s`.
    #[must_use]
    pub fn first_refusal(&self) -> Option<&str> {
        self.core.first_refusal.as_deref()
    }

    /// `None` if there is none, or if giving up is not for this session to decide.
    fn half_frame_expires_at(&self) -> Option<Timestamp> {
        let may_expire = self.core.kind != Kind::Replay && self.decoder.pending_byte_count() > 0;
        may_expire.then(|| self.core.last_bytes.offset_by(HALF_FRAME_S))
    }

    fn end_stream(&mut self, now: Timestamp) {
        let core = &mut self.core;
        core.clock_is(now);
        self.decoder.finish(&mut |event| core.handle(&event, now));
        core.release_held();
    }
}

impl Core {
    /// Waits move along when the host's clock goes back; forward they only end early.
    fn clock_is(&mut self, now: Timestamp) {
        let back_s = self.now.seconds_since(now);
        if back_s > 1.0 {
            self.last_bytes = self.last_bytes.offset_by(-back_s);
            if let Some(handshake) = &mut self.handshake {
                handshake.shift(back_s);
            }
        }
        self.now = now;
    }

    fn send_what_is_due(&mut self, now: Timestamp) {
        let Some(handshake) = &mut self.handshake else {
            return;
        };
        let outgoing = &mut self.outgoing;
        let resends = handshake.handle_timeout(&self.config, now, &mut |frame| {
            if outgoing.len() >= MAX_OUTGOING {
                outgoing.pop_front();
            }
            if !frame.is_empty() {
                outgoing.push_back(frame);
            }
        });
        self.counters.resends += resends;
        if self.counters.resends >= 3 && self.counters.pings == 0 {
            let text = "the device does not answer with profiles; asking again with growing waits";
            self.warn_once(Warned::NoProfiles, text.to_owned());
        }
    }

    fn handle(&mut self, event: &Event<'_>, now: Timestamp) {
        match event {
            Event::Frame(frame) => self.handle_frame(frame, now),
            Event::Skipped(Skipped { byte_count, reason }) => {
                self.counters.bytes_skipped += *byte_count as u64;
                self.counters.frames_bad += u64::from(*reason != SkipReason::Noise);
            }
        }
    }

    fn handle_frame(&mut self, frame: &Frame<'_>, now: Timestamp) {
        self.counters.frames_good += 1;
        let message = match Message::parse(frame) {
            Ok(message) => message,
            Err(error) => return self.malformed(frame, &error),
        };
        match message {
            Message::OsMonoProfile(profile) => self.handle_profile(&profile, frame, now),
            Message::DeviceInformation(information) => self.identified(information, now),
            Message::Ack { .. } => self.counters.acks += 1,
            Message::Nack { nacked_id, text } => {
                self.refused(nacked_id, &text.to_string(), now);
            }
            Message::Json(text) if self.kind == Kind::Log => self.log_json(text.as_bytes()),
            Message::AsciiText(text) => self.said(&text.to_string(), now),
            Message::Nmea(_) => self.counters.nmea += 1,
            Message::Mavlink(_) => self.counters.mavlink += 1,
            Message::Status(_) => self.counters.status += 1,
            Message::Unknown { message_id, .. } => {
                self.counters.frames_unknown += 1;
                self.other_product = self.other_product.or(product_of_message(message_id));
            }
            _ => self.counters.frames_unused += 1,
        }
    }

    fn malformed(&mut self, frame: &Frame<'_>, error: &ParseError) {
        if frame.message_id() != id::OS_MONO_PROFILE {
            self.counters.frames_unknown += 1;
            return;
        }
        self.counters.profiles += 1;
        self.counters.profiles_rejected.payload += 1;
        self.first_refusal.get_or_insert_with(|| error.to_string());
    }

    fn identified(&mut self, information: DeviceInformation, now: Timestamp) {
        self.identity = Some(information);
        if let Some(handshake) = &mut self.handshake {
            handshake.identity_answered();
        }
        if !information.is_omniscan_450() {
            let text = format!(
                "the device says that it is no OmniScan 450: {information}; it is used as it is"
            );
            self.warn_once(Warned::UnknownType, text);
        }
        // Asked for at each link; a device that says it unasked is told rarely.
        if self.identities_told.admit(now).is_none() {
            return;
        }
        self.events.push_back(SessionEvent::Identified(information));
    }

    fn refused(&mut self, nacked_id: u16, text: &str, now: Timestamp) {
        self.counters.nacks += 1;
        let is_identity = matches!(nacked_id, id::GENERAL_REQUEST | id::DEVICE_INFORMATION);
        if let Some(handshake) = self.handshake.as_mut().filter(|_| is_identity) {
            handshake.identity_answered();
        }
        let Some(left_out) = self.nacks_told.admit(now) else {
            return;
        };
        self.events.push_back(SessionEvent::Nack {
            id: nacked_id,
            text: with_count(printable(text), left_out),
        });
    }

    /// The device's own words: some are worth reading, none may fill the log.
    fn said(&mut self, text: &str, now: Timestamp) {
        self.counters.frames_unused += 1;
        if let Some(left_out) = self.texts_told.admit(now) {
            let text = with_count(printable(text), left_out);
            let warning = SessionEvent::Warning(format!("the device says: {text}"));
            self.events.push_back(warning);
        }
    }

    fn log_json(&mut self, json: &[u8]) {
        match log_header::read(json) {
            LogJson::Session { timestamp } => self.begin_log_session(timestamp),
            LogJson::Other => self.counters.frames_unused += 1,
            LogJson::Bad => self.counters.json_bad += 1,
        }
    }

    fn begin_log_session(&mut self, timestamp: Option<Timestamp>) {
        self.release_held();
        self.counters.log_sessions += 1;
        if timestamp.is_none() {
            let text = "a session of the log gives no time; its pings are on device time";
            self.warn_once(Warned::LogWithoutTime, text.to_owned());
        }
        if timestamp.is_some() && timestamp < self.newest_log_time {
            let text = "a session of the log begins before the one ahead of it";
            self.warn_once(Warned::LogBackInTime, text.to_owned());
        }
        self.newest_log_time = timestamp.max(self.newest_log_time);
        self.units.begin_log_session();
        self.stream.begin_log_session(timestamp);
    }

    fn release_held(&mut self) {
        self.units.release();
        let all = vec![Settled::Mapped; self.waiting.len()];
        self.settle_waiting(&all);
        let events = &mut self.events;
        let emit = &mut |event| events.push_back(event);
        self.stream.release(&self.config, &mut self.counters, emit);
    }

    /// Of each kind only the first.
    fn warn_once(&mut self, kind: Warned, text: String) {
        if !self.warned.contains(&kind) {
            self.warned.push(kind);
            self.events.push_back(SessionEvent::Warning(text));
        }
    }
}

#[cfg(test)]
mod tests;
