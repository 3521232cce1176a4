//! Asking the device who it is and how to ping, again and again until it shows that it heard.

use echosplat_firmware_protocol::{EncodeError, Message, OsMonoProfile, OsPingParams, id};
use echosplat_model::Timestamp;

use crate::config::SessionConfig;

/// First wait before asking again; it doubles up to [`MAX_WAIT_S`].
const MIN_WAIT_S: f64 = 0.5;
const MAX_WAIT_S: f64 = 30.0;
/// A unit that has not said who it is after so many requests is not asked again.
const MAX_IDENTITY_REQUESTS: u32 = 8;
/// So many profiles with other settings on end: somebody else has changed them.
const MISMATCH_RUN: u32 = 8;
/// Two that both insist change the settings no more often than this, in the end.
const MAX_DISPUTE_WAIT_S: f64 = 60.0;
/// Without profiles for so long the unit was restarted or never heard. Also 10 intervals.
const SILENCE_S: f64 = 3.0;

/// Which length of the settings message goes out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Variant {
    /// 36 bytes of payload.
    Full,
    /// 34, as one vendor page has it.
    Short,
}

/// When to ask again.
#[derive(Debug, Clone, Copy)]
struct Retry {
    due: Option<Timestamp>,
    wait_s: f64,
    sent: u32,
}

impl Retry {
    fn starting(now: Timestamp, wait_s: f64) -> Self {
        Self {
            due: Some(now),
            wait_s,
            sent: 0,
        }
    }

    fn is_due(&self, now: Timestamp) -> bool {
        self.due.is_some_and(|due| due <= now)
    }

    fn sent(&mut self, now: Timestamp) {
        self.due = Some(now.offset_by(self.wait_s));
        self.wait_s = (2.0 * self.wait_s).min(MAX_WAIT_S);
        self.sent += 1;
    }
}

/// What a profile shows about the settings asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Confirmation {
    /// They are in force, and were not known to be before.
    Confirmed,
    /// Nothing new.
    AsBefore,
    /// Others are in force.
    Mismatch,
    /// Others have been in force for a while after those asked for were: somebody else asks too.
    Disputed,
}

#[derive(Debug, Clone)]
pub(crate) struct Handshake {
    identity: Retry,
    settings: Retry,
    /// What the last settings message was, and whether a profile has confirmed it since.
    variant: Variant,
    is_configured: bool,
    mismatches: u32,
    /// Wait before asking again for what somebody else has changed; at first none.
    dispute_wait_s: f64,
    /// When the last profile came, or profiles were first to be expected.
    last_profile: Timestamp,
    has_ended: bool,
}

impl Handshake {
    pub(crate) fn new(config: &SessionConfig, now: Timestamp) -> Self {
        Self {
            identity: Retry::starting(now, MIN_WAIT_S),
            settings: Retry::starting(now, first_wait_s(config)),
            variant: Variant::Full,
            is_configured: false,
            mismatches: 0,
            dispute_wait_s: 0.0,
            last_profile: now,
            has_ended: false,
        }
    }

    /// Nothing is asked any more: the link is down, or there is none.
    pub(crate) fn suspend(&mut self) {
        self.identity.due = None;
        self.settings.due = None;
        self.is_configured = false;
    }

    /// The earliest time at which [`Handshake::handle_timeout`] has something to do.
    pub(crate) fn poll_timeout(&self, config: &SessionConfig) -> Option<Timestamp> {
        let silence = self.is_configured.then(|| self.silent_at(config));
        let dues = [self.identity.due, self.settings.due, silence];
        dues.into_iter().flatten().min()
    }

    /// Pushes what is to be sent now to `outgoing`; returns how many settings messages went out
    /// again.
    pub(crate) fn handle_timeout(
        &mut self,
        config: &SessionConfig,
        now: Timestamp,
        outgoing: &mut dyn FnMut(Vec<u8>),
    ) -> u64 {
        if self.is_configured && self.silent_at(config) <= now {
            self.configure_again(config, now);
        }
        if self.identity.is_due(now) {
            self.identity.sent(now);
            if self.identity.sent >= MAX_IDENTITY_REQUESTS {
                self.identity.due = None;
            }
            for requested_id in [id::DEVICE_INFORMATION, id::PROTOCOL_VERSION] {
                outgoing(encoded(&Message::GeneralRequest { requested_id }));
            }
        }
        if !self.settings.is_due(now) {
            return 0;
        }
        // Twice the documented length, then both in turn.
        self.variant = match self.settings.sent {
            sent if sent >= 2 && sent % 2 == 0 => Variant::Short,
            _ => Variant::Full,
        };
        self.settings.sent(now);
        outgoing(settings_frame(config, true, self.variant));
        u64::from(self.settings.sent > 1)
    }

