//! Where a recording begins and ends in a file: the magic, the end of the data, the summary behind it,
//! and another recording that somebody has put behind that.

use std::io::Read;

use mcap::records::op;

use super::RecordingError;
use super::cutter::{
    Cutter, HEAD_BYTES, LOOK_BYTES, MAX_OWN_BODY_BYTES, Of, SEARCH_BYTES, length_of,
};

/// Longest first record, which says who wrote the file.
const MAX_HEADER_BYTES: u64 = 64 << 10;
/// Bytes of the magic that may be others.
const MOST_WRONG: usize = 2;
/// What stands behind the end of the data.
const SUMMARY_RECORDS: [u8; 9] = [
    op::SCHEMA,
    op::CHANNEL,
    op::MESSAGE_INDEX,
    op::STATISTICS,
    op::CHUNK_INDEX,
    op::ATTACHMENT_INDEX,
    op::METADATA_INDEX,
    op::SUMMARY_OFFSET,
    op::FOOTER,
];

impl<R: Read> Cutter<R> {
    /// Whether a recording begins `offset` bytes on: the magic, and who wrote it.
    pub(super) fn begins_at(&self, offset: usize) -> bool {
        let Some(bytes) = self.buffer.get(self.at + offset..) else {
            return false;
        };
        let Some((magic, header)) = bytes.split_at_checked(mcap::MAGIC.len()) else {
            return false;
        };
        self.of == Of::File && magic == mcap::MAGIC && is_header(header)
    }

    pub(super) fn begin(&mut self) {
        self.checksum = crc32fast::Hasher::new();
        self.consume(mcap::MAGIC.len());
    }

    /// Over the file's first bytes. A few of them may be damaged, or all if records show what it is.
    pub(super) fn skip_magic(&mut self) -> Result<(), RecordingError> {
        let available = self.fill(mcap::MAGIC.len() + LOOK_BYTES)?;
        let magic = &mcap::MAGIC[..available.min(mcap::MAGIC.len())];
        let start = self.buffer[..magic.len()].to_vec();
        let wrong_count = start.iter().zip(magic).filter(|(a, b)| a != b).count();
        let is_written = is_header(&self.buffer[magic.len()..]);
        if wrong_count <= MOST_WRONG.min(magic.len() / 4) || is_written {
            // What it was, so that the file's checksum is as it was.
            self.buffer[..magic.len()].copy_from_slice(magic);
            self.consume(magic.len());
            return Ok(());
        }
        let available = self.fill(SEARCH_BYTES)?;
        let found = self.search_chain(0..available);
        let found = found.ok_or_else(|| RecordingError::NotMcap {
            found: shown(&start),
        })?;
        self.damaged_byte_count += found as u64;
        self.consume(found);
        Ok(())
    }

    /// Over what stands behind the end of the data; says whether another recording follows.
    pub(super) fn skip_summary(&mut self) -> Result<bool, RecordingError> {
        self.consume(self.at_hand);
        self.at_hand = 0;
        loop {
            let available = self.fill(LOOK_BYTES)?;
            if self.begins_at(0) {
                self.begin();
                return Ok(true);
            }
            let here = &self.buffer[self.at..];
            let is_summary = here
                .first()
                .is_some_and(|kind| SUMMARY_RECORDS.contains(kind));
            let length =
                length_of(here).filter(|length| is_summary && *length <= SEARCH_BYTES as u64);
            if let Some(length) = length {
                let end = HEAD_BYTES + length as usize;
                let available = self.fill(end)?;
                self.consume(end.min(available));
            } else if here.starts_with(mcap::MAGIC) {
                self.consume(mcap::MAGIC.len());
            } else {
                return match available {
                    0 => Ok(false),
                    _ => self.find_another(),
                };
            }
        }
    }

    /// Behind the end stands something that does not belong there.
    fn find_another(&mut self) -> Result<bool, RecordingError> {
        loop {
            let available = self.fill(SEARCH_BYTES)?;
            if let Some(found) = self.search_chain(0..available) {
                self.consume(found);
                if self.begins_at(0) {
                    self.begin();
                }
                return Ok(true);
            }
            self.consume(match self.source_ended {
                true => available,
                false => available.saturating_sub(MAX_OWN_BODY_BYTES),
            });
            if self.source_ended {
                return Ok(false);
            }
        }
    }
}

fn is_header(record: &[u8]) -> bool {
    let length = length_of(record);
    record.first() == Some(&op::HEADER)
        && length.is_some_and(|length| (8..=MAX_HEADER_BYTES).contains(&length))
}

fn shown(bytes: &[u8]) -> String {
    if bytes.iter().all(|b| b.is_ascii_graphic() || *b == b' ') {
        return format!("`{}`", String::from_utf8_lossy(bytes));
    }
    let hex: Vec<String> = bytes.iter().map(|b| format!("{b:02x}")).collect();
    hex.join(" ")
}
