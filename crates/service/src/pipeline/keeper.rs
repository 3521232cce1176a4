//! The map's file: written every minute while the dive goes on, on a thread of its own, and at the
//! end. What the disk refuses is told.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use echosplat_model::Snapshot;

use crate::maps::{self, RunNotes};

/// What a kill loses at most of a map.
const WRITE_EVERY: Duration = Duration::from_secs(60);

/// Keeps the file of the newest map.
#[derive(Debug)]
pub(crate) struct Keeper {
    map: PathBuf,
    notes: RunNotes,
    next: Instant,
    written_sequence: u64,
    writing: Option<JoinHandle<anyhow::Result<()>>>,
    fault: Option<String>,
}

impl Keeper {
    pub(crate) fn new(map: PathBuf, notes: RunNotes) -> Self {
        Self {
            map,
            notes,
            next: Instant::now() + WRITE_EVERY,
            written_sequence: 0,
            writing: None,
            fault: None,
        }
    }

    /// The same with the first map as soon as there is one: whoever follows a map may come at its end.
    pub(crate) fn due_at_once(self) -> Self {
        Self {
            next: Instant::now(),
            ..self
        }
    }

    /// Begins to write `newest` when it is time and it is another map than the one written.
    pub(crate) fn tick(&mut self, newest: impl FnOnce() -> Option<Arc<Snapshot>>) {
        self.take_result();
        if self.writing.is_some() || Instant::now() < self.next {
            return;
        }
        let Some(snapshot) = newest().filter(|map| map.sequence != self.written_sequence) else {
            return;
        };
        self.next = Instant::now() + WRITE_EVERY;
        self.written_sequence = snapshot.sequence;
        let (map, notes) = (self.map.clone(), self.notes.clone());
        let work = move || maps::write(&snapshot, &map, &notes).map(drop);
        let thread = std::thread::Builder::new().name("map-file".to_owned());
        match thread.spawn(work) {
            Ok(thread) => self.writing = Some(thread),
            Err(error) => self.fault = Some(error.to_string()),
        }
    }

    /// Where the map goes.
    pub(crate) fn map(&self) -> &Path {
        &self.map
    }

    /// Why the newest try failed.
    pub(crate) fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Writes the last map. A write that hangs is left alone: no two share a temporary file.
    ///
    /// # Errors
    /// If the map cannot be written.
    pub(crate) fn finish(mut self, last: &Snapshot) -> anyhow::Result<()> {
        self.take_result();
        maps::write(last, &self.map, &self.notes).map(drop)
    }

    fn take_result(&mut self) {
        let Some(writing) = self.writing.take_if(|thread| thread.is_finished()) else {
            return;
        };
        self.fault = match writing.join() {
            Ok(Ok(())) => None,
            Ok(Err(error)) => Some(crate::exit::one_line(&error)),
            Err(_) => Some("writing it panicked; the log above says where".to_owned()),
        };
    }
}
