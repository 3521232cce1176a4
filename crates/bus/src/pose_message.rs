//! Poses as JSON or as one of three ROS messages, checked.
//!
//! | payload | encodings |
//! |---|---|
//! | JSON `{stamp_ns, frame_id, child_frame_id, position: [x, y, z], orientation_xyzw: [x, y, z, w], covariance: [36 numbers]?, epoch: number?}` | any: its first byte tells |
//! | `nav_msgs/msg/Odometry`: pose with covariance; the twist is not used | `application/cdr;nav_msgs/msg/Odometry`, or no schema |
//! | `geometry_msgs/msg/PoseStamped` | likewise |
//! | `geometry_msgs/msg/PoseWithCovarianceStamped` | likewise |
//!
//! A `put` of a string from Python bears the encoding `zenoh/string`, one of bytes `zenoh/bytes`;
//! so JSON is told by its first byte, and CDR without a schema by which of the three messages has
//! exactly its length. A ROS quaternion and ours are both x, y, z, w; one sent w first cannot be
//! told from another rotation.
//!
//! Position in metres, world ENU; orientation world from vehicle, the vehicle forward-left-up.
//! Covariance is row by row over (x, y, z, rotation about x, y, z); all zeros means unknown. Its numbers are handed on as
//! they are, also those that are no variance: in JSON, `null`, `NaN`, `Infinity` and what no double holds are read there as NaN.
//! `epoch` changes when the estimator resets (0 if left out).

use echosplat_model::{Pose, PoseCovariance, StampedPose, Timestamp};
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::cdr::{CdrError, CdrReader};
use crate::ros::{Header, MAX_FRAME_ID_BYTES};

/// Longest payload that is read; an Odometry message has some 720 bytes.
pub const MAX_POSE_BYTES: usize = 16 * 1024;

/// Encoding of the poses this crate publishes.
pub const JSON: &str = "application/json";
/// `nav_msgs/msg/Odometry`.
pub const ODOMETRY: &str = "application/cdr;nav_msgs/msg/Odometry";
/// `geometry_msgs/msg/PoseStamped`.
pub const POSE_STAMPED: &str = "application/cdr;geometry_msgs/msg/PoseStamped";
/// `geometry_msgs/msg/PoseWithCovarianceStamped`.
pub const POSE_WITH_COVARIANCE: &str =
    "application/cdr;geometry_msgs/msg/PoseWithCovarianceStamped";

/// Farther from the world's origin than any place on Earth is in UTM, ten times over.
const MAX_COORDINATE_M: f64 = 1e8;

/// How far a quaternion's length may be from 1.
const LENGTH_TOLERANCE: f64 = 0.01;

/// Beyond this a quaternion is normalised; below, its bits are kept.
const LENGTH_ROUNDING: f64 = 1e-9;

/// A pose as received.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseMessage {
    /// Checked and finite, with a unit quaternion.
    pub pose: StampedPose,
}

/// Why a message is no pose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseMessageError {
    /// Neither JSON nor one of the three messages.
    #[error(
        "pose of encoding {encoding:?} begins with {start}; read are JSON objects, {ODOMETRY}, {POSE_STAMPED} and {POSE_WITH_COVARIANCE}"
    )]
    Unknown {
        /// As sent, cut after 80 characters.
        encoding: String,
        /// The first bytes in hex, or the text.
        start: String,
    },
    /// CDR without a schema that is as long as none of the three.
    #[error(
        "pose of {bytes} bytes of CDR without a schema is no Odometry ({odometry}), no PoseWithCovarianceStamped and no PoseStamped; name the message in the encoding, as in {ODOMETRY}"
    )]
    NoSuchLength {
        /// Of the payload.
        bytes: usize,
        /// Why it is no Odometry.
        odometry: CdrError,
    },
    /// Longer than any pose.
    #[error("pose message has {0} bytes; at most {MAX_POSE_BYTES} are read")]
    Size(usize),
    /// Not the JSON object that is documented.
    #[error("pose is not the JSON object it should be: {0}")]
    Json(String),
    /// Not the bytes of the message its encoding names.
    #[error("pose: {0}")]
    Cdr(#[from] CdrError),
    /// A number is NaN or infinite.
    #[error("pose: {0} is not finite")]
    NotFinite(&'static str),
    /// The position cannot be one.
    #[error("pose: position is more than 1e8 m from the origin")]
    TooFar,
    /// The quaternion is none of a rotation.
    #[error("pose: quaternion has length {0}; it must be 1 ± 0.01")]
    Quaternion(f64),
    /// A frame with z down.
    #[error(
        "pose: frame {0:?} is north-east-down or forward-right-down; send ENU and forward-left-up"
    )]
    Frame(String),
}

impl PoseMessageError {
    fn unknown(encoding: &str, payload: &[u8]) -> Self {
        let start = &payload[..payload.len().min(16)];
        let is_text = !start.is_empty() && start.iter().all(|b| (b' '..=b'~').contains(b));
        let start = match is_text {
            true => format!("{:?}", String::from_utf8_lossy(start)),
            false => format!("{start:02x?}"),
        };
        let encoding = encoding.chars().take(80).collect();
        Self::Unknown { encoding, start }
    }
}

