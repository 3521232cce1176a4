//! What a path leads to, before it is replaced; files that are written whole; and why writing failed, in
//! words.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use anyhow::anyhow;
use echosplat_recording::replace::{replace_file, try_beside};

use crate::exit::Usage;

/// Refuses a file that could not be written, before hours are spent on what shall be in it. Its
/// directory is made. `name` is the argument's or the key's.
///
/// # Errors
/// Says what is in the way.
pub(crate) fn prepare(name: &str, path: &Path) -> anyhow::Result<()> {
    let refused = |why: String| Usage::error(format!("{name} {}: {why}", path.display()));
    if path.file_name().is_none() {
        return Err(refused("it must name a file".to_owned()));
    }
    replaceable(path).map_err(refused)?;
    let directory = path.parent().unwrap_or(Path::new(""));
    if !directory.as_os_str().is_empty() {
        std::fs::create_dir_all(directory).map_err(|error| {
            let why = in_words(&error);
            refused(format!("its directory cannot be made: {why}"))
        })?;
    }
    try_beside(path).map_err(|error| {
        let why = in_words(&error);
        refused(format!("no file can be written there: {why}"))
    })
}

/// Writes a file whole, its directory included.
///
/// # Errors
/// If it cannot be; an earlier one is then as it was.
pub(crate) fn write(name: &str, path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    write_with(name, path, |file| file.write_all(bytes))
}

/// The same of what `write` writes.
///
/// # Errors
/// As [`write()`].
pub(crate) fn write_with(
    name: &str,
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> anyhow::Result<()> {
    prepare(name, path)?;
    replace_file(path, write).map_err(|error| cannot_write(path, &error))
}

/// What could not be written, and why.
pub(crate) fn cannot_write(path: &Path, error: &io::Error) -> anyhow::Error {
    anyhow!("cannot write {}: {}", path.display(), in_words(error))
}

/// A full disk is named as such.
pub(crate) fn in_words(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::StorageFull => format!("the disk is full ({error})"),
        io::ErrorKind::QuotaExceeded => format!("the quota of this disk is used up ({error})"),
        _ => error.to_string(),
    }
}

/// Says why there can be no file of ours in the place of what is at `path`, if so.
///
/// # Errors
/// What it is instead of a regular file.
pub(crate) fn replaceable(path: &Path) -> Result<(), String> {
    if is_among_devices(path) {
        return Err("it lies among the system's devices; give a file in a directory".to_owned());
    }
    echosplat_input::replaceable(path)
}

/// `/dev/stdout` leads to a regular file where the output goes to one, and is still none to replace.
/// `/dev/shm` holds files like any other.
fn is_among_devices(path: &Path) -> bool {
    let parent = path.parent().and_then(|parent| parent.canonicalize().ok());
    [Some(path), parent.as_deref()]
        .into_iter()
        .flatten()
        .any(|path| {
            let is_device = path.starts_with("/dev") && !path.starts_with("/dev/shm");
            is_device || path.starts_with("/proc") || path.starts_with("/sys")
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_file_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let said = |path: &Path| prepare("--map", path).unwrap_err().to_string();
        assert!(said(folder.path()).contains("a directory"));
        assert!(said(Path::new("..")).contains("must name a file"));
        for device in ["/dev/null", "/dev/stdout", "/dev/map.ply", "/proc/self/map"] {
            assert!(said(Path::new(device)).contains("among the system's devices"));
        }
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let said = said(&file.join("map.ply"));
        assert!(said.contains("directory cannot be made"), "{said}");
        prepare("--map", &folder.path().join("new/map.ply")).unwrap();
        assert!(folder.path().join("new").is_dir());
        assert_eq!(
            std::fs::read_dir(folder.path().join("new"))
                .unwrap()
                .count(),
            0
        );
    }

    #[cfg(unix)]
    #[test]
    fn sockets_are_named_and_links_to_files_are_fine() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let _socket = std::os::unix::net::UnixListener::bind(path("socket")).unwrap();
        std::os::unix::fs::symlink(path("socket"), path("to-socket")).unwrap();
        for name in ["socket", "to-socket"] {
            assert!(replaceable(&path(name)).unwrap_err().contains("a socket"));
        }
        std::fs::write(path("file"), "").unwrap();
        std::os::unix::fs::symlink("file", path("to-file")).unwrap();
        prepare("--map", &path("to-file")).unwrap();
    }

    #[test]
    fn a_full_disk_is_named() {
        let full = io::Error::from(io::ErrorKind::StorageFull);
        let said = cannot_write(Path::new("a/map.ply"), &full).to_string();
        assert!(said.contains("a/map.ply: the disk is full"), "{said}");
    }
}
