//! The thread that writes: one record after another, through every failure of the disk.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use echosplat_liveness::Heartbeat;
use echosplat_model::Timestamp;
use echosplat_recording::mcap::{Record, RecordingError};

use super::progress::Progress;
use super::queue::{MAX_QUEUED_BYTES, Popped, Queue, size_of};
use super::room::{Shortage, Watch};
use super::storage::{Sink, Storage};
use super::syncer::Syncer;
use crate::clock;

/// Time between two tries while the disk refuses, and between two looks at whether the file is
/// there.
const RETRY_EVERY: Duration = Duration::from_millis(200);
/// So long after the end is asked for, a disk that refuses is waited for.
const LAST_TRIES: Duration = Duration::from_millis(2_500);
/// After another file could not be begun, so long the old one is written on.
const ROTATE_AGAIN_AFTER: Duration = Duration::from_secs(5);

/// Writes the queue's records.
pub(super) struct Worker {
    storage: Box<dyn Storage>,
    syncer: Syncer,
    queue: Arc<Queue>,
    progress: Arc<Progress>,
    room: Watch,
    heartbeat: Heartbeat,
    /// The thread has run before, and panicked.
    has_run: bool,
    sinks: Vec<Box<dyn Sink>>,
    rotate_bytes: u64,
    /// Not before this.
    rotate_from: Instant,
    /// Bytes in the files before.
    past_bytes: u64,
    /// Said at the start of every file.
    settings: Record,
    static_transform: Option<Record>,
}

impl Worker {
    /// With its first file begun.
    ///
    /// # Errors
    /// If there can be none.
    pub(super) fn begin(
        storage: Box<dyn Storage>,
        syncer: Syncer,
        rotate_bytes: u64,
        settings: String,
        (queue, progress): (Arc<Queue>, Arc<Progress>),
        room: Watch,
    ) -> Result<Self, RecordingError> {
        let mut worker = Self {
            storage,
            syncer,
            queue,
            progress,
            room,
            heartbeat: Heartbeat::new("recorder"),
            has_run: false,
            sinks: Vec::new(),
            rotate_bytes,
            rotate_from: Instant::now(),
            past_bytes: 0,
            settings: Record::Settings(settings),
            static_transform: None,
        };
        worker.sinks = worker.new_sinks()?;
        Ok(worker)
    }

    /// The same, showing that it is alive.
    pub(super) fn with_heartbeat(self, heartbeat: Heartbeat) -> Self {
        Self { heartbeat, ..self }
    }

    /// Until the queue is closed and empty. Called again after a panic it goes on in new files: what
    /// the panic left half written is at the end of the old ones.
    pub(super) fn run(&mut self) {
        if std::mem::replace(&mut self.has_run, true) {
            self.progress.lock().counters.lost_messages += 1;
            self.go_on_in_new_files();
        }
        loop {
            self.heartbeat.beat();
            match self.queue.pop(RETRY_EVERY) {
                Popped::Record(host_time, record) => self.take(host_time, &record),
                Popped::Nothing => self.replace_vanished(),
                Popped::Closed => break,
            }
        }
        self.conclude();
    }

    fn go_on_in_new_files(&mut self) {
        match self.new_sinks() {
            Ok(sinks) => self.replace_sinks(sinks),
            Err(error) => {
                tracing::error!("no new file of the recording, the old one goes on: {error}");
            }
        }
    }

    fn replace_sinks(&mut self, sinks: Vec<Box<dyn Sink>>) {
        self.past_bytes += byte_count(&mut self.sinks);
        self.sinks = sinks;
    }

    fn take(&mut self, host_time: Timestamp, record: &Record) {
        self.replace_vanished();
        if matches!(record, Record::StaticTransform(_)) {
            self.static_transform = Some(record.clone());
        }
        if !self.wait_for_room(size_of(record)) {
            return self.count(false);
        }
        let written = match write_all(&mut self.sinks, host_time, record) {
            Ok(()) => true,
            Err(error @ RecordingError::TooLong { .. }) => {
                tracing::error!("not recorded: {error}");
                false
            }
            Err(error) => self.outlast(error, host_time, record),
        };
        self.count(written);
        self.rotate_if_large();
    }