/// Reads a pose, whatever of the documented its bytes are.
///
/// # Errors
/// Says what is wrong with it; nothing is guessed.
pub fn decode(encoding: &str, payload: &[u8]) -> Result<PoseMessage, PoseMessageError> {
    if payload.len() > MAX_POSE_BYTES {
        return Err(PoseMessageError::Size(payload.len()));
    }
    let (kind, schema) = encoding.split_once(';').unwrap_or((encoding, ""));
    let first = payload.iter().find(|byte| !byte.is_ascii_whitespace());
    let raw = match (first, message_name(schema)) {
        (Some(b'{'), _) => RawPose::json(payload)?,
        _ if kind == JSON => RawPose::json(payload)?,
        (_, "Odometry") => RawPose::odometry(payload)?,
        (_, "PoseStamped") => RawPose::pose_stamped(payload)?,
        (_, "PoseWithCovarianceStamped") => RawPose::pose_with_covariance(payload)?,
        (_, "") if payload.starts_with(&[0, 1]) => RawPose::by_length(payload)?,
        _ => return Err(PoseMessageError::unknown(encoding, payload)),
    };
    raw.checked()
}

/// A pose that stood in a message of another kind, judged as those read here are: its time, the names
/// of its frames (outer, inner), position in metres and orientation as x, y, z, w, and its covariance.
///
/// # Errors
/// As [`decode`].
pub fn checked(
    time: Timestamp,
    [frame_id, child_frame_id]: [&str; 2],
    (position_m, orientation_xyzw): ([f64; 3], [f64; 4]),
    covariance: Option<[f64; 36]>,
) -> Result<PoseMessage, PoseMessageError> {
    let raw = RawPose {
        time,
        frame_id: frame_id.to_owned(),
        child_frame_id: child_frame_id.to_owned(),
        position_m,
        orientation_xyzw,
        covariance,
        epoch: 0,
    };
    raw.checked()
}

/// `Odometry` of `nav_msgs/msg/Odometry`, and of the name DDS gives it,
/// `nav_msgs::msg::dds_::Odometry_`.
fn message_name(schema: &str) -> &str {
    let name = schema.trim_end_matches('_');
    name.rsplit(['/', ':']).next().unwrap_or(name)
}

/// The JSON of a pose, to the last bit of every coordinate.
#[must_use]
pub fn encode_json(pose: &StampedPose, frame_id: &str, child_frame_id: &str) -> Vec<u8> {
    let covariance = pose
        .uncertainty
        .map(|covariance| covariance.rows().map(Some).to_vec());
    let document = Document {
        stamp_ns: pose.time.nanos(),
        frame_id: frame_id.to_owned(),
        child_frame_id: child_frame_id.to_owned(),
        position: pose.world_from_vehicle.translation_m.to_array(),
        orientation_xyzw: pose.world_from_vehicle.rotation.to_array(),
        covariance,
        epoch: pose.epoch,
    };
    // Numbers and texts: this cannot fail.
    serde_json::to_vec(&document).unwrap_or_default()
}

/// The JSON object, member by member.
#[derive(Debug, Serialize, Deserialize)]
struct Document {
    stamp_ns: i64,
    #[serde(default)]
    frame_id: String,
    #[serde(default)]
    child_frame_id: String,
    position: [f64; 3],
    orientation_xyzw: [f64; 4],
    #[serde(default, skip_serializing_if = "Option::is_none")]
    covariance: Option<Vec<Option<f64>>>,
    #[serde(default)]
    epoch: u32,
}

/// Any of the four, before it is judged.
#[derive(Debug)]
struct RawPose {
    time: Timestamp,
    frame_id: String,
    child_frame_id: String,
    position_m: [f64; 3],
    orientation_xyzw: [f64; 4],
    covariance: Option<[f64; 36]>,
    epoch: u32,
}

impl RawPose {
    fn json(payload: &[u8]) -> Result<Self, PoseMessageError> {
        let document: Document = serde_json::from_slice(payload)
            .or_else(|reason| with_nulls(payload).map_err(|_| reason))
            .map_err(|reason| PoseMessageError::Json(reason.to_string()))?;
        let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let numbers = |values: Vec<Option<f64>>| values.into_iter().map(number).collect();
        let covariance: Option<Vec<f64>> = document.covariance.map(numbers);
        let covariance = covariance.map(<[f64; 36]>::try_from).transpose();
        let covariance = covariance.map_err(|found| {
            let found = found.len();
            PoseMessageError::Json(format!("covariance has {found} numbers instead of 36"))
        })?;
        Ok(Self {
            time: Timestamp::from_nanos(document.stamp_ns),
            frame_id: document.frame_id,
            child_frame_id: document.child_frame_id,
            position_m: document.position,
            orientation_xyzw: document.orientation_xyzw,
            covariance,
            epoch: document.epoch,
        })
    }

