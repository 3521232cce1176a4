//! What is made from a session: what publishes, and what subscribes.

use std::sync::Arc;

use echosplat_model::Pose;

use super::Bus;
use crate::BusError;
use crate::publisher::MapPublisher;
use crate::ros2::{FixTopic, PoseTopic, RosPublisher};
use crate::streams::{MessageSubscription, PingSubscription, PoseSubscription, StatusSubscription};
use crate::subscriber::MapSubscriber;
use crate::tape::{TapeFollower, TapeKeeper};
use crate::taps::{DeltaTap, StaticTransformTap};

impl Bus {
    /// Hands each delta message that is published from the next [`Bus::publish_map`] on to `tap`,
    /// as it goes out, whether or not anybody subscribes: the cloud (CDR of
    /// `sensor_msgs/msg/PointCloud2`) and the attachment (JSON). Called on the publishing thread,
    /// and must not wait.
    pub fn on_delta(&self, tap: DeltaTap) {
        self.link.taps.edit().delta = Some(Arc::new(tap));
    }

    /// Hands the place of the map's own frame (CDR of `tf2_msgs/msg/TFMessage`) to `tap`, before
    /// the first delta of each epoch that has such a frame. As [`Bus::on_delta`] otherwise.
    pub fn on_static_transform(&self, tap: StaticTransformTap) {
        self.link.taps.edit().static_transform = Some(Arc::new(tap));
    }

    /// Starts to publish the map.
    ///
    /// # Errors
    /// If zenoh refuses, or no thread can be started.
    pub fn publish_map(&self) -> Result<MapPublisher, BusError> {
        MapPublisher::start(&self.link)
    }

    /// Starts to publish map, odometry and transforms for ROS 2, if a domain of it is configured;
    /// `vehicle_from_sensor` is where the sonar sits.
    ///
    /// # Errors
    /// If zenoh refuses, or no thread can be started.
    pub fn publish_ros(&self, vehicle_from_sensor: Pose) -> Result<Option<RosPublisher>, BusError> {
        let is_asked = self.link.config.ros_domain_id.is_some();
        let publisher = is_asked.then(|| RosPublisher::start(&self.link, vehicle_from_sensor));
        publisher.transpose()
    }

    /// Starts to follow the map of this prefix and node.
    ///
    /// # Errors
    /// If zenoh refuses, or no thread can be started.
    pub fn subscribe_map(&self) -> Result<MapSubscriber, BusError> {
        MapSubscriber::start(&self.link)
    }

    /// Starts to take poses.
    ///
    /// # Errors
    /// If zenoh refuses.
    pub fn subscribe_poses(&self) -> Result<PoseSubscription, BusError> {
        PoseSubscription::start(&self.link, &self.link.keys.pose())
    }

    /// Starts to take poses from a key of another program.
    ///
    /// # Errors
    /// If zenoh refuses, for example a text that is no key.
    pub fn subscribe_poses_on(&self, key: &str) -> Result<PoseSubscription, BusError> {
        PoseSubscription::start(&self.link, key)
    }

    /// Starts to take poses from a topic of ROS 2: `nav_msgs/msg/Odometry`,
    /// `geometry_msgs/msg/PoseStamped` or `geometry_msgs/msg/PoseWithCovarianceStamped`.
    ///
    /// # Errors
    /// If no domain of ROS is configured, it is no topic that poses can come from, or zenoh refuses.
    pub fn subscribe_poses_of_ros(&self, topic: &str) -> Result<PoseSubscription, BusError> {
        PoseSubscription::on_topic(&self.link, PoseTopic::open(&self.link, topic)?)
    }

    /// Starts to take the messages of a topic of ROS 2, `sensor_msgs/msg/NavSatFix` in CDR.
    ///
    /// # Errors
    /// If no domain of ROS is configured, it is no name of a topic, or zenoh refuses.
    pub fn subscribe_fixes_of_ros(&self, topic: &str) -> Result<MessageSubscription, BusError> {
        MessageSubscription::on_topic(&self.link, FixTopic::open(&self.link, topic)?)
    }

    /// Starts to take the messages of other programs on `keys`, which may be patterns.
    ///
    /// # Errors
    /// If zenoh refuses, for example a text that is no key.
    pub fn subscribe_messages(&self, keys: &[String]) -> Result<MessageSubscription, BusError> {
        MessageSubscription::start(&self.link, keys)
    }

    /// Starts to take raw Ping frames, for mapping on another machine.
    ///
    /// # Errors
    /// If zenoh refuses.
    pub fn subscribe_pings(&self) -> Result<PingSubscription, BusError> {
        PingSubscription::start(&self.link)
    }

    /// Starts to keep what a driver hears, for a mapper elsewhere. `driver` names this run of it, and
    /// `begin` is told to every mapper before anything else.
    ///
    /// # Errors
    /// If zenoh refuses, or no thread can be started.
    pub fn keep_tape(&self, driver: u64, begin: serde_json::Value) -> Result<TapeKeeper, BusError> {
        TapeKeeper::start(&self.link, driver, begin)
    }

    /// Follows what this node's driver hears.
    #[must_use]
    pub fn follow_tape(&self) -> TapeFollower {
        TapeFollower::new(&self.link)
    }

    /// Starts to take the service's status.
    ///
    /// # Errors
    /// If zenoh refuses.
    pub fn subscribe_status(&self) -> Result<StatusSubscription, BusError> {
        StatusSubscription::start(&self.link)
    }
}
