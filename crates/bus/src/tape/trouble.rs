//! What is wrong with a tape that cannot be followed.

use std::fmt;

/// What is wrong with what answers as this node's driver.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TapeTrouble {
    /// It cannot be read.
    Unreadable(String),
    /// It answers with words in the place of records.
    Refused(String),
    /// Another than the driver that is followed answers too.
    OtherDriver {
        /// Names the run that is followed.
        followed: u64,
        /// Names the other's.
        other: u64,
    },
}

impl fmt::Display for TapeTrouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(why) => write!(
                f,
                "what answers as the driver cannot be read: {why}; give driver and mapper the same \
                 version, and others than this driver another --prefix or --node"
            ),
            Self::Refused(why) => write!(f, "what answers as the driver refuses to: {why}"),
            Self::OtherDriver { followed, other } => write!(
                f,
                "two drivers answer under this node, the runs {followed} and {other}; the first is \
                 followed: end one of them, or give it a --node of its own"
            ),
        }
    }
}
