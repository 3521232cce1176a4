//! What the ROS messages of this crate share.

pub(crate) use echosplat_ros::{Header, MAX_FRAME_ID_BYTES};
