//! One message of a foreign MCAP file to a pose, or to where frames lie in others.
//!
//! | encoding | messages |
//! |---|---|
//! | `cdr`, `ros1` | `Odometry`, `PoseStamped`, `PoseWithCovarianceStamped`, `TFMessage`, `foxglove_msgs/PoseInFrame` (CDR alone) |
//! | `json` | poses as this program takes them, `foxglove.PoseInFrame` |
//! | `protobuf` | `foxglove.PoseInFrame` |

use echosplat_bus::pose_message::{self, PoseMessage};
use echosplat_model::Timestamp;
use echosplat_recording::mcap::Channel;
use echosplat_ros::{CdrReader, Header, MAX_FRAME_ID_BYTES};
use serde::Deserialize;

use super::protobuf::{Field, fields};
use super::ros1::Ros1Reader;

/// Transforms of one message.
const MAX_TRANSFORMS: usize = 4096;
const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// How messages of a channel are read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Kind {
    /// As [`pose_message::decode`] takes it.
    Pose(String),
    Ros1Pose(Ros1Pose),
    PoseInFrame(Encoding),
    Transforms(Encoding),
}

/// Messages with a pose that ROS 1 writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ros1Pose {
    Odometry,
    Stamped,
    WithCovariance,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Cdr,
    Ros1,
    Json,
    Protobuf,
}

/// Where a frame lies in another.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Transform {
    pub(super) parent: String,
    pub(super) child: String,
    /// The child's pose in the parent, checked.
    pub(super) pose: PoseMessage,
}

impl Kind {
    /// `None` if no message of this channel can be a pose.
    pub(super) fn of(channel: &Channel) -> Option<Self> {
        let encoding = match channel.encoding.as_str() {
            "cdr" => Encoding::Cdr,
            "ros1" => Encoding::Ros1,
            "json" => Encoding::Json,
            "protobuf" => Encoding::Protobuf,
            _ => return None,
        };
        let schema = channel.schema.as_str();
        let name = schema.rsplit(['/', ':', '.']).next().unwrap_or(schema);
        Some(match (encoding, name) {
            (Encoding::Cdr | Encoding::Json | Encoding::Protobuf, "PoseInFrame") => {
                Self::PoseInFrame(encoding)
            }
            (Encoding::Cdr | Encoding::Ros1, "TFMessage" | "tfMessage") => {
                Self::Transforms(encoding)
            }
            (Encoding::Cdr, _) => Self::Pose(format!("application/cdr;{schema}")),
            (Encoding::Json, _) => Self::Pose(pose_message::JSON.to_owned()),
            (Encoding::Ros1, "Odometry") => Self::Ros1Pose(Ros1Pose::Odometry),
            (Encoding::Ros1, "PoseStamped") => Self::Ros1Pose(Ros1Pose::Stamped),
            (Encoding::Ros1, "PoseWithCovarianceStamped") => {
                Self::Ros1Pose(Ros1Pose::WithCovariance)
            }
            _ => return None,
        })
    }

    /// Whether its schema says that its messages have a pose.
    pub(super) fn is_by_schema(&self) -> bool {
        match self {
            Self::Pose(encoding) => encoding.contains("Pose") || encoding.contains("Odometry"),
            _ => true,
        }
    }

    /// The pose in a message.
    ///
    /// # Errors
    /// In words, what is wrong with it.
    pub(super) fn pose(&self, data: &[u8]) -> Result<PoseMessage, String> {
        match self {
            Self::Pose(encoding) => {
                pose_message::decode(encoding, data).map_err(|error| error.to_string())
            }
            Self::Ros1Pose(kind) => ros1_pose(*kind, data),
            Self::PoseInFrame(Encoding::Json) => pose_in_frame_json(data),
            Self::PoseInFrame(Encoding::Protobuf) => pose_in_frame_protobuf(data),
            Self::PoseInFrame(_) => pose_in_frame_cdr(data),
            Self::Transforms(_) => Err("where frames lie, and no pose".to_owned()),
        }
    }
}

