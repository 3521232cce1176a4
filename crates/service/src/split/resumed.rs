//! What recordings hold of a dive that still goes on.

use std::path::PathBuf;

use echosplat_bus::{TapeEntry, TapeRecord};
use echosplat_recording::mcap::{Record, RecordingReader};

use super::begin::{Begin, position_of};
use crate::decided::Decided;
use crate::exit::Usage;

/// The records of a dive from its recordings, a driver's or a mapper's, in their order.
pub(crate) struct Resumed {
    reader: RecordingReader<'static>,
    begin: Begin,
    /// What a mapper decided under its load; nothing in a driver's.
    decided: Decided,
    /// The driver, and the number of the record that comes next.
    position: Option<(u64, u64)>,
    losses: Vec<String>,
}

impl Resumed {
    /// Reads all events first: what was decided of a ping is recorded after it. `None` without files.
    ///
    /// # Errors
    /// Says which file is no recording of a driver or a mapper.
    pub(crate) fn open(paths: &[PathBuf]) -> anyhow::Result<Option<Self>> {
        let Some(first) = paths.first() else {
            return Ok(None);
        };
        let refused = |why: &dyn std::fmt::Display| Usage::error(format!("--resume: {why}"));
        let mut looking = RecordingReader::open(paths).map_err(|error| refused(&error))?;
        let (mut begin, mut is_of_tape) = (None, false);
        let mut decided = Decided::default();
        while let Some(recorded) = looking.next_message().map_err(|error| refused(&error))? {
            if let Record::Event(event) = &recorded.record {
                begin = begin.or_else(|| Begin::read(event));
                is_of_tape |= position_of(event).is_some();
                decided.take(event);
            }
        }
        // The driver goes on where the last one ends.
        let losses = looking.losses(true);
        let reader = RecordingReader::open(paths).map_err(|error| refused(&error))?;
        match begin.filter(|_| is_of_tape) {
            Some(begin) => Ok(Some(Self {
                reader,
                begin,
                decided,
                position: None,
                losses,
            })),
            None => Err(refused(&format!(
                "{} is no recording made with --role driver or --role mapper; `echosplat replay` \
                 maps any other",
                first.display()
            ))),
        }
    }

    pub(crate) fn begin(&self) -> &Begin {
        &self.begin
    }

    /// What the recordings lack or hold that is not of the dive, a sentence each.
    pub(crate) fn losses(&self) -> Vec<String> {
        self.losses.clone()
    }

    /// To be obeyed again while its pings come.
    pub(crate) fn take_decided(&mut self) -> Decided {
        std::mem::take(&mut self.decided)
    }

    /// What the driver is to be asked for next, once all is read.
    pub(crate) fn position(&self) -> Option<(u64, u64)> {
        self.position
    }

    /// The next record, `None` at the end.
    ///
    /// # Errors
    /// In words, if a file cannot be read further.
    pub(crate) fn next_record(&mut self) -> Result<Option<TapeRecord>, String> {
        loop {
            let next = self.reader.next_message();
            let Some(recorded) = next.map_err(|error| error.to_string())? else {
                return Ok(None);
            };
            let entry = match recorded.record {
                Record::LinkUp => TapeEntry::LinkUp,
                Record::LinkDown => TapeEntry::LinkDown,
                Record::HalfFrameExpired => TapeEntry::HalfFrameExpired,
                Record::Raw(bytes) => TapeEntry::Bytes(bytes),
                Record::Pose(pose) => TapeEntry::Pose(pose),
                Record::Event(event) => {
                    self.position = position_of(&event).or(self.position);
                    continue;
                }
                _ => continue,
            };
            if let Some((_, next)) = &mut self.position {
                *next += 1;
            }
            return Ok(Some(TapeRecord {
                host_time: recorded.host_time,
                entry,
            }));
        }
    }
}
