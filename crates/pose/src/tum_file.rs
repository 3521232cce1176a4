//! Poses of a TUM file, read whole.

use std::io::BufReader;
use std::path::Path;

use echosplat_input::Input;
use echosplat_model::StampedPose;
use echosplat_recording::foreign;
use echosplat_recording::tum::{self, TumFile};

use crate::source::PoseSourceError;
use crate::status::PoseSourceStatus;

/// Poses in order of time, and what of the file was left out.
#[derive(Debug, Default)]
pub struct FilePoses {
    poses: std::vec::IntoIter<StampedPose>,
    /// All that there were.
    count: u64,
    not_finite: u64,
    first_fault: Option<String>,
}

impl From<Vec<StampedPose>> for FilePoses {
    /// In order of time.
    fn from(poses: Vec<StampedPose>) -> Self {
        Self {
            count: poses.len() as u64,
            poses: poses.into_iter(),
            ..Self::default()
        }
    }
}

impl Iterator for FilePoses {
    type Item = StampedPose;

    fn next(&mut self) -> Option<StampedPose> {
        self.poses.next()
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.poses.size_hint()
    }
}

impl ExactSizeIterator for FilePoses {}

impl FilePoses {
    /// Those that were not taken yet.
    pub(crate) fn known(&self) -> &[StampedPose] {
        self.poses.as_slice()
    }

    /// Reads the file, and says what of it was left out.
    pub(crate) fn open(path: &Path) -> Result<Self, PoseSourceError> {
        let path = path.to_owned();
        let file = match echosplat_input::open(&path) {
            Ok(file) => file,
            Err(reason) => return Err(PoseSourceError::Open { path, reason }),
        };
        if let Input::File(file) = &file
            && let Some(reason) = foreign::of_file(file, &path)
        {
            return Err(PoseSourceError::Foreign { path, reason });
        }
        let read = match tum::read(BufReader::new(file)) {
            Ok(read) => read,
            Err(reason) => return Err(PoseSourceError::Read { path, reason }),
        };
        let rows = read.poses.len() + read.duplicate_count + read.contradicting_count;
        match &read.poses[..] {
            [] if read.not_finite_count > 0 => {
                let rows = read.not_finite_count;
                return Err(PoseSourceError::NoneFinite { path, rows });
            }
            [] => return Err(PoseSourceError::Empty(path)),
            [only] if rows > 1 => {
                let stamp_s = only.time.as_secs_f64();
                return Err(PoseSourceError::OneTime {
                    path,
                    rows,
                    stamp_s,
                });
            }
            _ => {}
        }
        Ok(Self::of(read, &path))
    }

    fn of(read: TumFile, path: &Path) -> Self {
        let path = path.display();
        if read.out_of_order_count > 0 {
            let count = read.out_of_order_count;
            tracing::info!("{path}: {count} poses stood after later ones; all are sorted by time");
        }
        let (duplicates, contradicting) = (read.duplicate_count, read.contradicting_count);
        if duplicates + contradicting > 0 {
            tracing::warn!(
                "{path}: {duplicates} poses left out that stand there twice, {contradicting} that \
                 contradict an earlier line of the same time"
            );
        }
        let first = read.first_not_finite;
        let first_fault = first.map(|line| format!("line {line} holds NaN or infinity"));
        if let Some(first) = &first_fault {
            let count = read.not_finite_count;
            tracing::warn!("{path}: {count} rows left out that hold NaN or infinity; {first}");
        }
        Self {
            count: read.poses.len() as u64,
            poses: read.poses.into_iter(),
            not_finite: read.not_finite_count as u64,
            first_fault,
        }
    }

    pub(crate) fn status(&self) -> PoseSourceStatus {
        PoseSourceStatus {
            source: "tum://".to_owned(),
            received: self.count + self.not_finite,
            accepted: self.count,
            not_finite: self.not_finite,
            first_fault: self.first_fault.clone(),
            ..PoseSourceStatus::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opened(text: &str) -> Result<FilePoses, String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        FilePoses::open(file.path()).map_err(|error| error.to_string())
    }

    #[test]
    fn rows_that_are_not_finite_are_left_out_and_counted() {
        let poses =
            opened("1 0 0 0 0 0 0 1\n2 nan 0 0 0 0 0 1\n3 0 -inf 0 0 0 0 1\n4 0 0 0 0 0 0 1\n");
        let poses = poses.unwrap();
        let status = poses.status();
        assert_eq!((poses.len(), status.not_finite), (2, 2));
        assert_eq!((status.received, status.accepted), (4, 2));
        assert!(status.first_fault.unwrap().contains("line 2"));
    }

    #[test]
    fn files_that_cannot_be_joined_with_anything_say_why() {
        let refused = |text: &str| opened(text).unwrap_err();
        let zero = refused(&"0.000000000 1 2 3 0 0 0 1\n".repeat(40));
        assert!(zero.contains("all 40 rows have the timestamp 0"), "{zero}");
        let one = refused("5.5 1 2 3 0 0 0 1\n5.5 2 2 3 0 0 0 1\n");
        assert!(one.contains("all 2 rows have the timestamp 5.5"), "{one}");
        let nothing = refused("1 nan nan nan nan nan nan nan\n2 nan 0 0 0 0 0 1\n");
        assert!(nothing.contains("all 2 rows hold NaN"), "{nothing}");
    }
}
