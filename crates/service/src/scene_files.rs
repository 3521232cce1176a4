//! A scene's file with the meshes that it names, to be kept together: a dive's folder stands alone,
//! wherever it is moved.

use std::io::{self, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::Context;
use echosplat_input::open_file;
use echosplat_recording::replace::replace_file;
use serde::Deserialize;
use toml::{Spanned, Value};

use crate::exit::Usage;

/// What of a scene's file leads to other files.
#[derive(Debug, Deserialize)]
struct Meshes {
    #[serde(default)]
    mesh: Vec<Mesh>,
}

#[derive(Debug, Deserialize)]
struct Mesh {
    file: Spanned<PathBuf>,
}

/// A scene's text, in which each mesh is beside it, and where the meshes come from.
#[derive(Debug)]
pub(crate) struct SceneFiles {
    text: String,
    /// Where it is, and its name beside the scene.
    meshes: Vec<(PathBuf, String)>,
}

impl SceneFiles {
    /// Of a scene whose meshes are looked for in `folder`. All but the names of meshes stays as it
    /// is, comments too.
    ///
    /// # Errors
    /// If the text is no TOML.
    pub(crate) fn of(text: &str, folder: &Path) -> anyhow::Result<Self> {
        let found: Meshes = toml::from_str(text).map_err(Usage::error)?;
        let mut files = Self {
            text: text.to_owned(),
            meshes: Vec::new(),
        };
        // From the end, so that places before it stay.
        for mesh in found.mesh.iter().rev() {
            let name = files.name_of(&folder.join(mesh.file.get_ref()));
            files.rename(mesh.file.span(), &name);
        }
        Ok(files)
    }

    /// The mesh's name beside the scene; one that is used twice is copied once.
    fn name_of(&mut self, path: &Path) -> String {
        if let Some((_, name)) = self.meshes.iter().find(|(known, _)| known == path) {
            return name.clone();
        }
        let own = path.file_name().unwrap_or_default().to_string_lossy();
        let is_taken = self.meshes.iter().any(|(_, name)| *name == own);
        let name = match is_taken {
            true => format!("{}-{own}", self.meshes.len()),
            false => own.into_owned(),
        };
        self.meshes.push((path.to_owned(), name.clone()));
        name
    }

    fn rename(&mut self, span: Range<usize>, name: &str) {
        let literal = Value::from(name).to_string();
        self.text.replace_range(span, &literal);
    }

    /// Writes the scene as `name` into `directory`, and its meshes beside it.
    ///
    /// # Errors
    /// Of the file system; names the mesh.
    pub(crate) fn write(&self, directory: &Path, name: &str) -> io::Result<()> {
        for (from, name) in &self.meshes {
            copy(from, &directory.join(name))
                .with_context(|| format!("mesh {}", from.display()))
                .map_err(io::Error::other)?;
        }
        replace_file(&directory.join(name), |file| {
            file.write_all(self.text.as_bytes())
        })
    }
}

/// A dive may be made anew in its own folder, from its own scene.
fn copy(from: &Path, to: &Path) -> io::Result<()> {
    let is_itself = to
        .canonicalize()
        .is_ok_and(|to| from.canonicalize().is_ok_and(|from| from == to));
    match is_itself {
        true => Ok(()),
        false => {
            let mut mesh = open_file(from)?;
            replace_file(to, |file| io::copy(&mut mesh, file).map(drop))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn meshes_come_along_and_are_found_beside_the_scene() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (directory, content) in [("a", "of a"), ("b", "of b")] {
            fs::create_dir(path(directory)).unwrap();
            fs::write(path(directory).join("plate.obj"), content).unwrap();
        }
        let far = path("b/plate.obj").display().to_string();
        let text = format!(
            "name = \"m\" # kept\n[[mesh]]\nfile = \"a/plate.obj\"\nscale = 2\n\
             [[mesh]]\nfile = '{far}' # here\n[[mesh]]\nfile = \"a/plate.obj\"\n"
        );
        let files = SceneFiles::of(&text, folder.path()).unwrap();
        fs::create_dir(path("truth")).unwrap();
        files.write(&path("truth"), "scene.toml").unwrap();
        let written = fs::read_to_string(path("truth/scene.toml")).unwrap();
        assert_eq!(
            written,
            "name = \"m\" # kept\n[[mesh]]\nfile = \"plate.obj\"\nscale = 2\n\
             [[mesh]]\nfile = \"1-plate.obj\" # here\n[[mesh]]\nfile = \"plate.obj\"\n"
        );
        let content = |name: &str| fs::read_to_string(path("truth").join(name)).unwrap();
        assert_eq!(content("plate.obj"), "of a");
        assert_eq!(content("1-plate.obj"), "of b");
        // Again over itself.
        let again = SceneFiles::of(&written, &path("truth")).unwrap();
        again.write(&path("truth"), "scene.toml").unwrap();
        assert_eq!(content("plate.obj"), "of a");
        assert_eq!(content("scene.toml"), written);
    }
}
