//! What `rmw_zenoh_cpp`, the ROS 2 middleware on zenoh, writes beside messages: names, keys,
//! liveliness tokens, attachments.
//!
//! From the sources of `ros2/rmw_zenoh` (branch `rolling`; Lyrical, Kilted and Jazzy write the same):
//! `liveliness_utils.cpp`, `attachment_helpers.cpp`, `qos.cpp`. Humble names no types by hash and
//! is not reached. Texts and bytes only; no session.

mod attachment;
mod keys;
mod names;
mod tokens;

pub use attachment::{ATTACHMENT_BYTES, Attachment, Gid};
pub use keys::{
    EndpointKind, MessageType, NAV_SAT_FIX, Node, ODOMETRY, POINT_CLOUD2, POSE_STAMPED,
    POSE_WITH_COVARIANCE_STAMPED, TF_MESSAGE, Topic,
};
pub use names::{NameError, namespace, topic_name};
pub use tokens::Endpoint;
