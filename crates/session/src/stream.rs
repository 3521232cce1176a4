//! Profiles to pings: which are taken, what number and what time each gets.

use std::sync::Arc;

use bytes::Bytes;
use echosplat_firmware_protocol::{Frame, Message, OsMonoProfile};
use echosplat_model::{Ping, Timestamp};

use crate::clock::{DeviceClock, DeviceTime, HostClock};
use crate::config::{ClockSource, SessionConfig};
use crate::continuity::{Advance, Break, Continuity, Fate, HeldFate};
use crate::counters::SessionCounters;
use crate::event::SessionEvent;
use crate::profile::{self, Implausible};

/// The profiles of one device, or of one log.
#[derive(Debug)]
pub(crate) struct Stream {
    is_log: bool,
    continuity: Continuity,
    /// The profile that waits for the next to confirm it, and when it came.
    held: Option<(Bytes, Timestamp)>,
    device_clock: DeviceClock,
    host_clock: HostClock,
    base: Base,
    /// Time of the newest ping over device time.
    offset_nanos: Option<i64>,
}

/// A profile that is taken, as it came.
struct Origin<'a> {
    profile: &'a OsMonoProfile<'a>,
    frame: Bytes,
    arrival: Timestamp,
}

/// No link's delay changes by more.
const STEP_NANOS: u64 = 1_000_000_000;

/// What is added to device time.
#[derive(Debug, Clone, Copy)]
enum Base {
    Nanos(i64),
    /// A log's session began at this time; known with its first profile.
    SessionStart(Timestamp),
}

impl Stream {
    pub(crate) fn new(is_log: bool) -> Self {
        Self {
            is_log,
            continuity: Continuity::new(is_log, true),
            held: None,
            device_clock: DeviceClock::default(),
            host_clock: HostClock::default(),
            base: Base::Nanos(0),
            offset_nanos: None,
        }
    }

    /// A session of a log begins: another order of pings, another base of time.
    pub(crate) fn begin_log_session(&mut self, timestamp: Option<Timestamp>) {
        let is_first = !self.device_clock.is_running();
        self.continuity = Continuity::new(true, is_first);
        self.base = timestamp.map_or(Base::Nanos(0), Base::SessionStart);
    }

    /// Whether the profile was taken already, or there is a place for it before the last one.
    pub(crate) fn has_place_for(&self, profile: &OsMonoProfile<'_>) -> bool {
        self.continuity.has_place_for(&profile::stamp(profile))
    }

    /// Takes, holds or leaves out one profile.
    ///
    /// # Errors
    /// What it says that no sonar can have; it is counted.
    pub(crate) fn insert(
        &mut self,
        profile: &OsMonoProfile<'_>,
        frame: &Frame<'_>,
        (config, now): (&SessionConfig, Timestamp),
        counters: &mut SessionCounters,
        emit: &mut dyn FnMut(SessionEvent),
    ) -> Result<(), Implausible> {
        if let Err(reason) = profile::check(profile) {
            *reason.counter(&mut counters.profiles_rejected) += 1;
            return Err(reason);
        }
        let verdict = self.continuity.judge(profile::stamp(profile));
        self.settle_held(verdict.held, config, counters, emit);
        let origin = || Origin {
            profile,
            frame: Bytes::copy_from_slice(frame.bytes()),
            arrival: now,
        };
        match verdict.this {
            Fate::Taken(how) => self.take(how, origin(), config, counters, emit),
            Fate::Late(step) => self.take_late(step, origin(), config, counters, emit),
            Fate::Held => self.held = Some((Bytes::copy_from_slice(frame.bytes()), now)),
            Fate::Duplicate => counters.profiles_rejected.duplicate += 1,
            Fate::Misplaced => counters.profiles_rejected.late += 1,
        }
        Ok(())
    }

    /// Nothing more comes of this stream for now: the held profile is taken or left out.
    pub(crate) fn release(
        &mut self,
        config: &SessionConfig,
        counters: &mut SessionCounters,
        emit: &mut dyn FnMut(SessionEvent),
    ) {
        let fate = self.continuity.release();
        self.settle_held(fate, config, counters, emit);
    }

