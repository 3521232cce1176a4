//! Cuts a stream into MCAP records, around damage and up to a cut.
//!
//! A record is one byte of kind, eight of length and its body, without a checksum. A damaged length
//! shows by the sound records it swallows, that is by places inside its body from which records
//! follow each other, or where another recording begins; a damaged kind by itself.

use std::collections::HashMap;
use std::io::{self, ErrorKind, Read};
use std::ops::Range;

use mcap::records::op;

use super::RecordingError;
use super::channel::Channel;
use super::chunk::{CHUNK_HEAD_BYTES, ChunkHead, FIXED_BYTES, MAX_CHUNK_BYTES};
use super::message::{RAW_HEAD_BYTES, is_raw_of};
use super::topic::Topic;

/// Kind and length.
pub(super) const HEAD_BYTES: usize = 9;
/// Channel, sequence, two times.
const MESSAGE_HEAD_BYTES: usize = 22;
/// Longest body that this program writes, and by which damage is got over.
pub(super) const MAX_OWN_BODY_BYTES: usize = 2 << 20;
/// How far is searched at once for the next sound record.
pub(super) const SEARCH_BYTES: usize = 2 * MAX_OWN_BODY_BYTES;
const READ_BYTES: usize = 64 << 10;
/// What is looked at of a record before it is taken for one.
pub(super) const LOOK_BYTES: usize = HEAD_BYTES + CHUNK_HEAD_BYTES;
/// So many records that follow each other are no chance, even where nothing says that a file is one.
const CHAIN: usize = 3;
/// What else stands between messages.
const SMALL_RECORDS: [u8; 7] = [
    op::HEADER,
    op::SCHEMA,
    op::CHANNEL,
    op::MESSAGE_INDEX,
    op::ATTACHMENT,
    op::METADATA,
    op::STATISTICS,
];

/// What is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Of {
    File,
    /// The records of a chunk; as they were written, or damaged.
    Chunk {
        is_sound: bool,
    },
}

/// What comes next.
pub(super) enum Piece {
    /// A record; where its body is says [`Cutter::body`]. That of a chunk may be cut.
    Record(u8),
    /// Another recording begins in the same file.
    Begin,
    End,
}

pub(super) struct Cutter<R> {
    source: R,
    pub(super) of: Of,
    pub(super) buffer: Vec<u8>,
    /// Start of what is not consumed yet.
    pub(super) at: usize,
    /// Body of the record at hand.
    body: Range<usize>,
    /// Bytes of the record at hand: gone with the next call.
    pub(super) at_hand: usize,
    pub(super) source_ended: bool,
    /// Longest body that is taken.
    pub(super) most_body_bytes: usize,
    /// Of all bytes before the record at hand.
    pub(super) checksum: crc32fast::Hasher,
    pub(super) channels: HashMap<u16, Channel>,
    /// Skipped because they made no record.
    pub(super) damaged_byte_count: u64,
    /// Of a record whose end is not there.
    pub(super) cut_byte_count: u64,
}

/// A record that can be one.
struct Head {
    kind: u8,
    /// Of its body.
    length: usize,
    is_chunk: bool,
    /// A chunk that is not compressed.
    is_plain_chunk: bool,
}

impl<R: Read> Cutter<R> {
    /// Of a file; `channels` are those that its messages may be of before it says so.
    ///
    /// # Errors
    /// If the stream is no MCAP; a cut inside the first bytes is a recording of nothing.
    pub(super) fn of_file(
        source: R,
        channels: HashMap<u16, Channel>,
    ) -> Result<Self, RecordingError> {
        let mut cutter = Self::new(source, Of::File, channels);
        cutter.most_body_bytes = MAX_OWN_BODY_BYTES;
        cutter.skip_magic()?;
        Ok(cutter)
    }

    /// Of the records of a chunk.
    pub(super) fn of_chunk(source: R, is_sound: bool, channels: HashMap<u16, Channel>) -> Self {
        Self::new(source, Of::Chunk { is_sound }, channels)
    }

    fn new(source: R, of: Of, channels: HashMap<u16, Channel>) -> Self {
        Self {
            source,
            of,
            buffer: Vec::new(),
            at: 0,
            body: 0..0,
            at_hand: 0,
            source_ended: false,
            most_body_bytes: MAX_CHUNK_BYTES,
            checksum: crc32fast::Hasher::new(),
            channels,
            damaged_byte_count: 0,
            cut_byte_count: 0,
        }
    }

    /// The body of the record at hand.
    pub(super) fn body(&self) -> &[u8] {
        &self.buffer[self.body.clone()]
    }

    /// The next sound record.
    pub(super) fn next(&mut self) -> Result<Piece, RecordingError> {
        loop {
            self.consume(self.at_hand);
            self.at_hand = 0;
            let available = self.fill(LOOK_BYTES)?;
            if self.begins_at(0) {
                self.begin();
                return Ok(Piece::Begin);
            }
            let is_chunk = self.of == Of::File && self.buffer.get(self.at) == Some(&op::CHUNK);
            let least = HEAD_BYTES + if is_chunk { FIXED_BYTES } else { 0 };
            if available < least {
                self.cut_byte_count += available as u64;
                self.consume(available);
                return Ok(Piece::End);
            }
            let Some(head) = self.head(0) else {
                self.refuse_long_chunk()?;
                self.skip_damage(1)?;
                continue;
            };
            if let Some(end) = self.sound_end(&head)? {
                self.body = self.at + HEAD_BYTES..self.at + end;
                self.at_hand = end;
                return Ok(Piece::Record(head.kind));
            }
        }
    }

