//! The thread of a live source: begun again after a panic, and another in its place if it hangs.

use std::io;
use std::sync::Arc;

use crossbeam_channel::Receiver;
use echosplat_join::ArrivedPose;
use echosplat_liveness::Heartbeat;

use crate::outlet::{Inlet, Outlet, queue};
use crate::status::PoseSourceStatus;
use crate::stop::{Stop, Stopper, stop_pair};

/// What the thread does until the stop; begun again where it panicked.
pub(crate) type Work = Arc<dyn Fn(&mut Outlet, &Stop) + Send + Sync>;

/// Name of the thread, and of its heartbeat.
const THREAD_NAME: &str = "poses";

/// The taker's side of the thread. Dropped, it ends the thread without waiting: the stop is seen
/// within what a connection attempt takes.
pub(crate) struct SourceThread {
    work: Work,
    heartbeat: Heartbeat,
    inlet: Inlet,
    stopper: Stopper,
}

impl std::fmt::Debug for SourceThread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut fields = f.debug_struct("SourceThread");
        fields
            .field("heartbeat", &self.heartbeat)
            .finish_non_exhaustive()
    }
}

impl SourceThread {
    /// # Errors
    /// If there can be no thread.
    pub(crate) fn start(work: Work) -> io::Result<Self> {
        let heartbeat = Heartbeat::new(THREAD_NAME);
        let (stopper, inlet) = spawn(&work, &heartbeat)?;
        Ok(Self {
            work,
            heartbeat,
            inlet,
            stopper,
        })
    }

    /// To be called now and then. What the thread that hangs still holds is left to it; should it
    /// ever go on, it sees its stop and hands on nothing more.
    pub(crate) fn replace_if_it_hangs(&mut self) {
        if !self.heartbeat.is_to_be_replaced() {
            return;
        }
        // Before the other begins, so that its beats are the newest.
        self.heartbeat.replaced();
        match spawn(&self.work, &self.heartbeat) {
            Ok(others) => (self.stopper, self.inlet) = others,
            Err(error) => {
                tracing::error!(%error, "poses: the thread hangs, and there can be no other");
                self.heartbeat.fail();
            }
        }
    }

    pub(crate) fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    pub(crate) fn poses(&self) -> &Receiver<ArrivedPose> {
        &self.inlet.poses
    }

    pub(crate) fn status(&self) -> PoseSourceStatus {
        self.inlet.status()
    }
}

fn spawn(work: &Work, heartbeat: &Heartbeat) -> io::Result<(Stopper, Inlet)> {
    let (stopper, stop) = stop_pair();
    let (mut outlet, inlet) = queue(heartbeat.clone(), stop.clone());
    let (work, heartbeat) = (Arc::clone(work), heartbeat.clone());
    let thread = std::thread::Builder::new().name(THREAD_NAME.to_owned());
    thread.spawn(move || heartbeat.run_again(|| work(&mut outlet, &stop)))?;
    Ok((stopper, inlet))
}
