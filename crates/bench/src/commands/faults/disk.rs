//! A disk of limited size, to be filled and freed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};

/// A tmpfs; unmounted when dropped. Takes what the system allows only to root.
pub(super) struct Disk {
    path: PathBuf,
}

impl Disk {
    /// # Errors
    /// If the system does not allow it.
    pub(super) fn mount(path: PathBuf, bytes: u64) -> anyhow::Result<Self> {
        fs::create_dir_all(&path).with_context(|| format!("cannot make {}", path.display()))?;
        let size = format!("size={bytes}");
        let mut command = Command::new("mount");
        command
            .args(["-t", "tmpfs", "-o", &size, "tmpfs"])
            .arg(&path);
        let output = command.output().context("mount does not start")?;
        ensure!(
            output.status.success(),
            "a disk of limited size takes root: {}",
            String::from_utf8_lossy(&output.stderr).trim()
        );
        Ok(Self { path })
    }

    /// Takes all the room that is left.
    pub(super) fn fill(&self) {
        let block = vec![0; 64 << 10];
        if let Ok(mut file) = fs::File::create(self.filler()) {
            while std::io::Write::write_all(&mut file, &block).is_ok() {}
        }
    }

    /// Gives that room back.
    pub(super) fn free(&self) {
        // What is not there takes no room.
        let _ = fs::remove_file(self.filler());
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    fn filler(&self) -> PathBuf {
        self.path.join("filler")
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        // Whoever still looks into it keeps it until then.
        let _ = Command::new("umount").arg("-l").arg(&self.path).status();
    }
}
