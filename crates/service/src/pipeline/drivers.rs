//! The sonar's task, or one thread per log, one after another.

use std::collections::VecDeque;

use crossbeam_channel::Sender;
use echosplat_driver::{
    DriverConfig, DriverError, DriverEvent, DriverHandle, DriverStatus, LinkState, Pause, SonarUrl,
    Tape,
};
use echosplat_liveness::Heartbeat;
use echosplat_session::{ProfilesRejected, SessionCounters, UnitHeard};
use tokio::runtime::Handle;

use crate::exit::Usage;
use crate::recorder::MakeTap;
use crate::runtime;

/// Where pings come from: a link, a log, a recording, or a driver elsewhere.
pub(crate) struct Input {
    pub(crate) config: DriverConfig,
    /// Opens a recording in place of the link; `None` for a link or a log.
    pub(crate) tape: Option<OpenTape>,
    /// How many bytes it holds, where that is known.
    pub(crate) byte_count: Option<u64>,
    /// What it gives is recorded by whoever opened it.
    pub(crate) records_itself: bool,
}

pub(crate) type OpenTape = Box<dyn FnOnce() -> anyhow::Result<Tape>>;

impl Input {
    /// A link.
    pub(crate) fn link(config: DriverConfig) -> Self {
        Self {
            config,
            tape: None,
            byte_count: None,
            records_itself: false,
        }
    }
}

/// Inputs in order; only the last may be one that does not end by itself.
pub(crate) struct Drivers {
    runtime: Handle,
    running: Option<DriverHandle>,
    /// How the link at hand is begun again; `None` for a log.
    link: Option<DriverConfig>,
    waiting: VecDeque<Input>,
    done: Vec<DriverStatus>,
    tap: Option<MakeTap>,
    /// Given up with the last log, so that the mapper's thread sees the end.
    events: Option<Sender<DriverEvent>>,
    /// Of all inputs, if all say it.
    byte_count: Option<u64>,
    /// Of what is replayed.
    pause: Option<Pause>,
}

impl Drivers {
    /// Starts the first.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(crate) fn start(
        inputs: Vec<Input>,
        tap: Option<MakeTap>,
        events: Sender<DriverEvent>,
    ) -> anyhow::Result<Self> {
        let mut drivers = Self {
            runtime: runtime::handle()?,
            running: None,
            link: None,
            byte_count: inputs.iter().map(|input| input.byte_count).sum(),
            pause: inputs.first().and_then(|input| input.config.pause.clone()),
            waiting: inputs.into(),
            done: Vec::new(),
            tap,
            events: Some(events),
        };
        drivers.start_next()?;
        Ok(drivers)
    }

    /// Whether the input at hand is a link, whose sonar is asked for pings.
    pub(crate) fn asks_a_sonar(&self) -> bool {
        self.link.is_some()
    }

    /// How much of the logs has been read, 0 to 1.
    pub(crate) fn share_read(&self) -> Option<f64> {
        let byte_count = self.byte_count.filter(|&count| count > 0)?;
        let read = self.status().session.bytes_received;
        Some((read as f64 / byte_count as f64).min(1.0))
    }

    /// Whether somebody holds what is replayed; `None` where nothing is.
    pub(crate) fn is_held(&self) -> Option<bool> {
        self.pause.as_ref().map(Pause::is_set)
    }

    /// Inputs, begun or not.
    pub(crate) fn count(&self) -> usize {
        self.waiting.len() + usize::from(self.running.is_some())
    }

    /// If the input at hand has ended and another waits, begins that.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(crate) fn go_on_to_next(&mut self) -> anyhow::Result<()> {
        let ended = self.running.as_ref().is_some_and(DriverHandle::is_finished);
        match ended && !self.waiting.is_empty() {
            true => self.start_next(),
            false => Ok(()),
        }
    }

    fn start_next(&mut self) -> anyhow::Result<()> {
        self.stop_running();
        let Some(input) = self.waiting.pop_front() else {
            return Ok(());
        };
        let is_link = input.tape.is_none() && !matches!(input.config.url, SonarUrl::File(_));
        self.link = is_link.then(|| input.config.clone());
        let events = match self.waiting.is_empty() && !is_link {
            true => self.events.take(),
            false => self.events.clone(),
        };
        let Some(events) = events else { return Ok(()) };
        let tap = self.tap.as_ref().filter(|_| !input.records_itself);
        let tap = tap.map(|make| make());
        let url = input.config.url.to_string();
        let handle = match input.tape {
            Some(open) => echosplat_driver::spawn_tape(&input.config, open()?, tap, events),
            None => echosplat_driver::spawn(&self.runtime, input.config, tap, events),
        };
        let handle = handle.map_err(|error| match error {
            DriverError::Thread(_) => anyhow::Error::new(error),
            wrong => Usage::error(format!("{url}: {wrong}")),
        })?;
        self.running = Some(handle);
        Ok(())
    }

    /// Of the input at hand.
    pub(crate) fn heartbeat(&self) -> Option<&Heartbeat> {
        self.running.as_ref().map(DriverHandle::heartbeat)
    }

    /// If the link hangs, another takes its place.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(crate) fn replace_if_it_hangs(&mut self) -> anyhow::Result<()> {
        let hangs = |handle: &mut DriverHandle| handle.heartbeat().is_to_be_replaced();
        let (Some(link), Some(events)) = (&self.link, &self.events) else {
            return Ok(());
        };
        let Some(hung) = self.running.take_if(hangs) else {
            return Ok(());
        };
        let tap = self.tap.as_ref().map(|make| make());
        let (config, events) = (link.clone(), events.clone());
        let runtime = &self.runtime;
        let (running, last) =
            echosplat_driver::spawn_in_place_of(hung, runtime, config, tap, events)?;
        self.done.push(last);
        self.running = Some(running);
        Ok(())
    }

    /// Ends the input at hand, a sonar with `enable = 0`, and forgets those that wait.
    pub(crate) fn stop(&mut self) {
        self.waiting.clear();
        self.events = None;
        self.stop_running();
    }

    fn stop_running(&mut self) {
        if let Some(running) = self.running.take() {
            let before = running.status();
            self.done.push(without_own_cut(&before, running.stop()));
        }
    }

    /// Of the input at hand, with the counters of those before added.
    pub(crate) fn status(&self) -> DriverStatus {
        let running = self.running.as_ref().map(DriverHandle::status);
        let all = self.done.iter().cloned().chain(running);
        all.reduce(|sum, next| add(&sum, next)).unwrap_or_default()
    }
}

