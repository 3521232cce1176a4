//! Where poses come from.
//!
//! [`PoseSource`] yields poses from what a [`PoseUrl`] names: the bus, `MAVLink` over UDP, TCP, a
//! serial line or a server on the bus, a Water Linked DVL, or a TUM file; [`poses_of_svlog`] and
//! [`poses_of_mcap`] read those that a log holds, and [`survey_of_mcap`] says which there are. Each source
//! turns what it hears into the frames
//! of this program and, where it stamps with a clock of its own, puts the stamps on the pings'
//! clock. [`GnssSource`] takes fixes of a satellite receiver, which are no poses.
//!
//! Deliberately absent: any guess at a pose (a position is moved by its own velocity for half a second at most, and where
//! positions are reckoned the last velocity is carried on for six, with a sigma that grows), and any judgement of whether
//! poses make sense: `echosplat_join` does that, and says which goes with which ping.

mod advance;
mod bus_feed;
mod clock;
mod dvl;
mod fault;
mod gnss;
mod link;
mod log;
mod mavlink;
mod now;
mod only;
mod outlet;
mod reckon;
mod senders;
mod source;
mod source_task;
mod status;
mod tum_file;
mod url;

pub use gnss::{
    GNSS_URL_FORMS, GnssLog, GnssSource, GnssStatus, GnssUrl, GnssUrlError, fixes_of_mcap,
    fixes_of_svlog,
};
pub use log::{LogPoses, LogPosesError, SvlogPoses, poses_of_mcap, poses_of_svlog};
pub use log::{McapSurvey, McapTopic, TopicPoses, survey_of_mcap};
pub use mavlink::origin::{OriginEpochs, ToldOrigin};
pub use only::Only;
pub use source::{LivePoses, MadePoses, PoseSource, PoseSourceError};
pub use status::{PoseSender, PoseSourceStatus, Several};
pub use tum_file::FilePoses;
pub use url::{POSE_URL_FORMS, PoseUrl, PoseUrlError};