/// The transforms in a `TFMessage`.
///
/// # Errors
/// In words, what is wrong with it.
pub(super) fn transforms(encoding: Encoding, data: &[u8]) -> Result<Vec<Transform>, String> {
    let mut found = Vec::new();
    if encoding == Encoding::Ros1 {
        let mut reader = Ros1Reader::new(data);
        let count = reader.count(MAX_TRANSFORMS)?;
        for _ in 0..count {
            let (stamp, parent) = reader.header()?;
            let child = reader.string()?;
            let (place, turn) = (reader.f64s()?, reader.f64s()?);
            found.push(transform(stamp, parent, child, (place, turn))?);
        }
        return Ok(found);
    }
    let wrong = |error: echosplat_ros::CdrError| error.to_string();
    let mut reader = CdrReader::new(data).map_err(wrong)?;
    let count = reader.count("transforms", MAX_TRANSFORMS).map_err(wrong)?;
    for _ in 0..count {
        let header = Header::read(&mut reader).map_err(wrong)?;
        let child = reader.string("child_frame_id", MAX_FRAME_ID_BYTES);
        let child = child.map_err(wrong)?;
        let place = reader.f64s("transform.translation").map_err(wrong)?;
        let turn = reader.f64s("transform.rotation").map_err(wrong)?;
        found.push(transform(
            header.stamp,
            header.frame_id,
            child,
            (place, turn),
        )?);
    }
    Ok(found)
}

fn transform(
    stamp: Timestamp,
    parent: &str,
    child: &str,
    (place, turn): ([f64; 3], [f64; 4]),
) -> Result<Transform, String> {
    // ROS 1 wrote names with a slash before.
    let [parent, child] = [parent, child].map(|name| name.trim_start_matches('/'));
    Ok(Transform {
        parent: parent.to_owned(),
        child: child.to_owned(),
        pose: checked(stamp, [parent, child], (place, turn), None)?,
    })
}

fn checked(
    stamp: Timestamp,
    frames: [&str; 2],
    place_and_turn: ([f64; 3], [f64; 4]),
    covariance: Option<&[f64; 36]>,
) -> Result<PoseMessage, String> {
    pose_message::checked(stamp, frames, place_and_turn, covariance.copied())
        .map_err(|error| error.to_string())
}

fn ros1_pose(kind: Ros1Pose, data: &[u8]) -> Result<PoseMessage, String> {
    let mut reader = Ros1Reader::new(data);
    let (stamp, frame) = reader.header()?;
    let child = match kind {
        Ros1Pose::Odometry => reader.string()?,
        _ => "",
    };
    let pose = (reader.f64s()?, reader.f64s()?);
    let covariance = match kind {
        Ros1Pose::Stamped => None,
        _ => Some(reader.f64s()?),
    };
    checked(stamp, [frame, child], pose, covariance.as_ref())
}

fn pose_in_frame_cdr(data: &[u8]) -> Result<PoseMessage, String> {
    let read = || {
        let mut reader = CdrReader::new(data)?;
        let header = Header::read(&mut reader)?;
        let place = reader.f64s("pose.position")?;
        let turn = reader.f64s("pose.orientation")?;
        reader.finish()?;
        Ok((header, place, turn))
    };
    let read: Result<_, echosplat_ros::CdrError> = read();
    let (header, place, turn) = read.map_err(|error| error.to_string())?;
    checked(header.stamp, [header.frame_id, ""], (place, turn), None)
}

#[derive(Deserialize)]
struct PoseInFrame {
    timestamp: Stamp,
    #[serde(default)]
    frame_id: String,
    pose: PlaceAndTurn,
}

#[derive(Deserialize)]
struct Stamp {
    sec: i64,
    #[serde(default, alias = "nanosec", alias = "nanos")]
    nsec: i64,
}

#[derive(Deserialize)]
struct PlaceAndTurn {
    position: Vector,
    orientation: Quaternion,
}

#[derive(Deserialize)]
struct Vector {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Deserialize)]
struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

