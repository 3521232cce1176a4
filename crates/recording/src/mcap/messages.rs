//! The messages of an MCAP file of any program, in the order they stand there: in chunks or not,
//! around damage, up to a cut, and on where one file was put behind another.

use std::collections::HashMap;
use std::fs::File;
use std::io::{Cursor, Read};
use std::path::Path;

use bytes::Bytes;
use echosplat_ply::{Newer, version_of};
use mcap::records::{MessageHeader, Record, op};

use super::channel::{Channel, own_channels};
use super::chunk::{ChunkHead, FIXED_BYTES, MAX_CHUNK_BYTES};
use super::cutter::{Cutter, Piece};
use super::{LIBRARY, ROS2, RecordingError};

/// What stands before the version of the format.
const LIBRARY_NAME: &str = "echosplat recording ";

/// A message as it stands in a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Channel, sequence and times, nanoseconds.
    pub header: MessageHeader,
    /// In the encoding of its channel.
    pub data: Bytes,
}

/// What was wrong with a recording, or with one of several in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Condition {
    /// Bytes skipped because they made no record.
    pub damaged_byte_count: u64,
    /// Bytes of a last record whose end is not there.
    pub cut_byte_count: u64,
    /// It ends in the middle.
    pub is_cut: bool,
    /// Its bytes are not those that were written.
    pub is_checksum_wrong: bool,
}

impl Condition {
    /// Nothing was wrong.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        *self == Self::default()
    }
}

/// What a file says in its first record.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct WrittenBy {
    /// The program or library that wrote it.
    pub library: String,
    /// Whose rules its messages follow, as in `ros2`; empty without any.
    pub profile: String,
}

impl WrittenBy {
    /// This program wrote the file, or a tool wrote it anew and said so.
    #[must_use]
    pub fn is_this_program(&self) -> bool {
        self.library.contains(LIBRARY_NAME)
    }
}

/// What comes next in a file.
pub(super) enum Item {
    /// Another recording begins: how the one before was.
    Begin(Condition),
    Message(Message),
    End,
}

/// What a record says.
enum Said {
    /// Who wrote the file, and for whom.
    Header(WrittenBy),
    Schema(u16, String),
    Channel(u16, u16, [String; 2]),
    Message(Message),
    Nothing,
}

/// Reads the messages of an MCAP file of any program.
pub struct Messages<R> {
    file: Cutter<R>,
    /// The chunk at hand; it has the channels meanwhile.
    chunk: Option<Cutter<Cursor<Vec<u8>>>>,
    schemas: HashMap<u16, String>,
    written_by: WrittenBy,
    /// Whether this program wrote the file as it is; `None` before the file says it. Its ids are
    /// fixed, so that damage to a channel's record costs nothing.
    is_own: Option<bool>,
    /// Messages have the sequences that this program gave them.
    keeps_sequences: bool,
    /// Its profile says so.
    is_for_ros: bool,
    condition: Condition,
    is_ended: bool,
}

impl Messages<File> {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// If it is no regular file, no MCAP, or cannot be read.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::new(regular_file(path)?)
    }
}

impl<R: Read> Messages<R> {
    /// Starts reading. A file cut in its first bytes holds nothing.
    ///
    /// # Errors
    /// If the stream is something else than MCAP, or cannot be read.
    pub fn new(source: R) -> Result<Self, RecordingError> {
        Ok(Self {
            file: Cutter::of_file(source, own_channels())?,
            chunk: None,
            schemas: HashMap::new(),
            written_by: WrittenBy::default(),
            is_own: None,
            keeps_sequences: true,
            is_for_ros: false,
            condition: Condition::default(),
            is_ended: false,
        })
    }

    /// The next message, `None` at the end.
    ///
    /// # Errors
    /// If the stream cannot be read, or holds a chunk too long to be taken into memory.
    pub fn next_message(&mut self) -> Result<Option<Message>, RecordingError> {
        loop {
            match self.next_item()? {
                Item::Message(message) => return Ok(Some(message)),
                Item::Begin(_) => {}
                Item::End => return Ok(None),
            }
        }
    }

