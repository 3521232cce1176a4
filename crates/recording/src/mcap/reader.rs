//! Recorded messages in the order they were written.

use std::io::Read;

use echosplat_model::{StampedPose, Timestamp};
use mcap::records::{Record as McapRecord, op};

use super::records::{Ending, Records};
use super::{LIBRARY, RecordingError, Topic, pose};

/// One message and when the host had it.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// Host time.
    pub time: Timestamp,
    /// What it was.
    pub item: RecordedItem,
}

/// What was recorded.
#[derive(Debug, Clone, PartialEq)]
pub enum RecordedItem {
    /// A pose.
    Pose(StampedPose),
    /// Anything else, as it was given.
    Bytes(Topic, Vec<u8>),
}

/// Reads a recording, also a cut or damaged one.
pub struct RecordingReader<R> {
    records: Records<R>,
    is_own: bool,
    undecodable_count: u64,
}

impl<R: Read> RecordingReader<R> {
    /// Starts reading. A file cut in its first bytes is a recording of nothing.
    ///
    /// # Errors
    /// If the stream is something else than MCAP, or cannot be read.
    pub fn new(source: R) -> Result<Self, RecordingError> {
        Ok(Self {
            records: Records::new(source)?,
            is_own: false,
            undecodable_count: 0,
        })
    }

    /// The next message, `None` at the end or the cut. Messages of other programs are skipped.
    ///
    /// # Errors
    /// If the stream cannot be read, or holds chunks.
    pub fn next_message(&mut self) -> Result<Option<Recorded>, RecordingError> {
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
                    let topic = self.records.channels.get(&header.channel_id);
                    let Some(&Some(topic)) = topic else { continue };
                    if let Some(item) = item_of(topic, bytes) {
                        let time = time_of(header.log_time);
                        return Ok(Some(Recorded { time, item }));
                    }
                    self.undecodable_count += 1;
                }
                _ => {}
            }
        }
    }

    /// How the recording ended, once [`RecordingReader::next_message`] has returned `None`.
    #[must_use]
    pub fn ending(&self) -> Option<Ending> {
        self.records.ending
    }

    /// Bytes skipped so far because they made no record.
    #[must_use]
    pub fn damaged_byte_count(&self) -> u64 {
        self.records.damaged_byte_count
    }

    /// Messages whose record was sound and whose content was not.
    #[must_use]
    pub fn undecodable_count(&self) -> u64 {
        self.undecodable_count
    }
}

fn item_of(topic: Topic, bytes: Vec<u8>) -> Option<RecordedItem> {
    match topic {
        Topic::Pose => pose::of_json(&bytes).map(RecordedItem::Pose),
        _ => Some(RecordedItem::Bytes(topic, bytes)),
    }
}

fn time_of(nanos: u64) -> Timestamp {
    Timestamp::from_nanos(i64::try_from(nanos).unwrap_or(i64::MAX))
}
