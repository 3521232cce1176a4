//! The way out of a driver's thread: events to their channel, by one rule for a full one.

use crossbeam_channel::{Sender, TrySendError, select};
use echosplat_session::{ClockSource, SessionEvent};

use crate::config::DriverConfig;
use crate::driver::SharedStatus;
use crate::event::DriverEvent;
use crate::stop::Stop;
use crate::url::SonarUrl;

/// Whether the thread goes on.
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
    waits_for_room: bool,
}

impl Outlet {
    pub(crate) fn new(
        config: &DriverConfig,
        events: Sender<DriverEvent>,
        stop: Stop,
        status: SharedStatus,
    ) -> Self {
        let is_log = matches!(config.url, SonarUrl::File(_));
        Self {
            events,
            stop,
            status,
            waits_for_room: is_log || config.session.clock == ClockSource::Device,
        }
    }

    pub(crate) fn send(&self, event: DriverEvent) -> Flow {
        let is_ping = matches!(event, DriverEvent::Ping { .. });
        match self.events.try_send(event) {
            Ok(()) => self.was_sent(is_ping),
            Err(TrySendError::Full(event)) if self.waits_for_room => select! {
                send(self.events, event) -> sent => match sent {
                    Ok(()) => self.was_sent(is_ping),
                    Err(_) => Flow::Ends,
                },
                recv(self.stop.channel()) -> _ => {
                    self.was_dropped(is_ping);
                    Flow::Ends
                }
            },
            Err(TrySendError::Full(_)) => {
                self.was_dropped(is_ping);
                Flow::GoesOn
            }
            Err(TrySendError::Disconnected(_)) => Flow::Ends,
        }
    }

    fn was_sent(&self, is_ping: bool) -> Flow {
        if is_ping {
            self.status.update(|status| status.pings_sent += 1);
        }
        Flow::GoesOn
    }

    fn was_dropped(&self, is_ping: bool) {
        self.status.update(|status| match is_ping {
            true => status.pings_dropped += 1,
            false => status.events_dropped += 1,
        });
    }
}

impl From<SessionEvent> for DriverEvent {
    fn from(event: SessionEvent) -> Self {
        match event {
            SessionEvent::Ping { ping, frame } => Self::Ping { ping, frame },
            SessionEvent::Identified {
                device_type,
                device_revision,
                firmware,
            } => Self::Identified {
                device_type,
                device_revision,
                firmware,
            },
            SessionEvent::Configured => Self::Configured,
            SessionEvent::Rebooted => Self::Rebooted,
            SessionEvent::Nack { id, text } => Self::Nack { id, text },
            SessionEvent::Warning(text) => Self::Warning(text),
        }
    }
}
