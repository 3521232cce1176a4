//! Records in the order they were written, of one file or of the files of a dive.

use std::collections::VecDeque;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use mcap::records::{Record as McapRecord, op};

use super::message::{Assembler, Made, time_of};
use super::records::{Ending, Records};
use super::topic::Topic;
use super::{LIBRARY, Recorded, RecordingError};

type Source<'a> = Box<dyn Read + Send + 'a>;

/// Reads a recording, also a cut or damaged one; the files of one dive, given in order, as one.
pub struct RecordingReader<'a> {
    records: Records<Source<'a>>,
    /// Of the file at hand, if it was opened by name.
    path: Option<PathBuf>,
    files_to_come: VecDeque<PathBuf>,
    assembler: Assembler,
    is_own: bool,
    /// One of the files before was cut.
    was_cut: bool,
    /// Of the files before.
    past_damaged_byte_count: u64,
    undecodable_count: u64,
}

impl<'a> RecordingReader<'a> {
    /// Starts reading. A file cut in its first bytes is a recording of nothing.
    ///
    /// # Errors
    /// If the stream is something else than MCAP, or cannot be read.
    pub fn new(source: impl Read + Send + 'a) -> Result<Self, RecordingError> {
        Ok(Self {
            records: Records::new(Box::new(source) as Source<'a>)?,
            path: None,
            files_to_come: VecDeque::new(),
            assembler: Assembler::default(),
            is_own: false,
            was_cut: false,
            past_damaged_byte_count: 0,
            undecodable_count: 0,
        })
    }

    /// Starts reading the files of one dive, in this order. Each is opened when its turn comes.
    ///
    /// # Errors
    /// Names the file that is no recording, is no regular file or cannot be read; also if none is
    /// given.
    pub fn open<P: AsRef<Path>>(paths: &[P]) -> Result<Self, RecordingError> {
        let mut paths: VecDeque<_> = paths.iter().map(|path| path.as_ref().to_owned()).collect();
        let none = || std::io::Error::new(std::io::ErrorKind::NotFound, "no file was given");
        let first = paths.pop_front().ok_or_else(none)?;
        let reader = regular_file(&first).and_then(Self::new);
        let mut reader = reader.map_err(|source| of_file(&first, source))?;
        reader.path = Some(first);
        reader.files_to_come = paths;
        Ok(reader)
    }

    /// The next record, `None` at the end or the cut of the last file. Messages of other programs
    /// are skipped.
    ///
    /// # Errors
    /// If the stream cannot be read, or holds chunks.
    pub fn next_message(&mut self) -> Result<Option<Recorded>, RecordingError> {
        loop {
            let next = self.next_of_file();
            let next = match &self.path {
                Some(path) => next.map_err(|source| of_file(path, source))?,
                None => next?,
            };
            if next.is_some() || !self.go_on_to_next_file()? {
                return Ok(next);
            }
        }
    }

    fn next_of_file(&mut self) -> Result<Option<Recorded>, RecordingError> {
        loop {
            let Some(record) = self.records.next()? else {
                return Ok(None);
            };
            // The library's parser is trusted with these kinds only.
            if !matches!(record.kind, op::HEADER | op::CHANNEL | op::MESSAGE) {
                continue;
            }
            match mcap::parse_record(record.kind, record.body) {
                Ok(McapRecord::Header(header)) => self.is_own = header.library == LIBRARY,
                // Our own ids are fixed, so that damage to a channel's record costs nothing.
                Ok(McapRecord::Channel(channel)) if !self.is_own => {
                    let topic = Topic::of_name(&channel.topic);
                    self.records.channels.insert(channel.id, topic);
                }
                Ok(McapRecord::Message { header, data }) => {
                    let bytes = data.into_owned();
                    let Some(topic) = self.records.topic_of(header.channel_id) else {
                        continue;
                    };
                    match self.assembler.take(topic, &header, &bytes) {
                        Made::Record(record) => {
                            let host_time = time_of(header.log_time);
                            return Ok(Some(Recorded { host_time, record }));
                        }
                        Made::Half => {}
                        Made::Undecodable => self.undecodable_count += 1,
                    }
                }
                _ => {}
            }
        }
    }

    /// Whether there was one.
    fn go_on_to_next_file(&mut self) -> Result<bool, RecordingError> {
        let Some(path) = self.files_to_come.pop_front() else {
            return Ok(false);
        };
        let file = regular_file(&path).map_err(|source| of_file(&path, source))?;
        let records = Records::new(Box::new(file) as Source<'a>);
        let records = records.map_err(|source| of_file(&path, source))?;
        self.was_cut |= self.records.ending == Some(Ending::Cut);
        self.past_damaged_byte_count += self.records.damaged_byte_count;
        self.records = records;
        self.path = Some(path);
        self.assembler = Assembler::default();
        self.is_own = false;
        Ok(true)
    }

    /// How the recording ended, once [`RecordingReader::next_message`] has returned `None`: cut if
    /// any of its files was.
    #[must_use]
    pub fn ending(&self) -> Option<Ending> {
        let last = self.records.ending?;
        Some(if self.was_cut { Ending::Cut } else { last })
    }

    /// Bytes skipped so far because they made no record.
    #[must_use]
    pub fn damaged_byte_count(&self) -> u64 {
        self.past_damaged_byte_count + self.records.damaged_byte_count
    }

    /// Messages whose record was sound and whose content was not.
    #[must_use]
    pub fn undecodable_count(&self) -> u64 {
        self.undecodable_count
    }
}

/// Opening a fifo would wait for ever for its other end.
fn regular_file(path: &Path) -> Result<File, RecordingError> {
    match std::fs::metadata(path)?.is_file() {
        true => Ok(File::open(path)?),
        false => Err(RecordingError::NotAFile),
    }
}

fn of_file(path: &Path, source: RecordingError) -> RecordingError {
    RecordingError::File {
        path: path.to_owned(),
        source: Box::new(source),
    }
}