    fn count(&mut self, written: bool) {
        let bytes = self.past_bytes + byte_count(&mut self.sinks);
        let counters = &mut self.progress.lock().counters;
        counters.bytes = bytes;
        counters.messages += u64::from(written);
        counters.lost_messages += u64::from(!written);
    }

    /// Waits while the map needs what is free; `false` if the end was asked for and its time is up.
    fn wait_for_room(&mut self, bytes: usize) -> bool {
        let bytes = bytes as u64;
        let path = self.path();
        match self.room.shortage(&path, bytes) {
            None => true,
            Some(found) => self.hold(short_of(found, &path), |worker| {
                match worker.room.shortage(&path, bytes) {
                    None => Ok(()),
                    Some(found) => Err(short_of(found, &path)),
                }
            }),
        }
    }

    /// Tries again until the record is written, or the end was asked for and its time is up.
    fn outlast(
        &mut self,
        mut error: RecordingError,
        host_time: Timestamp,
        record: &Record,
    ) -> bool {
        let fault = self.words_of(&error);
        self.hold(fault, |worker| {
            let tried = worker.try_again(&error, host_time, record);
            tried.map_err(|again| {
                error = again;
                worker.words_of(&error)
            })
        })
    }

    /// Tells the fault, and tries again until it is over, or the end was asked for and its time is up.
    fn hold(
        &mut self,
        mut fault: String,
        mut try_again: impl FnMut(&mut Self) -> Result<(), String>,
    ) -> bool {
        let lost_before = self.lost();
        let began = Instant::now();
        tracing::error!("{fault}");
        loop {
            self.heartbeat.beat();
            self.progress.lock().write_fault = Some(fault);
            let closed = self.queue.wait_closed(RETRY_EVERY);
            match try_again(self) {
                Ok(()) => break,
                Err(again) => fault = again,
            }
            if closed.is_some_and(|since| since.elapsed() > LAST_TRIES) {
                self.queue.give_up();
                return false;
            }
            if closed.is_some() {
                // The queue wakes at once from now on.
                std::thread::sleep(RETRY_EVERY);
            }
        }
        self.progress.lock().write_fault = None;
        let lost = self.lost() - lost_before;
        let outage_s = began.elapsed().as_secs_f64();
        tracing::warn!("recording again after {outage_s:.1} s; {lost} messages lost");
        true
    }

    fn lost(&self) -> u64 {
        self.queue.state().1 + self.progress.counters().lost_messages
    }

    /// On a full disk the files at hand go on as soon as there is room. After any other failure
    /// they may never be written again, and the record at hand goes into new ones.
    fn try_again(
        &mut self,
        error: &RecordingError,
        host_time: Timestamp,
        record: &Record,
    ) -> Result<(), RecordingError> {
        let is_there = !self.syncer.has_vanished();
        let caught_up = self.sinks.iter_mut().try_for_each(|sink| sink.catch_up());
        if is_there && (caught_up.is_ok() || is_full(error)) {
            return caught_up;
        }
        let mut sinks = self.new_sinks()?;
        write_all(&mut sinks, host_time, record)?;
        self.replace_sinks(sinks);
        Ok(())
    }

    /// What was written into a file that is no longer there may be in none.
    fn replace_vanished(&mut self) {
        if !self.syncer.has_vanished() {
            return;
        }
        let path = self.path().display().to_string();
        match self.new_sinks() {
            Ok(sinks) => {
                let mut state = self.progress.lock();
                let unseen = state.counters.messages - state.seen_messages;
                state.counters.messages -= unseen;
                state.counters.lost_messages += unseen;
                state.seen_messages = state.counters.messages;
                state.write_fault = None;
                drop(state);
                tracing::error!(
                    "the recording's file {path} is gone (moved, deleted, or its disk removed); \
                     recording goes on in a new file; {unseen} messages lost"
                );
                self.replace_sinks(sinks);
            }
            Err(error) => {
                let fault = format!(
                    "the recording's file {path} is gone, and no new one can be begun: {error}; \
                     make the folder writable again"
                );
                let before = self.progress.lock().write_fault.replace(fault.clone());
                if before.is_none() {
                    tracing::error!("{fault}");
                }
            }
        }
    }

