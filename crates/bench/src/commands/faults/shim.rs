//! A wall clock of the child's own that the bench can step: a few lines of C, compiled when they are
//! needed and loaded before the C library.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};

const SOURCE: &str = include_str!("shim.c");

/// The wall clock of one child.
pub(super) struct Shim {
    library: PathBuf,
    offset: PathBuf,
}

impl Shim {
    /// Compiles it in `folder`, which has to stay.
    ///
    /// # Errors
    /// If there is no C compiler.
    pub(super) fn compile(folder: &Path) -> anyhow::Result<Self> {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let folder = folder.canonicalize()?;
        let source = folder.join("shim.c");
        let shim = Self {
            library: folder.join("shim.so"),
            offset: folder.join("offset"),
        };
        fs::write(&source, SOURCE)?;
        shim.set_offset(0.0)?;
        let output = Command::new("cc")
            .args(["-shared", "-fPIC", "-O2", "-o"])
            .args([&shim.library, &source])
            .output()
            .context("stepping the clock needs a C compiler called `cc`")?;
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(
            output.status.success(),
            "cc does not compile the clock: {said}"
        );
        Ok(shim)
    }

    /// What the child is started with.
    pub(super) fn environment(&self) -> Vec<(String, String)> {
        let path = |path: &Path| path.display().to_string();
        vec![
            ("LD_PRELOAD".to_owned(), path(&self.library)),
            ("ECHOSPLAT_CLOCK_OFFSET".to_owned(), path(&self.offset)),
        ]
    }

    /// The child's clock is so far ahead of the true one from now on.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(super) fn set_offset(&self, seconds: f64) -> anyhow::Result<()> {
        let nanos = (seconds * 1e9) as i64;
        // Written in place: the child has it mapped.
        let mut options = fs::OpenOptions::new();
        let file = options.write(true).create(true).truncate(false);
        let file = file.open(&self.offset)?;
        std::io::Write::write_all(&mut &file, &nanos.to_ne_bytes())
            .with_context(|| format!("cannot write {}", self.offset.display()))
    }
}
