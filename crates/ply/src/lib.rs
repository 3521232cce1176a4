//! PLY: text, little-endian and big-endian, any scalar and list types, read; little-endian written.
//!
//! A [`Reader`] takes rows one at a time. What a file says of its own size is never believed: memory
//! grows with the bytes that came, and a header, a list and a word have most bytes that are taken.
//!
//! A header whose comments say a version of this program's formats that is not known here is refused.
//!
//! Deliberately absent: what elements and properties mean, and files.

mod header;
mod reader;
mod values;
mod version;
mod writer;

use std::io;

pub use header::{Element, Format, Header, Kind, Property, Scalar};
pub use reader::{Reader, Row};
pub use version::{Newer, Written, refuse_newer, version_of};
pub use writer::{write_floats, write_list};

/// Why a PLY was refused.
#[derive(Debug, thiserror::Error)]
pub enum PlyError {
    /// No bytes at all.
    #[error("the file is empty")]
    Empty,
    /// Something else than PLY.
    #[error("not a PLY: starts with `{found}`, expected `ply`")]
    NotPly {
        /// The first characters.
        found: String,
    },
    /// The header says something that cannot be.
    #[error("header: {0}")]
    Header(String),
    /// Of a version that is not known here.
    #[error(transparent)]
    Newer(#[from] Newer),
    /// Fewer rows than the header says.
    #[error("cut off: the header says {expected} of element `{element}`, {found} are there")]
    Cut {
        /// Its name.
        element: String,
        /// By the header.
        expected: u64,
        /// Whole rows present.
        found: u64,
    },
    /// A row that cannot be read.
    #[error("element `{element}`, row {row}: {what}")]
    Row {
        /// Its name.
        element: String,
        /// Counted from 0.
        row: u64,
        /// What cannot be.
        what: String,
    },
    /// The file could not be read.
    #[error("reading: {0}")]
    Io(#[from] io::Error),
}

/// At most 40 characters, none of which a terminal obeys.
fn shown(text: &str) -> String {
    text.chars().take(40).filter(|c| !c.is_control()).collect()
}

#[cfg(test)]
mod tests;