    /// Where the record here ends, if it is sound; else moves over the damage.
    fn sound_end(&mut self, head: &Head) -> Result<Option<usize>, RecordingError> {
        let end = HEAD_BYTES + head.length;
        let mut available = self.fill(end + LOOK_BYTES)?;
        let is_whole = available >= end;
        if is_whole && self.of == (Of::Chunk { is_sound: true }) {
            return Ok(Some(end));
        }
        let is_followed = is_whole && self.is_followed(end);
        let says_it_twice = head.is_chunk || is_whole && self.is_whole_raw(head.length);
        if head.is_plain_chunk {
            // Of one that is cut the head alone: its records are read one by one.
            let is_sound = is_followed && !self.is_chunk_cut_before(end);
            return Ok(Some(if is_sound {
                end
            } else {
                HEAD_BYTES + FIXED_BYTES
            }));
        }
        if says_it_twice && is_followed && !self.is_cut_before(end)? {
            return Ok(Some(end));
        }
        if says_it_twice {
            let inside = HEAD_BYTES..end.min(available);
            return Ok(match (self.find_begin(inside.clone()), head.is_chunk) {
                // Cut, and another recording stands behind it.
                (Some(begin), true) => Some(begin),
                (Some(begin), false) => {
                    self.cut_byte_count += begin as u64;
                    self.consume(begin);
                    None
                }
                (None, _) => Some(inside.end),
            });
        }
        if !is_followed {
            // Something is damaged, or the end is near: look further before deciding.
            available = self.fill(SEARCH_BYTES)?;
        }
        let is_whole = available >= end;
        if self.search(HEAD_BYTES..end.min(available)).is_none() {
            if is_whole {
                return Ok(Some(end));
            }
            if self.source_ended {
                self.cut_byte_count += available as u64;
                self.consume(available);
                return Ok(None);
            }
        }
        self.skip_damage(HEAD_BYTES)?;
        Ok(None)
    }

    /// Whether the record here was cut and another recording stands behind it, so that what follows this end is of that
    /// one: what a recording begins with, or no records at all. Bytes of a sonar that look like a recording are followed by
    /// messages.
    fn is_cut_before(&mut self, end: usize) -> io::Result<bool> {
        if self.find_begin(HEAD_BYTES..end).is_none() {
            return Ok(false);
        }
        self.fill(end + SEARCH_BYTES)?;
        let mut next = end;
        for _ in 0..CHAIN {
            if self.at + next == self.buffer.len() || self.begins_at(next) {
                return Ok(false);
            }
            match self.head(next) {
                None => return Ok(true),
                Some(head) => match head.kind {
                    op::HEADER | op::SCHEMA | op::CHANNEL | op::CHUNK => return Ok(true),
                    // What a recording begins with may stand behind it too.
                    op::DATA_END => return Ok(false),
                    _ => next += HEAD_BYTES + head.length,
                },
            }
        }
        Ok(false)
    }

    /// The same of a chunk, which has a checksum.
    fn is_chunk_cut_before(&self, end: usize) -> bool {
        let body = &self.buffer[self.at + HEAD_BYTES..self.at + end];
        let holds_begin = self.find_begin(HEAD_BYTES..end).is_some();
        holds_begin && !ChunkHead::is_of(body)
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
        let channel = channel.and_then(|id| self.channels.get(&id));
        let head = body.get(MESSAGE_HEAD_BYTES..MESSAGE_HEAD_BYTES + RAW_HEAD_BYTES);
        channel.and_then(|channel| channel.own) == Some(Topic::Raw)
            && self.buffer[self.at] == op::MESSAGE
            && head.is_some_and(|head| is_raw_of(head, content))
    }

    fn refuse_long_chunk(&self) -> Result<(), RecordingError> {
        let here = &self.buffer[self.at..];
        let length = length_of(here).unwrap_or(0);
        let is_chunk = here.first() == Some(&op::CHUNK) && self.of == Of::File;
        let is_long = length > MAX_CHUNK_BYTES as u64;
        match is_chunk && is_long && ChunkHead::read(&here[HEAD_BYTES..], length).is_some() {
            true => Err(RecordingError::ChunkTooLong { found: length }),
            false => Ok(()),
        }
    }

    /// Moves to the next sound message or chunk, looking from `from` bytes on, or to the end.
    fn skip_damage(&mut self, from: usize) -> Result<(), RecordingError> {
        let available = self.fill(SEARCH_BYTES)?;
        let step = match self.search(from..available) {
            Some(found) => found,
            None if self.source_ended => available,
            // The last bytes searched may be the start of a record that goes on.
            None => available
                .saturating_sub(HEAD_BYTES + MAX_OWN_BODY_BYTES)
                .max(from),
        };
        self.damaged_byte_count += step as u64;
        self.consume(step);
        Ok(())
    }

