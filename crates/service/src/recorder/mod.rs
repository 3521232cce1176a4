//! The recording of a dive: what is kept, who writes it when, and what becomes of failures.
//!
//! Callers only put records into a queue, bounded in bytes: none ever waits for a disk. One thread
//! writes them, each whole before the next; another syncs twice a second and sees whether the file
//! is still there. While the disk refuses, the record at hand is kept and tried again and the queue
//! holds what comes; what finds no room is counted and told.

mod progress;
mod queue;
mod room;
mod storage;
mod syncer;
mod worker;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard};
use std::time::Duration;

use anyhow::anyhow;
use bytes::Bytes;
use echosplat_driver::{RawTap, Tapped};
use echosplat_join::ArrivedPose;
use echosplat_liveness::Heartbeat;
use echosplat_model::Timestamp;
use echosplat_recording::mcap::Record;
use echosplat_recording::svlog::LogClock;
use serde::Serialize;
use serde_json::Value;

use crate::clock;
use crate::config::RecordFormat;
use crate::decided::pings_shed;
use crate::exit::Usage;
use progress::Progress;
use queue::Queue;
use room::{Room, Watch};
use storage::Folder;
use syncer::Syncer;
use worker::Worker;

/// Longest that [`Recorder::finish`] takes.
const FINISH_LIMIT: Duration = Duration::from_secs(3);
/// Name of the event that a recording begins with.
pub(crate) const BEGIN: &str = "begin";
/// A longer piece of raw bytes is recorded in several.
const MAX_RAW_BYTES: usize = 512 << 10;

/// Makes what is shown a link's bytes before they are decoded, for each link that reads them.
pub(crate) type MakeTap = Arc<dyn Fn() -> RawTap + Send + Sync>;

/// How it is written.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RecorderConfig {
    /// Another file begins beyond this.
    pub(crate) rotate_bytes: u64,
    pub(crate) format: RecordFormat,
    /// That of the pings, by which a log tells times.
    pub(crate) log_clock: LogClock,
}

/// Shared by all threads that have something to record: a recording that goes on, or none until one
/// is begun.
#[derive(Clone)]
pub(crate) struct Recorder {
    running: Arc<RwLock<Option<Running>>>,
    plan: Arc<Plan>,
    /// As the driver told last; a recording begun in mid-dive begins with it.
    is_link_up: Arc<AtomicBool>,
}

/// How recordings are begun.
struct Plan {
    room: Room,
    directory: PathBuf,
    config: RecorderConfig,
    /// The configuration in force, first record of every file.
    settings: String,
    /// Said at the beginning of every recording.
    begin: Option<Value>,
}

/// What was recorded.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub(crate) struct RecorderCounters {
    /// Bytes written.
    pub(crate) bytes: u64,
    /// Records written.
    pub(crate) messages: u64,
    /// Records that are in no file.
    pub(crate) lost_messages: u64,
    /// Files begun.
    pub(crate) files: u64,
    /// Bytes that wait to be written.
    pub(crate) queued_bytes: u64,
    /// Whether writing fails at the moment.
    pub(crate) failing: bool,
}

impl Recorder {
    /// Records nothing until [`Recorder::begin`]. `begin` is the event that every recording begins
    /// with, after the configuration in force.
    pub(crate) fn idle(
        directory: &Path,
        config: RecorderConfig,
        settings: String,
        begin: Option<Value>,
    ) -> Self {
        let plan = Plan {
            room: Room::default(),
            directory: directory.to_owned(),
            config,
            settings,
            begin,
        };
        Self {
            running: Arc::default(),
            plan: Arc::new(plan),
            is_link_up: Arc::default(),
        }
    }

