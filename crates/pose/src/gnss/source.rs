//! Fixes as they arrive.

use std::convert::Infallible;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use echosplat_bus::{Bus, MessageSubscription};
use echosplat_georeference::Heard;
use echosplat_georeference::nmea::NmeaReceiver;
use echosplat_liveness::Heartbeat;
use echosplat_ros::NavSatFix;
use serde::Serialize;
use tokio::runtime::Handle;
use tokio::time::sleep;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::fix_message::fix_of;
use super::url::GnssUrl;
use crate::link::{Address, BackOff};
use crate::now::now;
use crate::source::PoseSourceError;

/// What waits to be taken: a minute of a fast receiver. Beyond, the newest is dropped.
const QUEUE_LEN: usize = 1_024;
/// Of one datagram; more is cut off, and its last sentence with it.
const DATAGRAM_BYTES: usize = 8_192;
/// Between a panic and the next try.
const PAUSE: Duration = Duration::from_millis(100);

/// What became of a receiver's messages.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct GnssStatus {
    /// The URL.
    pub source: String,
    /// With a fix.
    pub fixes: u64,
    /// That say that there is no fix.
    pub no_fix: u64,
    /// With a true heading.
    pub headings: u64,
    /// With a magnetic heading, which is not used.
    pub magnetic_headings: u64,
    /// Cut, damaged, or with a number that cannot be.
    pub refused: u64,
    /// Newest dropped because the queue was full.
    pub dropped_full: u64,
    /// What was wrong with the first refused.
    pub first_fault: Option<String>,
    /// Of a listening address: `up`, `lost: …`.
    pub link: Option<String>,
}

/// A satellite receiver, listened to. Dropped, it lets go without waiting.
#[derive(Debug)]
pub struct GnssSource {
    url: GnssUrl,
    feed: Feed,
}

#[derive(Debug)]
enum Feed {
    Nmea {
        heard: Receiver<Heard>,
        shared: Arc<Mutex<GnssStatus>>,
        heartbeat: Heartbeat,
        _stopper: DropGuard,
    },
    Ros {
        messages: Box<MessageSubscription>,
        status: GnssStatus,
    },
}

impl GnssSource {
    /// Begins to listen; a receiver that is not there yet is no error. `bus` is needed for ROS only.
    ///
    /// # Errors
    /// If a topic is named and there is no bus, or it refuses.
    pub fn open(
        runtime: &Handle,
        url: &GnssUrl,
        bus: Option<&Bus>,
    ) -> Result<Self, PoseSourceError> {
        let feed = match url {
            GnssUrl::Nmea(address) => listen(runtime, Address::UdpIn(address.clone())),
            GnssUrl::Ros2(topic) => {
                let bus = bus.ok_or(PoseSourceError::NoBus)?;
                Feed::Ros {
                    messages: Box::new(bus.subscribe_fixes_of_ros(topic)?),
                    status: GnssStatus::default(),
                }
            }
        };
        let url = url.clone();
        Ok(Self { url, feed })
    }

    /// What was told next, if it came. NMEA is stamped on this host's clock as it arrives, messages of ROS by their own stamp.
    #[must_use]
    pub fn try_next(&mut self) -> Option<Heard> {
        match &mut self.feed {
            Feed::Nmea { heard, .. } => heard.try_recv().ok(),
            Feed::Ros { messages, status } => loop {
                let message = messages.try_next()?;
                let decoded = NavSatFix::decode(&message.payload);
                let decoded = decoded.map_err(|error| format!("NavSatFix: {error}"));
                match decoded.and_then(|message| fix_of(&message)) {
                    Ok(Some(fix)) => {
                        status.fixes += 1;
                        return Some(Heard::Fix(fix));
                    }
                    Ok(None) => status.no_fix += 1,
                    Err(fault) => {
                        status.refused += 1;
                        status.first_fault.get_or_insert(fault);
                    }
                }
            },
        }
    }

