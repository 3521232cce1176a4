//! Finds intact frames in a stream of bytes that may be damaged anywhere.

use core::fmt;

use crate::frame::{Frame, MAX_FRAME_BYTES, START, Verdict, claimed, judge};
use crate::long_frame::{self, ProfileSearch, is_long};
use crate::skip::{SkipLedger, SkipReason, Skipped};

/// What the decoder found next in its stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event<'a> {
    /// An intact frame.
    Frame(Frame<'a>),
    /// Bytes that are in no frame.
    Skipped(Skipped),
}

/// Finds intact frames in a stream that comes in pieces of any size.
///
/// A candidate begins at each `42 52`. It is judged as soon as its bytes allow: the length against
/// its message id from the header alone, a profile's count of results from its first 32 bytes, the
/// checksum when it is whole. A candidate that fails is given up by its first byte only, and the
/// search goes on at its second; until then every byte of it is kept. So an intact frame is lost
/// to no damage beside it, unless damage by chance makes a candidate with a right checksum around
/// it. A frame inside the payload of an intact frame is payload; but a candidate of more than 2048
/// payload bytes that is no profile and has an intact profile within is none, its sum right or not.
///
/// The events depend on the bytes and on where [`expire`](Self::expire) falls among them, not on
/// how the bytes are cut into pieces. Every byte fed is in exactly one event, or still in
/// [`pending_byte_count`](Self::pending_byte_count).
///
/// Cost: a frame that lies whole in one piece is summed where it lies and copied nowhere; one cut
/// by the end of a piece is copied once. Each byte is summed once per candidate that covers it:
/// once on a clean stream, and in a stream made to hurt at most once for every 6 bytes of
/// [`MAX_FRAME_BYTES`]. Latency: a frame is yielded with its last byte, unless a false header
/// stands before it. Then it waits for what that claims, at most 8254 bytes, or for the next
/// profile; a false header before a stream without profiles for at most [`MAX_FRAME_BYTES`]; or
/// for `expire`.
#[derive(Clone)]
pub struct Decoder {
    /// The unfinished candidate and what follows it, at `held_start..held_end`.
    buffer: [u8; MAX_FRAME_BYTES],
    held_start: usize,
    held_end: usize,
    profiles: ProfileSearch,
    skipped: SkipLedger,
}

