//! The recording of a dive: who writes when, and what becomes of failures.
//!
//! Bytes are written on the thread that received them, before they are decoded; nothing is
//! queued, so nothing can be dropped. What the disk refuses is counted and told once per outage.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use echosplat_driver::RawTap;
use echosplat_model::{StampedPose, Timestamp};
use echosplat_recording::mcap::{RecordingError, RecordingFile, Topic};
use serde::Serialize;

use crate::clock;
use crate::exit::Usage;

/// Shared by all threads that have something to record.
#[derive(Clone)]
pub(crate) struct Recorder(Arc<Mutex<State>>);

struct State {
    directory: PathBuf,
    rotate_bytes: u64,
    /// `None` once it is finished.
    file: Option<RecordingFile>,
    path: PathBuf,
    settings: String,
    /// Of the files before this one; `files` counts this one as well.
    past: RecorderCounters,
    failing: bool,
}

/// What was recorded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub(crate) struct RecorderCounters {
    /// Bytes of messages written.
    pub(crate) bytes: u64,
    /// Messages that are in no file.
    pub(crate) lost_messages: u64,
    /// Files begun.
    pub(crate) files: u64,
}

impl Recorder {
    /// Starts a file in `directory`, with the configuration in force as its first message.
    ///
    /// # Errors
    /// If the directory or the file cannot be made.
    pub(crate) fn create(
        directory: &Path,
        rotate_bytes: u64,
        settings: String,
    ) -> anyhow::Result<Self> {
        let refused = |error: &dyn std::fmt::Display| {
            Usage::error(format!("--record {}: {error}", directory.display()))
        };
        std::fs::create_dir_all(directory).map_err(|error| refused(&error))?;
        let (file, path) = begin(directory, &settings).map_err(|error| refused(&error))?;
        tracing::info!(file = %path.display(), "recording");
        Ok(Self(Arc::new(Mutex::new(State {
            directory: directory.to_owned(),
            rotate_bytes,
            file: Some(file),
            path,
            settings,
            past: RecorderCounters {
                files: 1,
                ..RecorderCounters::default()
            },
            failing: false,
        }))))
    }

    /// For the driver: records bytes as they come.
    pub(crate) fn raw_tap(&self) -> RawTap {
        let recorder = self.clone();
        Box::new(move |host_time: Timestamp, bytes: &[u8]| {
            recorder.with(|file| file.writer().write_raw(host_time, bytes));
        })
    }

    /// Records a pose as it came.
    pub(crate) fn pose(&self, pose: &StampedPose) {
        self.with(|file| file.writer().write_pose(clock::now(), pose));
    }

    /// Records what happened.
    pub(crate) fn event(&self, event: &serde_json::Value) {
        let text = event.to_string();
        self.with(|file| {
            let writer = file.writer();
            writer.write(Topic::Event, clock::now(), text.as_bytes())
        });
    }

    /// To be called by a timer: makes what is written survive a power cut, and begins a new file
    /// when this one is large.
    pub(crate) fn sync(&self) {
        self.with(RecordingFile::sync);
        self.with_state(|state| match state.is_large() {
            true => state.rotate(),
            false => Ok(()),
        });
    }

    /// What was recorded so far.
    pub(crate) fn counters(&self) -> RecorderCounters {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.counters()
    }

    /// Writes the end of the file; nothing is recorded after it.
    pub(crate) fn finish(&self) {
        self.with_state(|state| {
            state.past = state.counters();
            state.file.take().map_or(Ok(()), RecordingFile::finish)
        });
    }

    fn with(&self, write: impl FnOnce(&mut RecordingFile) -> Result<(), RecordingError>) {
        self.with_state(|state| state.file.as_mut().map_or(Ok(()), write));
    }

    /// Tells of the first failure of a row and of the recovery.
    fn with_state(&self, write: impl FnOnce(&mut State) -> Result<(), RecordingError>) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let result = write(&mut state);
        match (&result, state.failing) {
            (Err(error), false) => {
                tracing::error!(file = %state.path.display(), %error, "recording fails");
            }
            (Ok(()), true) => tracing::warn!("recording again"),
            _ => {}
        }
        state.failing = result.is_err();
    }
}

impl State {
    fn counters(&mut self) -> RecorderCounters {
        let mut counters = self.past;
        if let Some(file) = &mut self.file {
            counters.bytes += file.writer().byte_count();
            counters.lost_messages += file.writer().lost_message_count();
        }
        counters
    }

    fn is_large(&mut self) -> bool {
        let limit = self.rotate_bytes;
        let large = |file: &mut RecordingFile| file.writer().byte_count() > limit;
        self.file.as_mut().is_some_and(large)
    }

    fn rotate(&mut self) -> Result<(), RecordingError> {
        let (file, path) = begin(&self.directory, &self.settings)?;
        self.past = self.counters();
        self.past.files += 1;
        tracing::info!(file = %path.display(), "recording goes on in a new file");
        self.path = path;
        self.file
            .replace(file)
            .map_or(Ok(()), RecordingFile::finish)
    }
}

/// A new file named by the time, with a number behind it where two fall into one second.
fn begin(directory: &Path, settings: &str) -> Result<(RecordingFile, PathBuf), RecordingError> {
    let now = clock::now();
    let stem = format!("echosplat-{}", clock::compact_utc(now));
    let mut number = 1;
    loop {
        let path = match number {
            1 => directory.join(format!("{stem}.mcap")),
            _ => directory.join(format!("{stem}-{number}.mcap")),
        };
        match RecordingFile::create(&path) {
            Ok(mut file) => {
                file.writer()
                    .write(Topic::Settings, now, settings.as_bytes())?;
                return Ok((file, path));
            }
            Err(RecordingError::Io(error))
                if error.kind() == std::io::ErrorKind::AlreadyExists && number < 1000 =>
            {
                number += 1;
            }
            Err(error) => return Err(error),
        }
    }
}
