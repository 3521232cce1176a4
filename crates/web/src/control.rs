//! What the page can have done; the service does it.

use std::fs::File;
use std::io::{self, Write};

use echosplat_model::Snapshot;
use serde::Serialize;
use serde_json::Value;

/// Half of a map that is downloaded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapPart {
    /// What it asserts.
    Confident,
    /// What it cannot tell apart.
    Ambiguous,
}

/// One recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LogFile {
    /// Without a folder.
    pub name: String,
    /// So far.
    pub bytes: u64,
    /// Seconds since 1970, of the last change.
    pub modified_s: u64,
}

/// What is done for the page, on threads that may wait. Requests come one at a time.
pub trait Control: Send + Sync + 'static {
    /// Writes one half of `map` as PLY.
    ///
    /// # Errors
    /// Of the writer.
    fn write_map(&self, map: &Snapshot, part: MapPart, to: &mut dyn Write) -> io::Result<()>;

    /// A size in `map`, asked for by the query of an address: an object with `name`, `lines` for people, `facts` as the
    /// command `measure` prints them, and `shape_m`, its places.
    ///
    /// # Errors
    /// A sentence for whoever asked.
    fn measure(&self, map: &Snapshot, query: &str) -> Result<Value, String>;

    /// Whether a recording goes on.
    fn is_recording(&self) -> bool;

    /// Begins one.
    ///
    /// # Errors
    /// A sentence for whoever asked.
    fn start_recording(&self) -> Result<(), String>;

    /// Ends it.
    ///
    /// # Errors
    /// A sentence for whoever asked.
    fn stop_recording(&self) -> Result<(), String>;

    /// Holds what is replayed between two pings, or lets it go on.
    ///
    /// # Errors
    /// A sentence for whoever asked; where a sonar is listened to, nothing can be held.
    fn hold_replay(&self, is_held: bool) -> Result<(), String>;

    /// The recordings there are, newest first.
    fn logs(&self) -> Vec<LogFile>;

    /// One of [`Control::logs`] by its name; `None` for any other name.
    fn open_log(&self, name: &str) -> Option<io::Result<File>>;
}
