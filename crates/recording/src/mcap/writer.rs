//! Messages to the operating system, each whole or not at all.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;

use echosplat_model::Timestamp;
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

use super::message::{Message, epoch_event, messages_of, nanos_of};
use super::topic::Topic;
use super::{LIBRARY, Record, RecordingError};

/// Longest message; what is longer is refused.
pub const MAX_MESSAGE_BYTES: usize = 1 << 20;

/// Room for any one record with its two messages, so that it is never handed over in parts of its
/// own making.
const BUFFER_BYTES: usize = 2 * MAX_MESSAGE_BYTES + (16 << 10);
/// Kind, length and head of a message.
const MESSAGE_OVERHEAD_BYTES: u64 = 31;

/// Writes a recording. Every record is flushed before its call returns.
///
/// If the operating system refuses (a full disk), the record at hand is kept and completed by a
/// later call; records that come while it still refuses are counted and lost. So a file never
/// holds half a record with something after it.
pub struct RecordingWriter<W: Write + Seek> {
    writer: Writer<BufWriter<W>>,
    frame_id: String,
    sequences: [u32; Topic::ALL.len()],
    /// Epoch of the last pose.
    epoch: Option<u32>,
    /// The buffer holds what the operating system did not take yet.
    behind: bool,
    byte_count: u64,
    lost_message_count: u64,
}

impl<W: Write + Seek> RecordingWriter<W> {
    /// Starts a recording whose poses are in the frame `frame_id`.
    ///
    /// # Errors
    /// Of the writer.
    pub fn new(writer: W, frame_id: &str) -> Result<Self, RecordingError> {
        let buffered = BufWriter::with_capacity(BUFFER_BYTES, writer);
        let mut writer = WriteOptions::new()
            .use_chunks(false)
            .profile("")
            .library(LIBRARY)
            .create(buffered)?;
        for topic in Topic::ALL {
            let (id, schema) = (topic.id(), topic.schema());
            let text = schema.text.as_bytes();
            writer.add_schema_with_id(id, schema.name, schema.encoding, text)?;
            let encoding = schema.message_encoding;
            writer.add_channel_with_id(id, id, topic.name(), encoding, &BTreeMap::new())?;
        }
        writer.flush()?;
        Ok(Self {
            writer,
            frame_id: frame_id.to_owned(),
            sequences: [0; Topic::ALL.len()],
            epoch: None,
            behind: false,
            byte_count: 0,
            lost_message_count: 0,
        })
    }

    /// Records what came at `host_time`. Times before 1970 are written as 1970.
    ///
    /// # Errors
    /// If it is too long, which is counted as lost. Of the operating system: then the record is
    /// kept, and written by the next [`RecordingWriter::catch_up`] that succeeds; a record that
    /// comes before that is lost and counted.
    pub fn write(&mut self, host_time: Timestamp, record: &Record) -> Result<(), RecordingError> {
        let frame_id = self.frame_id.clone();
        let messages = messages_of(record, &frame_id);
        let allowed = messages.iter().try_for_each(check_length);
        if let Err(error) = allowed.and_then(|()| self.catch_up()) {
            self.lost_message_count += 1;
            return Err(error);
        }
        if let Record::Pose(pose) = record
            && self.epoch.replace(pose.epoch) != Some(pose.epoch)
        {
            let event = epoch_event(pose.epoch);
            self.put_all(host_time, &messages_of(&event, &frame_id))?;
        }
        self.put_all(host_time, &messages)?;
        self.catch_up()
    }

