//! What a recording holds beside its raw bytes, found in one pass.

use std::path::Path;

use echosplat_model::{StampedPose, Timestamp};
use serde_json::Value;

use super::part::{Part, losses};
use super::{Ending, Record, Recorded, RecordingError, RecordingReader};

/// The files of a dive.
#[derive(Debug)]
pub struct Recording;

/// What a recording holds, raw bytes and deltas only counted.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scan {
    /// The configuration the dive was mapped with, as TOML: the first one recorded.
    pub settings: Option<String>,
    /// Poses as they came, each with when it came (host time).
    pub poses: Vec<(StampedPose, Timestamp)>,
    /// Events with their host time.
    pub events: Vec<(Timestamp, Value)>,
    /// The last status.
    pub last_status: Option<Value>,
    /// Least and greatest host time.
    pub span: Option<(Timestamp, Timestamp)>,
    /// How many records of each kind.
    pub counts: Counts,
    /// Bytes that made no record.
    pub damaged_byte_count: u64,
    /// Records whose content was damaged.
    pub undecodable_count: u64,
    /// A file ends in the middle.
    pub is_cut: bool,
    /// What each file gave and lacks, or each of several recordings in a file.
    pub parts: Vec<Part>,
}

/// How many records of each kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Pieces of raw bytes.
    pub raw: u64,
    /// Bytes in them.
    pub raw_bytes: u64,
    /// Times the link came up.
    pub link_ups: u64,
    /// Times it was lost.
    pub link_downs: u64,
    /// Half frames given up.
    pub half_frames_expired: u64,
    /// Poses.
    pub poses: u64,
    /// Events.
    pub events: u64,
    /// Statuses.
    pub statuses: u64,
    /// Changes of the map.
    pub deltas: u64,
}

impl Recording {
    /// Reads the files of one dive, given in order, once.
    ///
    /// # Errors
    /// Names the file that is no recording or cannot be read.
    pub fn scan<P: AsRef<Path>>(paths: &[P]) -> Result<Scan, RecordingError> {
        Self::scan_of(RecordingReader::open(paths)?)
    }

    /// The same of a reader that was not read from yet.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn scan_of(mut reader: RecordingReader<'_>) -> Result<Scan, RecordingError> {
        let mut scan = Scan::default();
        while let Some(recorded) = reader.next_message()? {
            scan.take(recorded);
        }
        scan.damaged_byte_count = reader.damaged_byte_count();
        scan.undecodable_count = reader.undecodable_count();
        scan.is_cut = reader.ending() == Some(Ending::Cut);
        scan.parts = reader.parts().to_vec();
        Ok(scan)
    }
}

impl Scan {
    /// What was lost or wrong, a sentence each. `goes_on` if somebody else gives what comes after the
    /// end.
    #[must_use]
    pub fn losses(&self, goes_on: bool) -> Vec<String> {
        losses(&self.parts, goes_on)
    }

    fn take(&mut self, recorded: Recorded) {
        let time = recorded.host_time;
        let (first, last) = self.span.unwrap_or((time, time));
        self.span = Some((first.min(time), last.max(time)));
        let counts = &mut self.counts;
        match recorded.record {
            Record::LinkUp => counts.link_ups += 1,
            Record::LinkDown => counts.link_downs += 1,
            Record::HalfFrameExpired => counts.half_frames_expired += 1,
            Record::Raw(bytes) => {
                counts.raw += 1;
                counts.raw_bytes += bytes.len() as u64;
            }
            Record::Pose(pose) => {
                counts.poses += 1;
                self.poses.push((pose, time));
            }
            Record::Settings(toml) => {
                self.settings.get_or_insert(toml);
            }
            Record::Event(event) => {
                counts.events += 1;
                self.events.push((time, event));
            }
            Record::Status(status) => {
                counts.statuses += 1;
                self.last_status = Some(status);
            }
            Record::Delta { .. } => counts.deltas += 1,
            Record::StaticTransform(_) => {}
        }
    }
}
