//! The task of one sonar, or the thread that reads a log, and its owner's handle.

use std::fs::File;
use std::io;
use std::path::Path;
use std::thread;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use echosplat_liveness::Heartbeat;
use tokio::runtime::Handle;

use crate::config::{DriverConfig, DriverError};
use crate::event::{DriverEvent, DriverStatus};
use crate::link::Link;
use crate::log_reader::LogReader;
use crate::outlet::Outlet;
use crate::status::SharedStatus;
use crate::stop::{Stopper, stop_pair};
use crate::tap::{RawTap, Tape};
use crate::tape_reader::TapeReader;
use crate::transport;
use crate::url::SonarUrl;

/// A stop takes at most this long; what then still hangs is left alone.
const STOP_WAIT: Duration = Duration::from_secs(2);

/// Name of the part: of its heartbeat, and of a reader's thread.
const NAME: &str = "sonar";

/// A running driver. Dropping it stops the driver without waiting.
#[derive(Debug)]
pub struct DriverHandle {
    stopper: Stopper,
    status: SharedStatus,
    heartbeat: Heartbeat,
    /// Disconnects when the task or the thread ends.
    ended: Receiver<()>,
}

/// Starts the driver of one sonar: a link as a task of `runtime`, which connects for ever; a log as
/// a thread, which reads it once. It ends when stopped, when the receiver of `events` is dropped, or
/// after [`DriverEvent::Ended`]. `runtime` is one of several workers.
///
/// `events` is bounded by its maker. With `clock = device`, and for a log, the driver waits for
/// room in it, which through TCP makes the device wait too; with `clock = host` what finds no room
/// is left out and counted.
///
/// # Errors
/// If the configuration is out of range, a log cannot be opened or is no file, a serial line's path
/// leads to something else, or the URL is `sim://`.
pub fn spawn(
    runtime: &Handle,
    config: DriverConfig,
    raw: Option<RawTap>,
    events: Sender<DriverEvent>,
) -> Result<DriverHandle, DriverError> {
    spawn_with(runtime, Heartbeat::new(NAME), config, raw, events)
}

/// As [`spawn`], in the place of a link that hangs. That one is let go without waiting: should it
/// ever go on, it neither sends, records nor decodes anything more. Gives its last state too.
///
/// # Errors
/// As [`spawn`].
pub fn spawn_in_place_of(
    hung: DriverHandle,
    runtime: &Handle,
    config: DriverConfig,
    raw: Option<RawTap>,
    events: Sender<DriverEvent>,
) -> Result<(DriverHandle, DriverStatus), DriverError> {
    let DriverHandle {
        mut stopper,
        status,
        heartbeat,
        ..
    } = hung;
    stopper.abandon();
    // Before the other begins, so that its beats are the newest.
    heartbeat.replaced();
    let handle = spawn_with(runtime, heartbeat, config, raw, events)?;
    Ok((handle, status.read()))
}

fn spawn_with(
    runtime: &Handle,
    heartbeat: Heartbeat,
    config: DriverConfig,
    raw: Option<RawTap>,
    events: Sender<DriverEvent>,
) -> Result<DriverHandle, DriverError> {
    config.check()?;
    match &config.url {
        SonarUrl::Sim(scene) => Err(DriverError::Simulated {
            scene: scene.clone(),
        }),
        SonarUrl::File(path) => {
            let file = open_log(path)?;
            let (handle, outlet, alive) = wired(heartbeat, &config, events);
            let reader = LogReader::new(&config, raw, outlet);
            start_thread(handle, alive, move || reader.run(file))
        }
        SonarUrl::Tcp(_) | SonarUrl::Udp(_) | SonarUrl::Serial { .. } => {
            refuse_what_is_no_line(&config.url)?;
            let (handle, outlet, alive) = wired(heartbeat, &config, events);
            start_task(
                runtime,
                &handle,
                alive,
                Link::new(config, raw, outlet).run(),
            );
            Ok(handle)
        }
    }
}

