//! Messages to the operating system, each whole or not at all, in chunks that end as often as the
//! file is synced.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, Write};
use std::path::Path;

use echosplat_model::Timestamp;
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

use super::held::Held;
use super::message::{Message, epoch_event, messages_of, nanos_of};
use super::topic::Topic;
use super::{LIBRARY, ROS2, Record, RecordingError};

/// Longest message; what is longer is refused.
pub const MAX_MESSAGE_BYTES: usize = 1 << 20;

/// A chunk ends after so long, seconds of host time: as often as the service syncs the file.
const CHUNK_S: f64 = 0.5;
/// A chunk ends at this length, so that whoever reads it needs no more memory at once.
const CHUNK_BYTES: u64 = 1 << 20;

/// For whom a recording is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Profile {
    /// All there is, to be replayed.
    #[default]
    Full,
    /// Only what is CDR, with the profile `ros2`: programs of ROS refuse a file with anything else.
    /// Settings, events, link news and what is said of deltas are not in it.
    Ros2,
}

impl Profile {
    fn name(self) -> &'static str {
        match self {
            Self::Full => "",
            Self::Ros2 => ROS2,
        }
    }

    /// Whether such a record is kept, if only half of it.
    #[must_use]
    pub fn keeps(self, record: &Record) -> bool {
        let is_of_ros = matches!(
            record,
            Record::Raw(_) | Record::Pose(_) | Record::Delta { .. } | Record::StaticTransform(_)
        );
        self == Self::Full || is_of_ros
    }

    fn takes(self, topic: Topic) -> bool {
        self == Self::Full || topic.schema().message_encoding == "cdr"
    }
}

/// Writes a recording. Every record is flushed before its call returns.
///
/// If the operating system refuses (a full disk), the record at hand is kept and completed by a
/// later call; records that come while it still refuses are counted and lost. So a file never
/// holds half a record with something after it.
///
/// The head of a chunk says how long it is once the chunk has ended; until then, and after a kill,
/// its records can be read one by one. Dropping the writer writes nothing.
pub struct RecordingWriter<W: Write + Seek> {
    writer: Writer<Held<W>>,
    file: Held<W>,
    profile: Profile,
    frame_id: String,
    /// When the chunk at hand began, and how long the file was then.
    chunk_began: Option<(Timestamp, u64)>,
    sequences: [u32; Topic::ALL.len()],
    /// Epoch of the last pose.
    epoch: Option<u32>,
    lost_message_count: u64,
}

impl<W: Write + Seek> RecordingWriter<W> {
    /// Starts a recording whose poses are in the frame `frame_id`.
    ///
    /// # Errors
    /// Of the writer.
    pub fn new(writer: W, frame_id: &str, profile: Profile) -> Result<Self, RecordingError> {
        let file = Held::new(writer);
        let mut writer = WriteOptions::new()
            .use_chunks(true)
            // Compressed, a record would not be whole before others have come.
            .compression(None)
            .chunk_size(None)
            .profile(profile.name())
            .library(LIBRARY)
            .create(file.clone())?;
        for topic in Topic::ALL.into_iter().filter(|topic| profile.takes(*topic)) {
            let (id, schema) = (topic.id(), topic.schema());
            let text = schema.text.as_bytes();
            writer.add_schema_with_id(id, schema.name, schema.encoding, text)?;
            let encoding = schema.message_encoding;
            writer.add_channel_with_id(id, id, topic.name(), encoding, &BTreeMap::new())?;
        }
        file.hand_over()?;
        Ok(Self {
            writer,
            file,
            profile,
            frame_id: frame_id.to_owned(),
            chunk_began: None,
            sequences: [0; Topic::ALL.len()],
            epoch: None,
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
        self.end_chunk_if_due(host_time)?;
        if let Record::Pose(pose) = record
            && self.epoch.replace(pose.epoch) != Some(pose.epoch)
        {
            let event = epoch_event(pose.epoch);
            self.put_all(host_time, &messages_of(&event, &frame_id))?;
        }
        self.put_all(host_time, &messages)?;
        self.catch_up()
    }

    /// The operating system has all that came before: so no more waits than the chunk's end and one
    /// record.
    fn end_chunk_if_due(&mut self, host_time: Timestamp) -> Result<(), RecordingError> {
        let byte_count = self.file.byte_count();
        let (began, at) = *self.chunk_began.get_or_insert((host_time, byte_count));
        let is_due = host_time.seconds_since(began).abs() >= CHUNK_S;
        if is_due || byte_count - at >= CHUNK_BYTES {
            self.end_chunk()?;
            self.chunk_began = Some((host_time, self.file.byte_count()));
        }
        Ok(())
    }

    fn end_chunk(&mut self) -> Result<(), RecordingError> {
        self.chunk_began = None;
        Ok(self.writer.flush()?)
    }

    /// Into memory.
    fn put_all(
        &mut self,
        host_time: Timestamp,
        messages: &[Message<'_>],
    ) -> Result<(), RecordingError> {
        let profile = self.profile;
        let mut taken = messages
            .iter()
            .filter(|message| profile.takes(message.topic));
        taken.try_for_each(|message| self.put(host_time, message))
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
        Ok(self
            .writer
            .write_to_known_channel(&header, &message.bytes)?)
    }

    /// Hands over what was refused before, if anything was.
    ///
    /// # Errors
    /// If it is refused again.
    pub fn catch_up(&mut self) -> Result<(), RecordingError> {
        Ok(self.file.hand_over()?)
    }

    /// Bytes of the file so far, by which to rotate.
    #[must_use]
    pub fn byte_count(&self) -> u64 {
        self.file.byte_count()
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
        self.file.hand_over()?;
        drop(self.writer);
        let file = self.file.into_inner();
        file.ok_or_else(|| io::Error::other("the file is held elsewhere").into())
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
    pub fn create(path: &Path, frame_id: &str, profile: Profile) -> Result<Self, RecordingError> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        let writer = file.try_clone().map_err(RecordingError::from);
        match writer.and_then(|writer| RecordingWriter::new(writer, frame_id, profile)) {
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

    /// Where to write.
    pub fn writer(&mut self) -> &mut RecordingWriter<File> {
        &mut self.writer
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
