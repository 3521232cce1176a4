//! From messages back to whole deltas and answers.

use std::collections::BTreeMap;

use echosplat_model::{Delta, Gaussian, TileKey};

use super::{MapHeader, MapMessage};
use crate::delta::{SnapshotAnswer, TileState};

/// Puts the chunks of deltas together. They come in order; one that is missing costs its delta,
/// which then shows as a gap.
#[derive(Debug)]
pub(crate) struct DeltaCollector {
    max_gaussians: usize,
    begun: Option<(Delta, u32)>,
    incomplete_count: u64,
}

impl DeltaCollector {
    /// A delta of more than `max_gaussians` is let go.
    pub(crate) fn new(max_gaussians: usize) -> Self {
        Self {
            max_gaussians,
            begun: None,
            incomplete_count: 0,
        }
    }

    /// Deltas of which not every chunk came, or which were too large.
    pub(crate) fn incomplete_count(&self) -> u64 {
        self.incomplete_count
    }

    /// The delta that this message completes, and whether it is marked final.
    pub(crate) fn push(&mut self, message: MapMessage) -> Option<(Delta, bool)> {
        let MapHeader {
            chunk,
            chunks,
            is_final,
            ..
        } = message.header;
        let delta = delta_of(message);
        let whole = match (self.begun.take(), chunk) {
            (None, 0) => delta,
            (Some((mut begun, next)), _) if next == chunk && follows(&begun, &delta) => {
                begun.gaussians.extend(delta.gaussians);
                begun.removed.extend(delta.removed);
                begun
            }
            (begun, _) => {
                self.incomplete_count += u64::from(begun.is_some());
                if chunk != 0 {
                    return None;
                }
                delta
            }
        };
        if whole.gaussians.len() + whole.removed.len() > self.max_gaussians {
            self.incomplete_count += 1;
            return None;
        }
        if chunk + 1 == chunks {
            return Some((whole, is_final));
        }
        self.begun = Some((whole, chunk + 1));
        None
    }
}

fn follows(begun: &Delta, next: &Delta) -> bool {
    (begun.epoch, begun.sequence, begun.tile) == (next.epoch, next.sequence, next.tile)
}

fn delta_of(message: MapMessage) -> Delta {
    let header = message.header;
    Delta {
        epoch: header.epoch,
        sequence: header.sequence,
        time: header.time,
        through_ping: header.through_ping,
        origin_m: header.origin_m,
        intensity_unit: header.intensity_unit,
        tile: header.tile,
        gaussians: message.gaussians,
        removed: header.removed,
    }
}

/// Puts the messages of one answer together, in whatever order they come.
#[derive(Debug)]
pub(crate) struct SnapshotCollector {
    max_gaussians: usize,
    first: Option<MapHeader>,
    parts: BTreeMap<u32, (TileKey, bool, Vec<Gaussian>)>,
    gaussian_count: usize,
    is_spoilt: bool,
}

impl SnapshotCollector {
    /// An answer of more than `max_gaussians` is not taken.
    pub(crate) fn new(max_gaussians: usize) -> Self {
        Self {
            max_gaussians,
            first: None,
            parts: BTreeMap::new(),
            gaussian_count: 0,
            is_spoilt: false,
        }
    }

    /// Takes one message. Messages of another answer (two publishers under one name) spoil it.
    pub(crate) fn push(&mut self, message: MapMessage) {
        let header = message.header;
        let Some(part) = header.part else {
            self.is_spoilt = true;
            return;
        };
        let first = self.first.get_or_insert_with(|| header.clone());
        let same = (
            first.epoch,
            first.sequence,
            first.since,
            first.part.map(|p| p.parts),
        ) == (
            header.epoch,
            header.sequence,
            header.since,
            Some(part.parts),
        );
        self.gaussian_count += message.gaussians.len();
        if !same || self.gaussian_count > self.max_gaussians {
            self.is_spoilt = true;
            return;
        }
        let is_tile = header.chunks > 0;
        let entry = (header.tile, is_tile, message.gaussians);
        self.parts.insert(part.part, entry);
    }

    /// The answer, if every message of it came.
    pub(crate) fn finish(self) -> Option<SnapshotAnswer> {
        let first = self.first?;
        let whole = first
            .part
            .is_some_and(|part| part.parts as usize == self.parts.len());
        if self.is_spoilt || !whole {
            return None;
        }
        let mut tiles: BTreeMap<TileKey, Vec<Gaussian>> = BTreeMap::new();
        for (tile, _, gaussians) in self.parts.into_values().filter(|(_, is_tile, _)| *is_tile) {
            tiles.entry(tile).or_default().extend(gaussians);
        }
        let tiles = tiles.into_iter();
        Some(SnapshotAnswer {
            epoch: first.epoch,
            sequence: first.sequence,
            time: first.time,
            through_ping: first.through_ping,
            origin_m: first.origin_m,
            intensity_unit: first.intensity_unit,
            is_final: first.is_final,
            since: first.since,
            tiles: tiles
                .map(|(tile, gaussians)| TileState { tile, gaussians })
                .collect(),
        })
    }
}
