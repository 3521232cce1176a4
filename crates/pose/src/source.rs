//! Poses from a file or from the bus, one after another.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::Duration;

use echosplat_bus::{Bus, BusError, PoseCounters, PoseSubscription};
use echosplat_model::StampedPose;
use echosplat_recording::tum::{self, TumError};

use crate::PoseUrl;

/// Poses as they become known.
#[derive(Debug)]
pub enum PoseSource {
    /// None at all.
    None,
    /// All at once, in order of time.
    File(std::vec::IntoIter<StampedPose>),
    /// As they arrive.
    Live(PoseSubscription),
}

/// Why there is no such source.
#[derive(Debug, thiserror::Error)]
pub enum PoseSourceError {
    /// The file cannot be opened.
    #[error("poses: cannot open {path}: {reason}", path = .path.display())]
    Open {
        /// Which.
        path: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },
    /// The file holds something else.
    #[error("poses: {path}: {reason}", path = .path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// Where and what.
        reason: TumError,
    },
    /// The file holds no pose.
    #[error("poses: {path} holds no pose; lines are `timestamp tx ty tz qx qy qz qw`", path = .0.display())]
    Empty(PathBuf),
    /// `zenoh://` without a bus.
    #[error("poses come from zenoh://, but the bus is off")]
    NoBus,
    /// The bus refuses.
    #[error(transparent)]
    Bus(#[from] BusError),
}

impl PoseSource {
    /// Opens what `url` names; a file is read whole. `bus` is needed for `zenoh://` only.
    ///
    /// # Errors
    /// Says which file or what of the bus cannot be used.
    pub fn open(url: &PoseUrl, bus: Option<&Bus>) -> Result<Self, PoseSourceError> {
        match url {
            PoseUrl::None => Ok(Self::None),
            PoseUrl::Tum(path) => Self::file(path),
            PoseUrl::Zenoh => {
                let bus = bus.ok_or(PoseSourceError::NoBus)?;
                Ok(Self::Live(bus.subscribe_poses()?))
            }
        }
    }

    fn file(path: &Path) -> Result<Self, PoseSourceError> {
        let path = path.to_owned();
        let file = match File::open(&path) {
            Ok(file) => file,
            Err(reason) => return Err(PoseSourceError::Open { path, reason }),
        };
        let read = match tum::read(BufReader::new(file)) {
            Ok(read) => read,
            Err(reason) => return Err(PoseSourceError::Read { path, reason }),
        };
        if read.poses.is_empty() {
            return Err(PoseSourceError::Empty(path));
        }
        if read.not_increasing_count > 0 {
            let count = read.not_increasing_count;
            let path = path.display();
            tracing::warn!("{path}: {count} poses left out whose time does not increase");
        }
        Ok(Self::File(read.poses.into_iter()))
    }

    /// The next pose, if it is known already.
    #[must_use]
    pub fn try_next(&mut self) -> Option<StampedPose> {
        match self {
            Self::None => None,
            Self::File(poses) => poses.next(),
            Self::Live(poses) => poses.try_next(),
        }
    }

    /// The next pose, waiting for one that is yet to arrive no longer than `limit`.
    #[must_use]
    pub fn next_within(&mut self, limit: Duration) -> Option<StampedPose> {
        match self {
            Self::Live(poses) => poses.next_within(limit),
            _ => self.try_next(),
        }
    }

    /// Whether no pose will ever come again.
    #[must_use]
    pub fn is_ended(&self) -> bool {
        match self {
            Self::None => true,
            Self::File(poses) => poses.len() == 0,
            Self::Live(_) => false,
        }
    }

    /// How many poses are known to be left: of a file all of them, which is what a trajectory
    /// should have room for.
    #[must_use]
    pub fn known_len(&self) -> usize {
        match self {
            Self::None => 0,
            Self::File(poses) => poses.len(),
            Self::Live(poses) => poses.receiver().len(),
        }
    }

    /// What became of the poses that came over the bus.
    #[must_use]
    pub fn live_counters(&self) -> Option<PoseCounters> {
        match self {
            Self::Live(poses) => Some(poses.counters()),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn file(text: &str) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file
    }

    #[test]
    fn a_file_yields_all_its_poses_at_once() {
        let file = file("# t x y z qx qy qz qw\n1.5 1 2 3 0 0 0 1\n2.5 1 2 3 0 0 0 1\n");
        let url = PoseUrl::Tum(file.path().to_owned());
        let mut source = PoseSource::open(&url, None).unwrap();
        assert_eq!((source.known_len(), source.is_ended()), (2, false));
        let times: Vec<_> = std::iter::from_fn(|| source.try_next())
            .map(|pose| pose.time.nanos())
            .collect();
        assert_eq!(times, [1_500_000_000, 2_500_000_000]);
        assert!(source.is_ended());
    }

    #[test]
    fn unusable_sources_say_why() {
        let refusal = |url: &PoseUrl| PoseSource::open(url, None).unwrap_err().to_string();
        assert!(refusal(&PoseUrl::Zenoh).contains("bus"));
        assert!(refusal(&PoseUrl::Tum("/no/such.tum".into())).contains("/no/such.tum"));
        let empty = file("# nothing\n");
        assert!(refusal(&PoseUrl::Tum(empty.path().into())).contains("holds no pose"));
        let broken = file("1 2 3\n");
        assert!(refusal(&PoseUrl::Tum(broken.path().into())).contains("line 1"));
    }

    #[test]
    fn nowhere_has_ended_from_the_start() {
        let mut source = PoseSource::open(&PoseUrl::None, None).unwrap();
        assert!(source.is_ended() && source.try_next().is_none());
    }
}
