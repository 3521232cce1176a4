//! Cuts a stream into MCAP records, around damage and up to a cut.
//!
//! A record is one byte of kind, eight of length and its body, without a checksum. A damaged length
//! shows by the sound records it swallows, that is by places inside its body from which records
//! follow each other; a damaged kind by itself.

use std::collections::HashMap;
use std::io::{self, ErrorKind, Read};
use std::ops::Range;

use mcap::records::op;

use super::RecordingError;
use super::message::{RAW_HEAD_BYTES, is_raw_of};
use super::topic::Topic;

/// Kind and length.
const HEAD_BYTES: usize = 9;
/// Channel, sequence, two times.
const MESSAGE_HEAD_BYTES: usize = 22;
/// Longest body taken; a recording's own are shorter.
const MAX_BODY_BYTES: usize = 2 << 20;
/// How far is searched at once for the next sound record.
const SEARCH_BYTES: usize = 2 * MAX_BODY_BYTES;
const READ_BYTES: usize = 64 << 10;
/// What else an unchunked file has before its end.
const SMALL_RECORDS: [u8; 7] = [
    op::HEADER,
    op::SCHEMA,
    op::CHANNEL,
    op::MESSAGE_INDEX,
    op::ATTACHMENT,
    op::METADATA,
    op::STATISTICS,
];

/// How a recording ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// As its writer meant.
    Complete,
    /// In the middle; everything before was read.
    Cut,
}

/// Kind and body of one record.
pub(super) struct Record<'a> {
    pub(super) kind: u8,
    pub(super) body: &'a [u8],
}

pub(super) struct Records<R> {
    source: R,
    buffer: Vec<u8>,
    /// Start of what is not consumed yet.
    at: usize,
    source_ended: bool,
    /// Something besides the file's header was read.
    any_content: bool,
    pub(super) ending: Option<Ending>,
    pub(super) damaged_byte_count: u64,
    /// Topics by channel id, as far as they are this program's.
    pub(super) channels: HashMap<u16, Option<Topic>>,
}

impl<R: Read> Records<R> {
    /// # Errors
    /// If the stream is no MCAP; a cut inside the first bytes is a recording of nothing.
    pub(super) fn new(source: R) -> Result<Self, RecordingError> {
        let own = Topic::ALL.map(|topic| (topic.id(), Some(topic)));
        let mut records = Self {
            source,
            buffer: Vec::new(),
            at: 0,
            source_ended: false,
            any_content: false,
            ending: None,
            damaged_byte_count: 0,
            channels: HashMap::from(own),
        };
        let magic = mcap::MAGIC;
        records.fill(magic.len())?;
        let start = &records.buffer[..records.buffer.len().min(magic.len())];
        let wrong_count = start.iter().zip(magic).filter(|(a, b)| a != b).count();
        if wrong_count > start.len() / 4 {
            return Err(RecordingError::NotMcap {
                found: shown(start),
            });
        }
        records.at = start.len();
        Ok(records)
    }

