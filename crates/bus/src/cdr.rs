//! CDR, as this crate's messages use it.

pub use echosplat_ros::CdrError;
pub(crate) use echosplat_ros::CdrReader;
#[cfg(test)]
pub(crate) use echosplat_ros::CdrWriter;
