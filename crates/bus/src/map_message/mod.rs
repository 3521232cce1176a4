//! The messages that carry the map: a point cloud and a small JSON attachment.
//!
//! | member | what |
//! |---|---|
//! | `epoch` | changes when the map starts anew; ids of two epochs have nothing in common |
//! | `sequence` | counts the deltas of an epoch without a gap, over all tiles; in a snapshot: all deltas up to this one are in it |
//! | `tile` | `x_y_z`, as in the key; tile x covers `[x, x+1) · tile_edge` metres of the map's frame |
//! | `chunk`, `chunks` | this message is number `chunk` of the `chunks` that make up one delta, or one tile of a snapshot |
//! | `removed` | ids no longer in this tile |
//! | `through_ping` | sequence of the newest ping whose evidence is in it |
//! | `time_ns` | transmit time of that ping |
//! | `origin_m` | three numbers; add to x, y, z for world coordinates |
//! | `intensity_unit` | intensity per steradian, at the gain of the map's first ping, that αρ = 1 sends back |
//! | `final` | `true` on the publisher's last state: with this sequence the map is whole |
//! | `part`, `parts` | snapshot only: this message is number `part` of `parts` of the whole answer |
//! | `since` | snapshot only: only tiles changed after this sequence are in the answer; if left out, tiles not in it are empty |
//! | `why` | base64 of three bytes for each point of the payload, in their order: number of its [`Reason`], clear observations, what the test measured ([`Why`]); left out if nothing is said of any |
//!
//! A delta adds and replaces Gaussians of its tile by id; a tile of a snapshot replaces it whole.

mod attachment;
mod collect;

#[cfg(doc)]
use echosplat_model::Reason;
use echosplat_model::{Delta, Gaussian, GaussianId, TileKey, Unsound, Why};

pub(crate) use attachment::MapHeader;
pub use attachment::{AttachmentError, Part};
pub(crate) use collect::{DeltaCollector, SnapshotCollector};

use crate::delta::{SnapshotAnswer, TileName};
use crate::point_cloud::{self, POINT_BYTES, PointCloudError};

/// Most ids in one message's `removed`, some 22 kB of text.
const MAX_REMOVED_PER_MESSAGE: usize = 2000;

/// Bytes of a message that are neither points nor ids: fields, header, attachment.
const FIXED_BYTES: usize = 1536;

/// Bytes of one point: those of the payload, and its characters in `why`.
pub(crate) const BYTES_PER_POINT: usize = POINT_BYTES + 4;

/// Bytes of one id in `removed`.
const REMOVED_BYTES: usize = 11;

/// A message ready to be sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WireMessage {
    /// Tile of the key it goes to.
    pub tile: TileName,
    /// CDR bytes, encoding [`point_cloud::ENCODING`].
    pub payload: Vec<u8>,
    /// JSON text.
    pub attachment: Vec<u8>,
}

impl WireMessage {
    /// Bytes on the wire, framing aside.
    #[must_use]
    pub fn byte_count(&self) -> usize {
        self.payload.len() + self.attachment.len()
    }
}

/// A message as received.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MapMessage {
    pub(crate) header: MapHeader,
    pub(crate) gaussians: Vec<Gaussian>,
    /// Left out of them, and why. In a delta these ids are gone from the map: what it held of them is
    /// of earlier.
    pub(crate) unsound: Vec<(GaussianId, Unsound)>,
}

/// Why a message is none of the map's.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MapMessageError {
    /// The attachment.
    #[error(transparent)]
    Attachment(#[from] AttachmentError),
    /// The payload.
    #[error(transparent)]
    PointCloud(#[from] PointCloudError),
}

impl MapMessage {
    pub(crate) fn decode(payload: &[u8], attachment: &[u8]) -> Result<Self, MapMessageError> {
        let mut header = MapHeader::parse(attachment)?;
        let why_of = |point: usize| header.why.get(point).copied().unwrap_or_default();
        let cloud = point_cloud::decode_with(payload, why_of)?;
        header
            .removed
            .extend(cloud.unsound.iter().map(|&(id, _)| id));
        Ok(Self {
            header,
            gaussians: cloud.gaussians,
            unsound: cloud.unsound,
        })
    }
}

/// How messages are cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cut<'a> {
    /// Payload and attachment together.
    pub(crate) max_message_bytes: usize,
    /// Name of the map's frame.
    pub(crate) frame_id: &'a str,
}