/// Starts the thread `sonar` on a recording in place of a link. It is read once, at `config.rate`
/// times the pace of its recorded times, and gives the same pings, bit for bit, as the live
/// session did whose [`RawTap`] it was made by, if `config.session` is that session's. `raw` is
/// shown everything again, at the host's time now. `config.url` only names it.
///
/// What the tape cannot give ends it with a warning. The driver waits for room in `events`.
///
/// # Errors
/// If the configuration is out of range.
pub fn spawn_tape(
    config: &DriverConfig,
    tape: Tape,
    raw: Option<RawTap>,
    events: Sender<DriverEvent>,
) -> Result<DriverHandle, DriverError> {
    config.check()?;
    let (handle, outlet, alive) = wired(Heartbeat::new(NAME), config, events);
    let reader = TapeReader::new(config, raw, outlet.waiting_for_room());
    start_thread(handle, alive, move || reader.run(tape))
}

/// A driver's two ends, and what it drops when it ends.
fn wired(
    heartbeat: Heartbeat,
    config: &DriverConfig,
    events: Sender<DriverEvent>,
) -> (DriverHandle, Outlet, Sender<()>) {
    let (stopper, stop) = stop_pair();
    let status = SharedStatus::default();
    let outlet = Outlet::new(config, events, stop, status.clone(), heartbeat.clone());
    let (alive, ended) = bounded(0);
    let handle = DriverHandle {
        stopper,
        status,
        heartbeat,
        ended,
    };
    (handle, outlet, alive)
}

/// The link outlives the panics of its talk; one anywhere else ends it, which its heartbeat tells.
fn start_task(
    runtime: &Handle,
    handle: &DriverHandle,
    alive: Sender<()>,
    link: impl Future<Output = ()> + Send + 'static,
) {
    let heartbeat = handle.heartbeat.clone();
    runtime.spawn(async move {
        match heartbeat.survive_task(link).await {
            Ok(()) => heartbeat.end(),
            Err(_) => heartbeat.fail(),
        }
        drop(alive);
    });
}

fn start_thread(
    handle: DriverHandle,
    alive: Sender<()>,
    work: impl FnOnce() + Send + 'static,
) -> Result<DriverHandle, DriverError> {
    let heartbeat = handle.heartbeat.clone();
    thread::Builder::new()
        .name(NAME.to_owned())
        .spawn(move || {
            heartbeat.run_once(work);
            drop(alive);
        })
        .map_err(DriverError::Thread)?;
    Ok(handle)
}

/// A path that will never be a serial line is not waited for; one that is not there yet is.
fn refuse_what_is_no_line(url: &SonarUrl) -> Result<(), DriverError> {
    let SonarUrl::Serial { path, .. } = url else {
        return Ok(());
    };
    match transport::what_else_than_a_line(path) {
        Some(what) => Err(DriverError::NoLine {
            path: path.display().to_string(),
            what,
        }),
        None => Ok(()),
    }
}

/// Opens a log. Only files are: a fifo that nobody writes to would be waited for, for ever.
fn open_log(path: &Path) -> Result<File, DriverError> {
    let refused = |source| DriverError::Log {
        path: path.display().to_string(),
        source,
    };
    let metadata = std::fs::metadata(path).map_err(refused)?;
    if !metadata.is_file() {
        let words = "it is no file; copy it to one first";
        return Err(refused(io::Error::new(io::ErrorKind::InvalidInput, words)));
    }
    File::open(path).map_err(refused)
}

impl DriverHandle {
    /// The latest state.
    #[must_use]
    pub fn status(&self) -> DriverStatus {
        self.status.read()
    }

    /// Whether it is alive. One that panics on a link takes the link for lost; one that
    /// reads a log or a recording has failed.
    #[must_use]
    pub fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// Whether it has ended by itself.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        use crossbeam_channel::TryRecvError::Disconnected;
        self.ended.try_recv() == Err(Disconnected)
    }

    /// Tells the device to stop (`enable = 0`) and ends the driver, in bounded time; returns the
    /// last state. Not to be called from a task. Events that still wait in the channel stay there.
    #[must_use]
    pub fn stop(mut self) -> DriverStatus {
        self.stopper.stop();
        // Nothing is ever sent: this waits for the other end to be dropped.
        let _ = self.ended.recv_timeout(STOP_WAIT);
        self.status.read()
    }
}
