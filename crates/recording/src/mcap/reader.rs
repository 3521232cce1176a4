//! Records in the order they were written, of one file or of the files of a dive.

use std::collections::VecDeque;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::files::{FileMessages, Next, in_order};
use super::joining::{Fate, Joining, identity};
use super::message::{Assembler, Made, POSE_EPOCH, time_of};
use super::messages::{Condition, Message};
use super::part::{Part, losses};
use super::topic::Topic;
use super::{Record, Recorded, RecordingError, Source};

/// How a recording ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// As its writer meant.
    Complete,
    /// In the middle; everything before was read.
    Cut,
}

/// Reads a recording, also a cut or damaged one, or one that another program wrote anew; the files of
/// one dive as one. What stands there twice is taken once, and what does not go on from what was read
/// is left out: [`RecordingReader::parts`] says so.
pub struct RecordingReader<'a> {
    file: FileMessages<'a>,
    files_to_come: VecDeque<PathBuf>,
    assembler: Assembler,
    joining: Joining,
    parts: Vec<Part>,
    /// The record of each part that stands there last.
    last_records: Vec<Option<u64>>,
    /// Sequence of the next piece of raw bytes in the part at hand, and in the one before.
    next_sequences: [Option<u32>; 2],
    /// Wait until it is known whether their part goes on from those before.
    waiting: VecDeque<Recorded>,
    ready: VecDeque<Recorded>,
    /// As the newest event says; other programs number messages anew.
    epoch: Option<u32>,
    is_ended: bool,
}