    /// Whether stamps are of the clock that stamps pings; else they are of that of poses.
    #[must_use]
    pub fn is_on_clock_of_pings(&self) -> bool {
        matches!(self.feed, Feed::Nmea { .. })
    }

    /// What became of what came.
    #[must_use]
    pub fn status(&self) -> GnssStatus {
        let status = match &self.feed {
            Feed::Nmea { shared, .. } => lock(shared).clone(),
            Feed::Ros { messages, status } => GnssStatus {
                dropped_full: messages.dropped(),
                ..status.clone()
            },
        };
        GnssStatus {
            source: self.url.to_string(),
            ..status
        }
    }

    /// Of the task that listens, if there is one.
    #[must_use]
    pub fn heartbeat(&self) -> Option<&Heartbeat> {
        match &self.feed {
            Feed::Nmea { heartbeat, .. } => Some(heartbeat),
            Feed::Ros { .. } => None,
        }
    }
}

fn lock(shared: &Mutex<GnssStatus>) -> MutexGuard<'_, GnssStatus> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn listen(runtime: &Handle, address: Address) -> Feed {
    let (sender, heard) = bounded(QUEUE_LEN);
    let shared = Arc::new(Mutex::new(GnssStatus::default()));
    let heartbeat = Heartbeat::new("gnss");
    let stop = CancellationToken::new();
    let task = Listener {
        address,
        sender,
        shared: Arc::clone(&shared),
        heartbeat: heartbeat.clone(),
    };
    let again_and_again = async move {
        while let Err(panicked) = task.heartbeat.survive_task(task.run()).await {
            if panicked.is_hopeless {
                return task.heartbeat.fail();
            }
            sleep(PAUSE).await;
        }
    };
    let cancelled = stop.clone();
    runtime.spawn(async move { cancelled.run_until_cancelled(again_and_again).await });
    Feed::Nmea {
        heard,
        shared,
        heartbeat,
        _stopper: stop.drop_guard(),
    }
}

struct Listener {
    address: Address,
    sender: Sender<Heard>,
    shared: Arc<Mutex<GnssStatus>>,
    heartbeat: Heartbeat,
}

impl Listener {
    async fn run(&self) {
        let mut receiver = NmeaReceiver::default();
        let mut back_off = BackOff::default();
        let name = self.address.name();
        loop {
            let Err(error) = self.read(&mut receiver, &mut back_off).await;
            self.link(format!("lost: {name}: {error}; trying again"));
            self.heartbeat.rest();
            back_off.wait().await;
        }
    }

    fn link(&self, link: String) {
        let mut status = lock(&self.shared);
        if status.link.as_ref() != Some(&link) {
            tracing::info!("GNSS: link {link}");
            status.link = Some(link);
        }
    }

    async fn read(
        &self,
        receiver: &mut NmeaReceiver,
        back_off: &mut BackOff,
    ) -> io::Result<Infallible> {
        let mut link = self.address.open().await?;
        self.link(format!("listening on {}", self.address.name()));
        let mut buffer = [0; DATAGRAM_BYTES];
        loop {
            self.heartbeat.beat();
            let count = link.read(&mut buffer).await?;
            back_off.reset();
            let arrived = now();
            let mut dropped = 0;
            receiver.take(&buffer[..count], |told, _| {
                dropped += u64::from(self.sender.try_send(told.at(arrived)).is_err());
            });
            if count > 0 {
                self.tell(receiver, dropped);
            }
        }
    }

    fn tell(&self, receiver: &NmeaReceiver, dropped: u64) {
        let counters = receiver.counters();
        let mut status = lock(&self.shared);
        status.fixes = counters.fixes;
        status.no_fix = counters.no_fix;
        status.headings = counters.headings;
        status.magnetic_headings = counters.magnetic_headings;
        status.refused = counters.refused;
        status.first_fault.clone_from(&counters.first_fault);
        status.dropped_full += dropped;
    }
}
