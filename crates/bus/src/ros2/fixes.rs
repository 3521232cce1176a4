//! Fixes of a satellite receiver from a topic of ROS 2.

use echosplat_ros::rmw_zenoh::{NAV_SAT_FIX, topic_name};
use zenoh::liveliness::LivelinessToken;

use super::node::topic_of_others;
use crate::BusError;
use crate::bus::Link;

/// A topic of `sensor_msgs/msg/NavSatFix`; nodes are told that it is taken as long as this is held.
#[derive(Debug)]
pub(crate) struct FixTopic {
    /// Of its messages, whatever hash their sender has of their type.
    pub(crate) key: String,
    _token: LivelinessToken,
}

impl FixTopic {
    pub(crate) fn open(link: &Link, topic: &str) -> Result<Self, BusError> {
        let name = topic_name(topic).map_err(|error| BusError::RosTopic(error.to_string()))?;
        let node = link.ros.node(link)?;
        let topic = topic_of_others(name, NAV_SAT_FIX);
        Ok(Self {
            key: topic.key_of_any_hash(node.domain_id()),
            _token: node.subscribes(&topic)?,
        })
    }
}
