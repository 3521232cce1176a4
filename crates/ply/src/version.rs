//! Which version of its format a file of this program is.
//!
//! A comment `echosplat_map 1` says it, in PLY and in other files that have comment lines. A file without is of
//! the first version. One of a newer version than is known here is refused: what is read of it could mean
//! something else.

/// A format of this program's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Written {
    /// First word of the comment.
    word: &'static str,
    /// As an error names it.
    what: &'static str,
    /// The newest version that is known here, which is the one written.
    newest: u64,
}

impl Written {
    /// A map of Gaussians, as PLY.
    pub const MAP: Self = Self::new("echosplat_map", "map");
    /// A surface, as PLY or OBJ.
    pub const MESH: Self = Self::new("echosplat_mesh", "mesh");
    /// A point cloud, as PCD.
    pub const POINTS: Self = Self::new("echosplat_points", "point cloud");

    const ALL: [Self; 3] = [Self::MAP, Self::MESH, Self::POINTS];

    const fn new(word: &'static str, what: &'static str) -> Self {
        Self {
            word,
            what,
            newest: 1,
        }
    }

    /// The comment that says it.
    #[must_use]
    pub fn comment(self) -> String {
        format!("{} {}", self.word, self.newest)
    }

    /// Whether a comment says such a version, and so is no free text.
    #[must_use]
    pub fn is_said_by(comment: &str) -> bool {
        Self::of(comment).is_some()
    }

    fn of(comment: &str) -> Option<Self> {
        let word = comment.split_whitespace().next()?;
        Self::ALL.into_iter().find(|written| written.word == word)
    }
}

/// A file of a newer version of its format than is known here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "made by a newer EchoSplat: it is version {found} of a {what}, and this program reads up to version {newest}; \
     update EchoSplat on this machine to read it"
)]
pub struct Newer {
    /// What the file is.
    pub what: &'static str,
    /// Its version.
    pub found: u64,
    /// The newest that is read here.
    pub newest: u64,
}

/// Looks for a version in the comments of a file, each without what makes it a comment.
///
/// # Errors
/// If it is newer than is known here.
pub fn refuse_newer<'a>(comments: impl IntoIterator<Item = &'a str>) -> Result<(), Newer> {
    for comment in comments {
        let Some(Written { what, newest, .. }) = Written::of(comment) else {
            continue;
        };
        let word = comment.split_whitespace().nth(1).unwrap_or_default();
        if let Some(found) = version_of(word)
            && found > newest
        {
            return Err(Newer {
                what,
                found,
                newest,
            });
        }
    }
    Ok(())
}

/// The number that a text begins with; one beyond all numbers is the greatest.
#[must_use]
pub fn version_of(text: &str) -> Option<u64> {
    let end = text.find(|c: char| !c.is_ascii_digit());
    let digits = &text[..end.unwrap_or(text.len())];
    (!digits.is_empty()).then(|| digits.parse().unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_newer_is_refused_with_both_versions() {
        for written in Written::ALL {
            let (comment, next) = (written.comment(), written.newest + 1);
            assert_eq!(refuse_newer([comment.as_str()]), Ok(()));
            assert!(Written::is_said_by(&comment));
            let newer = format!("{} {next}", written.word);
            let said = refuse_newer(["a comment", &newer]).unwrap_err().to_string();
            for words in [
                format!("version {next} of a {}", written.what),
                format!("up to version {}", written.newest),
                "made by a newer EchoSplat".to_owned(),
            ] {
                assert!(said.contains(&words), "{said}");
            }
        }
    }

    #[test]
    fn what_says_no_version_is_of_the_first() {
        for comment in [
            "",
            "echosplat_map",
            "echosplat_map x",
            "echosplat_maps 9",
            "2",
        ] {
            assert_eq!(refuse_newer([comment]), Ok(()), "{comment}");
        }
    }

    #[test]
    fn a_version_is_the_number_in_front() {
        assert_eq!(version_of("12"), Some(12));
        assert_eq!(version_of("2; by another"), Some(2));
        assert_eq!(version_of("99999999999999999999999"), Some(u64::MAX));
        assert_eq!(version_of("x2"), None);
    }
}
