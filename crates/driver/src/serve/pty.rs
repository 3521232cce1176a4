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
    /// Removed when the server ends, if it still leads there.
    link: Option<(PathBuf, PathBuf)>,
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
    let target = marked(&path);
    if let Some(link) = link {
        place_link(&target, link)?;
    }
    let pty = Pty {
        path,
        _client_end: client_end,
        link: link.map(|link| (link.to_path_buf(), target)),
    };
    Ok((File::from(device_end), pty))
}

/// What the links that are made here lead to begins with: the same place as without the dot, and
/// the mark by which they are known again.
const MARK: &str = "/dev/pts/./";

/// The way to `path` that bears the mark, if it is a pseudo-terminal where they usually are.
fn marked(path: &Path) -> PathBuf {
    match path.strip_prefix("/dev/pts") {
        Ok(number) => PathBuf::from(format!("{MARK}{}", number.display())),
        Err(_) => path.to_path_buf(),
    }
}

/// Takes the place of a link that an emulator left behind when it was killed, and of nothing else:
/// not of a file, not of a link of somebody else's, not of one that is in use.
fn place_link(target: &Path, link: &Path) -> io::Result<()> {
    let refused = |words: String| Err(io::Error::new(ErrorKind::AlreadyExists, words));
    match (fs::read_link(link), fs::symlink_metadata(link)) {
        (Ok(old), _) if is_left_behind(&old) => fs::remove_file(link)?,
        (Ok(old), _) => {
            return refused(format!(
                "there is a link of that name to {}, which this program did not make or which \
                 is in use: remove it, or choose another path",
                old.display()
            ));
        }
        (Err(_), Ok(_)) => {
            return refused("there is a file of that name that is no serial line".to_owned());
        }
        (Err(_), Err(_)) => {}
    }
    symlink(target, link)
}

fn is_left_behind(target: &Path) -> bool {
    target.as_os_str().as_bytes().starts_with(MARK.as_bytes())
        && fs::symlink_metadata(target).is_err_and(|error| error.kind() == ErrorKind::NotFound)
}

impl Drop for Pty {
    fn drop(&mut self) {
        let Some((link, target)) = &self.link else {
            return;
        };
        // As bytes: paths that differ in a dot are equal to `Path`.
        let leads_there =
            fs::read_link(link).is_ok_and(|found| found.as_os_str() == target.as_os_str());
        if leads_there {
            // Gone already is as good.
            let _ = fs::remove_file(link);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_links_left_behind_by_an_emulator_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("sonar");
        let file = folder.path().join("precious");
        fs::write(&file, "precious").unwrap();
        let gone = Path::new("/dev/pts/./987654321");
        for foreign in [
            file.as_path(),
            Path::new("/dev/pts/987654321"),
            Path::new("/dev/ttyUSB9"),
        ] {
            symlink(foreign, &link).unwrap();
            let error = open(Some(&link)).err().unwrap();
            assert_eq!(error.kind(), ErrorKind::AlreadyExists);
            assert!(error.to_string().contains("did not make"), "{error}");
            assert_eq!(fs::read_link(&link).unwrap(), foreign);
            fs::remove_file(&link).unwrap();
        }
        symlink(gone, &link).unwrap();
        let (_device_end, served) = open(Some(&link)).unwrap();
        let second = open(Some(&link)).err().unwrap();
        assert!(second.to_string().contains("in use"), "{second}");
        assert_eq!(fs::canonicalize(&link).unwrap(), served.path);
        drop(served);
        assert!(fs::symlink_metadata(&link).is_err());
    }
}
