//! What a file is, by its first bytes, and where those are damaged by what follows.

use std::io::Read;
use std::path::Path;

use echosplat_recording::foreign;
use echosplat_recording::mcap::Messages;

use crate::exit::Usage;

/// Enough to tell.
const LOOKED_AT_BYTES: u64 = 512;

/// What a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Recording,
    Log,
    Trajectory,
    Map,
}

impl Kind {
    /// # Errors
    /// If it cannot be read, is empty, or is no regular file: a fifo would be waited for for ever.
    pub(crate) fn of(file: &Path) -> anyhow::Result<Self> {
        let refused =
            |why: &dyn std::fmt::Display| Usage::error(format!("{}: {why}", file.display()));
        let opened = echosplat_input::open_file(file).map_err(|error| refused(&error))?;
        let mut start = Vec::new();
        let read = opened.take(LOOKED_AT_BYTES).read_to_end(&mut start);
        read.map_err(|error| refused(&error))?;
        if let Some(what) = foreign::named(&start, file) {
            return Err(refused(&what));
        }
        match Self::of_bytes(&start) {
            // The first bytes of a recording may be damaged, or all that stood at its head.
            Some(Self::Log) if Messages::open(file).is_ok() => Ok(Self::Recording),
            Some(kind) => Ok(kind),
            None => Err(refused(&"the file is empty")),
        }
    }

    /// The ending that such a file has.
    pub(crate) fn ending(self) -> &'static str {
        match self {
            Self::Recording => "mcap",
            Self::Log => "svlog",
            Self::Trajectory => "tum",
            Self::Map => "ply",
        }
    }

    fn of_bytes(start: &[u8]) -> Option<Self> {
        let is_text = |byte: &u8| byte.is_ascii_graphic() || b" \t\r\n".contains(byte);
        let text = start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(start);
        match start {
            [] => None,
            [0x89, b'M', b'C', b'A', b'P', ..] => Some(Self::Recording),
            [b'p', b'l', b'y', b'\n' | b'\r', ..] => Some(Self::Map),
            _ if text.iter().all(is_text) => Some(Self::Trajectory),
            _ => Some(Self::Log),
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Recording => "recording (mcap)",
            Self::Log => "log (svlog)",
            Self::Trajectory => "trajectory (tum)",
            Self::Map => "map (ply)",
        }
    }
}
