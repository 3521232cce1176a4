//! What of a run goes out over the bus: begun together, and watched over by one supervisor.

use std::sync::Arc;

use echosplat_bus::{AliveToken, Bus, MapPublisher, RosPublisher};
use echosplat_liveness::Heartbeat;
use echosplat_model::Pose;
use echosplat_recording::mcap::Record;

use super::Setup;
use crate::clock;
use crate::recorder::Recorder;

/// All of it is `None` without a bus.
#[derive(Default)]
pub(super) struct Published {
    pub(super) map: Option<Arc<MapPublisher>>,
    /// For nodes of ROS, where it is asked for.
    pub(super) ros: Option<Arc<RosPublisher>>,
    pub(super) alive: Vec<AliveToken>,
}

impl Published {
    /// Begins to publish the map, where there is a bus, and to record what is published.
    pub(super) fn start(setup: &Setup, vehicle_from_sensor: Pose) -> anyhow::Result<Self> {
        let Some(bus) = &setup.bus else {
            return Ok(Self::default());
        };
        if let Some(recorder) = &setup.recorder {
            record_what_is_published(bus, recorder);
        }
        let alive = setup
            .part
            .roles()
            .iter()
            .map(|role| bus.declare_alive(role));
        Ok(Self {
            map: Some(Arc::new(bus.publish_map()?)),
            ros: bus.publish_ros(vehicle_from_sensor)?.map(Arc::new),
            alive: alive.collect::<Result<_, _>>()?,
        })
    }

    /// Of threads that the run goes on without.
    pub(super) fn heartbeats(&self) -> impl Iterator<Item = &Heartbeat> {
        let of_map = self.map.iter().flat_map(|map| map.heartbeats());
        of_map.chain(self.ros.iter().map(|ros| ros.heartbeat()))
    }
}

/// Deltas and the frame of the map go into the recording as they are published.
fn record_what_is_published(bus: &Bus, recorder: &Recorder) {
    let to = recorder.clone();
    bus.on_delta(Box::new(move |cloud, info| {
        to.record(clock::now(), Record::Delta { cloud, info });
    }));
    let to = recorder.clone();
    bus.on_static_transform(Box::new(move |transform| {
        to.record(clock::now(), Record::StaticTransform(transform));
    }));
}
