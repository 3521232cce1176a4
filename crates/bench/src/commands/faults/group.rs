//! A share of the processor for one program, as the kernel's control groups give it.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

/// Where version 1 and version 2 of control groups are mounted.
const VERSION_1: &str = "/sys/fs/cgroup/cpu";
const VERSION_2: &str = "/sys/fs/cgroup";
/// Microseconds; within each the share is used up at most.
const PERIOD_US: u64 = 100_000;

/// A group of its own; taken away when dropped. Takes what the system allows only to root.
pub(super) struct Group {
    path: PathBuf,
}

impl Group {
    /// Of so many processors.
    ///
    /// # Errors
    /// If there are no control groups, or the system does not allow one.
    pub(super) fn of(processors: f64) -> anyhow::Result<Self> {
        let quota_us = (processors * PERIOD_US as f64).round() as u64;
        let name = format!("echosplat-bench-{}", std::process::id());
        if Path::new(VERSION_1).is_dir() {
            let group = Self::make(Path::new(VERSION_1).join(name))?;
            group.write("cpu.cfs_period_us", &PERIOD_US.to_string())?;
            group.write("cpu.cfs_quota_us", &quota_us.to_string())?;
            return Ok(group);
        }
        let root = Path::new(VERSION_2);
        if !root.join("cgroup.controllers").is_file() {
            bail!(
                "there are no control groups in {VERSION_2}: a share of a processor cannot be had"
            );
        }
        // Where it is on already, or may not be turned on, what is written below says so.
        let _ = fs::write(root.join("cgroup.subtree_control"), "+cpu");
        let group = Self::make(root.join(name))?;
        group.write("cpu.max", &format!("{quota_us} {PERIOD_US}"))?;
        Ok(group)
    }

    fn make(path: PathBuf) -> anyhow::Result<Self> {
        fs::create_dir_all(&path)
            .with_context(|| format!("a control group takes root: {}", path.display()))?;
        Ok(Self { path })
    }

    /// A process, with all its threads.
    ///
    /// # Errors
    /// If it has ended.
    pub(super) fn take(&self, process: u32) -> anyhow::Result<()> {
        self.write("cgroup.procs", &process.to_string())
    }

    fn write(&self, name: &str, value: &str) -> anyhow::Result<()> {
        let path = self.path.join(name);
        fs::write(&path, value).with_context(|| format!("cannot write {}", path.display()))
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        // What cannot go is empty and harms nobody.
        let _ = fs::remove_dir(&self.path);
    }
}
