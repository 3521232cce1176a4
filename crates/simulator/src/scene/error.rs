//! Why a scene could not be read.

use std::path::PathBuf;

/// What is wrong with a scene, where, and what would be right.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// Not the name of a built-in scene.
    #[error("no built-in scene is called `{name}`; there are {known}")]
    UnknownName {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// A file that cannot be read.
    #[error("cannot read {path}: {source}")]
    Io {
        /// Which.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Not a scene: the message shows line, column, key and what is allowed.
    #[error("{origin}: {message}")]
    Toml {
        /// File or name of the scene.
        origin: String,
        /// With the line it is on.
        message: String,
    },
    /// A solid with a value that fits its type and still cannot be.
    #[error("{origin}, line {line}: {message}")]
    Solid {
        /// File or name of the scene.
        origin: String,
        /// Line of the solid's first key, from 1.
        line: usize,
        /// Names the key and what is allowed.
        message: String,
    },
    /// A mesh file that is not one, or is larger than allowed.
    #[error("mesh {path}: {message}")]
    Mesh {
        /// Which.
        path: PathBuf,
        /// What is wrong, where.
        message: String,
    },
}