    /// The device said who it is, or that it will not.
    pub(crate) fn identity_answered(&mut self) {
        self.identity.due = None;
    }

    /// A profile came; `now` restarts the wait for the next.
    pub(crate) fn profile(
        &mut self,
        profile: &OsMonoProfile<'_>,
        config: &SessionConfig,
        now: Timestamp,
    ) -> Confirmation {
        self.last_profile = now;
        if !shows_settings(profile, config) {
            self.mismatches += 1;
            if !(self.is_configured && self.mismatches >= MISMATCH_RUN) {
                return Confirmation::Mismatch;
            }
            self.configure_again(config, now.offset_by(self.dispute_wait_s));
            self.dispute_wait_s = (2.0 * self.dispute_wait_s).clamp(1.0, MAX_DISPUTE_WAIT_S);
            return Confirmation::Disputed;
        }
        self.mismatches = 0;
        if self.is_configured {
            return Confirmation::AsBefore;
        }
        self.is_configured = true;
        self.settings.due = None;
        Confirmation::Confirmed
    }

    /// The messages that stop the device, and the end of all asking. Both lengths if it is not
    /// known which one the device understands.
    pub(crate) fn stop(&mut self, config: &SessionConfig) -> Vec<Vec<u8>> {
        let variants: &[Variant] = match (self.has_ended, self.is_configured) {
            (true, _) => &[],
            (false, true) => &[self.variant],
            (false, false) => &[Variant::Full, Variant::Short],
        };
        let frames = variants
            .iter()
            .map(|&variant| settings_frame(config, false, variant))
            .collect();
        self.suspend();
        self.has_ended = true;
        frames
    }

    /// The host's clock went back by `seconds`: so do all waits.
    pub(crate) fn shift(&mut self, seconds: f64) {
        for due in [&mut self.identity.due, &mut self.settings.due] {
            *due = due.map(|due| due.offset_by(-seconds));
        }
        self.last_profile = self.last_profile.offset_by(-seconds);
    }

    fn configure_again(&mut self, config: &SessionConfig, now: Timestamp) {
        self.is_configured = false;
        self.mismatches = 0;
        self.settings = Retry::starting(now, first_wait_s(config));
    }

    fn silent_at(&self, config: &SessionConfig) -> Timestamp {
        let silence_s = SILENCE_S.max(10.0 * config.expected_interval_s());
        self.last_profile.offset_by(silence_s)
    }
}

/// The first profile takes an interval to come.
fn first_wait_s(config: &SessionConfig) -> f64 {
    MIN_WAIT_S.max(3.0 * config.expected_interval_s())
}

/// Start, length and bins are those asked for; a unit may round ranges by up to 1 %.
fn shows_settings(profile: &OsMonoProfile<'_>, config: &SessionConfig) -> bool {
    let (start_mm, length_mm) = config.range_mm();
    let tolerance = 2 + length_mm / 100;
    profile.start_mm.abs_diff(start_mm) <= tolerance
        && profile.length_mm.abs_diff(length_mm) <= tolerance
        && profile.pwr_results.len() == usize::from(config.bin_count)
}

fn settings_frame(config: &SessionConfig, enable: bool, variant: Variant) -> Vec<u8> {
    let (start_mm, length_mm) = config.range_mm();
    let params = OsPingParams {
        start_mm,
        length_mm,
        msec_per_ping: config.ping_interval_ms,
        pulse_len_percent: config.pulse_len_fraction as f32,
        filter_duration_percent: config.filter_duration_fraction as f32,
        gain_index: config.gain_index,
        num_results: config.bin_count,
        enable,
    };
    match variant {
        Variant::Full => encoded(&Message::OsPingParams(params)),
        Variant::Short => written(|out| params.encode_short(0, 0, out)),
    }
}

fn encoded(message: &Message<'_>) -> Vec<u8> {
    written(|out| message.encode(0, 0, out))
}

/// Requests have at most 46 bytes; one that could not be written is empty and not sent.
fn written(encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>) -> Vec<u8> {
    let mut frame = vec![0; 64];
    let byte_count = encode(&mut frame).unwrap_or(0);
    frame.truncate(byte_count);
    frame
}
