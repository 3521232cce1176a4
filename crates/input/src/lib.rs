//! Files that come from outside, opened: the one door for all that is named on the command line or in a
//! configuration.
//!
//! A regular file is opened. A pipe, as `/dev/stdin` and `<(…)` of a shell are, is read by a thread of
//! its own, so that whoever waits for it can be told to end. Nothing else is read: opening a device can
//! have effects, and reading one need never end. It deliberately lacks signals, and what files hold.

mod kind;
mod pipe;

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

pub use kind::{readable, replaceable};
use pipe::Pipe;
pub use pipe::{end_waiting, was_ended};

/// A file that is read once, from its beginning to its end.
#[derive(Debug)]
pub enum Input {
    /// A regular file.
    File(File),
    /// A pipe; a read of it fails once [`end_waiting`] was called.
    Pipe(Pipe),
}

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.read(buffer),
            Self::Pipe(pipe) => pipe.read(buffer),
        }
    }
}

/// Opens what is read once: a regular file, a pipe, or `/dev/null` as a file of nothing. Never waits.
///
/// # Errors
/// Of the file system; or says what the path leads to instead, and what to give.
pub fn open(path: &Path) -> io::Result<Input> {
    let metadata = std::fs::metadata(path)?;
    if kind::is_pipe(&metadata) {
        return Pipe::open(path, &metadata).map(Input::Pipe);
    }
    if !kind::is_null_device(path) {
        kind::regular(&metadata, kind::READ_ONCE).map_err(io::Error::other)?;
    }
    File::open(path).map(Input::File)
}

/// Opens what is read more than once, or with files beside it: a regular file. Never waits.
///
/// # Errors
/// Of the file system; or says what the path leads to instead, and what to give.
pub fn open_file(path: &Path) -> io::Result<File> {
    let metadata = std::fs::metadata(path)?;
    kind::regular(&metadata, kind::READ).map_err(io::Error::other)?;
    File::open(path)
}

/// All that [`open`] gives, if that is no more than `most_bytes`.
///
/// # Errors
/// As [`open`], and if there is more.
pub fn read(path: &Path, most_bytes: u64) -> io::Result<Vec<u8>> {
    all_of(open(path)?, most_bytes)
}

/// All that [`open_file`] gives, if that is no more than `most_bytes`.
///
/// # Errors
/// As [`open_file`], and if there is more.
pub fn read_file(path: &Path, most_bytes: u64) -> io::Result<Vec<u8>> {
    all_of(open_file(path)?, most_bytes)
}

fn all_of(input: impl Read, most_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    // One byte more tells a file of just that size from a longer one.
    input.take(most_bytes + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most_bytes {
        let message = format!("longer than the {most_bytes} bytes allowed");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}
