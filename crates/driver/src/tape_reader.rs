//! A recording as if it came over its link again: at real time, a multiple of it, or as fast as
//! it is taken.

use std::time::Instant;

use echosplat_model::Timestamp;
use echosplat_session::{Session, SessionConfig, SessionEvent};

use crate::clock::host_time;
use crate::config::DriverConfig;
use crate::event::{DriverEvent, LinkState};
use crate::outlet::{Flow, Outlet};
use crate::pace::Pace;
use crate::tap::{RawTap, Tape, TapeItem};

/// Longer pauses in a recording are not waited for.
const MAX_GAP_S: f64 = 10.0;

pub(crate) struct TapeReader {
    raw: Option<RawTap>,
    outlet: Outlet,
    config: SessionConfig,
    is_log: bool,
    /// Made at the time of the tape's first item.
    session: Option<Session>,
    pace: Pace,
    now: Timestamp,
}

impl TapeReader {
    pub(crate) fn new(config: &DriverConfig, raw: Option<RawTap>, outlet: Outlet) -> Self {
        Self {
            raw,
            outlet,
            config: config.session.clone(),
            is_log: config.tape_is_log,
            session: None,
            pace: Pace::new(config.rate, MAX_GAP_S),
            now: Timestamp::ZERO,
        }
    }

    pub(crate) fn run(mut self, tape: Tape) {
        self.publish(LinkState::Connecting);
        for item in tape {
            let flow = match item {
                Ok((time, item)) => self.play(time, &item),
                Err(words) => {
                    let text = format!("the recording cannot be read further: {words}");
                    tracing::warn!("recording: {text}");
                    self.outlet.send(DriverEvent::Warning(text));
                    break;
                }
            };
            if flow == Flow::Ends {
                self.publish(LinkState::Stopped);
                return;
            }
        }
        if let Some(session) = &mut self.session {
            session.finish(self.now);
        }
        let flow = self.deliver();
        self.publish(LinkState::Ended);
        if flow == Flow::GoesOn {
            self.outlet.send(DriverEvent::Ended);
        }
    }

    fn play(&mut self, time: Timestamp, item: &TapeItem) -> Flow {
        if let TapeItem::Mark(number) = item {
            return self.outlet.send(DriverEvent::Mark(*number));
        }
        if *item == TapeItem::GoesOn {
            return self.outlet.send(DriverEvent::GoesOn);
        }
        if *item == TapeItem::Nothing {
            return match self.outlet.stop.is_set() {
                true => Flow::Ends,
                false => Flow::GoesOn,
            };
        }
        if self.outlet.wait_while_held() {
            return Flow::Ends;
        }
        let wait = self.pace.wait(time, Instant::now());
        if self.outlet.stop.is_set() || (!wait.is_zero() && self.outlet.stop.wait(wait)) {
            return Flow::Ends;
        }
        if let (Some(raw), Some(tapped)) = (&mut self.raw, item.tapped()) {
            raw(host_time(), tapped);
        }
        self.now = time;
        let config = &self.config;
        let begin = || match self.is_log {
            true => Session::listening(config.clone(), time),
            false => Session::replaying(config.clone(), time),
        };
        let session = self.session.get_or_insert_with(begin);
        let (link, event) = match item {
            TapeItem::Bytes(bytes) => {
                session.receive(bytes, time);
                (LinkState::Up, None)
            }
            TapeItem::HalfFrameExpired => {
                session.expire_half_frame(time);
                (LinkState::Up, None)
            }
            TapeItem::Nothing | TapeItem::Mark(_) | TapeItem::GoesOn => return Flow::GoesOn,
            TapeItem::LinkUp => {
                session.link_restored(time);
                (LinkState::Up, Some(DriverEvent::LinkUp))
            }
            TapeItem::LinkDown => {
                session.link_lost(time);
                let reason = "as recorded".to_owned();
                (LinkState::Down, Some(DriverEvent::LinkDown { reason }))
            }
        };
        self.count_link(event.as_ref());
        // As live: first what the lost link left behind, then that it is lost.
        let mut flow = self.deliver();
        self.publish(link);
        if let (Flow::GoesOn, Some(event)) = (flow, event) {
            flow = self.outlet.send(event);
        }
        flow
    }

    fn count_link(&self, event: Option<&DriverEvent>) {
        self.outlet.status.update(|status| match event {
            Some(DriverEvent::LinkUp) => status.connects += 1,
            Some(DriverEvent::LinkDown { reason }) => {
                status.disconnects += 1;
                status.reason = Some(reason.clone());
            }
            _ => {}
        });
    }

    fn deliver(&mut self) -> Flow {
        let Some(session) = &mut self.session else {
            return Flow::GoesOn;
        };
        self.outlet.status.count(session);
        while let Some(event) = session.poll_event() {
            if let SessionEvent::Warning(text) = &event {
                tracing::warn!("recording: {text}");
            }
            if self.outlet.send(event.into()) == Flow::Ends {
                return Flow::Ends;
            }
        }
        Flow::GoesOn
    }

    fn publish(&self, link: LinkState) {
        self.outlet.status.publish(link, self.session.as_ref());
    }
}