    /// Offset of the first message or end of data that is whole and followed by a record or the
    /// end of the file, of the first chunk, or of another recording's beginning.
    fn search(&self, offsets: Range<usize>) -> Option<usize> {
        self.find(offsets, |cutter, offset| {
            let head = cutter.head(offset)?;
            let is_sought = matches!(head.kind, op::MESSAGE | op::DATA_END | op::CHUNK);
            let end = offset + HEAD_BYTES + head.length;
            let is_sure = head.is_chunk || cutter.is_followed(end);
            (is_sought && is_sure).then_some(offset)
        })
    }

    /// The same where nothing says yet that these are records.
    pub(super) fn search_chain(&self, offsets: Range<usize>) -> Option<usize> {
        let end_of_all = self.buffer.len() - self.at;
        self.find(offsets, |cutter, offset| {
            let mut end = offset;
            for _ in 0..CHAIN {
                let head = cutter.head(end)?;
                if head.is_chunk {
                    return Some(offset);
                }
                end += HEAD_BYTES + head.length;
                if end == end_of_all {
                    return Some(offset);
                }
            }
            Some(offset)
        })
    }

    fn find_begin(&self, offsets: Range<usize>) -> Option<usize> {
        self.find(offsets, |_, _| None)
    }

    /// The first offset that `is_it` takes, or where another recording begins.
    fn find(
        &self,
        offsets: Range<usize>,
        is_it: impl Fn(&Self, usize) -> Option<usize>,
    ) -> Option<usize> {
        const CANDIDATES: [u8; 4] = [op::MESSAGE, op::CHUNK, op::DATA_END, mcap::MAGIC[0]];
        let here = self.buffer[self.at..].get(offsets.clone())?;
        let candidates = here.iter().enumerate();
        let mut candidates = candidates.filter(|(_, kind)| CANDIDATES.contains(kind));
        candidates.find_map(|(index, kind)| {
            let offset = offsets.start + index;
            match *kind == mcap::MAGIC[0] {
                true => self.begins_at(offset).then_some(offset),
                false => is_it(self, offset),
            }
        })
    }

    fn is_followed(&self, end: usize) -> bool {
        let is_end = self.at + end == self.buffer.len();
        is_end || self.head(end).is_some() || self.begins_at(end)
    }

    /// Kind and length of body of what starts `offset` bytes on, if it can be a record.
    fn head(&self, offset: usize) -> Option<Head> {
        let bytes = self.buffer.get(self.at + offset..)?;
        let kind = *bytes.first()?;
        let said = length_of(bytes)?;
        let length = usize::try_from(said).ok()?;
        let of_file = self.of == Of::File;
        if of_file && kind == op::CHUNK {
            return Self::chunk_head(bytes, said);
        }
        let possible = match kind {
            op::MESSAGE => length >= MESSAGE_HEAD_BYTES && self.knows_channel_of(bytes),
            op::DATA_END => of_file && length == 4,
            op::FOOTER => of_file && length == 20,
            _ => SMALL_RECORDS.contains(&kind),
        };
        (possible && length <= self.most_body_bytes).then_some(Head {
            kind,
            length,
            is_chunk: false,
            is_plain_chunk: false,
        })
    }

    /// Of one that has not ended no more than its head: its records follow.
    fn chunk_head(bytes: &[u8], said: u64) -> Option<Head> {
        let is_open = ChunkHead::is_open(bytes);
        let found = ChunkHead::read(&bytes[HEAD_BYTES..], said);
        let length = match is_open {
            true => FIXED_BYTES,
            false => usize::try_from(said).ok()?,
        };
        let is_possible = is_open || found.is_some() && length <= MAX_CHUNK_BYTES;
        is_possible.then_some(Head {
            kind: op::CHUNK,
            length,
            is_chunk: !is_open,
            is_plain_chunk: found.is_some_and(|found| found.is_plain()),
        })
    }

    fn knows_channel_of(&self, message: &[u8]) -> bool {
        let id = message.get(HEAD_BYTES..).and_then(<[u8]>::first_chunk);
        // One that is cut before it says it may be of any.
        let is_known = id.is_none_or(|id| self.channels.contains_key(&u16::from_le_bytes(*id)));
        is_known || self.of == (Of::Chunk { is_sound: true })
    }

    pub(super) fn consume(&mut self, byte_count: usize) {
        if self.of == Of::File {
            let gone = self.at..self.at + byte_count;
            self.checksum.update(&self.buffer[gone]);
        }
        self.at += byte_count;
    }

    /// Tries to have `wanted` bytes here; says how many there are.
    pub(super) fn fill(&mut self, wanted: usize) -> io::Result<usize> {
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

/// What the head of a record says of its body.
pub(super) fn length_of(record: &[u8]) -> Option<u64> {
    let length = record.get(1..)?.first_chunk()?;
    Some(u64::from_le_bytes(*length))
}