    /// Begins a file in the directory.
    ///
    /// # Errors
    /// If one goes on already, or the directory or the file cannot be made.
    pub(crate) fn begin(&self) -> anyhow::Result<()> {
        if self.is_running() {
            return Err(anyhow!("a recording goes on already"));
        }
        // Nobody who records waits for the disk meanwhile.
        let begun = self.plan.begin()?;
        if let Some(event) = &self.plan.begin {
            begun.record(clock::now(), Record::Event(event.clone()));
        }
        if self.is_link_up.load(Ordering::Relaxed) {
            begun.record(clock::now(), Record::LinkUp);
        }
        let mut running = self.running.write().unwrap_or_else(PoisonError::into_inner);
        let before = running.replace(begun);
        drop(running);
        before.iter().for_each(Running::finish);
        Ok(())
    }

    fn read(&self) -> RwLockReadGuard<'_, Option<Running>> {
        self.running.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a recording goes on.
    pub(crate) fn is_running(&self) -> bool {
        self.read().is_some()
    }

    /// Where recordings are.
    pub(crate) fn directory(&self) -> &Path {
        &self.plan.directory
    }

    /// For the driver: a tap for each thread that it reads with.
    pub(crate) fn taps(&self) -> MakeTap {
        let recorder = self.clone();
        Arc::new(move || recorder.raw_tap())
    }

    /// For the driver: records bytes as they come.
    pub(crate) fn raw_tap(&self) -> RawTap {
        let recorder = self.clone();
        Box::new(
            move |host_time: Timestamp, tapped: Tapped<'_>| match tapped {
                Tapped::Bytes(bytes) => recorder.raw(host_time, bytes),
                Tapped::LinkUp => recorder.link(host_time, true),
                Tapped::LinkDown => recorder.link(host_time, false),
                Tapped::HalfFrameExpired => recorder.record(host_time, Record::HalfFrameExpired),
                Tapped::PingsShed(first, last) => {
                    recorder.record(host_time, Record::Event(pings_shed(first, last)));
                }
            },
        )
    }

    fn raw(&self, host_time: Timestamp, bytes: &Bytes) {
        let running = self.read();
        let Some(running) = &*running else { return };
        for begin in (0..bytes.len()).step_by(MAX_RAW_BYTES) {
            let end = bytes.len().min(begin + MAX_RAW_BYTES);
            running.record(host_time, Record::Raw(bytes.slice(begin..end)));
        }
    }

    /// Records that the link came or went.
    pub(crate) fn link(&self, host_time: Timestamp, is_up: bool) {
        let record = match is_up {
            true => Record::LinkUp,
            false => Record::LinkDown,
        };
        self.record(host_time, record);
        self.is_link_up.store(is_up, Ordering::Relaxed);
    }

    /// Records what came or happened at `host_time`. Never waits for the disk.
    pub(crate) fn record(&self, host_time: Timestamp, record: Record) {
        if let Some(running) = &*self.read() {
            running.record(host_time, record);
        }
    }

    /// As the pose came; that of a log or a file now, when it is taken: its own time is on another clock
    /// than the log's bytes, which are recorded as they are read.
    pub(crate) fn record_pose(&self, arrived: &ArrivedPose) {
        let host_time = match self.plan.config.log_clock {
            LogClock::Kept => clock::now(),
            LogClock::Host | LogClock::Device => arrived.arrived,
        };
        self.record(host_time, Record::Pose(arrived.pose));
    }

    /// From now on the recording leaves room for a map of so many bytes at this place, where both are on
    /// one disk.
    pub(crate) fn keep_room(&self, map: &Path, bytes: u64) {
        self.plan.room.keep(map, bytes);
    }

    /// The map is written: the recording may fill the disk.
    pub(crate) fn release_room(&self) {
        self.plan.room.release();
    }

    /// What was recorded so far, if a recording goes on.
    pub(crate) fn counters(&self) -> Option<RecorderCounters> {
        self.read().as_ref().map(Running::counters)
    }

    /// While it fails: what fails and what to do.
    pub(crate) fn fault(&self) -> Option<String> {
        self.read().as_ref().and_then(Running::fault)
    }

    /// Of the threads of the recording that goes on: the one that writes, and the one that syncs.
    pub(crate) fn heartbeats(&self) -> Option<[Heartbeat; 2]> {
        self.read()
            .as_ref()
            .map(|running| running.heartbeats.clone())
    }

    /// Nothing is recorded after this; does not wait for the end of the file, as
    /// [`Recorder::finish`] does.
    pub(crate) fn close(&self) {
        if let Some(running) = &*self.read() {
            running.queue.close();
        }
    }

    /// Writes what waits and the end of the file, within 3 s; nothing is recorded after it.
    pub(crate) fn finish(&self) {
        let running = self.read().clone();
        running.iter().for_each(Running::finish);
    }

    /// The same, and another recording may be begun; says whether one went on.
    pub(crate) fn end(&self) -> bool {
        let mut running = self.running.write().unwrap_or_else(PoisonError::into_inner);
        let ended = running.take();
        // Nobody waits for the disk meanwhile.
        drop(running);
        ended.inspect(Running::finish).is_some()
    }
}

