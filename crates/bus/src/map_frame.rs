//! Which frame a map's points are in, and where that frame lies in the poses'.
//!
//! A map with origin 0 0 0 is in the poses' own frame, so that clouds, poses and track overlay in
//! viewers that know nothing of origins. Any other has a frame of its own, `<frame_id>_local`,
//! whose place is told as a ROS static transform: `tf2_msgs/msg/TFMessage` in CDR.

use echosplat_model::{Pose, Timestamp};
use echosplat_ros::transform::{self, Transform};
use glam::DVec3;

use crate::ros::Header;

/// What a map's own frame is called: the poses' frame with this behind it.
pub(crate) const LOCAL_SUFFIX: &str = "_local";

/// The frame of a map's points.
#[derive(Debug, Clone, PartialEq)]
pub struct MapFrame {
    poses_frame_id: String,
    origin_m: DVec3,
}

impl MapFrame {
    /// Encoding of [`MapFrame::static_transform`] on the bus.
    pub const ENCODING: &'static str = "application/cdr;tf2_msgs/msg/TFMessage";

    /// `poses_frame_id` names the frame of the poses, in which the map's origin lies at `origin_m`.
    #[must_use]
    pub fn new(poses_frame_id: &str, origin_m: DVec3) -> Self {
        Self {
            poses_frame_id: poses_frame_id.to_owned(),
            origin_m,
        }
    }

    /// Whether the map's points are in the poses' own frame.
    #[must_use]
    pub fn is_that_of_poses(&self) -> bool {
        self.origin_m == DVec3::ZERO
    }

    /// Its name.
    #[must_use]
    pub fn frame_id(&self) -> String {
        match self.is_that_of_poses() {
            true => self.poses_frame_id.clone(),
            false => format!("{}{LOCAL_SUFFIX}", self.poses_frame_id),
        }
    }

    /// The place of the map's own frame in the poses', metres, without a turn; `None` if the map
    /// is in the poses' frame. The bytes are a `tf2_msgs/msg/TFMessage` with one transform.
    #[must_use]
    pub fn static_transform(&self, stamp: Timestamp) -> Option<Vec<u8>> {
        if self.is_that_of_poses() {
            return None;
        }
        Some(transform::encode(&[Transform {
            header: Header {
                stamp,
                frame_id: &self.poses_frame_id,
            },
            child_frame_id: &self.frame_id(),
            outer_from_child: self.place(),
        }]))
    }

    /// The map's own frame in the poses', without a turn.
    pub(crate) fn place(&self) -> Pose {
        Pose {
            translation_m: self.origin_m,
            ..Pose::IDENTITY
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cdr::CdrReader;

    #[test]
    fn a_map_at_the_poses_origin_is_in_their_frame_and_needs_no_transform() {
        let frame = MapFrame::new("map", DVec3::ZERO);
        assert_eq!(frame.frame_id(), "map");
        assert_eq!(frame.static_transform(Timestamp::ZERO), None);
    }

    #[test]
    fn the_transform_says_where_the_maps_own_frame_lies() {
        let origin_m = DVec3::new(500_000.125, -6_000_000.1, 3.0);
        let stamp = Timestamp::from_nanos(1_700_000_000_000_000_001);
        let frame = MapFrame::new("map", origin_m);
        let bytes = frame.static_transform(stamp).unwrap();
        let mut reader = CdrReader::new(&bytes).unwrap();
        assert_eq!(reader.u32("transforms"), Ok(1));
        let header = Header::read(&mut reader).unwrap();
        assert_eq!((header.stamp, header.frame_id), (stamp, "map"));
        assert_eq!(reader.string("child_frame_id", 255), Ok("map_local"));
        assert_eq!(reader.f64s("translation"), Ok(origin_m.to_array()));
        assert_eq!(reader.f64s("rotation"), Ok([0.0, 0.0, 0.0, 1.0]));
        assert_eq!(reader.finish(), Ok(()));
    }

    #[test]
    fn its_bytes_are_those_worked_out_by_hand() {
        let frame = MapFrame::new("m", DVec3::X);
        let bytes = frame.static_transform(Timestamp::ZERO).unwrap();
        // Count 1, seconds, nanoseconds, "m" with its NUL and two bytes of padding, then
        // "m_local" with its NUL: 32 bytes behind the encapsulation, which f64 needs no more of.
        assert_eq!(bytes[4..8], [1, 0, 0, 0]);
        assert_eq!(bytes[16..24], [2, 0, 0, 0, b'm', 0, 0, 0]);
        assert_eq!(bytes[24..36], *b"\x08\0\0\0m_local\0");
        assert_eq!(bytes[36..44], 1.0_f64.to_le_bytes());
        assert_eq!(bytes[84..], 1.0_f64.to_le_bytes());
    }
}