    /// The next sound record, `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Record<'_>>, RecordingError> {
        while self.ending.is_none() {
            let Some((kind, end)) = self.sound_record()? else {
                continue;
            };
            if kind == op::DATA_END {
                self.ending = Some(Ending::Complete);
                break;
            }
            self.any_content |= kind != op::HEADER;
            let body = self.at + HEAD_BYTES..self.at + end;
            self.at += end;
            return Ok(Some(Record {
                kind,
                body: &self.buffer[body],
            }));
        }
        Ok(None)
    }

    /// Kind and whole length of the record here; or skips damage, or notes the end.
    fn sound_record(&mut self) -> Result<Option<(u8, usize)>, RecordingError> {
        let available = self.fill(HEAD_BYTES + MESSAGE_HEAD_BYTES)?;
        if available < HEAD_BYTES {
            self.ending = Some(Ending::Cut);
            return Ok(None);
        }
        let Some((kind, length)) = self.head(0) else {
            if self.buffer[self.at] == op::CHUNK && !self.any_content {
                return Err(RecordingError::Chunked);
            }
            self.skip_damage(1)?;
            return Ok(None);
        };
        let end = HEAD_BYTES + length;
        let mut available = self.fill(end + HEAD_BYTES + MESSAGE_HEAD_BYTES)?;
        if available >= end && self.is_whole_raw(length) {
            return Ok(Some((kind, end)));
        }
        if self.head(end).is_none() {
            // Something is damaged, or the end is near: look further before deciding.
            available = self.fill(SEARCH_BYTES)?;
        }
        if available >= end && self.search(HEAD_BYTES..end).is_none() {
            return Ok(Some((kind, end)));
        }
        self.skip_damage(HEAD_BYTES)?;
        Ok(None)
    }

    /// Whether the record here, with a body of this length, holds raw bytes and says twice how
    /// many: such a one is taken whatever it holds, since a sonar may send bytes that look like
    /// records.
    fn is_whole_raw(&self, length: usize) -> bool {
        let Some(content) = length.checked_sub(MESSAGE_HEAD_BYTES) else {
            return false;
        };
        let body = &self.buffer[self.at + HEAD_BYTES..];
        let channel = body.first_chunk().map(|id| u16::from_le_bytes(*id));
        let head = body.get(MESSAGE_HEAD_BYTES..MESSAGE_HEAD_BYTES + RAW_HEAD_BYTES);
        channel.and_then(|id| self.topic_of(id)) == Some(Topic::Raw)
            && self.buffer[self.at] == op::MESSAGE
            && head.is_some_and(|head| is_raw_of(head, content))
    }

    /// What the channel holds, if it is one of this program's.
    pub(super) fn topic_of(&self, channel_id: u16) -> Option<Topic> {
        self.channels.get(&channel_id).copied().flatten()
    }

    /// Moves to the next sound message, looking from `from` bytes on, or to the end.
    fn skip_damage(&mut self, from: usize) -> Result<(), RecordingError> {
        let available = self.fill(SEARCH_BYTES)?;
        let found = self.search(from..available);
        if found.is_none() && self.source_ended {
            self.ending = Some(Ending::Cut);
        }
        let step = found.unwrap_or(match self.ending {
            Some(_) => available,
            // The last bytes searched may be the start of a record that goes on.
            None => available
                .saturating_sub(HEAD_BYTES + MAX_BODY_BYTES)
                .max(from),
        });
        self.damaged_byte_count += step as u64;
        self.at += step;
        Ok(())
    }

    /// Offset of the first message or end of data that is whole and followed by a record or the
    /// end of the file.
    fn search(&self, offsets: Range<usize>) -> Option<usize> {
        let here = &self.buffer[self.at..];
        let candidates = here[offsets.clone()].iter().enumerate();
        let mut candidates =
            candidates.filter(|(_, kind)| matches!(**kind, op::MESSAGE | op::DATA_END));
        let is_followed = |end| end == here.len() || self.head(end).is_some();
        candidates.find_map(|(index, _)| {
            let offset = offsets.start + index;
            let (_, length) = self.head(offset)?;
            is_followed(offset + HEAD_BYTES + length).then_some(offset)
        })
    }

    /// Kind and length of body of what starts `offset` bytes on, if it can be a record.
    fn head(&self, offset: usize) -> Option<(u8, usize)> {
        let bytes = self.buffer.get(self.at + offset..)?;
        let (&kind, rest) = bytes.split_first()?;
        let length = u64::from_le_bytes(rest.get(..8)?.try_into().ok()?);
        let length = usize::try_from(length).ok()?;
        let possible = match kind {
            op::MESSAGE => {
                let id = rest.get(8..10)?.try_into().ok()?;
                length >= MESSAGE_HEAD_BYTES && self.channels.contains_key(&u16::from_le_bytes(id))
            }
            op::DATA_END => length == 4,
            _ => SMALL_RECORDS.contains(&kind),
        };
        (possible && length <= MAX_BODY_BYTES).then_some((kind, length))
    }

    /// Tries to have `wanted` bytes here; says how many there are.
    fn fill(&mut self, wanted: usize) -> io::Result<usize> {
        if self.buffer.len() - self.at < wanted && self.at >= READ_BYTES {
            self.buffer.drain(..self.at);
            self.at = 0;
        }
        while self.buffer.len() - self.at < wanted && !self.source_ended {
            let before = self.buffer.len();
            self.buffer.resize(before + READ_BYTES, 0);
            let read = self.source.read(&mut self.buffer[before..]);
            self.buffer.truncate(before + *read.as_ref().unwrap_or(&0));
            match read {
                Ok(count) => self.source_ended = count == 0,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(self.buffer.len() - self.at)
    }
}

fn shown(bytes: &[u8]) -> String {
    if bytes.iter().all(|b| b.is_ascii_graphic() || *b == b' ') {
        return format!("`{}`", String::from_utf8_lossy(bytes));
    }
    let hex: Vec<String> = bytes.iter().map(|b| format!("{b:02x}")).collect();
    hex.join(" ")
}
