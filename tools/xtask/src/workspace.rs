//! What is looked at: the crates as cargo knows them, the files as git knows them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};

use crate::crates::PROGRAM;
use crate::graph::DependencyGraph;
use crate::sources::SourceFile;

/// Made by tools, not by us: left out where git cannot say what is tracked.
const GENERATED_FOLDERS: [&str; 4] = [".git", "target", "out", "__pycache__"];

/// A checkout.
#[derive(Debug)]
pub(crate) struct Workspace {
    root: PathBuf,
}

impl Workspace {
    /// The checkout that cargo runs this program for: with a target folder shared by several, it may
    /// have been built in another.
    pub(crate) fn here() -> anyhow::Result<Self> {
        let here = std::env::var_os("CARGO_MANIFEST_DIR");
        let here = here.unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
        let root = Path::new(&here).join("../..").canonicalize();
        Ok(Self {
            root: root.context("the checkout to be checked is gone")?,
        })
    }

    /// For each crate of the workspace what it depends on, with the features it has when it is
    /// built alone: what another crate switches on is no fault of its own.
    pub(crate) fn dependency_graphs(&self) -> anyhow::Result<BTreeMap<String, DependencyGraph>> {
        let names = self.cargo_tree("none", &["--workspace", "--depth", "0"])?;
        let names = names
            .lines()
            .filter_map(|line| line.split_whitespace().next());
        names
            .map(|name| {
                let tree = self.cargo_tree("depth", &["--package", name])?;
                let graph = DependencyGraph::parse(&tree);
                let graph = graph.with_context(|| format!("cargo tree of {name}"))?;
                Ok((name.to_owned(), graph))
            })
            .collect()
    }

    /// What the program depends on as it is built for a vehicle.
    pub(crate) fn vehicle_graph(&self) -> anyhow::Result<DependencyGraph> {
        let tree = self.cargo_tree("depth", &["--package", PROGRAM, "--no-default-features"])?;
        DependencyGraph::parse(&tree).context("cargo tree of the program for a vehicle")
    }

    fn cargo_tree(&self, prefix: &str, arguments: &[&str]) -> anyhow::Result<String> {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut command = Command::new(cargo);
        command
            .args([
                "tree", "--edges", "normal", "--format", " {p}", "--prefix", prefix,
            ])
            .args(arguments)
            .current_dir(&self.root);
        run(command)
    }

    /// The tracked files that hold text; those on disk where git does not answer.
    pub(crate) fn tracked_files(&self) -> anyhow::Result<Vec<SourceFile>> {
        let mut git = Command::new("git");
        git.args(["ls-files", "-z"]).current_dir(&self.root);
        let paths = match run(git) {
            Ok(list) => list.split_terminator('\0').map(str::to_owned).collect(),
            Err(_) => self.files_on_disk()?,
        };
        let read = |path: String| match std::fs::read(self.root.join(&path)) {
            Ok(bytes) => Ok(String::from_utf8(bytes)
                .ok()
                .map(|text| SourceFile { path, text })),
            // Removed from disk, not yet from git.
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error).context(path),
        };
        paths
            .into_iter()
            .filter_map(|path| read(path).transpose())
            .collect()
    }

    /// Writes a file of the checkout.
    pub(crate) fn write(&self, path: &str, text: &str) -> anyhow::Result<()> {
        std::fs::write(self.root.join(path), text).with_context(|| path.to_owned())
    }

    fn files_on_disk(&self) -> anyhow::Result<Vec<String>> {
        let mut paths = Vec::new();
        let mut folders = vec![self.root.clone()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder)? {
                let entry = entry?;
                let kind = entry.file_type()?;
                let generated = GENERATED_FOLDERS
                    .iter()
                    .any(|name| entry.file_name() == *name);
                if kind.is_dir() && !generated {
                    folders.push(entry.path());
                } else if kind.is_file() {
                    let path = entry.path();
                    let path = path.strip_prefix(&self.root)?.to_string_lossy();
                    paths.push(path.replace('\\', "/"));
                }
            }
        }
        paths.sort();
        Ok(paths)
    }
}

fn run(mut command: Command) -> anyhow::Result<String> {
    let output = command.output();
    let output = output.with_context(|| format!("{command:?} does not start"))?;
    if !output.status.success() {
        let errors = String::from_utf8_lossy(&output.stderr);
        bail!("{command:?} failed: {}", errors.trim());
    }
    String::from_utf8(output.stdout).with_context(|| format!("{command:?} printed no UTF-8"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crates::{CRATES, SERVICE};

    #[test]
    fn the_crates_and_files_of_this_checkout_are_found() {
        let workspace = Workspace::here().unwrap();
        let graphs = workspace.dependency_graphs().unwrap();
        assert!(
            graphs.keys().any(|name| name == SERVICE),
            "{:?}",
            graphs.keys()
        );
        let on_disk = workspace.files_on_disk().unwrap();
        for (name, folder, _) in CRATES
            .iter()
            .filter(|(name, ..)| graphs.contains_key(*name))
        {
            let manifest = format!("{folder}Cargo.toml");
            assert!(on_disk.contains(&manifest), "{name}: {manifest}");
        }
    }
}
