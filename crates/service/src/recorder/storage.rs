//! Where records go: files in a folder, of one format or two.

use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use echosplat_model::Timestamp;
use echosplat_recording::mcap::{Profile, Record, RecordingError, RecordingFile};
use echosplat_recording::svlog::{LiveSvlog, LogClock};

use crate::clock;
use crate::config::RecordFormat;

/// Two services that begin in one second, many times over.
const MAX_NAMES: u32 = 1000;

/// A place where files can be begun.
pub(super) trait Storage: Send {
    /// A new file of each format; none that is there is touched.
    fn begin(&mut self) -> Result<Vec<Box<dyn Sink>>, RecordingError>;
}

/// One file being written. A record that is refused is kept, and completed by `catch_up`.
pub(super) trait Sink: Send {
    fn write(&mut self, host_time: Timestamp, record: &Record) -> Result<(), RecordingError>;
    fn catch_up(&mut self) -> Result<(), RecordingError>;
    fn byte_count(&mut self) -> u64;
    fn path(&self) -> &Path;
    /// For syncing; `None` where there is nothing to sync.
    fn handle(&self) -> io::Result<Option<File>>;
    /// Writes the file's end; without it the file stays as it is.
    fn close(self: Box<Self>) -> Result<(), RecordingError>;
}

/// Files in a folder, which is made again if it vanishes.
pub(super) struct Folder {
    directory: PathBuf,
    format: RecordFormat,
    frame_id: String,
    url: String,
    log_clock: LogClock,
    /// Begin of the files' names, the same for all of a dive, so that they sort in its order
    /// whatever the clock does.
    dive: Option<String>,
    file_count: u32,
}

impl Folder {
    /// Frame of the poses, URL of the sonar and clock are those of the configuration.
    pub(super) fn new(
        directory: &Path,
        format: RecordFormat,
        log_clock: LogClock,
        settings: &str,
    ) -> Self {
        let settings: toml::Table = toml::from_str(settings).unwrap_or_default();
        let text = |table: &str, key: &str, other: &str| {
            let value = settings.get(table).and_then(|table| table.get(key));
            value.and_then(|v| v.as_str()).unwrap_or(other).to_owned()
        };
        Self {
            directory: directory.to_owned(),
            format,
            frame_id: text("bus", "frame_id", "map"),
            url: text("sonar", "url", ""),
            log_clock,
            dive: None,
            file_count: 0,
        }
    }

    fn begin_named(&self, stem: &str) -> Result<Vec<Box<dyn Sink>>, RecordingError> {
        let path = |ending: &str| self.directory.join(format!("{stem}.{ending}"));
        let mut sinks: Vec<Box<dyn Sink>> = Vec::new();
        let (profile, has_log) = match self.format {
            RecordFormat::Mcap => (Some(Profile::Full), false),
            RecordFormat::Ros => (Some(Profile::Ros2), false),
            RecordFormat::Svlog => (None, true),
            RecordFormat::Both => (Some(Profile::Full), true),
        };
        if let Some(profile) = profile {
            let sink = McapSink::create(path("mcap"), &self.frame_id, profile)?;
            sinks.push(Box::new(sink));
        }
        if has_log {
            match SvlogSink::create(path("svlog"), &self.url, self.log_clock) {
                Ok(sink) => sinks.push(Box::new(sink)),
                Err(error) => {
                    sinks.into_iter().for_each(remove);
                    return Err(error.into());
                }
            }
        }
        Ok(sinks)
    }
}

/// Of a file that was begun and holds nothing yet.
fn remove(sink: Box<dyn Sink>) {
    let path = sink.path().to_owned();
    drop(sink);
    // It may be gone already, and is of no use to anyone.
    let _ = std::fs::remove_file(path);
}

impl Storage for Folder {
    fn begin(&mut self) -> Result<Vec<Box<dyn Sink>>, RecordingError> {
        std::fs::create_dir_all(&self.directory)?;
        let number = self.file_count + 1;
        let now = clock::compact_utc(clock::now());
        for attempt in 1..=MAX_NAMES {
            let dive = match (&self.dive, attempt) {
                (Some(dive), 1) => dive.clone(),
                (_, 1) => format!("echosplat-{now}"),
                _ => format!("echosplat-{now}_{attempt}"),
            };
            match self.begin_named(&format!("{dive}-{number:04}")) {
                Err(error) if error.io_kind() == Some(io::ErrorKind::AlreadyExists) => {}
                Err(error) => return Err(error),
                Ok(sinks) => {
                    self.dive = Some(dive);
                    self.file_count = number;
                    return Ok(sinks);
                }
            }
        }
        Err(io::Error::from(io::ErrorKind::AlreadyExists).into())
    }
}

struct McapSink {
    file: RecordingFile,
    path: PathBuf,
}

impl McapSink {
    fn create(path: PathBuf, frame_id: &str, profile: Profile) -> Result<Self, RecordingError> {
        let file = RecordingFile::create(&path, frame_id, profile)?;
        Ok(Self { file, path })
    }
}

impl Sink for McapSink {
    fn write(&mut self, host_time: Timestamp, record: &Record) -> Result<(), RecordingError> {
        self.file.writer().write(host_time, record)
    }

    fn catch_up(&mut self) -> Result<(), RecordingError> {
        self.file.writer().catch_up()
    }

    fn byte_count(&mut self) -> u64 {
        self.file.writer().byte_count()
    }

    fn path(&self) -> &Path {
        &self.path
    }

    fn handle(&self) -> io::Result<Option<File>> {
        self.file.handle().map(Some)
    }

    fn close(self: Box<Self>) -> Result<(), RecordingError> {
        self.file.close()
    }
}

struct SvlogSink {
    log: LiveSvlog<File>,
    handle: File,
    path: PathBuf,
}

impl SvlogSink {
    fn create(path: PathBuf, url: &str, log_clock: LogClock) -> io::Result<Self> {
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&path)?;
        let handle = file.try_clone()?;
        let log = LiveSvlog::new(file, url, log_clock);
        Ok(Self { log, handle, path })
    }
}

impl Sink for SvlogSink {
    fn write(&mut self, host_time: Timestamp, record: &Record) -> Result<(), RecordingError> {
        match record {
            Record::Raw(bytes) => self.log.take(host_time, bytes)?,
            Record::LinkDown => self.log.link_down(host_time)?,
            Record::HalfFrameExpired => self.log.half_frame_expired(host_time)?,
            _ => {}
        }
        Ok(())
    }

    fn catch_up(&mut self) -> Result<(), RecordingError> {
        Ok(self.log.catch_up()?)
    }

    fn byte_count(&mut self) -> u64 {
        self.log.byte_count()
    }

    fn path(&self) -> &Path {
        &self.path
    }

    fn handle(&self) -> io::Result<Option<File>> {
        self.handle.try_clone().map(Some)
    }

    fn close(mut self: Box<Self>) -> Result<(), RecordingError> {
        Ok(self.log.catch_up()?)
    }
}
