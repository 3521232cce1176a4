//! The simulated unit behind the real protocol, without any transport.

mod request;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use echosplat_firmware_protocol::{
    Decoder, DeviceInformation, Event, Frame, Message, OsPingParams, ProtocolVersion, Status,
    SyncChannel, Text, id,
};
use echosplat_model::Timestamp;

use crate::dive::SPEED_OF_SOUND_MPS;
use crate::sonar::{SimulatedSonar, encoded};
use request::Asked;

/// As a real FS unit answers.
const IDENTITY: DeviceInformation = DeviceInformation {
    device_type: 104,
    device_revision: 2,
    firmware: [1, 5, 6],
};
const PROTOCOL: ProtocolVersion = ProtocolVersion { version: [1, 0, 0] };
/// Never assigned.
const CHANNEL: SyncChannel = SyncChannel {
    channel_number: 255,
    channel_count: 1,
};
const DEVICE_ID: u8 = 1;
/// Status comes at 0.9 Hz, an empty message now and then.
const STATUS_INTERVAL_MS: i64 = 1_111;
const NOP_INTERVAL_MS: i64 = 7_300;
/// Replies that wait for [`SimulatedDevice::advance`]; later ones are dropped and counted.
const MAX_WAITING_REPLY_BYTES: usize = 64 << 10;
/// Frames made by one call of [`SimulatedDevice::advance`].
const MAX_FRAMES_PER_ADVANCE: usize = 64;

/// What a device has seen and done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeviceCounters {
    /// Intact frames received.
    pub frames: u64,
    /// Bytes received that belong to no intact frame.
    pub bytes_skipped: u64,
    /// Requests for one message.
    pub requests: u64,
    /// Ping settings that start or keep it pinging.
    pub enables: u64,
    /// Ping settings that stop it.
    pub disables: u64,
    /// Requests refused.
    pub nacks: u64,
    /// Profiles made.
    pub pings: u64,
    /// Replies dropped because nobody took them.
    pub replies_dropped: u64,
}

/// An `OmniScan` 450 FS carried along a dive: bytes in, bytes out, and when to come back.
///
/// Its clock is the dive's: it stands at 0 until a client first starts pinging, then runs with the
/// time its caller passes in, on which the dive goes on whether it is pinging or not. Stopped and
/// started again after its end, the dive begins anew, as after a restart of the device. What it sends
/// is meant for all its clients; so is what it is told: the last settings hold.
pub struct SimulatedDevice {
    sonar: Arc<SimulatedSonar>,
    decoder: Decoder,
    device_id: u8,
    channel: SyncChannel,
    speed_of_sound_mps: f64,
    /// The caller's time at which the dive began.
    began: Option<Timestamp>,
    pinging: Option<Asked>,
    due: Due,
    /// Counted from the beginning of the dive.
    ping_number: u64,
    range_has_changed: bool,
    replies: Vec<u8>,
    counters: DeviceCounters,
}

/// Times of the next frames sent unasked, milliseconds into the dive.
#[derive(Debug, Clone, Copy)]
struct Due {
    ping_ms: i64,
    status_ms: i64,
    nop_ms: i64,
}

impl Due {
    const AT_FIRST: Self = Self {
        ping_ms: 0,
        status_ms: STATUS_INTERVAL_MS,
        nop_ms: NOP_INTERVAL_MS,
    };
}

impl SimulatedDevice {
    /// Powered up and silent.
    #[must_use]
    pub fn new(sonar: Arc<SimulatedSonar>) -> Self {
        Self {
            sonar,
            decoder: Decoder::new(),
            device_id: DEVICE_ID,
            channel: CHANNEL,
            speed_of_sound_mps: SPEED_OF_SOUND_MPS,
            began: None,
            pinging: None,
            due: Due::AT_FIRST,
            ping_number: 0,
            range_has_changed: false,
            replies: Vec::new(),
            counters: DeviceCounters::default(),
        }
    }

    /// Takes bytes from a client at the caller's time `now`; what it answers comes with the next
    /// [`Self::advance`]. At most 64 KiB of answers wait.
    pub fn receive(&mut self, bytes: &[u8], now: Timestamp) {
        // Taken out so that frames it lends can be handled by the rest of the device.
        let mut decoder = std::mem::replace(&mut self.decoder, Decoder::new());
        decoder.feed(bytes, &mut |event| match event {
            Event::Frame(frame) => self.handle(&frame, now),
            Event::Skipped(skipped) => self.counters.bytes_skipped += skipped.byte_count as u64,
        });
        self.decoder = decoder;
    }

