//! Names of pose sources.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Where poses come from.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum PoseUrl {
    /// `none`: from nowhere; no ping gets a pose.
    None,
    /// `zenoh://`: the key `<prefix>/<node>/pose` of the bus.
    #[default]
    Zenoh,
    /// `tum://PATH`, or a path that ends in `.tum` or `.txt`: a TUM file.
    Tum(PathBuf),
}

/// A text that names no pose source.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PoseUrlError {
    /// None of the forms.
    #[error(
        "pose source {0:?} is none of: zenoh://, tum://PATH, a path ending in .tum or .txt, none"
    )]
    Unknown(String),
    /// A TUM file without a name.
    #[error("pose source {0:?} names no file; write tum://PATH")]
    NoPath(String),
    /// zenoh with a key or address.
    #[error(
        "pose source {0:?}: write zenoh:// alone; the key follows from prefix and node, the endpoint from the bus's settings"
    )]
    ZenohAddress(String),
}

impl FromStr for PoseUrl {
    type Err = PoseUrlError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let owned = || text.to_owned();
        match text.split_once("://") {
            Some(("tum", "")) => Err(PoseUrlError::NoPath(owned())),
            Some(("tum", path)) => Ok(Self::Tum(path.into())),
            Some(("zenoh", "")) => Ok(Self::Zenoh),
            Some(("zenoh", _)) => Err(PoseUrlError::ZenohAddress(owned())),
            None if text == "none" => Ok(Self::None),
            None if is_trajectory(text) => Ok(Self::Tum(text.into())),
            _ => Err(PoseUrlError::Unknown(owned())),
        }
    }
}

fn is_trajectory(path: &str) -> bool {
    let extension = Path::new(path).extension();
    extension.is_some_and(|ext| ext.eq_ignore_ascii_case("tum") || ext.eq_ignore_ascii_case("txt"))
}

impl fmt::Display for PoseUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => write!(f, "none"),
            Self::Zenoh => write!(f, "zenoh://"),
            Self::Tum(path) => write!(f, "tum://{}", path.display()),
        }
    }
}

impl TryFrom<String> for PoseUrl {
    type Error = PoseUrlError;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<PoseUrl> for String {
    fn from(url: PoseUrl) -> Self {
        url.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_is_read_and_written() {
        let read = |text: &str| text.parse::<PoseUrl>();
        assert_eq!(read("none"), Ok(PoseUrl::None));
        assert_eq!(read("zenoh://"), Ok(PoseUrl::Zenoh));
        assert_eq!(read("tum:///a/b"), Ok(PoseUrl::Tum("/a/b".into())));
        assert_eq!(
            read("dive one.tum"),
            Ok(PoseUrl::Tum("dive one.tum".into()))
        );
        assert_eq!(read("poses.TXT"), Ok(PoseUrl::Tum("poses.TXT".into())));
        for url in [PoseUrl::None, PoseUrl::Zenoh, PoseUrl::Tum("x.tum".into())] {
            assert_eq!(read(&url.to_string()), Ok(url));
        }
    }

    #[test]
    fn other_texts_are_refused_with_what_would_do() {
        for bad in [
            "",
            "tum://",
            "zenoh",
            "zenoh://a/b",
            "mavlink://",
            "poses.csv",
            "None",
        ] {
            let refused = bad.parse::<PoseUrl>().unwrap_err().to_string();
            assert!(refused.contains("://"), "{refused}");
        }
    }
}
