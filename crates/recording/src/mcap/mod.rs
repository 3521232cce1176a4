//! The recording of a dive: an MCAP file of raw received bytes with host time, link news, poses,
//! settings, events, status and map deltas.
//!
//! | channel | message | what |
//! |---|---|---|
//! | `/sonar/raw` | CDR `echosplat_msgs/msg/ReceivedBytes` | bytes before decoding |
//! | `/sonar/link` | JSON | link up, down, half a frame given up |
//! | `/pose` | CDR `nav_msgs/msg/Odometry` | as it came; MCAP's sequence is its epoch |
//! | `/settings` | JSON `{"toml": …}` | the configuration in force |
//! | `/events`, `/status` | JSON | |
//! | `/map/delta` | CDR `sensor_msgs/msg/PointCloud2` | as published |
//! | `/map/delta_info` | JSON | of the delta before |
//! | `/tf_static` | CDR `tf2_msgs/msg/TFMessage` | |
//!
//! Each has a schema, so that other programs read it. Every message is handed to the operating system
//! whole before the call returns, so that a killed process loses nothing. The caller's timer says
//! when to sync to disk. A cut or damaged file is read up to the cut and around the damage.
//!
//! Messages stand in chunks with indexes, which other programs need to find them. Chunks are not
//! compressed. The last one of a file that was cut does not say how long it is: `recover` makes a
//! file that does.
//!
//! A finished one may be compressed, sorted or filtered by any MCAP tool: chunks
//! are read, stored as they are or by zstd or lz4. Of a chunk that is cut or damaged what stands
//! before that is read.
//!
//! Deliberately absent: threads and clocks.

mod channel;
mod chunk;
mod cutter;
mod ends;
mod files;
mod held;
mod joining;
mod message;
mod messages;
mod part;
mod reader;
mod scan;
mod topic;
mod writer;

use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use echosplat_model::{StampedPose, Timestamp};

pub use channel::Channel;
pub use messages::{Condition, Message, Messages, WrittenBy};
pub use part::Part;
pub use reader::{Ending, RecordingReader};
pub use scan::{Counts, Recording, Scan};
pub use writer::{MAX_MESSAGE_BYTES, Profile, RecordingFile, RecordingWriter};

/// Written into every recording; by it a reader knows the fixed channel ids.
const LIBRARY: &str = "echosplat recording 3";
/// Name of the profile of recordings for programs of ROS.
const ROS2: &str = "ros2";

/// Bytes of a file, or from somewhere else.
type Source<'a> = Box<dyn std::io::Read + Send + 'a>;

/// What is recorded, in the order it came.
#[derive(Debug, Clone, PartialEq)]
pub enum Record {
    /// The link to the sonar is up: bytes follow.
    LinkUp,
    /// The link is gone, and with it half a frame if one had begun.
    LinkDown,
    /// The rest of a frame did not come in time: the next byte begins another.
    HalfFrameExpired,
    /// Bytes as received, before anything looks into them.
    Raw(Bytes),
    /// A pose as it came from its source.
    Pose(StampedPose),
    /// The configuration in force, as TOML.
    Settings(String),
    /// What happened, a JSON object.
    Event(serde_json::Value),
    /// The service's status, a JSON object.
    Status(serde_json::Value),
    /// A change of the map as published.
    Delta {
        /// CDR `sensor_msgs/msg/PointCloud2`.
        cloud: Arc<[u8]>,
        /// Its attachment, a JSON object.
        info: Arc<[u8]>,
    },
    /// CDR `tf2_msgs/msg/TFMessage`.
    StaticTransform(Arc<[u8]>),
}

/// One record and when the host had it.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// Host time; never before 1970.
    pub host_time: Timestamp,
    /// What it was.
    pub record: Record,
}

/// Why a recording could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// Something else than MCAP.
    #[error("not a recording: starts with {found}, expected an MCAP file")]
    NotMcap {
        /// The first bytes, printable or in hex.
        found: String,
    },
    /// More than is taken into memory at once.
    #[error(
        "a chunk of {found} bytes, at most {} are read; `mcap compress` writes the file anew in chunks of 4 MB",
        chunk::MAX_CHUNK_BYTES
    )]
    ChunkTooLong {
        /// Its length.
        found: u64,
    },
    /// A message no reader would take back.
    #[error(
        "message of {found} bytes on {topic}, at most {MAX_MESSAGE_BYTES} are recorded at once"
    )]
    TooLong {
        /// Where it was to go.
        topic: &'static str,
        /// Its length.
        found: usize,
    },
    /// Another program has put its messages in an order that no dive had, and not by their topics.
    #[error(
        "its messages do not stand in the order of their times; `mcap sort IN.mcap -o OUT.mcap` puts them so"
    )]
    OutOfOrder,
    /// Of a version that is not known here.
    #[error(transparent)]
    Newer(echosplat_ply::Newer),
    /// A folder, a fifo or a device.
    #[error("not a regular file")]
    NotAFile,
    /// One of several files, and what is wrong with it.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What.
        source: Box<RecordingError>,
    },
    /// The operating system failed, for example because the disk is full.
    #[error("recording: {0}")]
    Io(#[from] std::io::Error),
    /// The MCAP library failed.
    #[error("recording: {0}")]
    Mcap(::mcap::McapError),
}

impl From<::mcap::McapError> for RecordingError {
    fn from(error: ::mcap::McapError) -> Self {
        match error {
            ::mcap::McapError::Io(error) => Self::Io(error),
            other => Self::Mcap(other),
        }
    }
}

impl RecordingError {
    /// What the operating system said, if it was that.
    #[must_use]
    pub fn io_kind(&self) -> Option<std::io::ErrorKind> {
        match self {
            Self::Io(error) => Some(error.kind()),
            Self::File { source, .. } => source.io_kind(),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests;