fn pose_in_frame_json(data: &[u8]) -> Result<PoseMessage, String> {
    let found: PoseInFrame = serde_json::from_slice(data).map_err(|error| error.to_string())?;
    let stamp = stamp_of(found.timestamp.sec, found.timestamp.nsec);
    let (p, q) = (&found.pose.position, &found.pose.orientation);
    let pose = ([p.x, p.y, p.z], [q.x, q.y, q.z, q.w]);
    checked(stamp, [&found.frame_id, ""], pose, None)
}

fn stamp_of(seconds: i64, nanos: i64) -> Timestamp {
    Timestamp::from_nanos(
        seconds
            .saturating_mul(NANOS_PER_SECOND)
            .saturating_add(nanos),
    )
}

/// `foxglove.PoseInFrame`: 1 a `google.protobuf.Timestamp`, 2 the frame, 3 a `foxglove.Pose` of 1 a
/// vector and 2 a quaternion; numbers that are 0 are left out.
fn pose_in_frame_protobuf(data: &[u8]) -> Result<PoseMessage, String> {
    let (mut seconds, mut nanos, mut frame) = (0, 0, "");
    let (mut place, mut turn) = ([0.0; 3], [0.0; 4]);
    for field in fields(data) {
        match field? {
            (1, Field::Bytes(stamp)) => {
                for part in fields(stamp) {
                    match part? {
                        (1, Field::Number(found)) => seconds = found.cast_signed(),
                        (2, Field::Number(found)) => nanos = found.cast_signed(),
                        _ => {}
                    }
                }
            }
            (2, Field::Bytes(name)) => frame = std::str::from_utf8(name).unwrap_or(""),
            (3, Field::Bytes(pose)) => {
                for part in fields(pose) {
                    match part? {
                        (1, Field::Bytes(vector)) => doubles(vector, &mut place)?,
                        (2, Field::Bytes(quaternion)) => doubles(quaternion, &mut turn)?,
                        _ => {}
                    }
                }
            }
            _ => {}
        }
    }
    checked(stamp_of(seconds, nanos), [frame, ""], (place, turn), None)
}

/// Of a message whose fields 1, 2, … are doubles.
fn doubles(message: &[u8], into: &mut [f64]) -> Result<(), String> {
    for field in fields(message) {
        if let (number, Field::Eight(bits)) = field?
            && let Some(value) = into.get_mut((number as usize).wrapping_sub(1))
        {
            *value = f64::from_bits(bits);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn length_delimited(number: u8, bytes: &[u8]) -> Vec<u8> {
        [&[(number << 3) | 2, bytes.len() as u8][..], bytes].concat()
    }

    fn double(number: u8, value: f64) -> Vec<u8> {
        [&[(number << 3) | 1][..], &value.to_le_bytes()].concat()
    }

    #[test]
    fn the_pose_of_foxglove_is_one_in_each_encoding() {
        let protobuf = [
            length_delimited(1, &[1 << 3, 5, 2 << 3, 7]),
            length_delimited(2, b"map"),
            length_delimited(
                3,
                &[
                    length_delimited(1, &[double(1, 1.5), double(3, -2.0)].concat()),
                    length_delimited(2, &double(4, 1.0)),
                ]
                .concat(),
            ),
        ]
        .concat();
        let json = br#"{"timestamp": {"sec": 5, "nsec": 7}, "frame_id": "map", "pose": {
            "position": {"x": 1.5, "y": 0, "z": -2.0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}}"#;
        let of_protobuf = Kind::PoseInFrame(Encoding::Protobuf)
            .pose(&protobuf)
            .unwrap();
        let of_json = Kind::PoseInFrame(Encoding::Json).pose(json).unwrap();
        assert_eq!(of_protobuf, of_json);
        assert_eq!(of_json.pose.time, Timestamp::from_nanos(5_000_000_007));
        let place = of_json.pose.world_from_vehicle.translation_m;
        assert_eq!(
            place.to_array().map(f64::to_bits),
            [1.5, 0.0, -2.0].map(f64::to_bits)
        );
        for end in 0..protobuf.len() {
            let _ = Kind::PoseInFrame(Encoding::Protobuf).pose(&protobuf[..end]);
        }
    }
}
