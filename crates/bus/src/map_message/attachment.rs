//! The JSON attachment of a map message.

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use echosplat_model::{GaussianId, INTENSITY_UNITS, TileKey, Timestamp, Why, is_origin};
use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::MAX_REMOVED_PER_MESSAGE;
use crate::delta::TileName;

/// Longest attachment that is read.
pub(crate) const MAX_ATTACHMENT_BYTES: usize = 64 * 1024;

/// Most chunks of one delta and most messages of one answer.
const MAX_CHUNK_COUNT: u32 = 1 << 16;

/// Which message of an answer this is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// Counts from 0.
    pub part: u32,
    /// How many there are.
    pub parts: u32,
}

/// What a map message says of itself, checked.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MapHeader {
    pub(crate) epoch: u64,
    pub(crate) sequence: u64,
    pub(crate) tile: TileKey,
    pub(crate) chunk: u32,
    pub(crate) chunks: u32,
    pub(crate) removed: Vec<GaussianId>,
    pub(crate) through_ping: u64,
    pub(crate) time: Timestamp,
    pub(crate) origin_m: DVec3,
    pub(crate) intensity_unit: f32,
    pub(crate) is_final: bool,
    pub(crate) part: Option<Part>,
    pub(crate) since: Option<u64>,
    /// Of each point of the payload; empty if nothing is said of any.
    pub(crate) why: Vec<Why>,
}

/// Why an attachment cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum AttachmentError {
    /// Longer than any this crate writes.
    #[error("map attachment has {found} bytes; at most {MAX_ATTACHMENT_BYTES} are read")]
    Size {
        /// How many.
        found: usize,
    },
    /// Not the JSON object that is documented.
    #[error("map attachment is not the JSON object it should be: {0}")]
    Json(String),
    /// A member out of range.
    #[error("map attachment: {member} is not {wanted}")]
    Member {
        /// Its name.
        member: &'static str,
        /// What it should be.
        wanted: &'static str,
    },
}

/// The JSON object, member by member.
#[derive(Debug, Serialize, Deserialize)]
struct Document {
    epoch: u64,
    sequence: u64,
    tile: String,
    chunk: u32,
    chunks: u32,
    #[serde(default)]
    removed: Vec<GaussianId>,
    through_ping: u64,
    time_ns: i64,
    origin_m: [f64; 3],
    intensity_unit: f32,
    #[serde(rename = "final", default)]
    is_final: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    part: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    parts: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    since: Option<u64>,
    /// Three bytes a point in base64, so that each point has four characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    why: Option<String>,
}

impl MapHeader {
    pub(crate) fn to_json(&self) -> Vec<u8> {
        let document = Document {
            epoch: self.epoch,
            sequence: self.sequence,
            tile: TileName(self.tile).to_string(),
            chunk: self.chunk,
            chunks: self.chunks,
            removed: self.removed.clone(),
            through_ping: self.through_ping,
            time_ns: self.time.nanos(),
            origin_m: self.origin_m.to_array(),
            intensity_unit: self.intensity_unit,
            is_final: self.is_final,
            part: self.part.map(|part| part.part),
            parts: self.part.map(|part| part.parts),
            since: self.since,
            why: (!self.why.is_empty()).then(|| text_of(&self.why)),
        };
        // Numbers, one text and lists of numbers: this cannot fail.
        serde_json::to_vec(&document).unwrap_or_default()
    }

    pub(crate) fn parse(json: &[u8]) -> Result<Self, AttachmentError> {
        if json.len() > MAX_ATTACHMENT_BYTES {
            return Err(AttachmentError::Size { found: json.len() });
        }
        let document: Document = serde_json::from_slice(json)
            .map_err(|reason| AttachmentError::Json(reason.to_string()))?;
        let member = |fits: bool, member, wanted| match fits {
            true => Ok(()),
            false => Err(AttachmentError::Member { member, wanted }),
        };
        let origin_m = DVec3::from_array(document.origin_m);
        member(
            is_origin(origin_m),
            "origin_m",
            "three numbers of 1e8 m at most",
        )?;
        let intensity_unit = document.intensity_unit;
        let unit_fits = INTENSITY_UNITS.contains(&intensity_unit);
        member(unit_fits, "intensity_unit", "a number within 1e-30 to 1e30")?;
        let removed_fits = document.removed.len() <= MAX_REMOVED_PER_MESSAGE;
        member(removed_fits, "removed", "at most 2000 ids")?;
        let tile = document.tile.parse::<TileName>();
        let TileName(tile) = tile.map_err(|_| AttachmentError::Member {
            member: "tile",
            wanted: "x_y_z in whole numbers",
        })?;
        let part = document.part.zip(document.parts);
        let part = part.map(|(part, parts)| Part { part, parts });
        let counts = |index: u32, count: u32| index < count && count <= MAX_CHUNK_COUNT;
        let part_fits = part.is_none_or(|part| counts(part.part, part.parts));
        member(part_fits, "part", "below parts, and parts at most 65536")?;
        let is_empty_answer = part.is_some() && (document.chunk, document.chunks) == (0, 0);
        let chunk_fits = is_empty_answer || counts(document.chunk, document.chunks);
        member(
            chunk_fits,
            "chunk",
            "below chunks, and chunks at most 65536",
        )?;
        let why = document.why.as_deref().map_or(Some(Vec::new()), whys_of);
        let why = why.ok_or(AttachmentError::Member {
            member: "why",
            wanted: "base64 of three bytes a point",
        })?;
        Ok(Self {
            epoch: document.epoch,
            sequence: document.sequence,
            tile,
            chunk: document.chunk,
            chunks: document.chunks,
            removed: document.removed,
            through_ping: document.through_ping,
            time: Timestamp::from_nanos(document.time_ns),
            origin_m,
            intensity_unit,
            is_final: document.is_final,
            part,
            since: document.since,
            why,
        })
    }
}

/// As it stands in the object.
pub(super) fn text_of(why: &[Why]) -> String {
    let bytes: Vec<u8> = why.iter().flat_map(|why| why.bytes()).collect();
    BASE64.encode(bytes)
}

fn whys_of(text: &str) -> Option<Vec<Why>> {
    let bytes = BASE64.decode(text).ok()?;
    let (whys, rest) = bytes.as_chunks::<3>();
    let whys = whys.iter().copied().map(Why::of_bytes);
    rest.is_empty().then(|| whys.collect())
}
