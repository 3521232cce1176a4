//! The map, pings, poses and status over zenoh.
//!
//! Keys, `<prefix>` being `echosplat` and `<node>` the vehicle's name unless configured:
//!
//! | key | kind | payload |
//! |---|---|---|
//! | `<prefix>/<node>/pose` | subscribed | see [`pose_message`] |
//! | `<prefix>/<node>/sonar/ping` | published | the raw Ping frame; attachment `{"host_time_ns": …}` |
//! | `<prefix>/<node>/driver/tape` | queryable | what a driver hears, for a mapper elsewhere; `?driver=E;from=N` |
//! | `<prefix>/<node>/driver/status` | published | JSON, of a driver apart from its mapper |
//! | `<prefix>/<node>/map/delta/<tile>` | published | see [`point_cloud`] and [`map_message`] |
//! | `<prefix>/<node>/map/snapshot` | queryable | the same; `?bbox=x0,y0,z0,x1,y1,z1;since=N;epoch=E`. Ask with consolidation `None`: all replies bear one key |
//! | `<prefix>/<node>/tf_static` | published and queryable | where the map's own frame lies, `tf2_msgs/msg/TFMessage` in CDR; only if it has one |
//! | `<prefix>/<node>/status` | published | JSON |
//! | `<prefix>/<node>/alive` | liveliness token | of the service that maps |
//! | `<prefix>/<node>/alive/<role>/<zid>` | liveliness token | of the session with this zenoh id, in this role |
//!
//! A map that begins within 10 km of the poses' origin is in the poses' frame (`frame_id`, `map`):
//! clouds overlay poses as they are. Any other is in a frame of its own, `<frame_id>_local`, and
//! `tf_static` says where that lies; its `origin_m` says the same.
//!
//! `README.md` beside this says the same to those who write other programs.
//!
//! On request the session is a node of ROS 2 too ([`Bus::publish_ros`]); `docs/live.md` says what
//! it has there.
//!
//! Live deltas are sent with congestion control Drop and below a bandwidth, so one can be lost; they
//! go slower once somebody missed one (`publisher/pace.rs`).
//! A subscriber therefore buffers deltas, asks for the snapshot, applies deltas with a larger
//! sequence, and asks again after a gap, a new epoch, or a while of silence; its answer says
//! `final` once the publisher has flushed, and then both ends hold the same map bit for bit.
//!
//! Peers do not relay for one another: of several programs on one machine, those reach each other
//! of which one listens at the common endpoint, that is, each reaches the one started first. With
//! more than that, run a zenoh router there and make them its clients (mode `client`): two peers do
//! not meet through it, since gossip is off.
//!
//! Everything here is called from ordinary threads, none of it from inside a runtime; own threads
//! are named. Deliberately absent: async functions, storage plugins, zenoh's unstable features,
//! and any reading of the clock for the data's sake (pacing, time limits and when a message
//! arrived aside).

mod alive;
mod bus;
mod cdr;
mod config;
pub mod delta;
mod encoder;
mod endpoints;
mod error;
mod keys;
mod listening;
mod map_frame;
pub mod map_message;
pub mod point_cloud;
pub mod pose_message;
mod publisher;
mod publishers;
mod reach;
mod ros;
mod ros2;
mod streams;
mod subscriber;
mod tape;
mod taps;
mod zenoh_config;

pub use alive::{AliveToken, DRIVER_ROLE, MAPPER_ROLE, gives_way};
pub use bus::{Bus, BusCounters};
pub use cdr::CdrError;
pub use config::{BusConfig, DEFAULT_NODE};
pub use encoder::{DeltaMessage, MapEncoder};
pub use endpoints::{Endpoints, NotListening};
pub use error::BusError;
pub use keys::Keys;
pub use listening::free_port;
pub use map_frame::MapFrame;
pub use publisher::{FlushReport, MapPublisher, MapPublisherCounters, Sent};
pub use publishers::{PublishedTopic, Publisher};
pub use reach::Unreached;
pub use ros2::{RosCounters, RosPublisher};
pub use streams::{
    MessageSubscription, PingCounters, PingSubscription, PoseCounters, PoseSubscription,
    ReceivedMessage, ReceivedPing, ReceivedPose, StatusSubscription,
};
pub use subscriber::{Liveliness, MapSubscriber, MapSubscriberCounters, MapWaitError};
pub use tape::{
    Heard, TapeEntry, TapeFollower, TapeFollowerCounters, TapeKeeper, TapeKeeperCounters,
    TapeMessageError, TapeRecord, TapeTrouble,
};
pub use taps::{DeltaTap, StaticTransformTap};
pub use zenoh_config::LOOPBACK;

#[cfg(test)]
mod end_to_end;
#[cfg(test)]
mod test_support;