    pub(super) fn next_item(&mut self) -> Result<Item, RecordingError> {
        while !self.is_ended {
            let said = match self.chunk.take() {
                Some(mut chunk) => match chunk.next()? {
                    Piece::Record(kind) => {
                        let said = said(kind, chunk.body());
                        self.chunk = Some(chunk);
                        said
                    }
                    Piece::Begin | Piece::End => {
                        self.leave(chunk);
                        continue;
                    }
                },
                None => match self.file.next()? {
                    Piece::Record(op::CHUNK) => {
                        self.enter_chunk();
                        continue;
                    }
                    Piece::Record(op::DATA_END | op::FOOTER) => return self.end_of_data(),
                    Piece::Record(kind) => said(kind, self.file.body()),
                    Piece::Begin => return Ok(self.begin_another(true)),
                    Piece::End => {
                        self.condition = self.condition_at_end(true);
                        self.is_ended = true;
                        break;
                    }
                },
            };
            if let Said::Message(message) = said {
                return Ok(Item::Message(message));
            }
            self.note(said)?;
        }
        Ok(Item::End)
    }

    fn note(&mut self, said: Said) -> Result<(), RecordingError> {
        match said {
            Said::Header(written_by) => {
                let library = written_by.library.as_str();
                refuse_newer(library)?;
                let is_own = library.starts_with(LIBRARY_NAME);
                self.is_own = Some(is_own);
                self.is_for_ros = written_by.profile == ROS2;
                // Tools that rewrite a file put their own name before.
                self.keeps_sequences = library.contains(LIBRARY_NAME);
                self.written_by = written_by;
                if !is_own {
                    self.file.most_body_bytes = MAX_CHUNK_BYTES;
                    self.file.channels.clear();
                }
            }
            Said::Schema(id, name) => {
                self.schemas.insert(id, name);
            }
            Said::Channel(id, schema, [topic, encoding]) if self.is_own != Some(true) => {
                let schema = self.schemas.get(&schema).cloned().unwrap_or_default();
                let channel = Channel::new(topic, schema, encoding);
                self.channels_mut().insert(id, channel);
            }
            Said::Channel(..) | Said::Message(_) | Said::Nothing => {}
        }
        Ok(())
    }

    fn channels_mut(&mut self) -> &mut HashMap<u16, Channel> {
        match &mut self.chunk {
            Some(chunk) => &mut chunk.channels,
            None => &mut self.file.channels,
        }
    }

    fn enter_chunk(&mut self) {
        let body = self.file.body();
        if body.len() == FIXED_BYTES {
            // The head alone: what it holds follows.
            return;
        }
        // The length is not asked again: what is cut is less.
        let length = ChunkHead::length_said(body);
        let Some(head) = length.and_then(|length| ChunkHead::read(body, length)) else {
            return;
        };
        let content = head.content(body);
        self.condition.is_checksum_wrong |= !content.is_sound;
        self.condition.damaged_byte_count += content.missing_byte_count;
        let channels = std::mem::take(&mut self.file.channels);
        let records = Cursor::new(content.bytes);
        self.chunk = Some(Cutter::of_chunk(records, content.is_sound, channels));
    }

    fn leave(&mut self, chunk: Cutter<Cursor<Vec<u8>>>) {
        self.condition.damaged_byte_count += chunk.damaged_byte_count + chunk.cut_byte_count;
        self.file.channels = chunk.channels;
    }

    /// Nothing but the summary follows, or another recording.
    fn end_of_data(&mut self) -> Result<Item, RecordingError> {
        let said = self
            .file
            .body()
            .first_chunk()
            .filter(|_| self.file.body().len() == 4);
        let said = said.map_or(0, |said| u32::from_le_bytes(*said));
        let found = self.file.checksum.clone().finalize();
        self.condition.is_checksum_wrong |= self.is_own == Some(true) && said != 0 && said != found;
        if self.file.skip_summary()? {
            return Ok(self.begin_another(false));
        }
        self.condition = self.condition_at_end(false);
        self.is_ended = true;
        Ok(Item::End)
    }

