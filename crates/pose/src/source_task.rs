//! The task of a live source: begun again after a panic, and another in its place if it hangs.

use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::Receiver;
use echosplat_join::{ArrivedPose, StampClock};
use echosplat_liveness::Heartbeat;
use tokio::runtime::Handle;
use tokio::time::sleep;
use tokio_util::sync::{CancellationToken, DropGuard};

use crate::dvl;
use crate::link::Address;
use crate::mavlink::over_bus::OnBus;
use crate::mavlink::run::OverLink;
use crate::outlet::{Inlet, Outlet, queue};
use crate::status::PoseSourceStatus;

/// Name of the part.
const NAME: &str = "poses";
/// Between a panic and the next try, so that one that comes at once does not take the processor.
const PAUSE: Duration = Duration::from_millis(100);

/// What the task does until it is cancelled; begun again where it panicked.
#[derive(Debug)]
pub(crate) enum Work {
    /// A vehicle at the other end of a link.
    Mavlink(OverLink),
    /// A vehicle whose messages a server puts on the bus.
    MavlinkOnBus(OnBus),
    /// A DVL.
    Dvl(Address, StampClock),
}

impl Work {
    async fn run(&self, outlet: &mut Outlet) {
        match self {
            Self::Mavlink(vehicle) => vehicle.run(outlet).await,
            Self::MavlinkOnBus(server) => server.run(outlet).await,
            Self::Dvl(address, stamps) => dvl::run(address, *stamps, outlet).await,
        }
    }
}

/// The taker's side of the task. Dropped, it cancels the task without waiting.
#[derive(Debug)]
pub(crate) struct SourceTask {
    runtime: Handle,
    work: Arc<Work>,
    heartbeat: Heartbeat,
    inlet: Inlet,
    /// Dropped, it cancels the task.
    stopper: DropGuard,
}

impl SourceTask {
    pub(crate) fn start(runtime: &Handle, work: Work) -> Self {
        let heartbeat = Heartbeat::new(NAME);
        let work = Arc::new(work);
        let (stopper, inlet) = spawn(runtime, &work, &heartbeat);
        Self {
            runtime: runtime.clone(),
            work,
            heartbeat,
            inlet,
            stopper,
        }
    }

    /// To be called now and then. What the task that hangs still holds is left to it; should it
    /// ever go on, it is cancelled at its next wait and hands on nothing more.
    pub(crate) fn replace_if_it_hangs(&mut self) {
        if !self.heartbeat.is_to_be_replaced() {
            return;
        }
        // Before the other begins, so that its beats are the newest.
        self.heartbeat.replaced();
        (self.stopper, self.inlet) = spawn(&self.runtime, &self.work, &self.heartbeat);
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

fn spawn(runtime: &Handle, work: &Arc<Work>, heartbeat: &Heartbeat) -> (DropGuard, Inlet) {
    let stop = CancellationToken::new();
    let (mut outlet, inlet) = queue(heartbeat.clone(), stop.clone());
    let (work, heartbeat) = (Arc::clone(work), heartbeat.clone());
    let again_and_again = async move {
        while let Err(panicked) = heartbeat.survive_task(work.run(&mut outlet)).await {
            if panicked.is_hopeless {
                return heartbeat.fail();
            }
            sleep(PAUSE).await;
        }
    };
    let cancelled = stop.clone();
    runtime.spawn(async move { cancelled.run_until_cancelled(again_and_again).await });
    (stop.drop_guard(), inlet)
}