    fn rotate_if_large(&mut self) {
        let is_large = byte_count(&mut self.sinks) > self.rotate_bytes;
        if !is_large || Instant::now() < self.rotate_from {
            return;
        }
        match self.new_sinks() {
            Ok(sinks) => {
                self.past_bytes += byte_count(&mut self.sinks);
                let before = std::mem::replace(&mut self.sinks, sinks);
                close_all(before);
            }
            Err(error) => {
                self.rotate_from = Instant::now() + ROTATE_AGAIN_AFTER;
                tracing::warn!("no further file of the recording, the old one goes on: {error}");
            }
        }
    }

    /// Files that begin with what every file has to say.
    fn new_sinks(&mut self) -> Result<Vec<Box<dyn Sink>>, RecordingError> {
        let mut sinks = self.storage.begin()?;
        let now = clock::now();
        for record in std::iter::once(&self.settings).chain(&self.static_transform) {
            write_all(&mut sinks, now, record)?;
        }
        let mut watched = Vec::new();
        for sink in &sinks {
            tracing::info!(file = %sink.path().display(), "recording");
            if let Some(handle) = sink.handle()? {
                watched.push((sink.path().to_owned(), handle));
            }
        }
        self.syncer.watch(watched);
        self.progress.lock().counters.files += 1;
        Ok(sinks)
    }

    fn words_of(&self, error: &RecordingError) -> String {
        let path = self.path();
        let path = path.display();
        let room = MAX_QUEUED_BYTES >> 20;
        match is_full(error) {
            true => format!(
                "disk full: the recording {path} cannot grow; free space on its disk and it goes \
                 on by itself (up to {room} MiB wait in memory)"
            ),
            false => format!(
                "the recording {path} cannot be written: {error}; tried again until it can \
                 (up to {room} MiB wait in memory)"
            ),
        }
    }

    fn path(&self) -> PathBuf {
        self.sinks
            .first()
            .map(|sink| Path::to_owned(sink.path()))
            .unwrap_or_default()
    }

    fn conclude(&mut self) {
        let handles = self.sinks.iter().filter_map(|sink| sink.handle().ok()?);
        let handles: Vec<_> = handles.collect();
        close_all(std::mem::take(&mut self.sinks));
        for handle in handles {
            if let Err(error) = handle.sync_all() {
                tracing::error!("the recording may not survive a power cut: {error}");
            }
        }
        self.progress.end();
    }
}

/// What to say where the recording waits so that the map has room.
fn short_of(found: Shortage, recording: &Path) -> String {
    let mb = |bytes: u64| bytes as f64 * 1e-6;
    let room = MAX_QUEUED_BYTES >> 20;
    format!(
        "disk nearly full: of the {:.1} MB left the map may need {:.1} MB, so the recording {} waits; free space \
         on its disk and it goes on by itself (up to {room} MiB wait in memory)",
        mb(found.free_bytes),
        mb(found.needed_bytes),
        recording.display()
    )
}

fn write_all(
    sinks: &mut [Box<dyn Sink>],
    host_time: Timestamp,
    record: &Record,
) -> Result<(), RecordingError> {
    // Each keeps what it could not write, so each is given the record whatever the others say.
    let results = sinks.iter_mut().map(|sink| sink.write(host_time, record));
    results.fold(Ok(()), Result::and)
}

fn byte_count(sinks: &mut [Box<dyn Sink>]) -> u64 {
    sinks.iter_mut().map(|sink| sink.byte_count()).sum()
}

fn close_all(sinks: Vec<Box<dyn Sink>>) {
    for sink in sinks {
        let path = sink.path().display().to_string();
        if let Err(error) = sink.close() {
            tracing::warn!("{path} has no end, but reads up to it: {error}");
        }
    }
}

fn is_full(error: &RecordingError) -> bool {
    let kind = error.io_kind();
    matches!(
        kind,
        Some(ErrorKind::StorageFull | ErrorKind::QuotaExceeded)
    )
}
