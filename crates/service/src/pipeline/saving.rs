//! What is saved of a run that has to end at once, whatever its threads are doing.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::shared::Shared;
use crate::maps::{self, RunNotes};
use crate::recorder::Recorder;
use crate::signals::LastWill;

/// The newest map and the recording.
#[derive(Clone)]
pub(super) struct Saving {
    shared: Arc<Shared>,
    recorder: Option<Recorder>,
    /// Where the map goes, if it is kept.
    map: Option<(PathBuf, RunNotes)>,
    /// Whether the last map of the run is written; held while one is.
    is_written: Arc<Mutex<bool>>,
}

impl Saving {
    pub(super) fn new(
        shared: &Arc<Shared>,
        recorder: Option<&Recorder>,
        map: Option<(PathBuf, RunNotes)>,
    ) -> Self {
        Self {
            shared: Arc::clone(shared),
            recorder: recorder.cloned(),
            map,
            is_written: Arc::default(),
        }
    }

    /// Held by whoever writes the last map, and set once it is written.
    pub(super) fn is_written(&self) -> MutexGuard<'_, bool> {
        let is_written = self.is_written.lock();
        is_written.unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn last_will(&self) -> LastWill {
        let saving = self.clone();
        Box::new(move || saving.save())
    }

    /// First the recording's end is asked for, so that it is written while the map is.
    fn save(self) {
        if let Some(recorder) = &self.recorder {
            recorder.close();
        }
        self.save_map();
        if let Some(recorder) = &self.recorder {
            recorder.release_room();
            recorder.finish();
        }
    }

    /// The newest map, unless the last one is there.
    fn save_map(&self) {
        let (Some((path, notes)), Some(newest)) = (&self.map, self.shared.newest_map()) else {
            return;
        };
        let mut is_written = self.is_written();
        if *is_written {
            return;
        }
        match maps::write(&newest, path, notes) {
            Ok(_) => *is_written = true,
            Err(error) => tracing::error!("{error:#}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_map_is_saved_once_and_not_over_the_last() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.ply");
        let shared = Arc::new(Shared::new());
        let place = Some((path.clone(), RunNotes::default()));
        let saving = Saving::new(&shared, None, place);
        saving.last_will()();
        assert!(!path.exists(), "there was no map yet");
        shared.keep_map(&Arc::new(maps::empty()));
        saving.last_will()();
        assert!(path.exists() && *saving.is_written());
        std::fs::remove_file(&path).unwrap();
        saving.last_will()();
        assert!(!path.exists());
    }
}
