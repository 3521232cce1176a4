//! Profiles to pings: which are taken, what number and what time each gets.

use std::sync::Arc;

use echosplat_firmware_protocol::{Frame, Message, OsMonoProfile};
use echosplat_model::{Ping, Timestamp};

use crate::clock::{DeviceClock, DeviceTime, HostClock};
use crate::config::{ClockSource, SessionConfig};
use crate::continuity::{Break, Continuity, Fate, HeldFate};
use crate::counters::SessionCounters;
use crate::profile::{self, Implausible};
use crate::session::SessionEvent;

/// The profiles of one device, or of one log.
#[derive(Debug)]
pub(crate) struct Stream {
    is_log: bool,
    continuity: Continuity,
    /// The profile that waits for the next to confirm it, and when it came.
    held: Option<(Arc<[u8]>, Timestamp)>,
    channel: Option<u8>,
    device_clock: DeviceClock,
    host_clock: HostClock,
    base: Base,
}

/// What is added to device time.
#[derive(Debug, Clone, Copy)]
enum Base {
    Nanos(i64),
    /// A log's session began at this time; known with its first profile.
    SessionStart(Timestamp),
}

impl Stream {
    pub(crate) fn new(config: &SessionConfig, is_log: bool) -> Self {
        Self {
            is_log,
            continuity: Continuity::new(is_log),
            held: None,
            channel: config.channel,
            device_clock: DeviceClock::default(),
            host_clock: HostClock::default(),
            base: Base::Nanos(0),
        }
    }

    /// A session of a log begins: another order of pings, another base of time.
    pub(crate) fn begin_log_session(
        &mut self,
        timestamp: Option<Timestamp>,
        config: &SessionConfig,
    ) {
        self.continuity = Continuity::new(true);
        self.channel = config.channel;
        self.base = timestamp.map_or(Base::Nanos(0), Base::SessionStart);
    }

    /// Whether the profile is of the channel listened to.
    pub(crate) fn is_heard(&self, profile: &OsMonoProfile<'_>) -> bool {
        self.channel
            .is_none_or(|channel| channel == profile.channel_number)
    }

    /// Takes, holds or leaves out one profile.
    pub(crate) fn insert(
        &mut self,
        profile: &OsMonoProfile<'_>,
        frame: &Frame<'_>,
        (config, now): (&SessionConfig, Timestamp),
        counters: &mut SessionCounters,
        emit: &mut dyn FnMut(SessionEvent),
    ) {
        if let Err(reason) = profile::check(profile) {
            match reason {
                Implausible::Settings => counters.profiles_rejected.settings += 1,
                Implausible::Scale => counters.profiles_rejected.scale += 1,
            }
            return;
        }
        // Without one configured, the first that makes sense.
        self.channel.get_or_insert(profile.channel_number);
        let verdict = self.continuity.judge(profile::stamp(profile));
        self.settle_held(verdict.held, config, counters, emit);
        let rejected = &mut counters.profiles_rejected;
        match verdict.this {
            Fate::Taken(how) => {
                let frame = Arc::from(frame.bytes());
                self.take(how, profile, (frame, now), config, counters, emit);
            }
            Fate::Held => self.held = Some((Arc::from(frame.bytes()), now)),
            Fate::Duplicate => rejected.duplicate += 1,
            Fate::Late => rejected.late += 1,
        }
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
        match (fate, message) {
            (HeldFate::Taken(how), Some(Message::OsMonoProfile(profile))) => {
                let origin = (Arc::clone(&bytes), arrival);
                self.take(how, &profile, origin, config, counters, emit);
            }
            _ => counters.profiles_rejected.unconfirmed += 1,
        }
    }

    fn take(
        &mut self,
        how: Break,
        profile: &OsMonoProfile<'_>,
        (frame, arrival): (Arc<[u8]>, Timestamp),
        config: &SessionConfig,
        counters: &mut SessionCounters,
        emit: &mut dyn FnMut(SessionEvent),
    ) {
        if how == Break::Restart {
            counters.reboots += 1;
            self.host_clock.forget();
            emit(SessionEvent::Rebooted);
        }
        let stamp = profile::stamp(profile);
        let device = self.device_clock.advance(how, &stamp);
        let transmit_time = self.transmit_time(&device, arrival, config, counters);
        let settings = profile::settings(profile, config);
        let intensity = profile::intensity(profile, &settings, config);
        match Ping::new(device.sequence, transmit_time, settings, intensity) {
            Ok(ping) => {
                counters.pings += 1;
                counters.pings_missing += device.missing;
                let ping = Arc::new(ping);
                emit(SessionEvent::Ping { ping, frame });
            }
            // What `check` lets through a ping can hold; were it not so, it is counted.
            Err(_) => counters.profiles_rejected.settings += 1,
        }
    }

    fn transmit_time(
        &mut self,
        device: &DeviceTime,
        arrival: Timestamp,
        config: &SessionConfig,
        counters: &mut SessionCounters,
    ) -> Timestamp {
        if self.is_log || config.clock == ClockSource::Device {
            let base = match self.base {
                Base::Nanos(nanos) => nanos,
                Base::SessionStart(start) => start.nanos().saturating_sub(device.nanos),
            };
            self.base = Base::Nanos(base);
            return Timestamp::from_nanos(device.nanos.saturating_add(base));
        }
        let sent = arrival.offset_by(-config.link_latency_s);
        let mapped = self.host_clock.map(device.nanos, sent);
        counters.clock_steps += u64::from(mapped.stepped);
        mapped.time
    }
}
