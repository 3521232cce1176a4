//! Messages to the operating system, each whole or not at all.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;

use echosplat_model::{StampedPose, Timestamp};
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

use super::{LIBRARY, RecordingError, Topic, pose};

/// Longest message; raw bytes are split, anything else longer is refused.
pub const MAX_MESSAGE_BYTES: usize = 1 << 20;

/// Room for any one record, so that a record is never handed over in parts of its own making.
const BUFFER_BYTES: usize = MAX_MESSAGE_BYTES + 4096;

/// Writes a recording. Every message is flushed before its call returns.
///
/// If the operating system refuses (a full disk), the message at hand is kept and completed by a
/// later call; messages that come while it still refuses are counted and lost. So a file never
/// holds half a record with something after it.
pub struct RecordingWriter<W: Write + Seek> {
    writer: Writer<BufWriter<W>>,
    sequences: [u32; Topic::ALL.len()],
    /// The buffer holds what the operating system did not take yet.
    behind: bool,
    byte_count: u64,
    lost_message_count: u64,
}

impl<W: Write + Seek> RecordingWriter<W> {
    /// Starts a recording.
    ///
    /// # Errors
    /// Of the writer.
    pub fn new(writer: W) -> Result<Self, RecordingError> {
        let buffered = BufWriter::with_capacity(BUFFER_BYTES, writer);
        let mut writer = WriteOptions::new()
            .use_chunks(false)
            .profile("")
            .library(LIBRARY)
            .create(buffered)?;
        for topic in Topic::ALL {
            writer.add_channel_with_id(
                topic.channel_id(),
                0,
                topic.name(),
                topic.encoding(),
                &BTreeMap::new(),
            )?;
        }
        writer.flush()?;
        Ok(Self {
            writer,
            sequences: [0; Topic::ALL.len()],
            behind: false,
            byte_count: 0,
            lost_message_count: 0,
        })
    }

    /// Records bytes as they were received, before anything looks into them.
    ///
    /// # Errors
    /// As [`RecordingWriter::write`].
    pub fn write_raw(&mut self, host_time: Timestamp, bytes: &[u8]) -> Result<(), RecordingError> {
        for piece in bytes.chunks(MAX_MESSAGE_BYTES) {
            self.write(Topic::Raw, host_time, piece)?;
        }
        Ok(())
    }

    /// Records a pose, to the last bit.
    ///
    /// # Errors
    /// As [`RecordingWriter::write`].
    pub fn write_pose(
        &mut self,
        host_time: Timestamp,
        pose: &StampedPose,
    ) -> Result<(), RecordingError> {
        self.write(Topic::Pose, host_time, &pose::to_json(pose))
    }

    /// Records a message. Times before 1970 are written as 1970.
    ///
    /// # Errors
    /// If it is too long, or of the operating system: then the loss is counted.
    pub fn write(
        &mut self,
        topic: Topic,
        host_time: Timestamp,
        bytes: &[u8],
    ) -> Result<(), RecordingError> {
        if bytes.len() > MAX_MESSAGE_BYTES {
            self.lost_message_count += 1;
            return Err(RecordingError::TooLong {
                topic: topic.name(),
                found: bytes.len(),
            });
        }
        if let Err(error) = self.catch_up() {
            self.lost_message_count += 1;
            return Err(error);
        }
        let nanos = u64::try_from(host_time.nanos()).unwrap_or(0);
        let sequence = &mut self.sequences[topic as usize];
        let header = MessageHeader {
            channel_id: topic.channel_id(),
            sequence: *sequence,
            log_time: nanos,
            publish_time: nanos,
        };
        *sequence = sequence.wrapping_add(1);
        self.byte_count += 31 + bytes.len() as u64;
        self.writer.write_to_known_channel(&header, bytes)?;
        self.behind = true;
        self.catch_up()
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

/// A recording in a file of its own.
pub struct RecordingFile {
    writer: RecordingWriter<File>,
    file: File,
}

impl RecordingFile {
    /// Creates the file; one that is already there is never touched.
    ///
    /// # Errors
    /// Of the file system.
    pub fn create(path: &Path) -> Result<Self, RecordingError> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        Ok(Self {
            writer: RecordingWriter::new(file.try_clone()?)?,
            file,
        })
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
