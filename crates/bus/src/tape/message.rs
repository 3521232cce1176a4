//! The records of a tape as bytes, and what stands beside them in an answer.

use bytes::Bytes;
use echosplat_model::{Pose, PoseCovariance, StampedPose, Timestamp};
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Longest attachment that is read.
const MAX_HEAD_BYTES: usize = 64 * 1024;
/// A quaternion's length may be off 1 by so much, as in poses of other programs.
const LENGTH_TOLERANCE: f64 = 0.01;

const LINK_UP: u8 = 1;
const LINK_DOWN: u8 = 2;
const HALF_FRAME_EXPIRED: u8 = 3;
const BYTES: u8 = 4;
const POSE: u8 = 5;
const END: u8 = 6;
const POSE_WITH_COVARIANCE: u8 = 7;

/// What the driver heard, and when, by its clock (Unix time).
#[derive(Debug, Clone, PartialEq)]
pub struct TapeRecord {
    /// When it came.
    pub host_time: Timestamp,
    /// What came.
    pub entry: TapeEntry,
}

/// What a driver hears.
#[derive(Debug, Clone, PartialEq)]
pub enum TapeEntry {
    /// The link to the sonar is there.
    LinkUp,
    /// It is gone, and with it what was half received.
    LinkDown,
    /// The rest of a half frame did not come; it is given up.
    HalfFrameExpired,
    /// Bytes of the sonar as they came, before they are decoded.
    Bytes(Bytes),
    /// A pose, stamped on the pings' clock.
    Pose(StampedPose),
    /// The driver ended in order: nothing follows.
    End,
}

/// Version of the answers, records included, that are given and read here.
const VERSION: u32 = 1;

/// What stands beside the records of an answer, as JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Head {
    /// Of the answer; 1 if nothing is said.
    #[serde(default = "version")]
    version: u32,
    /// Names the driver's run: its start in nanoseconds.
    pub(crate) driver: u64,
    /// Number of the first record in the answer, or of the next one if it holds none.
    pub(crate) first: u64,
    /// How many records it holds.
    pub(crate) count: u64,
    /// Number that the driver gives next.
    pub(crate) next: u64,
    /// How the sonar is asked and understood; to those who do not know this driver.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) begin: Option<Value>,
}

/// Why an answer cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TapeMessageError {
    /// Nothing stands beside the records.
    #[error("it has no attachment; a driver's answer has one, a JSON object")]
    NoHead,
    /// The attachment.
    #[error("its attachment is no JSON object with driver, first, count and next: {0}")]
    Head(String),
    /// Of a driver of another version.
    #[error("it is of version {0} of the tape; this program reads version {VERSION}")]
    Version(u32),
    /// Numbers that contradict one another.
    #[error("its attachment contradicts itself: {0}")]
    Numbers(&'static str),
    /// The driver that is followed has lost records that it had.
    #[error("it ends before record {expected}, which comes next: the tape went back to {found}")]
    Back {
        /// What was asked for.
        expected: u64,
        /// What comes after the answer.
        found: u64,
    },
    /// A driver that is met, and does not say how the sonar is asked.
    #[error("it is of a driver that is new here, and without `begin`")]
    NoBegin,
    /// It ends within a record.
    #[error("it ends within record {0}")]
    Cut(u64),
    /// A kind of record that there is not.
    #[error("record {number} is of kind {kind}; there are 1 to 7")]
    Kind {
        /// Of the record in the answer, from 0.
        number: u64,
        /// What it says.
        kind: u8,
    },
    /// A pose that cannot be.
    #[error("record {0} is a pose with a number that is not finite, or no rotation")]
    Pose(u64),
    /// More than the records that it says.
    #[error("{0} bytes follow its last record")]
    Rest(usize),
}

/// The record as it goes out, all numbers little-endian.
pub(crate) fn encode(record: &TapeRecord) -> Vec<u8> {
    let (kind, bytes) = match &record.entry {
        TapeEntry::LinkUp => (LINK_UP, 0),
        TapeEntry::LinkDown => (LINK_DOWN, 0),
        TapeEntry::HalfFrameExpired => (HALF_FRAME_EXPIRED, 0),
        TapeEntry::Bytes(bytes) => (BYTES, 4 + bytes.len()),
        TapeEntry::Pose(pose) => match pose.uncertainty {
            None => (POSE, 85),
            Some(_) => (POSE_WITH_COVARIANCE, 140),
        },
        TapeEntry::End => (END, 0),
    };
    let mut out = Vec::with_capacity(9 + bytes);
    out.push(kind);
    out.extend(record.host_time.nanos().to_le_bytes());
    match &record.entry {
        TapeEntry::Bytes(bytes) => {
            out.extend((bytes.len() as u32).to_le_bytes());
            out.extend_from_slice(bytes);
        }
        TapeEntry::Pose(pose) => encode_pose(pose, &mut out),
        _ => {}
    }
    out
}

fn encode_pose(pose: &StampedPose, out: &mut Vec<u8>) {
    out.extend(pose.time.nanos().to_le_bytes());
    let Pose {
        rotation,
        translation_m,
    } = pose.world_from_vehicle;
    let numbers = translation_m.to_array().into_iter();
    for number in numbers.chain(rotation.to_array()) {
        out.extend(number.to_le_bytes());
    }
    match &pose.uncertainty {
        Some(covariance) => {
            let numbers = covariance.position_m2.into_iter();
            for number in numbers.chain(covariance.attitude_rad2) {
                out.extend(number.to_le_bytes());
            }
        }
        // Where sigmas could stand.
        None => out.extend([0; 1 + 2 * 8]),
    }
    out.extend(pose.epoch.to_le_bytes());
}

