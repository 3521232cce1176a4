//! A driver's state, written by its task or thread and read by anyone.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use echosplat_session::{Session, SessionCounters};

use crate::event::{DriverStatus, LinkState};
use crate::path::PathTimes;

/// The driver's state, written by its task or thread, read by anyone.
#[derive(Debug, Clone, Default)]
pub(crate) struct SharedStatus(Arc<Mutex<State>>);

#[derive(Debug, Default)]
struct State {
    status: DriverStatus,
    last: LastTimes,
    path: PathTimes,
}

/// When something of each kind last came, on a clock that nobody sets.
#[derive(Debug, Clone, Copy, Default)]
struct LastTimes {
    byte: Option<Instant>,
    frame: Option<Instant>,
    profile: Option<Instant>,
    ping: Option<Instant>,
}

impl SharedStatus {
    /// The latest state, with ages as of now.
    pub(crate) fn read(&self) -> DriverStatus {
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        let since_s = |last: Option<Instant>| {
            last.map(|last| now.saturating_duration_since(last).as_secs_f64())
        };
        DriverStatus {
            since_byte_s: since_s(state.last.byte),
            since_frame_s: since_s(state.last.frame),
            since_profile_s: since_s(state.last.profile),
            since_ping_s: since_s(state.last.ping),
            ping_path_ms: state.path.report(),
            ..state.status.clone()
        }
    }

    pub(crate) fn update(&self, change: impl FnOnce(&mut DriverStatus)) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut state.status);
    }

    /// A ping got its place in the channel, so long after it was read if that is known.
    pub(crate) fn ping_sent(&self, took: Option<Duration>) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.status.pings_sent += 1;
        if let Some(took) = took {
            state.path.took(took);
        }
    }

    /// Where the link stands, and what its session has counted.
    pub(crate) fn publish(&self, link: LinkState, session: Option<&Session>) {
        self.update(|status| status.link = link);
        if let Some(session) = session {
            self.count(session);
        }
    }

    /// What the session has counted. Before its events are sent, so that no status shows more
    /// pings sent than there were.
    pub(crate) fn count(&self, session: &Session) {
        let mut guard = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let state = &mut *guard;
        let counters = session.counters();
        state.last.note(&state.status.session, &counters);
        state.status.session = counters;
        state.status.units = session.units();
        state.status.unit_is_chosen = session.chooses_a_unit();
        state.status.other_product = session.other_product();
        if state.status.first_refusal.is_none() {
            state.status.first_refusal = session.first_refusal().map(str::to_owned);
        }
    }
}

impl LastTimes {
    /// What has grown came just now.
    fn note(&mut self, before: &SessionCounters, after: &SessionCounters) {
        let now = Some(Instant::now());
        let kinds = [
            (&mut self.byte, before.bytes_received, after.bytes_received),
            (&mut self.frame, before.frames_good, after.frames_good),
            (&mut self.profile, before.profiles, after.profiles),
            (&mut self.ping, before.pings, after.pings),
        ];
        for (last, before, after) in kinds {
            if after > before {
                *last = now;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_came_has_an_age() {
        let status = SharedStatus::default();
        let before = SessionCounters::default();
        let noise = SessionCounters {
            bytes_received: 100,
            ..before
        };
        let mut last = LastTimes::default();
        last.note(&before, &noise);
        assert!(last.byte.is_some() && last.frame.is_none() && last.ping.is_none());
        last.note(
            &noise,
            &SessionCounters {
                frames_good: 1,
                ..noise
            },
        );
        assert!(last.frame.is_some() && last.profile.is_none());
        assert_eq!(status.read().since_byte_s, None);
    }
}
