//! The map at one moment, and what changed since another.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{Gaussian, GaussianId, Timestamp};

/// Index of a cubic tile of the map; tiles are what is published and asked for.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
pub struct TileKey {
    /// Along east.
    pub x: i32,
    /// Along north.
    pub y: i32,
    /// Up.
    pub z: i32,
}

/// The whole map at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// Changes when the map starts anew; ids of two epochs have nothing to do with each other.
    pub epoch: u64,
    /// Counts the snapshots of an epoch.
    pub sequence: u64,
    /// Transmit time of the newest ping whose evidence is in it.
    pub time: Timestamp,
    /// Sequence of that ping.
    pub through_ping: u64,
    /// Added to every mean gives the world's coordinates; fixed for an epoch. 0 0 0 for a map that
    /// begins within 10 km of the poses' origin: its means are in the poses' own frame.
    pub origin_m: DVec3,
    /// Intensity per steradian, in the pings' own unit, that αρ = 1 sends back; positive.
    pub intensity_unit: f32,
    /// In order of id.
    pub gaussians: Vec<Gaussian>,
}

/// What changed in one tile between two published states.
#[derive(Debug, Clone, PartialEq)]
pub struct Delta {
    /// Of the map it belongs to.
    pub epoch: u64,
    /// Counts the deltas of an epoch without a gap, over all tiles.
    pub sequence: u64,
    /// Transmit time of the newest ping whose evidence is in it.
    pub time: Timestamp,
    /// Sequence of that ping.
    pub through_ping: u64,
    /// Added to every mean gives the world's coordinates.
    pub origin_m: DVec3,
    /// Intensity per steradian, in the pings' own unit, that αρ = 1 sends back; positive.
    pub intensity_unit: f32,
    /// Where.
    pub tile: TileKey,
    /// New or changed, whole.
    pub gaussians: Vec<Gaussian>,
    /// No longer in the map, or moved to another tile.
    pub removed: Vec<GaussianId>,
}
