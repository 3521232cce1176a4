//! Whether a header that claims many bytes is to be believed.
//!
//! Wrappers, texts and packets of unknown ids may have any length, so their headers show nothing
//! of damage. But no payload of theirs holds an intact profile: where one lies within the bytes
//! that such a header claims, the header is false. So it is found out with the next profile, not
//! after up to 65,545 bytes, and swallows no profile even if its sum is right by chance.

use crate::frame::{HEADER_BYTES, LENGTH_AND_ID_BYTES, START, Verdict, claimed, judge};
use crate::id;

/// Longer payloads are believed only if they hold no intact profile. The largest message of the
/// family but profiles has 1214 bytes (Ping360); wrappers and logs have longer ones.
const READILY_BELIEVED_BYTES: usize = 2048;

/// Whether the candidate at the start of `bytes` claims a payload that is not readily believed. A
/// profile's own count of results speaks for its length.
pub(crate) fn is_long(bytes: &[u8]) -> bool {
    claimed(bytes).is_some_and(|(message_id, payload_bytes)| {
        message_id != id::OS_MONO_PROFILE && payload_bytes > READILY_BELIEVED_BYTES
    })
}

/// Looks for intact profiles in a stream, at each place once, whatever candidates lie around it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ProfileSearch {
    /// No intact profile begins before this offset, nor can one turn up there.
    none_before: usize,
}

impl ProfileSearch {
    pub(crate) const fn new() -> Self {
        Self { none_before: 0 }
    }

    /// The stream's first `byte_count` bytes are done with; offsets count from behind them.
    pub(crate) fn advance(&mut self, byte_count: usize) {
        self.none_before = self.none_before.saturating_sub(byte_count);
    }

    /// Whether an intact profile lies within the candidate at `bytes[from..until]`. While the
    /// candidate's end is not there yet, the search stops at the first profile whose end is not.
    pub(crate) fn is_within(&mut self, bytes: &[u8], from: usize, until: usize) -> bool {
        let is_whole = until <= bytes.len();
        let end = until.min(bytes.len());
        let mut at = self.none_before.max(from + 1);
        let mut is_settled = true;
        while let Some(next) = next_start(bytes, at, end) {
            match judge_profile(&bytes[next..]) {
                Some(Verdict::Intact { byte_count }) if next + byte_count <= until => return true,
                Some(_) if !is_whole => return false,
                Some(_) => is_settled = false,
                None if is_settled => self.none_before = next + 1,
                None => {}
            }
            at = next + 1;
        }
        if is_settled {
            self.none_before = self.none_before.max(end);
        }
        false
    }
}

fn next_start(bytes: &[u8], from: usize, end: usize) -> Option<usize> {
    let searched = bytes.get(from..end)?;
    let position = searched.iter().position(|&byte| byte == START[0])?;
    Some(from + position)
}

/// `None` if no intact profile begins here, whatever comes.
fn judge_profile(bytes: &[u8]) -> Option<Verdict> {
    let is_other = bytes.len() >= LENGTH_AND_ID_BYTES
        && claimed(bytes).is_some_and(|(message_id, _)| message_id != id::OS_MONO_PROFILE);
    if is_other {
        return None;
    }
    match judge(bytes) {
        verdict @ (Verdict::Intact { .. } | Verdict::Unfinished { .. }) => Some(verdict),
        Verdict::NoStart | Verdict::BadLength { .. } | Verdict::BadChecksum { .. } => None,
    }
}

/// What is blamed on a long candidate that is none: its header.
pub(crate) const BLAMED_BYTES: usize = HEADER_BYTES;
