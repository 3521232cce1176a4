//! What the bus is told.

use std::path::PathBuf;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::BusError;
use crate::keys::Keys;
use crate::ros2;

/// Name of the vehicle unless one is configured.
pub const DEFAULT_NODE: &str = "vehicle";

/// Bytes of the longest name of the poses' frame: room is kept for that of the map's own frame.
const MAX_FRAME_ID_BYTES: usize =
    crate::ros::MAX_FRAME_ID_BYTES - crate::map_frame::LOCAL_SUFFIX.len();

/// Largest number that ROS 2 takes for a domain.
const MAX_ROS_DOMAIN_ID: u32 = 232;

/// Configuration of the bus; [`BusConfig::check`] says what each key may hold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BusConfig {
    /// First part of every key.
    pub prefix: String,
    /// The vehicle's name, second part of every key.
    pub node: String,
    /// zenoh configuration (`.json5`, `.json`, `.yaml`) in place of the safe default; also named
    /// by the environment variable `ZENOH_CONFIG`, which this goes before.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zenoh_config_file: Option<PathBuf>,
    /// Single settings on top: path separated by slashes, and value in JSON5.
    pub zenoh: Vec<(String, String)>,
    /// Name of the poses' frame; a map whose origin is not that of the poses has its own, with
    /// `_local` behind this.
    pub frame_id: String,
    /// `ROS_DOMAIN_ID` of the ROS 2 nodes that map, odometry and transforms are published for, and
    /// that poses may come from; without one, none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ros_domain_id: Option<u32>,
    /// Whether transforms are published for ROS; off where others say where the vehicle is.
    pub ros_tf: bool,
    /// Most bytes of one map message, payload and attachment.
    pub max_message_bytes: usize,
    /// Largest message that is received.
    pub max_received_bytes: usize,
    /// Most that live deltas take of the link, bits per second.
    pub bandwidth_bps: u64,
    /// Shortest time between two rounds of deltas, seconds.
    pub publish_interval_s: f64,
    /// Side of a map tile, metres.
    pub tile_edge_m: f64,
    /// Poses that wait to be taken; beyond that the newest is dropped and counted.
    pub pose_queue_len: usize,
    /// Pings that wait to be sent or taken; beyond that the newest is dropped and counted.
    pub ping_queue_len: usize,
    /// Bytes of the newest records that a driver keeps for a mapper elsewhere; the oldest go first.
    pub history_bytes: usize,
    /// Most Gaussians a subscriber holds.
    pub max_gaussians: usize,
    /// How long a query for the map may take, seconds.
    pub query_timeout_s: f64,
    /// A subscriber that heard nothing for this long asks whether it still is up to date, seconds.
    pub idle_check_s: f64,
    /// How long opening may take, seconds.
    pub open_timeout_s: f64,
    /// How long closing may take, seconds; zenoh itself gives up after 10 s.
    pub close_timeout_s: f64,
}

impl Default for BusConfig {
    fn default() -> Self {
        Self {
            prefix: "echosplat".to_owned(),
            node: DEFAULT_NODE.to_owned(),
            zenoh_config_file: None,
            zenoh: Vec::new(),
            frame_id: "map".to_owned(),
            ros_domain_id: None,
            ros_tf: true,
            // One zenoh batch of 65,535 bytes holds it, so that it goes or is lost as one.
            max_message_bytes: 64_000,
            max_received_bytes: 1 << 20,
            bandwidth_bps: 4_000_000,
            publish_interval_s: 0.05,
            tile_edge_m: 4.0,
            pose_queue_len: 65_536,
            ping_queue_len: 256,
            // 13 minutes of 58 pings/s of 600 bins and 50 poses/s.
            history_bytes: 64 << 20,
            max_gaussians: 2_000_000,
            // A map of 200,000 Gaussians takes 10 s on a tether of 10 Mbit/s.
            query_timeout_s: 60.0,
            idle_check_s: 1.0,
            open_timeout_s: 15.0,
            close_timeout_s: 3.0,
        }
    }
}