impl Cut<'_> {
    /// The messages of one delta.
    pub(crate) fn delta(&self, delta: &Delta, is_final: bool) -> Vec<WireMessage> {
        let header = MapHeader {
            epoch: delta.epoch,
            sequence: delta.sequence,
            tile: delta.tile,
            chunk: 0,
            chunks: 1,
            removed: Vec::new(),
            through_ping: delta.through_ping,
            time: delta.time,
            origin_m: delta.origin_m,
            intensity_unit: delta.intensity_unit,
            is_final,
            part: None,
            since: None,
            why: Vec::new(),
        };
        let pieces = self.pieces(&header, &delta.gaussians, &delta.removed);
        pieces.iter().map(|piece| self.encode(piece)).collect()
    }

    /// The messages of one answer; an answer without tiles is one message without points.
    pub(crate) fn answer(&self, answer: &SnapshotAnswer) -> impl Iterator<Item = WireMessage> {
        let header = |tile: TileKey| MapHeader {
            epoch: answer.epoch,
            sequence: answer.sequence,
            tile,
            chunk: 0,
            chunks: 1,
            removed: Vec::new(),
            through_ping: answer.through_ping,
            time: answer.time,
            origin_m: answer.origin_m,
            intensity_unit: answer.intensity_unit,
            is_final: answer.is_final,
            part: None,
            since: answer.since,
            why: Vec::new(),
        };
        let mut pieces: Vec<Piece<'_>> = Vec::new();
        for state in &answer.tiles {
            pieces.extend(self.pieces(&header(state.tile), &state.gaussians, &[]));
        }
        if pieces.is_empty() {
            let mut empty = header(TileKey::default());
            empty.chunks = 0;
            pieces.push(Piece {
                header: empty,
                gaussians: &[],
            });
        }
        let parts = pieces.len() as u32;
        let cut = Cut { ..*self };
        pieces.into_iter().zip(0..).map(move |(mut piece, part)| {
            piece.header.part = Some(Part { part, parts });
            cut.encode(&piece)
        })
    }

    fn pieces<'g>(
        &self,
        header: &MapHeader,
        gaussians: &'g [Gaussian],
        removed: &[GaussianId],
    ) -> Vec<Piece<'g>> {
        let room = self.max_message_bytes.saturating_sub(FIXED_BYTES);
        let removed_room = (room / REMOVED_BYTES).clamp(1, MAX_REMOVED_PER_MESSAGE);
        let point_room = (room / BYTES_PER_POINT).max(1);
        let mut pieces: Vec<Piece<'g>> = Vec::new();
        for ids in removed.chunks(removed_room) {
            let header = MapHeader {
                removed: ids.to_vec(),
                ..header.clone()
            };
            pieces.push(Piece {
                header,
                gaussians: &[],
            });
        }
        for gaussians in gaussians.chunks(point_room) {
            pieces.push(Piece {
                header: header.clone(),
                gaussians,
            });
        }
        // Most deltas are small: what fits into one message goes as one.
        let fits_one = removed.len() * REMOVED_BYTES + gaussians.len() * BYTES_PER_POINT <= room
            && removed.len() <= removed_room;
        if pieces.is_empty() || fits_one {
            let header = MapHeader {
                removed: removed.to_vec(),
                ..header.clone()
            };
            pieces = vec![Piece { header, gaussians }];
        }
        let chunks = pieces.len() as u32;
        for (piece, chunk) in pieces.iter_mut().zip(0..) {
            (piece.header.chunk, piece.header.chunks) = (chunk, chunks);
        }
        pieces
    }

    fn encode(&self, piece: &Piece<'_>) -> WireMessage {
        let why = piece.gaussians.iter().map(|gaussian| gaussian.why);
        let is_said = why.clone().any(|why| why != Why::default());
        let header = MapHeader {
            why: why.filter(|_| is_said).collect(),
            ..piece.header.clone()
        };
        WireMessage {
            tile: TileName(piece.header.tile),
            payload: point_cloud::encode(piece.gaussians, piece.header.time, self.frame_id),
            attachment: header.to_json(),
        }
    }
}

/// One message before it is bytes.
#[derive(Debug)]
struct Piece<'g> {
    header: MapHeader,
    gaussians: &'g [Gaussian],
}

#[cfg(test)]
mod tests;