    /// One of the three by its length, which differs by far more than padding.
    fn by_length(payload: &[u8]) -> Result<Self, PoseMessageError> {
        let odometry = match Self::odometry(payload) {
            Ok(raw) => return Ok(raw),
            Err(reason) => reason,
        };
        let other = Self::pose_with_covariance(payload).or_else(|_| Self::pose_stamped(payload));
        other.map_err(|_| PoseMessageError::NoSuchLength {
            bytes: payload.len(),
            odometry,
        })
    }

    fn odometry(payload: &[u8]) -> Result<Self, CdrError> {
        let mut reader = CdrReader::new(payload)?;
        let header = Header::read(&mut reader)?;
        let child = reader.string("child_frame_id", MAX_FRAME_ID_BYTES)?;
        let mut raw = Self::pose(&header, &mut reader)?;
        raw.child_frame_id = child.to_owned();
        raw.covariance = Some(reader.f64s("pose.covariance")?);
        reader.f64s::<6>("twist.twist")?;
        reader.f64s::<36>("twist.covariance")?;
        reader.finish()?;
        Ok(raw)
    }

    fn pose_stamped(payload: &[u8]) -> Result<Self, CdrError> {
        let mut reader = CdrReader::new(payload)?;
        let header = Header::read(&mut reader)?;
        let raw = Self::pose(&header, &mut reader)?;
        reader.finish()?;
        Ok(raw)
    }

    fn pose_with_covariance(payload: &[u8]) -> Result<Self, CdrError> {
        let mut reader = CdrReader::new(payload)?;
        let header = Header::read(&mut reader)?;
        let mut raw = Self::pose(&header, &mut reader)?;
        raw.covariance = Some(reader.f64s("pose.covariance")?);
        reader.finish()?;
        Ok(raw)
    }

    /// `geometry_msgs/Pose`: position, then orientation x, y, z, w.
    fn pose(header: &Header<'_>, reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        Ok(Self {
            time: header.stamp,
            frame_id: header.frame_id.to_owned(),
            child_frame_id: String::new(),
            position_m: reader.f64s("pose.position")?,
            orientation_xyzw: reader.f64s("pose.orientation")?,
            covariance: None,
            epoch: 0,
        })
    }

    fn checked(&self) -> Result<PoseMessage, PoseMessageError> {
        for frame in [&self.frame_id, &self.child_frame_id] {
            if points_down(frame) {
                return Err(PoseMessageError::Frame(frame.chars().take(80).collect()));
            }
        }
        let translation_m = DVec3::from_array(self.position_m);
        if !translation_m.is_finite() {
            return Err(PoseMessageError::NotFinite("position"));
        }
        let is_near = translation_m.abs().max_element() <= MAX_COORDINATE_M;
        if !is_near {
            return Err(PoseMessageError::TooFar);
        }
        let rotation = unit(DQuat::from_array(self.orientation_xyzw))?;
        Ok(PoseMessage {
            pose: StampedPose {
                time: self.time,
                world_from_vehicle: Pose {
                    rotation,
                    translation_m,
                },
                uncertainty: self.covariance.as_ref().and_then(PoseCovariance::of_rows),
                epoch: self.epoch,
            },
        })
    }
}

/// The suffixes that MAVROS gives its frames with z down.
fn points_down(frame_id: &str) -> bool {
    let name = frame_id.to_ascii_lowercase();
    ["ned", "frd"]
        .iter()
        .any(|suffix| name == *suffix || name.ends_with(&format!("_{suffix}")))
}

/// The quaternion, normalised if its length is off by more than rounding.
fn unit(rotation: DQuat) -> Result<DQuat, PoseMessageError> {
    if !rotation.is_finite() {
        return Err(PoseMessageError::NotFinite("orientation"));
    }
    let length = rotation.length();
    let off = (length - 1.0).abs();
    let is_unit = off <= LENGTH_TOLERANCE;
    if !is_unit {
        return Err(PoseMessageError::Quaternion(length));
    }
    Ok(if off > LENGTH_ROUNDING {
        rotation / length
    } else {
        rotation
    })
}

/// Reads the object again with `null` for each number that JSON does not have, as Python and others write them.
fn with_nulls(payload: &[u8]) -> serde_json::Result<Document> {
    let mut text = Vec::with_capacity(payload.len());
    let (mut rest, mut is_string) = (payload, false);
    while let [byte, ..] = *rest {
        let is_of_token = |byte: &u8| byte.is_ascii_alphanumeric() || b"+-.".contains(byte);
        let length = match (is_string, byte) {
            (true, b'\\') => 2.min(rest.len()),
            (_, b'"') => {
                is_string = !is_string;
                1
            }
            (false, _) => rest
                .iter()
                .take_while(|byte| is_of_token(byte))
                .count()
                .max(1),
            (true, _) => 1,
        };
        let (token, after) = rest.split_at(length);
        let number = std::str::from_utf8(token).ok();
        let number = number.and_then(|token| token.parse::<f64>().ok());
        let is_none = !is_string && number.is_some_and(|number| !number.is_finite());
        text.extend_from_slice(if is_none { b"null" } else { token });
        rest = after;
    }
    serde_json::from_slice(&text)
}

#[cfg(test)]
mod tests;
