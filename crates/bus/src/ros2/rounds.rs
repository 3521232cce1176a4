//! The thread that puts map, odometry and transforms on their topics, in rounds of a second or two.

use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use echosplat_liveness::Heartbeat;
use echosplat_model::{Pose, Snapshot, StampedPose};
use echosplat_ros::transform::{self, Transform};
use echosplat_ros::{Header, odometry};
use zenoh::qos::Priority;

use super::cloud::{self, MAX_POINTS, POINT_BYTES};
use super::node::{RosNode, TopicPublisher, Topics};
use super::{Shared, lock};
use crate::bus::{Link, VEHICLE_FRAME_ID};
use crate::map_frame::MapFrame;
use crate::streams::now;
use crate::{BusConfig, BusError};

/// Name of the sonar's frame.
const SENSOR_FRAME_ID: &str = "sonar_link";

/// From round to round; the longer the more a cloud takes of the link.
const SHORTEST: Duration = Duration::from_secs(1);
const LONGEST: Duration = Duration::from_secs(2);

pub(super) struct Rounds {
    link: Arc<Link>,
    shared: Arc<Shared>,
    heartbeat: Heartbeat,
    vehicle_from_sensor: Pose,
    points: TopicPublisher,
    odometry: TopicPublisher,
    /// `None` where the vehicle's own programs say where its frames are.
    transforms: Option<TopicPublisher>,
}

/// What a round is to tell.
struct Work {
    map: Option<Arc<Snapshot>>,
    vehicle: Option<StampedPose>,
    flushes: u64,
    stop: bool,
}

impl Rounds {
    pub(super) fn new(
        link: &Arc<Link>,
        node: &Arc<RosNode>,
        shared: &Arc<Shared>,
        heartbeat: &Heartbeat,
        vehicle_from_sensor: Pose,
    ) -> Result<Self, BusError> {
        let transforms = link.config.ros_tf.then(Topics::transforms);
        let transforms = transforms.map(|topic| node.publisher(&topic, Priority::Data));
        Ok(Self {
            link: Arc::clone(link),
            shared: Arc::clone(shared),
            heartbeat: heartbeat.clone(),
            vehicle_from_sensor,
            // Behind what vehicles are steered by.
            points: node.publisher(&node.topics().points(), Priority::DataLow)?,
            odometry: node.publisher(&node.topics().odometry(), Priority::Data)?,
            transforms: transforms.transpose()?,
        })
    }

    /// Until the end; may be called again after a panic.
    pub(super) fn run(&mut self) {
        loop {
            let work = self.next_work();
            if work.stop {
                return;
            }
            self.heartbeat.beat();
            let begin = Instant::now();
            let cloud_bytes = self.round(&work);
            lock(&self.shared.orders).flushes_done = work.flushes;
            self.shared.flushed.notify_all();
            self.pause_until(begin + interval(cloud_bytes, self.link.config.bandwidth_bps));
        }
    }

    /// Waits until there is something to tell at all, a flush, or the end.
    fn next_work(&self) -> Work {
        let mut orders = lock(&self.shared.orders);
        self.heartbeat.rest();
        while !orders.is_urgent() && orders.map.is_none() && orders.vehicle.is_none() {
            let waited = self.shared.ordered.wait(orders);
            orders = waited.unwrap_or_else(PoisonError::into_inner);
        }
        Work {
            map: orders.map.clone(),
            vehicle: orders.vehicle,
            flushes: orders.flushes_asked,
            stop: orders.stop,
        }
    }

    /// Gives the bytes of the cloud.
    fn round(&mut self, work: &Work) -> usize {
        let now = now();
        let frame = work.map.as_ref().map(|map| self.frame_of(map));
        let sent_transforms = self.transforms.as_mut().map(|topic| {
            let mount = self.vehicle_from_sensor;
            let map = work.map.as_deref().zip(frame.as_ref());
            let message = transforms(&self.link.config, map, work.vehicle, mount);
            message.map(|message| topic.put(message, now))
        });
        let sent_odometry = work.vehicle.map(|vehicle| {
            let frame_id = &self.link.config.frame_id;
            let message = odometry::encode(&vehicle, frame_id, VEHICLE_FRAME_ID);
            self.odometry.put(message, now)
        });
        let cloud = work.map.as_deref().zip(frame.as_ref()).map(|(map, frame)| {
            let limit = most_points(self.link.config.bandwidth_bps);
            cloud::encode(map, &frame.frame_id(), limit)
        });
        let cloud_bytes = cloud.as_ref().map_or(0, |cloud| cloud.bytes.len());
        let mut counters = lock(&self.shared.counters);
        let mut count = |sent: Option<bool>, topic: fn(&mut super::RosCounters) -> &mut u64| {
            *topic(&mut counters) += u64::from(sent == Some(true));
            counters.failed += u64::from(sent == Some(false));
        };
        count(sent_transforms.flatten(), |counters| {
            &mut counters.transforms
        });
        count(sent_odometry, |counters| &mut counters.odometries);
        if let Some(cloud) = cloud {
            counters.points_left_out = cloud.left_out as u64;
            // The only one that may take a while.
            drop(counters);
            let is_sent = self.points.put(cloud.bytes, now);
            let mut counters = lock(&self.shared.counters);
            counters.clouds += u64::from(is_sent);
            counters.failed += u64::from(!is_sent);
        }
        cloud_bytes
    }