    /// When, by the caller's clock, the next frame is due: at once if an answer waits, never if
    /// it is not pinging or the dive is over.
    #[must_use]
    pub fn next_due(&self) -> Option<Timestamp> {
        if !self.replies.is_empty() {
            return Some(self.began.unwrap_or(Timestamp::ZERO));
        }
        let due = self.due;
        let next_ms = due.ping_ms.min(due.status_ms).min(due.nop_ms);
        let sends = self.pinging.is_some() && !self.is_finished();
        sends.then(|| self.callers_time(next_ms))
    }

    /// When, by the caller's clock, the next ping is due.
    #[must_use]
    pub fn next_ping_due(&self) -> Option<Timestamp> {
        let pings = self.pinging.is_some() && !self.is_finished();
        pings.then(|| self.callers_time(self.due.ping_ms))
    }

    /// How far into the dive the next ping is.
    #[must_use]
    pub fn dive_time(&self) -> Timestamp {
        Timestamp::from_millis(self.due.ping_ms)
    }

    /// All that is to be sent by the caller's time `now`: answers first, then what is due, in
    /// order of time. At most 64 frames a call; [`Self::next_due`] tells whether more are due.
    pub fn advance(&mut self, now: Timestamp) -> Vec<u8> {
        let mut bytes = std::mem::take(&mut self.replies);
        for _ in 0..MAX_FRAMES_PER_ADVANCE {
            match self.next_due() {
                Some(due) if due <= now => bytes.extend(self.next_frame()),
                _ => break,
            }
        }
        bytes
    }