impl BusConfig {
    /// # Errors
    /// Names the first key out of range and what it may hold.
    pub fn check(&self) -> Result<(), BusError> {
        Keys::new(&self.prefix, &self.node)?;
        self.check_ros()?;
        let count = |key, found: usize, low: usize, high: usize, allowed| {
            within(
                key,
                found.to_string(),
                (low..=high).contains(&found),
                allowed,
            )
        };
        let number = |key, found: f64, low: f64, high: f64, allowed| {
            within(
                key,
                found.to_string(),
                found >= low && found <= high,
                allowed,
            )
        };
        let message = self.max_message_bytes;
        count(
            "max_message_bytes",
            message,
            4096,
            262_144,
            "4096 to 262144",
        )?;
        let received = self.max_received_bytes;
        count(
            "max_received_bytes",
            received,
            262_144,
            1 << 26,
            "262144 to 67108864",
        )?;
        let bandwidth_fits = (10_000..=10_000_000_000).contains(&self.bandwidth_bps);
        let bandwidth = self.bandwidth_bps.to_string();
        within(
            "bandwidth_bps",
            bandwidth,
            bandwidth_fits,
            "10000 to 10000000000",
        )?;
        number(
            "publish_interval_s",
            self.publish_interval_s,
            0.01,
            10.0,
            "0.01 to 10",
        )?;
        number("tile_edge_m", self.tile_edge_m, 0.1, 1000.0, "0.1 to 1000")?;
        count(
            "pose_queue_len",
            self.pose_queue_len,
            1,
            1 << 20,
            "1 to 1048576",
        )?;
        count(
            "ping_queue_len",
            self.ping_queue_len,
            1,
            65_536,
            "1 to 65536",
        )?;
        count(
            "history_bytes",
            self.history_bytes,
            1 << 20,
            1 << 30,
            "1048576 to 1073741824",
        )?;
        count(
            "max_gaussians",
            self.max_gaussians,
            1,
            1 << 26,
            "1 to 67108864",
        )?;
        number(
            "query_timeout_s",
            self.query_timeout_s,
            0.1,
            600.0,
            "0.1 to 600",
        )?;
        number(
            "idle_check_s",
            self.idle_check_s,
            0.05,
            600.0,
            "0.05 to 600",
        )?;
        number(
            "open_timeout_s",
            self.open_timeout_s,
            0.5,
            600.0,
            "0.5 to 600",
        )?;
        number(
            "close_timeout_s",
            self.close_timeout_s,
            0.1,
            60.0,
            "0.1 to 60",
        )?;
        let frame = &self.frame_id;
        let frame_fits = frame.len() <= MAX_FRAME_ID_BYTES && !frame.contains('\0');
        within(
            "frame_id",
            format!("{frame:?}"),
            frame_fits,
            "at most 249 bytes without NUL",
        )
    }

    /// # Errors
    /// If ROS has no such domain, or takes no name made of prefix and node.
    fn check_ros(&self) -> Result<(), BusError> {
        let Some(domain_id) = self.ros_domain_id else {
            return Ok(());
        };
        let is_domain = domain_id <= MAX_ROS_DOMAIN_ID;
        within(
            "ros_domain_id",
            domain_id.to_string(),
            is_domain,
            "0 to 232",
        )?;
        ros2::check(self)
    }

    /// The same under a node of its own, unless a node was named: for what is not the vehicle's live
    /// service (`replay`, `demo`), so that it can run beside that on one bus without either's poses
    /// and maps getting into the other's.
    #[must_use]
    pub fn under_own_node(mut self, node: &str) -> Self {
        if self.node == DEFAULT_NODE {
            node.clone_into(&mut self.node);
        }
        self
    }

    pub(crate) fn close_timeout(&self) -> Duration {
        Duration::from_secs_f64(self.close_timeout_s)
    }
}

fn within(
    key: &'static str,
    found: String,
    fits: bool,
    allowed: &'static str,
) -> Result<(), BusError> {
    match fits {
        true => Ok(()),
        false => Err(BusError::Config {
            key,
            found,
            allowed,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed() {
        assert!(BusConfig::default().check().is_ok());
    }

    #[test]
    fn a_node_of_its_own_gives_way_to_one_that_was_named() {
        let own = BusConfig::default().under_own_node("replay");
        assert_eq!(own.node, "replay");
        assert!(own.check().is_ok());
        let named = BusConfig {
            node: "rov-1".to_owned(),
            ..BusConfig::default()
        };
        assert_eq!(named.under_own_node("replay").node, "rov-1");
    }

    #[test]
    fn what_is_out_of_range_is_named() {
        let refusal = |change: &dyn Fn(&mut BusConfig)| {
            let mut config = BusConfig::default();
            change(&mut config);
            config.check().unwrap_err().to_string()
        };
        assert!(refusal(&|c| c.tile_edge_m = f64::NAN).contains("tile_edge_m"));
        assert!(refusal(&|c| c.bandwidth_bps = 0).contains("bandwidth_bps"));
        assert!(refusal(&|c| c.max_message_bytes = 1 << 30).contains("4096 to 262144"));
        assert!(refusal(&|c| c.frame_id = "m".repeat(250)).contains("frame_id"));
        assert!(refusal(&|c| c.node = "a/b".to_owned()).contains("node"));
        assert!(refusal(&|c| c.ros_domain_id = Some(233)).contains("0 to 232"));
    }

    #[test]
    fn names_that_ros_does_not_take_are_refused_where_ros_is_asked_for() {
        let named = |prefix: &str, node: &str, ros_domain_id| BusConfig {
            prefix: prefix.to_owned(),
            node: node.to_owned(),
            ros_domain_id,
            ..BusConfig::default()
        };
        for (prefix, node, key) in [
            ("echosplat", "450", "bus.node"),
            ("9/a", "rov", "bus.prefix"),
        ] {
            assert!(named(prefix, node, None).check().is_ok());
            let refused = named(prefix, node, Some(0))
                .check()
                .unwrap_err()
                .to_string();
            assert!(refused.starts_with(key), "{refused}");
            assert!(refused.contains("letter"), "{refused}");
        }
        assert!(named("sea", "rov-1", Some(232)).check().is_ok());
    }
}
