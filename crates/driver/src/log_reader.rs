//! A log as if it came over a link: at real time, a multiple of it, or as fast as it is taken.

use std::fs::File;
use std::io::{self, Read};
use std::time::Instant;

use bytes::Bytes;
use echosplat_session::{Session, SessionEvent};

use crate::clock::host_time;
use crate::config::DriverConfig;
use crate::event::{DriverEvent, LinkState};
use crate::intake::Intake;
use crate::outlet::{Flow, Outlet};
use crate::pace::Pace;
use crate::tap::{RawTap, Tapped};

/// Longer pauses in a log, as between sessions, are not waited for.
const MAX_GAP_S: f64 = 10.0;

pub(crate) struct LogReader {
    raw: Option<RawTap>,
    outlet: Outlet,
    session: Session,
    pace: Pace,
}

impl LogReader {
    pub(crate) fn new(config: &DriverConfig, raw: Option<RawTap>, outlet: Outlet) -> Self {
        Self {
            raw,
            outlet,
            session: Session::listening(config.session.clone(), host_time()),
            pace: Pace::new(config.rate, MAX_GAP_S),
        }
    }

    pub(crate) fn run(mut self, mut file: File) {
        self.publish(LinkState::Up);
        let mut flow = self.outlet.send(DriverEvent::LinkUp);
        let mut intake = Intake::default();
        while flow == Flow::GoesOn {
            flow = match file.read(intake.room()) {
                Ok(0) => break,
                Ok(byte_count) => self.take(&intake.take(byte_count)),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => Flow::GoesOn,
                Err(error) => {
                    self.warn(format!("the log cannot be read further: {error}"));
                    break;
                }
            };
        }
        if flow == Flow::Ends {
            self.publish(LinkState::Stopped);
            return;
        }
        self.session.finish(host_time());
        let flow = self.deliver();
        self.publish(LinkState::Ended);
        if flow == Flow::GoesOn {
            self.outlet.send(DriverEvent::Ended);
        }
    }

    fn take(&mut self, bytes: &Bytes) -> Flow {
        let now = host_time();
        if let Some(raw) = &mut self.raw {
            raw(now, Tapped::Bytes(bytes));
        }
        self.session.receive(bytes, now);
        let flow = self.deliver();
        self.publish(LinkState::Up);
        match self.outlet.stop.is_set() {
            true => Flow::Ends,
            false => flow,
        }
    }

    fn deliver(&mut self) -> Flow {
        self.outlet.status.count(&self.session);
        while let Some(event) = self.session.poll_event() {
            if let SessionEvent::Ping { ping, .. } = &event {
                if self.outlet.wait_while_held() {
                    return Flow::Ends;
                }
                let wait = self.pace.wait(ping.transmit_time(), Instant::now());
                if !wait.is_zero() && self.outlet.stop.wait(wait) {
                    return Flow::Ends;
                }
            }
            if let SessionEvent::Warning(text) = &event {
                tracing::warn!("log: {text}");
            }
            if self.outlet.send(event.into()) == Flow::Ends {
                return Flow::Ends;
            }
        }
        Flow::GoesOn
    }

    fn warn(&self, text: String) {
        tracing::warn!("log: {text}");
        self.outlet.send(DriverEvent::Warning(text));
    }

    fn publish(&self, link: LinkState) {
        self.outlet.status.publish(link, Some(&self.session));
    }
}
