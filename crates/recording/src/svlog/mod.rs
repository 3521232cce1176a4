//! The vendor's `.svlog`: frames one after another, no file header.
//!
//! The first packet of a session is the JSON wrapper (id 10, source 0, destination 255) with the
//! session's `timestamp`; another one in mid-file starts a new session. The tail is often cut, and
//! file order need not be time order: the reader hands over bytes as they are, in bounded pieces.

mod header;
mod live;
mod reader;
mod session_clock;
mod writer;

pub use header::{HeaderError, SessionDevice, SessionHeader};
pub use live::{LiveSvlog, LogClock};
pub use reader::{SvlogReader, Tail};
pub use writer::SvlogWriter;

/// Why a log could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum SvlogError {
    /// No bytes at all.
    #[error("the file is empty; expected a .svlog")]
    Empty,
    /// Printable text.
    #[error("a text file, starting with `{found}`; expected a .svlog of binary Ping frames")]
    Text {
        /// The first characters.
        found: String,
    },
    /// An MCAP recording.
    #[error("an MCAP file; expected a .svlog")]
    Mcap,
    /// Nothing that can be told.
    #[error(
        "no intact Ping frame in the first {searched_byte_count} bytes (starting with {found}); expected a .svlog"
    )]
    NoFrame {
        /// How far was looked.
        searched_byte_count: usize,
        /// The first bytes in hex.
        found: String,
    },
    /// Bytes given to the writer that are no frame.
    #[error("not written: {0}")]
    NotAFrame(echosplat_firmware_protocol::FrameError),
    /// The session's header does not fit a frame.
    #[error("session header: {0}")]
    Header(#[from] HeaderError),
    /// The file could not be read or written.
    #[error("log: {0}")]
    Io(#[from] std::io::Error),
}

#[cfg(test)]
mod tests;
