//! From a source's task to whoever takes the poses: a bounded queue, and the status beside it.

use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use echosplat_liveness::Heartbeat;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use crate::status::PoseSourceStatus;
use echosplat_join::ArrivedPose;

/// Poses that wait to be taken: 20 minutes at 50 Hz.
const QUEUE_LEN: usize = 65_536;
/// While nothing is read the status is renewed so often.
const TELL_EVERY: Duration = Duration::from_millis(500);

/// The task's end.
#[derive(Debug)]
pub(crate) struct Outlet {
    pub(crate) heartbeat: Heartbeat,
    stop: CancellationToken,
    poses: Sender<ArrivedPose>,
    shared: Arc<Mutex<PoseSourceStatus>>,
    dropped: u64,
    link: Option<String>,
}

/// The taker's end.
#[derive(Debug)]
pub(crate) struct Inlet {
    pub(crate) poses: Receiver<ArrivedPose>,
    shared: Arc<Mutex<PoseSourceStatus>>,
}

pub(crate) fn queue(heartbeat: Heartbeat, stop: CancellationToken) -> (Outlet, Inlet) {
    let (sender, poses) = bounded(QUEUE_LEN);
    let shared = Arc::new(Mutex::new(PoseSourceStatus::default()));
    let outlet = Outlet {
        heartbeat,
        stop,
        poses: sender,
        shared: Arc::clone(&shared),
        dropped: 0,
        link: None,
    };
    (outlet, Inlet { poses, shared })
}

impl Outlet {
    /// Never waits: with the queue full the pose, being the newest, is dropped and counted.
    pub(crate) fn hand_on(&mut self, pose: ArrivedPose) {
        if self.stop.is_cancelled() {
            // Its taker is gone, or has put another task in the place of one that hung.
            return;
        }
        if self.poses.try_send(pose).is_err() {
            self.dropped += 1;
        }
    }

    /// What became of the link; told in the next status.
    pub(crate) fn link(&mut self, link: impl Into<String>) {
        let link = link.into();
        if self.link.as_ref() != Some(&link) {
            tracing::info!("poses: link {link}");
            self.link = Some(link.clone());
        }
        let mut shared = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        shared.link = Some(link);
    }

    /// What became of the link, as told last.
    pub(crate) fn link_so_far(&self) -> Option<&str> {
        self.link.as_deref()
    }

    /// Waits for `work` on the link, telling the status meanwhile: what was missing before may not be what is now.
    pub(crate) async fn meanwhile<T>(
        &self,
        status: impl Fn() -> PoseSourceStatus,
        work: impl Future<Output = T>,
    ) -> T {
        let mut work = pin!(work);
        loop {
            self.tell(status());
            self.heartbeat.rest();
            if let Ok(done) = timeout(TELL_EVERY, &mut work).await {
                return done;
            }
        }
    }

    /// Tells counters, clock and what is missing, and that the task is alive. A link that the status
    /// names goes before the one told.
    pub(crate) fn tell(&self, mut status: PoseSourceStatus) {
        self.heartbeat.beat();
        if status.link.is_none() {
            status.link.clone_from(&self.link);
        }
        status.dropped_full += self.dropped;
        status.accepted = status.accepted.saturating_sub(self.dropped);
        *self.shared.lock().unwrap_or_else(PoisonError::into_inner) = status;
    }
}

impl Inlet {
    pub(crate) fn status(&self) -> PoseSourceStatus {
        let shared = self.shared.lock();
        shared.unwrap_or_else(PoisonError::into_inner).clone()
    }
}