    fn condition_at_end(&mut self, is_cut: bool) -> Condition {
        let file = &mut self.file;
        Condition {
            is_cut,
            damaged_byte_count: self.condition.damaged_byte_count
                + std::mem::take(&mut file.damaged_byte_count),
            cut_byte_count: self.condition.cut_byte_count
                + std::mem::take(&mut file.cut_byte_count),
            ..self.condition
        }
    }

    fn begin_another(&mut self, is_cut: bool) -> Item {
        let before = self.condition_at_end(is_cut);
        self.condition = Condition::default();
        self.schemas.clear();
        self.file.channels = own_channels();
        self.is_own = None;
        self.keeps_sequences = true;
        self.is_for_ros = false;
        Item::Begin(before)
    }

    /// The channel with this id, if the file has told of it so far.
    #[must_use]
    pub fn channel(&self, id: u16) -> Option<&Channel> {
        self.channels().get(&id)
    }

    /// All that the file has told of so far, by their ids.
    #[must_use]
    pub fn channels(&self) -> &HashMap<u16, Channel> {
        match &self.chunk {
            Some(chunk) => &chunk.channels,
            None => &self.file.channels,
        }
    }

    /// Who wrote the recording at hand; empty before the file has said it.
    #[must_use]
    pub fn written_by(&self) -> &WrittenBy {
        &self.written_by
    }

    /// Whether this program wrote the file as it is.
    pub(super) fn is_own(&self) -> bool {
        self.is_own != Some(false)
    }

    pub(super) fn keeps_sequences(&self) -> bool {
        self.keeps_sequences
    }

    /// Whether it holds messages of ROS and nothing else.
    pub(super) fn is_for_ros(&self) -> bool {
        self.is_for_ros
    }

    /// How the recording was, once its end was reached; of the last one in the file.
    #[must_use]
    pub fn condition(&self) -> Condition {
        self.condition
    }

    /// Bytes skipped so far of the recording at hand, or cut off at its end.
    pub(super) fn lost_byte_count(&self) -> u64 {
        let (file, condition) = (&self.file, &self.condition);
        let of_file = file.damaged_byte_count + file.cut_byte_count;
        condition.damaged_byte_count + condition.cut_byte_count + of_file
    }
}

/// The library's parser is trusted with these kinds only.
fn said(kind: u8, body: &[u8]) -> Said {
    if !matches!(kind, op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE) {
        return Said::Nothing;
    }
    match mcap::parse_record(kind, body) {
        Ok(Record::Header(header)) => Said::Header(WrittenBy {
            library: header.library,
            profile: header.profile,
        }),
        Ok(Record::Schema { header, .. }) => Said::Schema(header.id, header.name),
        Ok(Record::Channel(channel)) => {
            let words = [channel.topic, channel.message_encoding];
            Said::Channel(channel.id, channel.schema_id, words)
        }
        Ok(Record::Message { header, data }) => Said::Message(Message {
            header,
            data: Bytes::copy_from_slice(&data),
        }),
        _ => Said::Nothing,
    }
}

/// # Errors
/// If this program wrote the file, or one that was made of it, by a format of a later version.
fn refuse_newer(library: &str) -> Result<(), RecordingError> {
    let after = |text: &str| {
        text.split_once(LIBRARY_NAME)
            .map(|(_, after)| version_of(after))
    };
    let newest = after(LIBRARY).flatten().unwrap_or_default();
    match after(library).flatten() {
        Some(found) if found > newest => Err(RecordingError::Newer(Newer {
            what: "recording",
            found,
            newest,
        })),
        _ => Ok(()),
    }
}

/// Opening a fifo would wait for ever for its other end.
pub(super) fn regular_file(path: &Path) -> Result<File, RecordingError> {
    match std::fs::metadata(path)?.is_file() {
        true => Ok(File::open(path)?),
        false => Err(RecordingError::NotAFile),
    }
}
