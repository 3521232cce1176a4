//! The way out of a driver: events to their channel, by one rule for a full one.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Sender, TrySendError, select};
use echosplat_liveness::Heartbeat;
use echosplat_session::{ClockSource, SessionEvent};

use tokio::task::block_in_place;

use crate::config::DriverConfig;
use crate::event::DriverEvent;
use crate::pause::Pause;
use crate::status::SharedStatus;
use crate::stop::Stop;
use crate::url::SonarUrl;

/// How often it is asked whether what is held goes on.
const HELD_TICK: Duration = Duration::from_millis(20);

/// Whether the link, or the reader, goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Flow {
    GoesOn,
    /// Stopped, or nobody listens any more.
    Ends,
}

pub(crate) struct Outlet {
    events: Sender<DriverEvent>,
    pub(crate) stop: Stop,
    pub(crate) status: SharedStatus,
    pub(crate) heartbeat: Heartbeat,
    /// When what is sent now was read, of a link.
    pub(crate) read_at: Option<Instant>,
    waits_for_room: bool,
    pause: Option<Pause>,
    /// First and last sequence of each run of pings dropped since they were last asked for.
    shed: Mutex<Vec<(u64, u64)>>,
    /// A step of the clock found no room: it goes before the next event that finds some, since pings
    /// before it and after it are on two clocks.
    owes_clock_step: AtomicBool,
}

impl Outlet {
    pub(crate) fn new(
        config: &DriverConfig,
        events: Sender<DriverEvent>,
        stop: Stop,
        status: SharedStatus,
        heartbeat: Heartbeat,
    ) -> Self {
        let is_log = matches!(config.url, SonarUrl::File(_));
        Self {
            events,
            stop,
            status,
            heartbeat,
            read_at: None,
            waits_for_room: is_log || config.session.clock == ClockSource::Device,
            pause: config.pause.clone(),
            shed: Mutex::default(),
            owes_clock_step: AtomicBool::new(false),
        }
    }

    /// The pings dropped since the last call, for whoever records that they were.
    pub(crate) fn take_shed(&self) -> Vec<(u64, u64)> {
        std::mem::take(&mut *self.shed.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Waits as long as somebody holds what is replayed; says whether to stop.
    pub(crate) fn wait_while_held(&self) -> bool {
        while self.pause.as_ref().is_some_and(Pause::is_set) {
            if self.stop.wait(HELD_TICK) {
                return true;
            }
        }
        self.stop.is_set()
    }

    /// Whatever the clock: what comes from a file is never dropped.
    pub(crate) fn waiting_for_room(self) -> Self {
        Self {
            waits_for_room: true,
            ..self
        }
    }

    pub(crate) fn send(&self, event: DriverEvent) -> Flow {
        if self.stop.is_abandoned() {
            return Flow::Ends;
        }
        let ping = match &event {
            DriverEvent::Ping { ping, .. } => Some(ping.sequence()),
            _ => None,
        };
        let is_ping = ping.is_some();
        if self.owes_clock_step.load(Ordering::Relaxed) {
            match self.events.try_send(DriverEvent::ClockStepped) {
                Ok(()) => self.owes_clock_step.store(false, Ordering::Relaxed),
                Err(TrySendError::Full(_)) => {
                    self.was_dropped(ping);
                    return Flow::GoesOn;
                }
                Err(TrySendError::Disconnected(_)) => return Flow::Ends,
            }
        }
        match self.events.try_send(event) {
            Ok(()) => self.was_sent(is_ping),
            Err(TrySendError::Full(event)) if self.waits_for_room => {
                self.wait_for_room(event, ping)
            }
            Err(TrySendError::Full(DriverEvent::ClockStepped)) => {
                self.owes_clock_step.store(true, Ordering::Relaxed);
                Flow::GoesOn
            }
            Err(TrySendError::Full(_)) => {
                self.was_dropped(ping);
                Flow::GoesOn
            }
            Err(TrySendError::Disconnected(_)) => Flow::Ends,
        }
    }

    fn wait_for_room(&self, event: DriverEvent, ping: Option<u64>) -> Flow {
        // Until the link's next read; logs and tapes rest all along.
        self.heartbeat.rest();
        // Of a thread the same; of a task this lets go of its worker first.
        block_in_place(|| {
            select! {
                send(self.events, event) -> sent => match sent {
                    Ok(()) => self.was_sent(ping.is_some()),
                    Err(_) => Flow::Ends,
                },
                recv(self.stop.channel()) -> _ => {
                    self.was_dropped(ping);
                    Flow::Ends
                }
            }
        })
    }

    fn was_sent(&self, is_ping: bool) -> Flow {
        if is_ping {
            self.status.ping_sent(self.read_at.map(|at| at.elapsed()));
        }
        Flow::GoesOn
    }

    fn was_dropped(&self, ping: Option<u64>) {
        self.status.update(|status| match ping {
            Some(_) => status.pings_dropped += 1,
            None => status.events_dropped += 1,
        });
        let Some(ping) = ping else { return };
        let mut shed = self.shed.lock().unwrap_or_else(PoisonError::into_inner);
        match shed.last_mut() {
            Some((_, last)) if last.checked_add(1) == Some(ping) => *last = ping,
            _ => shed.push((ping, ping)),
        }
    }
}

impl From<SessionEvent> for DriverEvent {
    fn from(event: SessionEvent) -> Self {
        match event {
            SessionEvent::Ping { ping, frame } => Self::Ping { ping, frame },
            SessionEvent::Identified(information) => Self::Identified(information),
            SessionEvent::Configured => Self::Configured,
            SessionEvent::Rebooted => Self::Rebooted,
            SessionEvent::ClockStepped => Self::ClockStepped,
            SessionEvent::Nack { id, text } => Self::Nack { id, text },
            SessionEvent::Warning(text) => Self::Warning(text),
        }
    }
}
