//! The slow, plain twin of the decoder: it has the whole stream before it and keeps no state.

use echosplat_firmware_protocol::{Decoder, Event, SkipReason, Skipped, id};

/// An event that owns its bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Found {
    Frame(Vec<u8>),
    Skipped(Skipped),
}

impl From<Event<'_>> for Found {
    fn from(event: Event<'_>) -> Self {
        match event {
            Event::Frame(frame) => Self::Frame(frame.bytes().to_vec()),
            Event::Skipped(skipped) => Self::Skipped(skipped),
        }
    }
}

/// What the decoder finds in `bytes`, fed in the given pieces and then finished.
pub(crate) fn decode<'a>(pieces: impl IntoIterator<Item = &'a [u8]>) -> Vec<Found> {
    let mut decoder = Box::new(Decoder::new());
    let mut found = Vec::new();
    for piece in pieces {
        decoder.feed(piece, &mut |event| found.push(event.into()));
    }
    decoder.finish(&mut |event| found.push(event.into()));
    assert_eq!(decoder.pending_byte_count(), 0);
    found
}

/// The payload lengths of the tables, written out a second time.
pub(crate) fn length_is_allowed(message_id: u16, payload_bytes: usize) -> bool {
    match message_id {
        id::NOP => payload_bytes == 0,
        id::SET_DEVICE_ID => payload_bytes == 1,
        id::ACK | id::GENERAL_REQUEST | id::SYNC_CHANNEL_NUMBER | id::SET_SYNC_CHANNEL_NUMBER => {
            payload_bytes == 2
        }
        id::PROTOCOL_VERSION | id::SET_SPEED_OF_SOUND => payload_bytes == 4,
        id::DEVICE_INFORMATION => payload_bytes == 6,
        id::NACK => (2..=65535).contains(&payload_bytes),
        id::STATUS => (16..=64).contains(&payload_bytes),
        id::OS_PING_PARAMS => payload_bytes == 34 || payload_bytes == 36,
        id::OS_MONO_PROFILE => {
            payload_bytes.is_multiple_of(2) && (52..=52 + 2 * 4096).contains(&payload_bytes)
        }
        _ => payload_bytes <= 65535,
    }
}

/// What a candidate at the start of `bytes` is, all bytes of the stream being there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Candidate {
    None,
    /// A frame of so many bytes.
    Intact(usize),
    /// None, and why, and how many bytes it seemed to cover.
    Failed(SkipReason, usize),
}

pub(crate) fn candidate(bytes: &[u8]) -> Candidate {
    let u16_at = |at: usize| usize::from(bytes[at]) + 256 * usize::from(bytes[at + 1]);
    if bytes[0] != b'B' || bytes.len() > 1 && bytes[1] != b'R' {
        return Candidate::None;
    }
    let timed_out = Candidate::Failed(SkipReason::TimedOut, bytes.len());
    if bytes.len() < 6 {
        return timed_out;
    }
    let (payload_bytes, message_id) = (u16_at(2), u16_at(4));
    if !length_is_allowed(message_id as u16, payload_bytes) {
        return Candidate::Failed(SkipReason::Length, 8);
    }
    if message_id == usize::from(id::OS_MONO_PROFILE) {
        if bytes.len() < 8 + 24 {
            return timed_out;
        }
        if 52 + 2 * u16_at(8 + 22) != payload_bytes {
            return Candidate::Failed(SkipReason::Length, 10 + payload_bytes);
        }
    }
    let is_long = message_id != usize::from(id::OS_MONO_PROFILE) && payload_bytes > 2048;
    let false_header = Candidate::Failed(SkipReason::Length, 8);
    if is_long && holds_profile(bytes, 10 + payload_bytes) {
        return false_header;
    }
    if bytes.len() < 10 + payload_bytes {
        return timed_out;
    }
    let sum: u64 = bytes[..8 + payload_bytes]
        .iter()
        .map(|&byte| u64::from(byte))
        .sum();
    if sum % 65536 == u16_at(8 + payload_bytes) as u64 {
        Candidate::Intact(10 + payload_bytes)
    } else if is_long {
        false_header
    } else {
        Candidate::Failed(SkipReason::Checksum, 10 + payload_bytes)
    }
}

/// Whether an intact profile lies within the first `byte_count` bytes. If not all of them are
/// there, those behind a profile whose end is missing are not looked at.
fn holds_profile(bytes: &[u8], byte_count: usize) -> bool {
    let is_whole = bytes.len() >= byte_count;
    for at in 1..byte_count.min(bytes.len()) {
        let inner = &bytes[at..];
        let is_other = inner.len() >= 6 && inner[4..6] != id::OS_MONO_PROFILE.to_le_bytes();
        if inner[0] != b'B' || is_other {
            continue;
        }
        match candidate(inner) {
            Candidate::Intact(inner_bytes) if at + inner_bytes <= byte_count => return true,
            Candidate::Intact(_) | Candidate::Failed(SkipReason::TimedOut, _) if !is_whole => {
                return false;
            }
            _ => {}
        }
    }
    false
}

/// What the decoder should find in `stream`.
pub(crate) fn expected(stream: &[u8]) -> Vec<Found> {
    let mut found: Vec<Found> = Vec::new();
    let mut at = 0;
    let mut blamed_until = 0;
    let mut blamed_reason = SkipReason::Noise;
    while at < stream.len() {
        match candidate(&stream[at..]) {
            Candidate::Intact(byte_count) => {
                found.push(Found::Frame(stream[at..at + byte_count].to_vec()));
                at += byte_count;
                blamed_until = at;
                continue;
            }
            Candidate::Failed(reason, byte_count) if at + byte_count > blamed_until => {
                (blamed_until, blamed_reason) = (at + byte_count, reason);
            }
            _ => {}
        }
        let reason = if at < blamed_until {
            blamed_reason
        } else {
            SkipReason::Noise
        };
        match found.last_mut() {
            Some(Found::Skipped(last)) if last.reason == reason => last.byte_count += 1,
            _ => found.push(Found::Skipped(Skipped {
                byte_count: 1,
                reason,
            })),
        }
        at += 1;
    }
    found
}