impl<'a> RecordingReader<'a> {
    /// Starts reading. A file cut in its first bytes is a recording of nothing.
    ///
    /// # Errors
    /// If the stream is something else than MCAP, or cannot be read.
    pub fn new(source: impl Read + Send + 'a) -> Result<Self, RecordingError> {
        let file = FileMessages::new(Box::new(source) as Source<'a>)?;
        Ok(Self::of(file, None))
    }

    fn of(file: FileMessages<'a>, path: Option<PathBuf>) -> Self {
        Self {
            file,
            files_to_come: VecDeque::new(),
            assembler: Assembler::default(),
            joining: Joining::default(),
            parts: vec![Part {
                path,
                ..Part::default()
            }],
            last_records: vec![None],
            next_sequences: [None; 2],
            waiting: VecDeque::new(),
            ready: VecDeque::new(),
            epoch: None,
            is_ended: false,
        }
    }

    /// Starts reading the files of one dive, in this order, or in that of their times where this one
    /// cannot be. Each is opened when its turn comes.
    ///
    /// # Errors
    /// Names the file that is no recording, is no regular file or cannot be read; also if none is
    /// given.
    pub fn open<P: AsRef<Path>>(paths: &[P]) -> Result<Self, RecordingError> {
        let paths = paths.iter().map(|path| path.as_ref().to_owned()).collect();
        let mut paths = VecDeque::from(in_order(paths));
        let none = || std::io::Error::new(std::io::ErrorKind::NotFound, "no file was given");
        let first = paths.pop_front().ok_or_else(none)?;
        let mut reader = Self::of(open_file(&first)?, Some(first));
        reader.files_to_come = paths;
        Ok(reader)
    }

    /// The next record, `None` at the end or the cut of the last file. Messages of other programs
    /// are skipped.
    ///
    /// # Errors
    /// If the stream cannot be read, or holds a chunk too long to be taken into memory.
    pub fn next_message(&mut self) -> Result<Option<Recorded>, RecordingError> {
        loop {
            if let Some(recorded) = self.ready.pop_front() {
                return Ok(Some(recorded));
            }
            if self.is_ended {
                return Ok(None);
            }
            let next = self.file.next().map_err(|source| self.named(source))?;
            match next {
                Next::Message(topic, message) => self.take(topic, &message),
                Next::Begin(before) => {
                    let path = self.part().path.clone();
                    self.end_part(before);
                    self.begin_part(path, true);
                }
                Next::End(condition) => {
                    self.end_part(condition);
                    self.go_on_to_next_file()?;
                }
            }
        }
    }

    /// An error of the file at hand.
    fn named(&mut self, source: RecordingError) -> RecordingError {
        match self.part().path.clone() {
            Some(path) => of_file(&path, source),
            None => source,
        }
    }

    fn part(&mut self) -> &mut Part {
        if self.parts.is_empty() {
            self.parts.push(Part::default());
        }
        let last = self.parts.len() - 1;
        &mut self.parts[last]
    }

    fn take(&mut self, topic: Topic, message: &Message) {
        self.note_sequence(topic, message);
        let id = identity(topic, message);
        let fate = self.joining.judge(topic, id, message);
        match fate {
            Fate::Repeated => return self.repeat(id),
            Fate::LeftOut => return self.leave_out(),
            Fate::Taken | Fate::Waits => {}
        }
        if matches!(topic, Topic::Raw | Topic::Pose)
            && let Some(last) = self.last_records.last_mut()
        {
            *last = Some(id);
        }
        let host_time = time_of(message.header.log_time);
        match self.assembler.take(topic, &message.header, &message.data) {
            Made::Record(mut record) => {
                self.follow_epoch(&mut record);
                let recorded = Recorded { host_time, record };
                match fate {
                    Fate::Waits => self.waiting.push_back(recorded),
                    _ => self.make_ready(topic, recorded),
                }
            }
            Made::Half => {}
            Made::Undecodable => self.part().undecodable_count += 1,
        }
    }

    /// The sequence of a pose is its epoch, unless another program has numbered it.
    fn follow_epoch(&mut self, record: &mut Record) {
        match record {
            Record::Event(event) if event["event"] == POSE_EPOCH => {
                self.epoch = event["epoch"]
                    .as_u64()
                    .and_then(|epoch| epoch.try_into().ok());
            }
            Record::Pose(pose) if !self.file.is_own() => {
                let otherwise = match self.file.keeps_sequences() {
                    true => pose.epoch,
                    false => 0,
                };
                pose.epoch = self.epoch.unwrap_or(otherwise);
            }
            _ => {}
        }
    }

    fn make_ready(&mut self, topic: Topic, recorded: Recorded) {
        if !self.waiting.is_empty() {
            self.release();
        }
        self.note(topic, &recorded);
        self.ready.push_back(recorded);
    }

    /// What waited goes on from the parts before.
    fn release(&mut self) {
        self.part().is_of_another_run = self.joining.is_another_run;
        for recorded in std::mem::take(&mut self.waiting) {
            let topic = match &recorded.record {
                Record::LinkUp | Record::LinkDown | Record::HalfFrameExpired => Topic::Link,
                Record::Event(_) => Topic::Events,
                _ => Topic::Status,
            };
            self.note(topic, &recorded);
            self.ready.push_back(recorded);
        }
    }

    fn note(&mut self, topic: Topic, recorded: &Recorded) {
        let time = recorded.host_time;
        let part = self.part();
        let (first, last) = part.span.unwrap_or((time, time));
        part.span = Some((first.min(time), last.max(time)));
        part.taken_count += 1;
        self.joining.count_taken(topic);
        if let Record::Event(event) = &recorded.record
            && let Some((lacking, is_first)) = self.joining.note_position(event)
        {
            self.part().lacking_count += lacking;
            let goes_on = is_first && lacking == 0;
            if let [.., before, _] = &mut self.parts[..] {
                before.is_continued |= goes_on;
            }
        }
    }

    /// Of a record that one of the parts before gave: where that one was cut, this one goes on.
    fn repeat(&mut self, id: u64) {
        self.part().repeated_count += 1;
        let parts = self.parts.iter_mut().zip(&self.last_records);
        for (part, _) in parts.filter(|(_, last)| **last == Some(id)) {
            part.is_continued = true;
        }
    }

    /// A record, and those that waited for it if none of their part goes on from those before.
    fn leave_out(&mut self) {
        let mut count = 1;
        if self.joining.is_elsewhere() {
            count += self.waiting.len() as u64;
            self.waiting.clear();
        }
        self.part().left_out_count += count;
    }

    /// Pieces of raw bytes are counted in each file: a gap shows what is not there.
    fn note_sequence(&mut self, topic: Topic, message: &Message) {
        if topic != Topic::Raw || !self.file.keeps_sequences() {
            return;
        }
        let sequence = message.header.sequence;
        let [here, before] = self.next_sequences;
        // A part of a file goes on from another part of it.
        let expected = here.unwrap_or(match before {
            Some(before) if sequence > 0 => before,
            _ => 0,
        });
        self.part().missing_count += u64::from(sequence.saturating_sub(expected));
        self.next_sequences[0] = Some(sequence.wrapping_add(1));
    }

    fn end_part(&mut self, condition: Condition) {
        self.release();
        self.part().condition = condition;
    }

    fn begin_part(&mut self, path: Option<PathBuf>, is_behind_another: bool) {
        self.parts.push(Part {
            path,
            is_behind_another,
            ..Part::default()
        });
        self.last_records.push(None);
        self.next_sequences = [None, self.next_sequences[0].or(self.next_sequences[1])];
        self.assembler = Assembler::default();
        self.joining.begin_part();
    }

    fn go_on_to_next_file(&mut self) -> Result<(), RecordingError> {
        let Some(path) = self.files_to_come.pop_front() else {
            self.is_ended = true;
            return Ok(());
        };
        self.file = open_file(&path)?;
        self.begin_part(Some(path), false);
        Ok(())
    }

    /// What each file gave and lacks, or each of several recordings in a file; complete once
    /// [`RecordingReader::next_message`] has returned `None`.
    #[must_use]
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// What was lost or wrong, a sentence each, once [`RecordingReader::next_message`] has returned
    /// `None`. `goes_on` if somebody else gives what comes after the end.
    #[must_use]
    pub fn losses(&self, goes_on: bool) -> Vec<String> {
        losses(&self.parts, goes_on)
    }

    /// How the recording ended, once [`RecordingReader::next_message`] has returned `None`: cut if
    /// any of its files was.
    #[must_use]
    pub fn ending(&self) -> Option<Ending> {
        let is_cut = self.parts.iter().any(|part| part.condition.is_cut);
        self.is_ended.then_some(match is_cut {
            true => Ending::Cut,
            false => Ending::Complete,
        })
    }

    /// Bytes skipped so far because they made no record, or only the beginning of one.
    #[must_use]
    pub fn damaged_byte_count(&self) -> u64 {
        let parts = self.parts.iter().map(|part| part.condition);
        let ended = parts.map(|found| found.damaged_byte_count + found.cut_byte_count);
        let at_hand = match self.is_ended {
            true => 0,
            false => self.file.lost_byte_count(),
        };
        ended.sum::<u64>() + at_hand
    }

    /// Messages whose record was sound and whose content was not.
    #[must_use]
    pub fn undecodable_count(&self) -> u64 {
        self.parts.iter().map(|part| part.undecodable_count).sum()
    }
}

fn open_file<'a>(path: &Path) -> Result<FileMessages<'a>, RecordingError> {
    FileMessages::open(path).map_err(|source| of_file(path, source))
}

fn of_file(path: &Path, source: RecordingError) -> RecordingError {
    RecordingError::File {
        path: path.to_owned(),
        source: Box::new(source),
    }
}