/// # Errors
/// If it is too long, or not what [`Head`] says.
pub(crate) fn decode_head(attachment: &[u8]) -> Result<Head, TapeMessageError> {
    if attachment.is_empty() {
        return Err(TapeMessageError::NoHead);
    }
    if attachment.len() > MAX_HEAD_BYTES {
        let words = format!("{} bytes; at most {MAX_HEAD_BYTES}", attachment.len());
        return Err(TapeMessageError::Head(words));
    }
    let head: Head = serde_json::from_slice(attachment)
        .map_err(|error| TapeMessageError::Head(error.to_string()))?;
    if head.version != VERSION {
        return Err(TapeMessageError::Version(head.version));
    }
    let Some(after) = head.first.checked_add(head.count) else {
        return Err(TapeMessageError::Numbers("first and count are too large"));
    };
    match head.next >= after {
        true => Ok(head),
        false => Err(TapeMessageError::Numbers(
            "next lies before the last of its records",
        )),
    }
}

fn version() -> u32 {
    VERSION
}

impl Head {
    /// Of an answer of this version.
    pub(crate) fn new(
        driver: u64,
        (first, count): (u64, u64),
        next: u64,
        begin: Option<Value>,
    ) -> Self {
        Self {
            version: VERSION,
            driver,
            first,
            count,
            next,
            begin,
        }
    }

    /// Number of the record after the last one here.
    pub(crate) fn after(&self) -> u64 {
        self.first.saturating_add(self.count)
    }
}

/// The `count` records that the payload holds.
///
/// # Errors
/// Names the record that is wrong.
pub(crate) fn decode(payload: &Bytes, count: u64) -> Result<Vec<TapeRecord>, TapeMessageError> {
    let mut cursor = Cursor {
        payload,
        at: 0,
        number: 0,
    };
    let mut records = Vec::new();
    while cursor.number < count {
        records.push(cursor.record()?);
        cursor.number += 1;
    }
    match payload.len() - cursor.at {
        0 => Ok(records),
        rest => Err(TapeMessageError::Rest(rest)),
    }
}

struct Cursor<'a> {
    payload: &'a Bytes,
    at: usize,
    number: u64,
}

impl Cursor<'_> {
    fn record(&mut self) -> Result<TapeRecord, TapeMessageError> {
        let kind = self.take(1)?[0];
        let host_time = Timestamp::from_nanos(self.i64()?);
        let entry = match kind {
            LINK_UP => TapeEntry::LinkUp,
            LINK_DOWN => TapeEntry::LinkDown,
            HALF_FRAME_EXPIRED => TapeEntry::HalfFrameExpired,
            BYTES => {
                let count = u32::from_le_bytes(self.array()?) as usize;
                TapeEntry::Bytes(self.take(count)?)
            }
            POSE | POSE_WITH_COVARIANCE => TapeEntry::Pose(self.pose(kind)?),
            END => TapeEntry::End,
            kind => {
                let number = self.number;
                return Err(TapeMessageError::Kind { number, kind });
            }
        };
        Ok(TapeRecord { host_time, entry })
    }

    /// The bits as they were sent: nothing is normalised anew.
    fn pose(&mut self, kind: u8) -> Result<StampedPose, TapeMessageError> {
        let time = Timestamp::from_nanos(self.i64()?);
        let translation_m = DVec3::new(self.f64()?, self.f64()?, self.f64()?);
        let rotation = DQuat::from_xyzw(self.f64()?, self.f64()?, self.f64()?, self.f64()?);
        let uncertainty = match kind {
            POSE_WITH_COVARIANCE => Some(self.covariance()?),
            _ => self.sigmas()?,
        };
        let epoch = u32::from_le_bytes(self.array()?);
        let fits = translation_m.is_finite() && (rotation.length() - 1.0).abs() <= LENGTH_TOLERANCE;
        match fits {
            true => Ok(StampedPose {
                time,
                world_from_vehicle: Pose {
                    rotation,
                    translation_m,
                },
                uncertainty,
                epoch,
            }),
            false => Err(TapeMessageError::Pose(self.number)),
        }
    }

    /// One sigma of position and attitude, as drivers of earlier versions told them.
    fn sigmas(&mut self) -> Result<Option<PoseCovariance>, TapeMessageError> {
        let is_known = self.take(1)?[0] != 0;
        let (position_m, attitude_rad) = (self.f64()?, self.f64()?);
        Ok(is_known.then(|| PoseCovariance::alike(position_m, attitude_rad)))
    }

    fn covariance(&mut self) -> Result<PoseCovariance, TapeMessageError> {
        let mut numbers = [0.0; 9];
        for number in &mut numbers {
            *number = self.f64()?;
        }
        let [xx, xy, xz, yy, yz, zz, roll, pitch, yaw] = numbers;
        Ok(PoseCovariance {
            position_m2: [xx, xy, xz, yy, yz, zz],
            attitude_rad2: [roll, pitch, yaw],
        })
    }

    fn i64(&mut self) -> Result<i64, TapeMessageError> {
        self.array().map(i64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, TapeMessageError> {
        self.array().map(f64::from_le_bytes)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], TapeMessageError> {
        let cut = TapeMessageError::Cut(self.number);
        self.take(N)?[..].try_into().map_err(|_| cut)
    }

    fn take(&mut self, count: usize) -> Result<Bytes, TapeMessageError> {
        let end = self.at.checked_add(count);
        let end = end.filter(|&end| end <= self.payload.len());
        let end = end.ok_or(TapeMessageError::Cut(self.number))?;
        let taken = self.payload.slice(self.at..end);
        self.at = end;
        Ok(taken)
    }
}
