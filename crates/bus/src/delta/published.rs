//! The state that every delta sent so far adds up to.

use std::collections::BTreeMap;
use std::sync::Arc;

use echosplat_model::{Gaussian, Snapshot, TileKey, Timestamp};
use glam::DVec3;

use super::answer::{SnapshotAnswer, SnapshotRequest, TileState};

/// One tile as published.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct PublishedTile {
    /// In order of id. Empty once everything in it is gone.
    pub(super) gaussians: Vec<Gaussian>,
    /// Sequence of the newest delta that touched it.
    pub(super) changed_at: u64,
}

/// The map as every subscriber has it that received all deltas; cheap to clone.
#[derive(Debug, Clone, PartialEq)]
pub struct PublishedMap {
    pub(super) epoch: u64,
    pub(super) sequence: u64,
    pub(super) time: Timestamp,
    pub(super) through_ping: u64,
    pub(super) origin_m: DVec3,
    pub(super) intensity_unit: f32,
    pub(super) is_final: bool,
    pub(super) tile_edge_m: f64,
    /// Tiles once published stay, empty or not, so that `since` can tell that they emptied.
    pub(super) tiles: BTreeMap<TileKey, Arc<PublishedTile>>,
}

impl PublishedMap {
    pub(super) fn empty(snapshot: &Snapshot, tile_edge_m: f64) -> Self {
        Self {
            epoch: snapshot.epoch,
            sequence: 0,
            time: snapshot.time,
            through_ping: snapshot.through_ping,
            origin_m: snapshot.origin_m,
            intensity_unit: snapshot.intensity_unit,
            is_final: false,
            tile_edge_m,
            tiles: BTreeMap::new(),
        }
    }

    /// Of the map.
    #[must_use]
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Of the newest delta in it.
    #[must_use]
    pub fn sequence(&self) -> u64 {
        self.sequence
    }

    /// Transmit time of the newest ping whose evidence is in it.
    #[must_use]
    pub fn time(&self) -> Timestamp {
        self.time
    }

    /// Added to every mean gives the world's coordinates.
    #[must_use]
    pub fn origin_m(&self) -> DVec3 {
        self.origin_m
    }

    /// Whether the publisher said that nothing more will come.
    #[must_use]
    pub fn is_final(&self) -> bool {
        self.is_final
    }

    /// How many Gaussians it holds.
    #[must_use]
    pub fn gaussian_count(&self) -> usize {
        self.tiles.values().map(|tile| tile.gaussians.len()).sum()
    }

    /// What answers `request`: the tiles in its box that changed since its sequence. A sequence
    /// of another epoch, or one not yet reached, is answered with everything.
    #[must_use]
    pub fn select(&self, request: &SnapshotRequest) -> SnapshotAnswer {
        let epoch_fits = request.epoch.is_none_or(|epoch| epoch == self.epoch);
        let since = request
            .since
            .filter(|&since| epoch_fits && since <= self.sequence);
        let wanted = |key: &TileKey, tile: &PublishedTile| match since {
            Some(since) => tile.changed_at > since && request.touches(*key, self.tile_edge_m),
            None => !tile.gaussians.is_empty() && request.touches(*key, self.tile_edge_m),
        };
        let tiles = self.tiles.iter().filter(|(key, tile)| wanted(key, tile));
        SnapshotAnswer {
            epoch: self.epoch,
            sequence: self.sequence,
            time: self.time,
            through_ping: self.through_ping,
            origin_m: self.origin_m,
            intensity_unit: self.intensity_unit,
            is_final: self.is_final,
            since,
            tiles: tiles
                .map(|(&key, tile)| TileState {
                    tile: key,
                    gaussians: tile.gaussians.clone(),
                })
                .collect(),
        }
    }
}