impl Plan {
    fn begin(&self) -> anyhow::Result<Running> {
        let (directory, config) = (&self.directory, self.config);
        let settings = self.settings.clone();
        let folder = Folder::new(directory, config.format, config.log_clock, &settings);
        match config.format {
            RecordFormat::Svlog => tracing::warn!(
                "an .svlog keeps no poses: --record-format both keeps them beside it"
            ),
            RecordFormat::Ros => tracing::warn!(
                "--record-format ros keeps no settings and no events: a replay of it takes those of \
                 --config, and need not give the same bits; `recover --ros` makes such a file of a \
                 whole recording later"
            ),
            RecordFormat::Mcap | RecordFormat::Both => {}
        }
        let room = Watch::new(self.room.clone(), room::look);
        Running::start(Box::new(folder), config.rotate_bytes, settings, room)
            .map_err(|error| Usage::error(format!("--record {}: {error}", directory.display())))
    }
}

/// One recording.
#[derive(Clone)]
struct Running {
    queue: Arc<Queue>,
    progress: Arc<Progress>,
    /// Of the thread that writes and of the one that syncs.
    heartbeats: [Heartbeat; 2],
}

impl Running {
    fn start(
        storage: Box<dyn storage::Storage>,
        rotate_bytes: u64,
        settings: String,
        room: Watch,
    ) -> anyhow::Result<Self> {
        let queue = Arc::new(Queue::default());
        let progress = Arc::new(Progress::default());
        let heartbeats = [Heartbeat::new("recorder"), Heartbeat::new("recorder-sync")];
        let [of_worker, of_syncer] = heartbeats.clone();
        let syncer = Syncer::start(Arc::clone(&progress), of_syncer)?;
        let shared = (Arc::clone(&queue), Arc::clone(&progress));
        let begun = Worker::begin(storage, syncer, rotate_bytes, settings, shared, room);
        let mut worker = begun?.with_heartbeat(of_worker.clone());
        std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || of_worker.run_again(|| worker.run()))?;
        Ok(Self {
            queue,
            progress,
            heartbeats,
        })
    }

    fn record(&self, host_time: Timestamp, record: Record) {
        self.queue.push(host_time, record);
    }

    fn counters(&self) -> RecorderCounters {
        let (queued_bytes, dropped) = self.queue.state();
        let mut counters = self.progress.counters();
        counters.queued_bytes = queued_bytes;
        counters.lost_messages += dropped;
        counters.failing = self.fault().is_some();
        counters
    }

    fn fault(&self) -> Option<String> {
        self.progress.fault()
    }

    fn finish(&self) {
        self.queue.close();
        let ended = self.progress.wait_ended(FINISH_LIMIT);
        let counters = self.counters();
        if !ended {
            tracing::error!(
                queued_bytes = counters.queued_bytes,
                "the recording was not finished within 3 s: what waits or was written last may be lost"
            );
        }
        if counters.lost_messages > 0 {
            let lost = counters.lost_messages;
            tracing::error!("the recording lacks {lost} messages");
        }
    }
}

#[cfg(test)]
mod tests;