    fn settle_held(
        &mut self,
        fate: Option<HeldFate>,
        config: &SessionConfig,
        counters: &mut SessionCounters,
        emit: &mut dyn FnMut(SessionEvent),
    ) {
        let Some(fate) = fate else { return };
        let Some((bytes, arrival)) = self.held.take() else {
            return;
        };
        let frame = Frame::from_bytes(&bytes).ok();
        let message = frame.and_then(|frame| Message::parse(&frame).ok());
        let Some(Message::OsMonoProfile(profile)) = message else {
            counters.profiles_rejected.unconfirmed += 1;
            return;
        };
        let origin = Origin {
            profile: &profile,
            frame: bytes.clone(),
            arrival,
        };
        match fate {
            HeldFate::Taken(how) => self.take(how, origin, config, counters, emit),
            HeldFate::Late(step) => self.take_late(step, origin, config, counters, emit),
            HeldFate::Dropped => counters.profiles_rejected.unconfirmed += 1,
        }
    }

    fn take(
        &mut self,
        how: Break,
        origin: Origin<'_>,
        config: &SessionConfig,
        counters: &mut SessionCounters,
        emit: &mut dyn FnMut(SessionEvent),
    ) {
        if how == Break::Restart {
            counters.reboots += 1;
            self.host_clock.forget();
            emit(SessionEvent::Rebooted);
        }
        let stamp = profile::stamp(origin.profile);
        let device = self.device_clock.advance(how, &stamp);
        let transmit_time = self.transmit_time(&device, origin.arrival, config, counters);
        if self.has_clock_stepped(how, &device, transmit_time) {
            emit(SessionEvent::ClockStepped);
        }
        counters.pings_missing += device.missing;
        finish(origin, &device, transmit_time, config, counters, emit);
    }

    /// One made before the newest, at its own place in number and time.
    fn take_late(
        &mut self,
        step: Advance,
        origin: Origin<'_>,
        config: &SessionConfig,
        counters: &mut SessionCounters,
        emit: &mut dyn FnMut(SessionEvent),
    ) {
        let device = self.device_clock.late(step);
        let transmit_time = match self.is_on_device_clock(config) {
            true => self.on_device_clock(&device),
            false => {
                let sent = origin.arrival.offset_by(-config.link_latency_s);
                self.host_clock.place(device.nanos, sent)
            }
        };
        counters.pings_late += 1;
        counters.pings_missing = counters.pings_missing.saturating_sub(1);
        finish(origin, &device, transmit_time, config, counters, emit);
    }

    /// Whether the time of pings went on by another amount than the device's own, and not by what a
    /// link's delay explains.
    fn has_clock_stepped(&mut self, how: Break, device: &DeviceTime, time: Timestamp) -> bool {
        let offset = time.nanos().saturating_sub(device.nanos);
        let before = self.offset_nanos.replace(offset);
        let is_on = how != Break::Restart && how != Break::First;
        let step = before.map_or(0, |before| offset.saturating_sub(before));
        is_on && step.unsigned_abs() > STEP_NANOS
    }

    fn is_on_device_clock(&self, config: &SessionConfig) -> bool {
        self.is_log || config.clock == ClockSource::Device
    }

    fn on_device_clock(&mut self, device: &DeviceTime) -> Timestamp {
        let base = match self.base {
            Base::Nanos(nanos) => nanos,
            Base::SessionStart(start) => start.nanos().saturating_sub(device.nanos),
        };
        self.base = Base::Nanos(base);
        Timestamp::from_nanos(device.nanos.saturating_add(base))
    }

    fn transmit_time(
        &mut self,
        device: &DeviceTime,
        arrival: Timestamp,
        config: &SessionConfig,
        counters: &mut SessionCounters,
    ) -> Timestamp {
        if self.is_on_device_clock(config) {
            return self.on_device_clock(device);
        }
        let sent = arrival.offset_by(-config.link_latency_s);
        let mapped = self.host_clock.map(device.nanos, sent);
        counters.clock_steps += u64::from(mapped.stepped);
        mapped.time
    }
}

/// Makes the ping of a profile whose number and time are known.
fn finish(
    origin: Origin<'_>,
    device: &DeviceTime,
    transmit_time: Timestamp,
    config: &SessionConfig,
    counters: &mut SessionCounters,
    emit: &mut dyn FnMut(SessionEvent),
) {
    let Origin { profile, frame, .. } = origin;
    let settings = profile::settings(profile, config);
    let intensity = profile::intensity(profile, &settings, config);
    match Ping::new(device.sequence, transmit_time, settings, intensity) {
        Ok(ping) => {
            counters.pings += 1;
            let ping = Arc::new(ping);
            emit(SessionEvent::Ping { ping, frame });
        }
        // What `check` lets through a ping can hold; were it not so, it is counted.
        Err(_) => counters.profiles_rejected.range += 1,
    }
}
