//! A pseudo-terminal that any serial program can open.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// The device's end, and what keeps the client's end in place.
pub(super) struct Pty {
    /// Of the client's end.
    pub(super) path: PathBuf,
    /// Held open, so that a client that closes is no end of file and none that comes is the first.
    _client_end: OwnedFd,
    /// Removed when the server ends.
    link: Option<PathBuf>,
}

/// A new pseudo-terminal in raw mode, linked to at `link`. The stream never waits.
pub(super) fn open(link: Option<&Path>) -> io::Result<(File, Pty)> {
    let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
    let device_end = openpt(flags)?;
    grantpt(&device_end)?;
    unlockpt(&device_end)?;
    let name = ptsname(&device_end, Vec::new())?;
    let path = PathBuf::from(std::ffi::OsStr::from_bytes(name.as_bytes()));
    let client_flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let client_end = rustix::fs::open(&path, client_flags, Mode::empty())?;
    let mut attributes = tcgetattr(&client_end)?;
    attributes.make_raw();
    tcsetattr(&client_end, OptionalActions::Now, &attributes)?;
    let status = rustix::fs::fcntl_getfl(&device_end)?;
    rustix::fs::fcntl_setfl(&device_end, status | OFlags::NONBLOCK)?;
    if let Some(link) = link {
        place_link(&path, link)?;
    }
    let pty = Pty {
        path,
        _client_end: client_end,
        link: link.map(Path::to_path_buf),
    };
    Ok((File::from(device_end), pty))
}

/// Takes the place of an older link, of nothing else.
fn place_link(target: &Path, link: &Path) -> io::Result<()> {
    match fs::symlink_metadata(link) {
        Ok(found) if found.is_symlink() => fs::remove_file(link)?,
        Ok(_) => {
            return Err(io::Error::new(
                ErrorKind::AlreadyExists,
                "there is a file of that name that is no serial line",
            ));
        }
        Err(_) => {}
    }
    symlink(target, link)
}

impl Drop for Pty {
    fn drop(&mut self) {
        let Some(link) = &self.link else { return };
        if fs::read_link(link).is_ok_and(|target| target == self.path) {
            // Gone already is as good.
            let _ = fs::remove_file(link);
        }
    }
}