    /// Whether the dive is over.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        self.due.ping_ms as f64 * 1e-3 >= self.sonar.dive().duration_s() - 1e-6
    }

    /// Whether a client has started it and none has stopped it since.
    #[must_use]
    pub fn is_pinging(&self) -> bool {
        self.pinging.is_some()
    }

    /// What it has seen and done so far.
    #[must_use]
    pub fn counters(&self) -> DeviceCounters {
        self.counters
    }

    fn handle(&mut self, frame: &Frame<'_>, now: Timestamp) {
        self.counters.frames += 1;
        match Message::parse(frame) {
            Ok(Message::Nop) => {}
            Ok(Message::GeneralRequest { requested_id }) => self.answer_request(requested_id),
            Ok(Message::OsPingParams(params)) => self.apply(&params, now),
            Ok(Message::SetSpeedOfSound {
                speed_of_sound_mmps,
            }) => self.set_speed_of_sound(speed_of_sound_mmps),
            Ok(Message::SetSyncChannelNumber(channel)) => {
                self.channel = channel;
                self.acknowledge(id::SET_SYNC_CHANNEL_NUMBER);
            }
            Ok(Message::SetDeviceId { device_id }) => {
                self.device_id = device_id;
                self.acknowledge(id::SET_DEVICE_ID);
            }
            Ok(message) => self.refuse(message.id(), "unknown message"),
            Err(_) => self.refuse(frame.message_id(), "malformed message"),
        }
    }

    fn answer_request(&mut self, requested_id: u16) {
        self.counters.requests += 1;
        match requested_id {
            id::DEVICE_INFORMATION => self.reply(&Message::DeviceInformation(IDENTITY)),
            id::PROTOCOL_VERSION => self.reply(&Message::ProtocolVersion(PROTOCOL)),
            id::SYNC_CHANNEL_NUMBER => self.reply(&Message::SyncChannelNumber(self.channel)),
            _ => self.refuse(requested_id, "cannot be requested"),
        }
    }

    /// Settings hold from the next ping on.
    fn apply(&mut self, params: &OsPingParams, now: Timestamp) {
        if !params.enable {
            self.counters.disables += 1;
            self.pinging = None;
            return;
        }
        self.counters.enables += 1;
        if self.pinging.is_none() && self.is_finished() {
            self.begin_anew();
        }
        let began = *self.began.get_or_insert(now);
        if self.pinging.is_none() {
            // What was due while it was silent is not made up for.
            let now_ms = now.nanos().saturating_sub(began.nanos()) / 1_000_000;
            let late = |due_ms: i64| due_ms.max(now_ms);
            self.due.ping_ms = late(self.due.ping_ms);
            self.due.status_ms = late(self.due.status_ms);
            self.due.nop_ms = late(self.due.nop_ms);
        }
        let frequency_hz = self.sonar.dive().settings().frequency_hz;
        self.pinging = Some(Asked::from_params(
            params,
            self.speed_of_sound_mps,
            frequency_hz,
        ));
    }

    fn begin_anew(&mut self) {
        self.began = None;
        self.due = Due::AT_FIRST;
        self.ping_number = 0;
        self.range_has_changed = false;
    }

    fn set_speed_of_sound(&mut self, speed_of_sound_mmps: u32) {
        let speed_mps = f64::from(speed_of_sound_mmps) * 1e-3;
        if !(1000.0..=2000.0).contains(&speed_mps) {
            self.refuse(id::SET_SPEED_OF_SOUND, "speed of sound out of range");
            return;
        }
        self.speed_of_sound_mps = speed_mps;
        if let Some(asked) = &mut self.pinging {
            asked.settings.speed_of_sound_mps = speed_mps;
        }
        self.acknowledge(id::SET_SPEED_OF_SOUND);
    }

    fn acknowledge(&mut self, acked_id: u16) {
        self.reply(&Message::Ack { acked_id });
    }

    fn refuse(&mut self, nacked_id: u16, reason: &str) {
        self.counters.nacks += 1;
        let text = Text::from(reason);
        self.reply(&Message::Nack { nacked_id, text });
    }

    fn reply(&mut self, message: &Message<'_>) {
        match encoded(message, self.device_id) {
            Some(bytes) if self.replies.len() + bytes.len() <= MAX_WAITING_REPLY_BYTES => {
                self.replies.extend(bytes);
            }
            _ => self.counters.replies_dropped += 1,
        }
    }

    fn callers_time(&self, dive_ms: i64) -> Timestamp {
        let began = self.began.unwrap_or(Timestamp::ZERO);
        began.offset_by_nanos(dive_ms.saturating_mul(1_000_000))
    }

    /// The frame that is due first; of several due at once a ping comes first.
    fn next_frame(&mut self) -> Vec<u8> {
        let Due {
            ping_ms,
            status_ms,
            nop_ms,
        } = self.due;
        let frame = if ping_ms <= status_ms.min(nop_ms) {
            self.ping(ping_ms)
        } else if status_ms <= nop_ms {
            self.due.status_ms += STATUS_INTERVAL_MS;
            let status = Status {
                values: [0.0; 2],
                timestamp_ms: status_ms as u32,
                channel_number: self.channel.channel_number,
            };
            encoded(&Message::Status(status), self.device_id)
        } else {
            self.due.nop_ms += NOP_INTERVAL_MS;
            encoded(&Message::Nop, self.device_id)
        };
        frame.unwrap_or_default()
    }

    fn ping(&mut self, ping_ms: i64) -> Option<Vec<u8>> {
        let asked = self.pinging?;
        let time_s = ping_ms as f64 * 1e-3;
        let settings = self.after_range_change(asked, time_s).settings;
        self.due.ping_ms += self.pinging?.interval_ms();
        // The water's speed of sound is the dive's: what the device takes it for only scales the
        // ranges it speaks of.
        let in_water = settings.with_speed_of_sound(SPEED_OF_SOUND_MPS);
        let mut ping = self.sonar.ping_at(self.ping_number, time_s, &in_water);
        ping.settings = echosplat_model::PingSettings {
            gain_index: ping.settings.gain_index,
            pulse_duration_s: ping.settings.pulse_duration_s,
            ..settings
        };
        self.ping_number += 1;
        self.counters.pings += 1;
        ping.frame(self.device_id)
    }

    /// In a harsh dive the range grows once, as if another client had asked for it; settings that
    /// come later hold again.
    fn after_range_change(&mut self, asked: Asked, time_s: f64) -> Asked {
        let dive = self.sonar.dive();
        let Some(first) = dive.range_change_at() else {
            return asked;
        };
        if self.range_has_changed || time_s < dive.transmit_s(first) - 1e-6 {
            return asked;
        }
        self.range_has_changed = true;
        let mut changed = asked;
        changed.settings.range_length_m =
            crate::dive::after_range_change(asked.settings.range_length_m);
        self.pinging = Some(changed);
        changed
    }
}