impl Decoder {
    /// A decoder at the start of a stream. It owns a buffer of [`MAX_FRAME_BYTES`] and never
    /// allocates.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: [0; MAX_FRAME_BYTES],
            held_start: 0,
            held_end: 0,
            profiles: ProfileSearch::new(),
            skipped: SkipLedger::new(),
        }
    }

    /// Takes the next `bytes` of the stream and gives `sink` what they complete, in stream order.
    pub fn feed(&mut self, bytes: &[u8], sink: &mut dyn FnMut(Event<'_>)) {
        let mut rest = bytes;
        while !rest.is_empty() {
            let missing = self.missing_byte_count();
            if missing == 0 {
                let scanned = scan(rest, &mut self.profiles, &mut self.skipped, sink);
                self.hold(&rest[scanned..]);
                return;
            }
            let (taken, left) = rest.split_at(missing.min(rest.len()));
            self.hold(taken);
            self.scan_held(sink);
            rest = left;
        }
    }

    /// Gives up the unfinished candidate, if there is one, and searches on from its second byte;
    /// reports what has been skipped so far. For the caller's time-out: the rest of the candidate
    /// did not come. A later unfinished candidate may remain, for the next time-out.
    pub fn expire(&mut self, sink: &mut dyn FnMut(Event<'_>)) {
        self.give_up(sink);
        self.skipped.report(sink);
    }

    /// Gives up every unfinished candidate: the end of a log, or a lost link. Nothing is pending
    /// afterwards, and the decoder is ready for another stream.
    pub fn finish(&mut self, sink: &mut dyn FnMut(Event<'_>)) {
        while !self.held().is_empty() {
            self.give_up(sink);
        }
        self.skipped.end_stretch(sink);
    }

    /// Bytes fed that are in no event yet: those of an unfinished candidate and what follows it,
    /// and skipped ones whose stretch may still grow. While it is not 0, `expire` has work to do.
    #[must_use]
    pub fn pending_byte_count(&self) -> usize {
        self.held().len() + self.skipped.unreported_byte_count()
    }

    fn held(&self) -> &[u8] {
        &self.buffer[self.held_start..self.held_end]
    }

    /// Bytes the held candidate lacks before it can be judged further; 0 if none is held.
    fn missing_byte_count(&self) -> usize {
        match (self.held(), judge(self.held())) {
            ([_, ..], Verdict::Unfinished { byte_count }) => byte_count - self.held().len(),
            _ => 0,
        }
    }

    /// Appends `bytes`: never more than complete the candidate at the start of what is held, so
    /// they fit once that start is moved to the buffer's.
    fn hold(&mut self, bytes: &[u8]) {
        if self.held_end + bytes.len() > self.buffer.len() {
            self.buffer.copy_within(self.held_start..self.held_end, 0);
            self.held_end -= self.held_start;
            self.held_start = 0;
        }
        self.buffer[self.held_end..self.held_end + bytes.len()].copy_from_slice(bytes);
        self.held_end += bytes.len();
    }

    fn scan_held(&mut self, sink: &mut dyn FnMut(Event<'_>)) {
        let held = &self.buffer[self.held_start..self.held_end];
        self.held_start += scan(held, &mut self.profiles, &mut self.skipped, sink);
        if self.held_start == self.held_end {
            (self.held_start, self.held_end) = (0, 0);
        }
    }

    fn give_up(&mut self, sink: &mut dyn FnMut(Event<'_>)) {
        if self.held().is_empty() {
            return;
        }
        self.skipped.blame(self.held().len(), SkipReason::TimedOut);
        self.skipped.skip(1, sink);
        self.held_start += 1;
        self.profiles.advance(1);
        self.scan_held(sink);
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl fmt::Debug for Decoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Decoder")
            .field("held_byte_count", &self.held().len())
            .field("skipped", &self.skipped)
            .finish_non_exhaustive()
    }
}

/// Reports what `bytes` hold up to the first unfinished candidate; returns where that begins, or
/// the length of `bytes`.
fn scan(
    bytes: &[u8],
    profiles: &mut ProfileSearch,
    skipped: &mut SkipLedger,
    sink: &mut dyn FnMut(Event<'_>),
) -> usize {
    let mut at = 0;
    while at < bytes.len() {
        let candidate = &bytes[at..];
        match judge_long(bytes, at, profiles) {
            Verdict::Intact { byte_count } => {
                skipped.end_stretch(sink);
                sink(Event::Frame(Frame::judged_intact(&candidate[..byte_count])));
                at += byte_count;
                continue;
            }
            Verdict::Unfinished { .. } => break,
            Verdict::BadLength { byte_count, .. } => skipped.blame(byte_count, SkipReason::Length),
            Verdict::BadChecksum { byte_count } => skipped.blame(byte_count, SkipReason::Checksum),
            Verdict::NoStart => {}
        }
        let step = byte_count_to_next_start(candidate);
        skipped.skip(step, sink);
        at += step;
    }
    profiles.advance(at);
    at
}

/// The verdict on the candidate at `bytes[at]`, with what its claimed bytes say of a long one:
/// it is believed if its sum is right and no intact profile lies within.
fn judge_long(bytes: &[u8], at: usize, profiles: &mut ProfileSearch) -> Verdict {
    let candidate = &bytes[at..];
    let verdict = judge(candidate);
    let is_false = match verdict {
        Verdict::Intact { byte_count } | Verdict::Unfinished { byte_count } => {
            is_long(candidate) && profiles.is_within(bytes, at, at + byte_count)
        }
        Verdict::BadChecksum { .. } => is_long(candidate),
        Verdict::NoStart | Verdict::BadLength { .. } => false,
    };
    match claimed(candidate) {
        Some((message_id, payload_bytes)) if is_false => Verdict::BadLength {
            message_id,
            payload_bytes,
            byte_count: long_frame::BLAMED_BYTES,
        },
        _ => verdict,
    }
}

/// Distance from the first byte to the next that could start a frame, or to the end.
fn byte_count_to_next_start(bytes: &[u8]) -> usize {
    let next = bytes.iter().skip(1).position(|&byte| byte == START[0]);
    next.map_or(bytes.len(), |position| position + 1)
}