    fn frame_of(&self, map: &Snapshot) -> MapFrame {
        MapFrame::new(&self.link.config.frame_id, map.origin_m)
    }

    /// Sleeps, unless something urgent comes up.
    fn pause_until(&self, time: Instant) {
        self.heartbeat.rest();
        let mut orders = lock(&self.shared.orders);
        while !orders.is_urgent() {
            let left = time.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            let waited = self.shared.ordered.wait_timeout(orders, left);
            orders = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// Points of which a round of two seconds at this bandwidth has room.
fn most_points(bandwidth_bps: u64) -> usize {
    let bytes = LONGEST.as_secs_f64() * bandwidth_bps as f64 / 8.0;
    MAX_POINTS.min(bytes as usize / POINT_BYTES)
}

/// From one round to the next, so that clouds take no more than this bandwidth.
fn interval(cloud_bytes: usize, bandwidth_bps: u64) -> Duration {
    let seconds = 8.0 * cloud_bytes as f64 / bandwidth_bps as f64;
    Duration::from_secs_f64(seconds.min(LONGEST.as_secs_f64())).max(SHORTEST)
}

/// Where the vehicle is, the sonar on it, and the map's own frame if it has one; `None` if nothing
/// of it is known yet.
fn transforms(
    config: &BusConfig,
    map: Option<(&Snapshot, &MapFrame)>,
    vehicle: Option<StampedPose>,
    vehicle_from_sensor: Pose,
) -> Option<Vec<u8>> {
    let between = |frame_id, child_frame_id, stamp, pose| Transform {
        header: Header { stamp, frame_id },
        child_frame_id,
        outer_from_child: pose,
    };
    let world = config.frame_id.as_str();
    let mut found = Vec::with_capacity(3);
    if let Some(StampedPose {
        time,
        world_from_vehicle,
        ..
    }) = vehicle
    {
        found.push(between(world, VEHICLE_FRAME_ID, time, world_from_vehicle));
        found.push(between(
            VEHICLE_FRAME_ID,
            SENSOR_FRAME_ID,
            time,
            vehicle_from_sensor,
        ));
    }
    let map_frame_id = map.map(|(_, frame)| frame.frame_id());
    if let (Some((map, frame)), Some(frame_id)) = (map, &map_frame_id)
        && !frame.is_that_of_poses()
    {
        let time = vehicle.map_or(map.time, |vehicle| vehicle.time.max(map.time));
        found.push(between(world, frame_id, time, frame.place()));
    }
    (!found.is_empty()).then(|| transform::encode(&found))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cdr::CdrReader;
    use crate::test_support::snapshot;
    use echosplat_model::Timestamp;
    use glam::DVec3;

    #[test]
    fn clouds_take_no_more_than_the_bandwidth() {
        let seconds = |bytes, bps| interval(bytes, bps).as_secs_f64();
        assert!((seconds(0, 4_000_000) - 1.0).abs() < 1e-9);
        assert!((seconds(750_000, 4_000_000) - 1.5).abs() < 1e-9);
        assert!((seconds(9_000_000, 4_000_000) - 2.0).abs() < 1e-9);
        assert_eq!(most_points(4_000_000), MAX_POINTS);
        assert_eq!(most_points(400_000), MAX_POINTS / 10);
        assert_eq!(most_points(10_000_000_000), MAX_POINTS);
    }

    /// Outer frame, inner frame, stamp in seconds and x of each transform.
    fn read(bytes: &[u8]) -> Vec<(String, String, i64, f64)> {
        let mut reader = CdrReader::new(bytes).unwrap();
        let count = reader.u32("transforms").unwrap();
        let read = (0..count).map(|_| {
            let header = Header::read(&mut reader).unwrap();
            let outer = header.frame_id.to_owned();
            let child = reader.string("child", 255).unwrap().to_owned();
            let [x, ..] = reader.f64s::<7>("transform").unwrap();
            (outer, child, header.stamp.nanos() / 1_000_000_000, x)
        });
        read.collect()
    }

    #[test]
    fn frames_hang_together_from_the_map_to_the_sonar() {
        let config = BusConfig::default();
        let at = |x| Pose {
            translation_m: DVec3::new(x, 0.0, 0.0),
            ..Pose::IDENTITY
        };
        let vehicle = StampedPose {
            time: Timestamp::from_millis(5000),
            world_from_vehicle: at(2.0),
            uncertainty: None,
            epoch: 0,
        };
        let map = snapshot(1, 70, Vec::new()); // of 7 s, far from the origin
        let local = MapFrame::new("map", map.origin_m);
        let row = |outer: &str, child: &str, s, x| (outer.to_owned(), child.to_owned(), s, x);
        let of = |map, vehicle| transforms(&config, map, vehicle, at(0.25));
        let expected = [
            row("map", "base_link", 5, 2.0),
            row("base_link", "sonar_link", 5, 0.25),
            row("map", "map_local", 7, 500_000.125),
        ];
        let all = of(Some((&map, &local)), Some(vehicle)).unwrap();
        assert_eq!(read(&all), expected);
        let alone = of(Some((&map, &local)), None).unwrap();
        assert_eq!(read(&alone), expected[2..]);
        let near = MapFrame::new("map", DVec3::ZERO);
        let plain = of(Some((&map, &near)), Some(vehicle)).unwrap();
        assert_eq!(read(&plain), expected[..2]);
        assert_eq!(of(Some((&map, &near)), None), None);
    }
}
