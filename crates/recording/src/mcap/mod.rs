//! The recording of a dive: an MCAP file of raw received bytes with host time, poses, settings,
//! events and map deltas.
//!
//! Unchunked, and every message handed to the operating system whole before the call returns, so
//! that a killed process loses nothing. The caller's timer says when to sync to disk. A cut or
//! damaged file is read up to the cut and around the damage.
//!
//! Deliberately absent: compression and chunks (write-through is the point; a finished file may be
//! compressed by any MCAP tool), threads and clocks.

mod pose;
mod reader;
mod records;
mod writer;

pub use reader::{Recorded, RecordedItem, RecordingReader};
pub use records::Ending;
pub use writer::{MAX_MESSAGE_BYTES, RecordingFile, RecordingWriter};

/// Written into every recording; by it a reader knows the fixed channel ids.
const LIBRARY: &str = "echosplat recording 1";

/// Why a recording could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// Something else than MCAP.
    #[error("not a recording: starts with {found}, expected an MCAP file")]
    NotMcap {
        /// The first bytes, printable or in hex.
        found: String,
    },
    /// MCAP as other programs write it.
    #[error(
        "written in chunks, which recordings never are; convert it with `mcap convert --chunked=false`"
    )]
    Chunked,
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
    /// The operating system failed, for example because the disk is full.
    #[error("recording: {0}")]
    Io(#[from] std::io::Error),
    /// The MCAP library failed.
    #[error("recording: {0}")]
    Mcap(#[from] ::mcap::McapError),
}

/// What a recording keeps apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Topic {
    /// Bytes as received from the sonar, before decoding.
    Raw,
    /// Poses as JSON.
    Pose,
    /// The configuration in force, as text.
    Settings,
    /// What happened (shedding, drops, links), as JSON or text.
    Event,
    /// Map deltas as published.
    Delta,
}

impl Topic {
    const ALL: [Self; 5] = [
        Self::Raw,
        Self::Pose,
        Self::Settings,
        Self::Event,
        Self::Delta,
    ];

    /// Its name in the file.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Raw => "sonar/raw",
            Self::Pose => "pose",
            Self::Settings => "settings",
            Self::Event => "event",
            Self::Delta => "map/delta",
        }
    }

    fn encoding(self) -> &'static str {
        match self {
            Self::Raw => "ping-protocol",
            Self::Pose | Self::Event => "json",
            Self::Settings => "toml",
            Self::Delta => "cdr",
        }
    }

    /// Fixed, so that a message can be told even if its channel's record is damaged.
    fn channel_id(self) -> u16 {
        self as u16 + 1
    }

    fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }
}

#[cfg(test)]
mod tests;
