//! Poses inside logs: `MAVLink` in wrapper packets of a `.svlog`, pose messages in a foreign MCAP.

mod found;
mod frames;
mod mcap;
mod message;
mod protobuf;
mod ros1;
mod survey;
mod svlog;

pub use self::found::LogPosesError;
pub(crate) use self::mcap::cannot_read;
pub use self::mcap::{LogPoses, poses_of_mcap};
pub(crate) use self::ros1::Ros1Reader;
pub use self::survey::{McapSurvey, McapTopic, TopicPoses, survey_of_mcap};
pub use self::svlog::{SvlogPoses, poses_of_svlog};
