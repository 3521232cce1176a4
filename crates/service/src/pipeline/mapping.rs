//! The mapper's thread fed with pings that are there already: the same worker as in every run,
//! without a device before it and a bus behind it.

use std::sync::Arc;
use std::thread::JoinHandle;

use anyhow::anyhow;
use bytes::Bytes;
use crossbeam_channel::{Sender, bounded};
use echosplat_driver::DriverEvent;
use echosplat_liveness::Heartbeat;
use echosplat_model::{Ping, Snapshot};

use super::calibration;
use super::earlier::EarlierMaps;
use super::places::Places;
use super::shared::{MapperReport, Shared};
use super::worker::THREAD_NAME;
use super::{Gate, Observer, Outlet, Poses, Shedding, Wiring, start_worker};
use crate::config::Config;
use crate::maps::RunNotes;

/// A map under way.
pub struct Mapping {
    events: Sender<DriverEvent>,
    shared: Arc<Shared>,
    thread: JoinHandle<Option<Arc<Snapshot>>>,
}

impl Mapping {
    /// # Errors
    /// If the mapper cannot be started.
    pub fn start(
        config: &Config,
        poses: Poses,
        observer: Option<Observer>,
    ) -> anyhow::Result<Self> {
        let (events, taken) = bounded(config.pipeline.queue_pings);
        let shared = Arc::new(Shared::new());
        let wiring = Wiring {
            events: taken,
            inputs_left: 1,
            poses,
            gate: Gate::default(),
            outlet: Outlet::new(None, None, observer),
            shedding: Shedding::none(),
            earlier: EarlierMaps::default(),
            places: Places::new(RunNotes::default(), None, Vec::new()),
            frame_check: None,
            calibration: calibration::Watch::off(config),
            came: None,
        };
        let thread = start_worker(config, wiring, &shared, Heartbeat::new(THREAD_NAME))?;
        Ok(Self {
            events,
            shared,
            thread,
        })
    }

    /// Takes the next ping, once there is room for it.
    ///
    /// # Errors
    /// If the mapper's thread has ended.
    pub fn take(&self, ping: Arc<Ping>) -> anyhow::Result<()> {
        let frame = Bytes::new();
        let event = DriverEvent::Ping { ping, frame };
        self.events.send(event).map_err(|_| ended())
    }

    /// The finished map and what it took.
    ///
    /// # Errors
    /// If the mapper's thread panicked.
    pub fn finish(self) -> anyhow::Result<(Arc<Snapshot>, MapperReport)> {
        drop(self.events);
        let snapshot = self.thread.join().ok().flatten().ok_or_else(ended)?;
        Ok((snapshot, self.shared.report()))
    }
}

fn ended() -> anyhow::Error {
    anyhow!("the mapper's thread panicked; the log above says where")
}
