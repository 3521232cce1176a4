//! Files that are replaced whole: a reader, a crash or a full disk never leaves half of one.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::{Builder, NamedTempFile};

/// A file written beside the one it will replace; gone again if it is dropped before.
#[derive(Debug)]
pub struct Replacement {
    written: NamedTempFile,
    target: PathBuf,
}

impl Replacement {
    /// Writes a file beside `path`, and has it on disk. Its name is its own, so that two programs
    /// that write to one path never share it, and one left behind by a crash is in nobody's way. Of a
    /// symbolic link the target is replaced.
    ///
    /// # Errors
    /// Of the file system.
    pub fn write(
        path: &Path,
        write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
    ) -> io::Result<Self> {
        let target = target_of(path);
        let mut written = beside(&target)?;
        let mut writer = BufWriter::new(written.as_file_mut());
        write(&mut writer)?;
        writer.flush()?;
        drop(writer);
        written.as_file().sync_all()?;
        Ok(Self { written, target })
    }

    /// Takes the place of what was there.
    ///
    /// # Errors
    /// Of the file system; what was there is then as it was.
    pub fn put_in_place(self) -> io::Result<()> {
        let directory = directory_of(&self.target).to_owned();
        self.written.persist(&self.target).map_err(|e| e.error)?;
        // The name is on disk too. Some file systems cannot be asked for that.
        let _ = File::open(directory).and_then(|directory| directory.sync_all());
        Ok(())
    }
}

/// Writes `path` whole.
///
/// # Errors
/// Of the file system; what was there is then as it was.
pub fn replace_file(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> io::Result<()> {
    Replacement::write(path, write)?.put_in_place()
}

/// Whether files can be made in the directory of `path`, by making one and removing it.
///
/// # Errors
/// Of the file system.
pub fn try_beside(path: &Path) -> io::Result<()> {
    beside(&target_of(path)).map(drop)
}

fn beside(target: &Path) -> io::Result<NamedTempFile> {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    let prefix = format!(".{name}.");
    let mut builder = Builder::new();
    builder.prefix(&prefix).suffix(".part");
    // As any new file has them; a temporary file by itself is for its owner only.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(directory_of(target))
}

/// What is replaced: of a link where it leads, even if nothing is there yet.
fn target_of(path: &Path) -> PathBuf {
    if let Ok(target) = path.canonicalize() {
        return target;
    }
    match std::fs::read_link(path) {
        Ok(link) => directory_of(path).join(link),
        Err(_) => path.to_owned(),
    }
}

fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_there_whole_or_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        fs::write(&path, "old").unwrap();
        let failed = replace_file(&path, |w| {
            w.write_all(b"half")?;
            Err(io::ErrorKind::StorageFull.into())
        });
        assert_eq!(failed.unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        assert_eq!(names(folder.path()), ["a.ply"]);
        replace_file(&path, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(names(folder.path()), ["a.ply"]);
    }

    #[test]
    fn two_at_a_time_do_not_meet() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.ply");
        let one = Replacement::write(&path, |w| w.write_all(b"one")).unwrap();
        let two = Replacement::write(&path, |w| w.write_all(b"two")).unwrap();
        assert_eq!(names(folder.path()).len(), 2);
        two.put_in_place().unwrap();
        one.put_in_place().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "one");
    }

    #[cfg(unix)]
    #[test]
    fn of_a_link_the_target_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (link, target) = (folder.path().join("link"), folder.path().join("target"));
        std::os::unix::fs::symlink("target", &link).unwrap();
        for text in ["first", "second"] {
            replace_file(&link, |w| w.write_all(text.as_bytes())).unwrap();
            assert_eq!(fs::read_to_string(&target).unwrap(), text);
            assert!(link.is_symlink());
        }
    }

    #[cfg(unix)]
    #[test]
    fn others_may_read_it() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("plain"), "").unwrap();
        replace_file(&path("replaced"), |_| Ok(())).unwrap();
        let mode = |name| fs::metadata(path(name)).unwrap().permissions().mode();
        assert_eq!(mode("plain"), mode("replaced"));
    }
}
