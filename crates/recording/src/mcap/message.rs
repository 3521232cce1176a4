//! Records to the bytes of their messages, and back.

use std::borrow::Cow;
use std::sync::Arc;

use bytes::Bytes;
use echosplat_model::{StampedPose, Timestamp};
use echosplat_ros::odometry;
use mcap::records::MessageHeader;
use serde_json::{Value, json};

use super::Record;
use super::topic::Topic;

/// The vehicle's frame in recorded poses.
const CHILD_FRAME_ID: &str = "base_link";
/// Encapsulation of CDR and the count of bytes behind it.
pub(super) const RAW_HEAD_BYTES: usize = 8;
/// Seconds that a ROS stamp saturates at.
const LAST_ROS_SECOND: i64 = i32::MAX as i64;
const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// One message to write.
pub(super) struct Message<'a> {
    pub(super) topic: Topic,
    /// Of a pose its epoch, so that each pose stands alone; else counted by the writer.
    pub(super) sequence: Option<u32>,
    /// Of a pose its time of validity; else the log time.
    pub(super) publish_time: Option<Timestamp>,
    pub(super) bytes: Cow<'a, [u8]>,
}

/// The messages of a record, in the order they are written.
pub(super) fn messages_of<'a>(record: &'a Record, frame_id: &str) -> Vec<Message<'a>> {
    match record {
        Record::LinkUp => vec![link("up")],
        Record::LinkDown => vec![link("down")],
        Record::HalfFrameExpired => vec![link("half_frame_expired")],
        Record::Raw(bytes) => vec![message(Topic::Raw, raw(bytes))],
        Record::Pose(pose) => vec![Message {
            sequence: Some(pose.epoch),
            publish_time: Some(pose.time),
            ..message(
                Topic::Pose,
                odometry::encode(pose, frame_id, CHILD_FRAME_ID),
            )
        }],
        Record::Settings(toml) => vec![document(Topic::Settings, &json!({ "toml": toml }))],
        Record::Event(event) => vec![document(Topic::Events, event)],
        Record::Status(status) => vec![document(Topic::Status, status)],
        Record::Delta { cloud, info } => vec![
            message(Topic::Delta, &cloud[..]),
            message(Topic::DeltaInfo, &info[..]),
        ],
        Record::StaticTransform(bytes) => vec![message(Topic::StaticTransform, &bytes[..])],
    }
}

/// Name of the event that says it.
pub(super) const POSE_EPOCH: &str = "pose_epoch";

/// Said before the first pose of each epoch: the message of a pose has no field for it.
pub(super) fn epoch_event(epoch: u32) -> Record {
    Record::Event(json!({ "event": POSE_EPOCH, "epoch": epoch }))
}

fn message<'a>(topic: Topic, bytes: impl Into<Cow<'a, [u8]>>) -> Message<'a> {
    Message {
        topic,
        sequence: None,
        publish_time: None,
        bytes: bytes.into(),
    }
}

fn document(topic: Topic, value: &Value) -> Message<'static> {
    message(topic, value.to_string().into_bytes())
}

fn link(news: &str) -> Message<'static> {
    document(Topic::Link, &json!({ "link": news }))
}

fn raw(bytes: &[u8]) -> Vec<u8> {
    let count = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
    [&[0, 1, 0, 0][..], &count.to_le_bytes(), bytes].concat()
}

/// Whether these first bytes of a raw message say that it has so many bytes in all: what came from
/// the sonar may look like anything, records of this file too, but this count is ours.
pub(super) fn is_raw_of(head: &[u8], byte_count: usize) -> bool {
    let count = u32::try_from(byte_count.wrapping_sub(RAW_HEAD_BYTES));
    count.is_ok_and(|count| head == raw_head(count))
}

fn raw_head(count: u32) -> [u8; RAW_HEAD_BYTES] {
    let mut head = [0, 1, 0, 0, 0, 0, 0, 0];
    head[4..].copy_from_slice(&count.to_le_bytes());
    head
}

/// Puts messages together to records.
#[derive(Debug, Default)]
pub(super) struct Assembler {
    /// A cloud waits for what is said of it.
    cloud: Option<Arc<[u8]>>,
}

/// What a message made.
pub(super) enum Made {
    Record(Record),
    /// The first half of one.
    Half,
    /// Its bytes are none of its kind, or its other half is gone.
    Undecodable,
}

impl Assembler {
    pub(super) fn take(&mut self, topic: Topic, header: &MessageHeader, bytes: &Bytes) -> Made {
        let made = match topic {
            Topic::Delta => {
                let before = self.cloud.replace(Arc::from(&bytes[..]));
                return match before {
                    Some(_) => Made::Undecodable,
                    None => Made::Half,
                };
            }
            Topic::DeltaInfo => self.cloud.take().map(|cloud| Record::Delta {
                cloud,
                info: Arc::from(&bytes[..]),
            }),
            _ => record_of(topic, header, bytes),
        };
        made.map_or(Made::Undecodable, Made::Record)
    }
}

fn record_of(topic: Topic, header: &MessageHeader, bytes: &Bytes) -> Option<Record> {
    let value = || serde_json::from_slice::<Value>(bytes).ok();
    match topic {
        Topic::Raw => {
            let head = bytes.get(..RAW_HEAD_BYTES)?;
            is_raw_of(head, bytes.len()).then(|| Record::Raw(bytes.slice(RAW_HEAD_BYTES..)))
        }
        Topic::Link => match value()?["link"].as_str()? {
            "up" => Some(Record::LinkUp),
            "down" => Some(Record::LinkDown),
            "half_frame_expired" => Some(Record::HalfFrameExpired),
            _ => None,
        },
        Topic::Pose => pose_of(header, bytes).map(Record::Pose),
        Topic::Settings => Some(Record::Settings(value()?["toml"].as_str()?.to_owned())),
        Topic::Events => value().map(Record::Event),
        Topic::Status => value().map(Record::Status),
        Topic::StaticTransform => Some(Record::StaticTransform(Arc::from(&bytes[..]))),
        Topic::Delta | Topic::DeltaInfo => None,
    }
}

/// `None` for what is no pose.
fn pose_of(header: &MessageHeader, bytes: &[u8]) -> Option<StampedPose> {
    let mut pose = odometry::decode(bytes).ok()?;
    pose.epoch = header.sequence;
    if pose.time.nanos().div_euclid(NANOS_PER_SECOND) == LAST_ROS_SECOND {
        pose.time = time_of(header.publish_time);
    }
    let rotation = pose.world_from_vehicle.rotation;
    let is_pose = rotation.length() > 1e-6 && pose.world_from_vehicle.is_finite();
    is_pose.then_some(pose)
}

pub(super) fn time_of(nanos: u64) -> Timestamp {
    Timestamp::from_nanos(i64::try_from(nanos).unwrap_or(i64::MAX))
}

/// Times before 1970 are written as 1970.
pub(super) fn nanos_of(time: Timestamp) -> u64 {
    u64::try_from(time.nanos()).unwrap_or(0)
}