    /// Into the buffer, which has room for them.
    fn put_all(
        &mut self,
        host_time: Timestamp,
        messages: &[Message<'_>],
    ) -> Result<(), RecordingError> {
        self.behind = true;
        messages
            .iter()
            .try_for_each(|message| self.put(host_time, message))
    }

    fn put(&mut self, host_time: Timestamp, message: &Message<'_>) -> Result<(), RecordingError> {
        let count = &mut self.sequences[message.topic as usize];
        let header = MessageHeader {
            channel_id: message.topic.id(),
            sequence: message.sequence.unwrap_or(*count),
            log_time: nanos_of(host_time),
            publish_time: nanos_of(message.publish_time.unwrap_or(host_time)),
        };
        *count = count.wrapping_add(1);
        self.byte_count += MESSAGE_OVERHEAD_BYTES + message.bytes.len() as u64;
        Ok(self
            .writer
            .write_to_known_channel(&header, &message.bytes)?)
    }

    /// Hands over what was refused before, if anything was.
    ///
    /// # Errors
    /// If it is refused again.
    pub fn catch_up(&mut self) -> Result<(), RecordingError> {
        if self.behind {
            self.writer.flush()?;
            self.behind = false;
        }
        Ok(())
    }

    /// Lets go of the writer without another byte: what it refused is in no file.
    pub fn abandon(self) {
        // Dropping the buffer would try once more to write.
        let _ = self.writer.into_inner().into_parts();
    }

    /// Bytes of messages so far, by which to rotate.
    #[must_use]
    pub fn byte_count(&self) -> u64 {
        self.byte_count
    }

    /// Messages that are not in the file.
    #[must_use]
    pub fn lost_message_count(&self) -> u64 {
        self.lost_message_count
    }

    /// Writes the file's end and gives the writer back.
    ///
    /// # Errors
    /// Of the writer; what was recorded so far can be read all the same.
    pub fn finish(mut self) -> Result<W, RecordingError> {
        self.catch_up()?;
        self.writer.finish()?;
        let buffered = self.writer.into_inner();
        let inner = buffered
            .into_inner()
            .map_err(io::IntoInnerError::into_error)?;
        Ok(inner)
    }
}

fn check_length(message: &Message<'_>) -> Result<(), RecordingError> {
    let found = message.bytes.len();
    match found > MAX_MESSAGE_BYTES {
        true => Err(RecordingError::TooLong {
            topic: message.topic.name(),
            found,
        }),
        false => Ok(()),
    }
}

/// A recording in a file of its own.
pub struct RecordingFile {
    writer: RecordingWriter<File>,
    file: File,
}

impl RecordingFile {
    /// Creates the file; one that is already there is never touched.
    ///
    /// # Errors
    /// Of the file system; then nothing is left behind.
    pub fn create(path: &Path, frame_id: &str) -> Result<Self, RecordingError> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        let writer = file.try_clone().map_err(RecordingError::from);
        match writer.and_then(|writer| RecordingWriter::new(writer, frame_id)) {
            Ok(writer) => Ok(Self { writer, file }),
            Err(error) => {
                // A file without its head is of no use to anyone.
                let _ = std::fs::remove_file(path);
                Err(error)
            }
        }
    }

    /// The file itself, for whoever syncs it on another thread.
    ///
    /// # Errors
    /// If the system gives no further handle.
    pub fn handle(&self) -> io::Result<File> {
        self.file.try_clone()
    }

    /// Writes the file's end; the caller syncs its handle.
    ///
    /// # Errors
    /// Of the file system.
    pub fn close(self) -> Result<(), RecordingError> {
        self.writer.finish().map(drop)
    }

    /// As [`RecordingWriter::abandon`].
    pub fn abandon(self) {
        self.writer.abandon();
    }

    /// Where to write.
    pub fn writer(&mut self) -> &mut RecordingWriter<File> {
        &mut self.writer
    }

    /// Makes what was written survive a power cut; the caller's timer says when.
    ///
    /// # Errors
    /// Of the file system.
    pub fn sync(&mut self) -> Result<(), RecordingError> {
        self.writer.catch_up()?;
        Ok(self.file.sync_data()?)
    }

    /// Writes the file's end and syncs.
    ///
    /// # Errors
    /// Of the file system.
    pub fn finish(self) -> Result<(), RecordingError> {
        self.writer.finish()?;
        Ok(self.file.sync_all()?)
    }
}
