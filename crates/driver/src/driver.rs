//! The thread of one sonar, and its owner's handle.

use std::fs::File;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crossbeam_channel::{Receiver, Sender, bounded};
use echosplat_model::Timestamp;

use crate::config::{DriverConfig, DriverError};
use crate::event::{DriverEvent, DriverStatus};
use crate::link::Link;
use crate::log_reader::LogReader;
use crate::outlet::Outlet;
use crate::stop::{Stopper, stop_pair};
use crate::url::SonarUrl;

/// Called with the time of arrival and the bytes, before they are decoded.
pub type RawTap = Box<dyn FnMut(Timestamp, &[u8]) + Send>;

/// A stop takes at most this long; a thread that then still hangs in a system call is left alone.
const STOP_WAIT: Duration = Duration::from_secs(5);

/// A running driver. Dropping it stops the thread without waiting.
#[derive(Debug)]
pub struct DriverHandle {
    stopper: Stopper,
    status: SharedStatus,
    /// Disconnects when the thread ends.
    ended: Receiver<()>,
}

/// Starts the thread `sonar`. It connects for ever (or reads its log once) and ends when stopped,
/// when the receiver of `events` is dropped, or after [`DriverEvent::Ended`].
///
/// `events` is bounded by its maker. With `clock = device`, and for a log, the driver waits for
/// room in it, which through TCP makes the device wait too; with `clock = host` what finds no room
/// is left out and counted.
///
/// # Errors
/// If the configuration is out of range, a log cannot be opened, or the URL is `sim://`.
pub fn spawn(
    config: DriverConfig,
    raw: Option<RawTap>,
    events: Sender<DriverEvent>,
) -> Result<DriverHandle, DriverError> {
    config.check()?;
    let (stopper, stop) = stop_pair();
    let status = SharedStatus::default();
    let outlet = Outlet::new(&config, events, stop, status.clone());
    let work: Box<dyn FnOnce() + Send> = match &config.url {
        SonarUrl::Sim(scene) => {
            return Err(DriverError::Simulated {
                scene: scene.clone(),
            });
        }
        SonarUrl::File(path) => {
            let file = File::open(path).map_err(|source| DriverError::Log {
                path: path.display().to_string(),
                source,
            })?;
            Box::new(move || LogReader::new(&config, raw, outlet).run(file))
        }
        SonarUrl::Tcp(_) | SonarUrl::Udp(_) | SonarUrl::Serial { .. } => {
            Box::new(move || Link::new(config, raw, outlet).run())
        }
    };
    let (alive, ended) = bounded(0);
    thread::Builder::new()
        .name("sonar".to_owned())
        .spawn(move || {
            work();
            drop::<Sender<()>>(alive);
        })
        .map_err(DriverError::Thread)?;
    Ok(DriverHandle {
        stopper,
        status,
        ended,
    })
}

impl DriverHandle {
    /// The latest state.
    #[must_use]
    pub fn status(&self) -> DriverStatus {
        self.status.read()
    }

    /// Whether the thread has ended by itself.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        use crossbeam_channel::TryRecvError::Disconnected;
        self.ended.try_recv() == Err(Disconnected)
    }

    /// Tells the device to stop (`enable = 0`) and ends the thread, in bounded time; returns the
    /// last state. Events that still wait in the channel stay there.
    #[must_use]
    pub fn stop(mut self) -> DriverStatus {
        self.stopper.stop();
        // Nothing is ever sent: this waits for the thread to drop its end.
        let _ = self.ended.recv_timeout(STOP_WAIT);
        self.status.read()
    }
}

/// The driver's state, written by its thread, read by anyone.
#[derive(Debug, Clone, Default)]
pub(crate) struct SharedStatus(Arc<Mutex<DriverStatus>>);

impl SharedStatus {
    pub(crate) fn read(&self) -> DriverStatus {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    pub(crate) fn update(&self, change: impl FnOnce(&mut DriverStatus)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

/// The host's clock.
pub(crate) fn host_time() -> Timestamp {
    let nanos = match SystemTime::now().duration_since(UNIX_EPOCH) {
        Ok(since) => i64::try_from(since.as_nanos()).unwrap_or(i64::MAX),
        Err(before) => i64::try_from(before.duration().as_nanos()).map_or(i64::MIN, |n| -n),
    };
    Timestamp::from_nanos(nanos)
}
