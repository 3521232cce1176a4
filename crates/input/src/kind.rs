//! What a path leads to, without opening it: a named pipe that nobody writes to would be waited for.

use std::fs::{FileType, Metadata};
use std::path::Path;

/// What is done with a file, and what may be given in its place.
#[derive(Clone, Copy)]
pub(crate) struct Use(&'static str, &'static str);

pub(crate) const READ_ONCE: Use = Use("read as a file", "a regular file or a pipe");
pub(crate) const READ: Use = Use("read as a file", "a regular file");
const REPLACED: Use = Use("written over", "a regular file");

/// Says why what is at `path` cannot be read as a file, if so.
///
/// # Errors
/// What it is, or that there is nothing.
pub fn readable(path: &Path) -> Result<(), String> {
    let metadata = std::fs::metadata(path).map_err(|error| error.to_string())?;
    regular(&metadata, READ)
}

/// Says why no file can take the place of what is at `path`, if so.
///
/// # Errors
/// What it is.
pub fn replaceable(path: &Path) -> Result<(), String> {
    match std::fs::metadata(path) {
        Ok(metadata) => regular(&metadata, REPLACED),
        Err(_) => Ok(()),
    }
}

pub(crate) fn regular(metadata: &Metadata, Use(used, wanted): Use) -> Result<(), String> {
    match metadata.is_file() {
        true => Ok(()),
        false => Err(format!(
            "it is {} and cannot be {used}; give {wanted}",
            kind(metadata.file_type())
        )),
    }
}

/// The one device whose end is known.
pub(crate) fn is_null_device(path: &Path) -> bool {
    path.canonicalize()
        .is_ok_and(|path| path == Path::new("/dev/null"))
}

#[cfg(unix)]
pub(crate) fn is_pipe(metadata: &Metadata) -> bool {
    std::os::unix::fs::FileTypeExt::is_fifo(&metadata.file_type())
}

#[cfg(not(unix))]
pub(crate) fn is_pipe(_: &Metadata) -> bool {
    false
}

fn kind(found: FileType) -> &'static str {
    if found.is_dir() {
        return "a directory";
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if found.is_fifo() {
            return "a named pipe";
        }
        if found.is_socket() {
            return "a socket";
        }
        if found.is_char_device() || found.is_block_device() {
            return "a device";
        }
    }
    "no regular file"
}