/// A frame that was cut by our own stop is no damage of the link.
fn without_own_cut(before: &DriverStatus, mut after: DriverStatus) -> DriverStatus {
    let new_bad = after
        .session
        .frames_bad
        .saturating_sub(before.session.frames_bad);
    if after.link == LinkState::Stopped && new_bad <= 1 {
        after.session.frames_bad = before.session.frames_bad;
        after.session.bytes_skipped = before.session.bytes_skipped;
    }
    after
}

/// Counters of both, the rest of the later one.
fn add(sum: &DriverStatus, mut next: DriverStatus) -> DriverStatus {
    add_session(&mut next.session, &sum.session);
    next.connects += sum.connects;
    next.disconnects += sum.disconnects;
    next.pings_sent += sum.pings_sent;
    next.pings_dropped += sum.pings_dropped;
    next.events_dropped += sum.events_dropped;
    next.bytes_after_stop += sum.bytes_after_stop;
    next.stop_sent |= sum.stop_sent;
    next.other_product = next.other_product.or(sum.other_product);
    for unit in &sum.units {
        let alike =
            |other: &&mut UnitHeard| (other.label, other.is_mapped) == (unit.label, unit.is_mapped);
        match next.units.iter_mut().find(alike) {
            Some(other) => other.profiles += unit.profiles,
            None => next.units.push(*unit),
        }
    }
    next
}

fn add_session(sum: &mut SessionCounters, other: &SessionCounters) {
    let mut other = *other;
    for (sum, other) in fields(sum).into_iter().zip(fields(&mut other)) {
        *sum += *other;
    }
}

/// Every counter; the compiler says when one is missing here.
fn fields(counters: &mut SessionCounters) -> [&mut u64; 34] {
    let SessionCounters {
        bytes_received,
        frames_good,
        frames_bad,
        bytes_skipped,
        frames_unknown,
        frames_unused,
        profiles,
        pings,
        pings_late,
        pings_missing,
        settings_mismatched,
        resends,
        reboots,
        clock_steps,
        acks,
        nacks,
        log_sessions,
        json_bad,
        nmea,
        mavlink,
        status,
        profiles_rejected,
    } = counters;
    let ProfilesRejected {
        payload,
        other_channel,
        other_unit,
        range,
        bins,
        speed_of_sound,
        frequency,
        pulse,
        gain,
        scale,
        duplicate,
        late,
        unconfirmed,
    } = profiles_rejected;
    [
        bytes_received,
        frames_good,
        frames_bad,
        bytes_skipped,
        frames_unknown,
        frames_unused,
        profiles,
        pings,
        pings_late,
        pings_missing,
        settings_mismatched,
        resends,
        reboots,
        clock_steps,
        acks,
        nacks,
        log_sessions,
        json_bad,
        nmea,
        mavlink,
        status,
        payload,
        other_channel,
        other_unit,
        range,
        bins,
        speed_of_sound,
        frequency,
        pulse,
        gain,
        scale,
        duplicate,
        late,
        unconfirmed,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_frame_that_the_stop_cut_is_forgiven() {
        let before = DriverStatus::default();
        let mut after = DriverStatus {
            link: LinkState::Stopped,
            ..DriverStatus::default()
        };
        after.session.frames_bad = 1;
        after.session.bytes_skipped = 700;
        let forgiven = without_own_cut(&before, after.clone());
        assert_eq!(forgiven.session.bytes_skipped, 0);
        after.link = LinkState::Ended;
        let cut_log = without_own_cut(&before, after);
        assert_eq!(cut_log.session.bytes_skipped, 700);
    }

    #[test]
    fn logs_add_up() {
        let mut first = DriverStatus::default();
        first.session.profiles = 3;
        first.session.profiles_rejected.late = 1;
        let mut second = first.clone();
        second.session.pings = 2;
        let sum = add(&first, second);
        assert_eq!(sum.session.profiles, 6);
        assert_eq!(sum.session.profiles_rejected.late, 2);
        assert_eq!(sum.session.pings, 2);
    }
}
