//! From snapshots to deltas, within a budget.

use std::collections::BTreeMap;
use std::sync::Arc;

use echosplat_model::{Delta, Gaussian, GaussianId, Snapshot, TileKey};

use super::change::{Change, applied, changes};
use super::published::{PublishedMap, PublishedTile};
use super::tile::tile_of;
use crate::map_message::BYTES_PER_POINT;

/// What a delta costs besides its points and ids: field descriptions, header, attachment, framing.
const DELTA_OVERHEAD_BYTES: usize = 1000;

/// One id in the attachment's list, digits and comma.
const REMOVED_BYTES: usize = 11;

/// Turns snapshots into deltas against what was published before. What does not fit a round's
/// budget is not lost: it is found again, against a newer snapshot, in the next round.
#[derive(Debug)]
pub struct SnapshotDiffer {
    tile_edge_m: f64,
    published: Option<PublishedMap>,
    target: Option<Target>,
    /// Rounds that a tile with changes was passed over, so that small changes get their turn.
    rounds_waited: BTreeMap<TileKey, u32>,
    unsound_count: u64,
}

/// The newest snapshot, sorted into tiles.
#[derive(Debug)]
struct Target {
    snapshot: Arc<Snapshot>,
    tiles: BTreeMap<TileKey, Vec<Gaussian>>,
    is_reached: bool,
}

/// What one tile needs.
#[derive(Debug)]
struct Plan {
    tile: TileKey,
    changes: Vec<Change>,
    urgency: f64,
}

impl SnapshotDiffer {
    /// `tile_edge_m` is the length of a tile's side, positive.
    #[must_use]
    pub fn new(tile_edge_m: f64) -> Self {
        Self {
            tile_edge_m,
            published: None,
            target: None,
            rounds_waited: BTreeMap::new(),
            unsound_count: 0,
        }
    }

    /// Makes `snapshot` what the deltas lead to. A new epoch starts from an empty map and from
    /// sequence 0. Unsound Gaussians are counted and left out.
    pub fn offer(&mut self, snapshot: Arc<Snapshot>) {
        let tiles = self.sorted_into_tiles(&snapshot);
        let same_epoch = |published: &PublishedMap| published.epoch == snapshot.epoch;
        if !self.published.as_ref().is_some_and(same_epoch) {
            self.published = Some(PublishedMap::empty(&snapshot, self.tile_edge_m));
            self.rounds_waited.clear();
        }
        // A map has no origin before its first pings: as long as nothing is placed by it, it may move.
        if let Some(published) = &mut self.published
            && published.gaussian_count() == 0
        {
            published.origin_m = snapshot.origin_m;
        }
        self.target = Some(Target {
            snapshot,
            tiles,
            is_reached: false,
        });
    }

    fn sorted_into_tiles(&mut self, snapshot: &Snapshot) -> BTreeMap<TileKey, Vec<Gaussian>> {
        let mut tiles: BTreeMap<TileKey, Vec<Gaussian>> = BTreeMap::new();
        let tile_edge_m = self.tile_edge_m;
        let is_sound = |gaussian: &&Gaussian| gaussian.is_sound();
        let sound = snapshot.gaussians.iter().filter(is_sound);
        let sound: Vec<&Gaussian> = sound.collect();
        self.unsound_count += (snapshot.gaussians.len() - sound.len()) as u64;
        // Neighbours in a snapshot mostly lie in one tile.
        let tile = |gaussian: &Gaussian| tile_of(gaussian.mean_m, tile_edge_m);
        for together in sound.chunk_by(|a, b| tile(a) == tile(b)) {
            let of_tile = tiles.entry(tile(together[0])).or_default();
            of_tile.extend(together.iter().copied());
        }
        for gaussians in tiles.values_mut() {
            gaussians.sort_by_key(|gaussian| gaussian.id);
            gaussians.dedup_by_key(|gaussian| gaussian.id);
        }
        tiles
    }

    /// The next deltas towards the newest snapshot, the most changed tiles first, at most about
    /// `budget_bytes` (`None`: everything). At least one change is sent however small the budget.
    #[must_use]
    pub fn next_deltas(&mut self, budget_bytes: Option<usize>) -> Vec<Delta> {
        let Self {
            published: Some(published),
            target: Some(target),
            rounds_waited,
            ..
        } = self
        else {
            return Vec::new();
        };
        if target.is_reached {
            return Vec::new();
        }
        published.is_final = false;
        published.time = target.snapshot.time;
        published.through_ping = target.snapshot.through_ping;
        let unit_changed =
            published.intensity_unit.to_bits() != target.snapshot.intensity_unit.to_bits();
        published.intensity_unit = target.snapshot.intensity_unit;

        let mut room = budget_bytes.unwrap_or(usize::MAX);
        let mut deltas: Vec<Delta> = Vec::new();
        target.is_reached = true;
        for plan in plans(published, target, rounds_waited) {
            let sent = affordable(&plan.changes, room, deltas.is_empty());
            if sent.len() < plan.changes.len() {
                target.is_reached = false;
                *rounds_waited.entry(plan.tile).or_default() += 1;
            } else {
                rounds_waited.remove(&plan.tile);
            }
            if !sent.is_empty() {
                room = room.saturating_sub(cost(&sent));
                deltas.push(publish(published, plan.tile, &sent));
            }
        }
        if unit_changed && deltas.is_empty() {
            deltas.push(publish(published, TileKey::default(), &[]));
        }
        deltas
    }

    /// Marks the published state as final, once nothing is pending, with an empty delta if there
    /// is no other to carry the mark; `None` if no snapshot was ever offered.
    #[must_use]
    pub fn finish(&mut self) -> Option<Vec<Delta>> {
        let mut deltas = self.next_deltas(None);
        let published = self.published.as_mut()?;
        if deltas.is_empty() {
            deltas.push(publish(published, TileKey::default(), &[]));
        }
        published.is_final = true;
        Some(deltas)
    }

    /// Whether the published state equals the newest snapshot.
    #[must_use]
    pub fn is_drained(&self) -> bool {
        self.target.as_ref().is_none_or(|target| target.is_reached)
    }

    /// What all deltas so far add up to.
    #[must_use]
    pub fn published(&self) -> Option<&PublishedMap> {
        self.published.as_ref()
    }

    /// Gaussians left out because they cannot be.
    #[must_use]
    pub fn unsound_count(&self) -> u64 {
        self.unsound_count
    }
}

/// What every tile needs, most urgent first; among equals in order of tile.
fn plans(
    published: &PublishedMap,
    target: &Target,
    rounds_waited: &BTreeMap<TileKey, u32>,
) -> Vec<Plan> {
    let gone = published.tiles.keys();
    let gone = gone.filter(|tile| !target.tiles.contains_key(tile));
    let mut plans: Vec<_> = target
        .tiles
        .keys()
        .chain(gone)
        .filter_map(|&tile| {
            let old = published.tiles.get(&tile);
            let old = old.map_or(&[][..], |old| &old.gaussians);
            let new = target.tiles.get(&tile).map_or(&[][..], Vec::as_slice);
            let changes = changes(old, new);
            let score: f64 = changes.iter().map(|change| change.score).sum();
            let waited = rounds_waited.get(&tile).copied().unwrap_or(0);
            (!changes.is_empty()).then_some(Plan {
                tile,
                changes,
                urgency: score * (1.0 + f64::from(waited)),
            })
        })
        .collect();
    plans.sort_by(|a, b| b.urgency.total_cmp(&a.urgency).then(a.tile.cmp(&b.tile)));
    plans
}

fn change_cost(change: &Change) -> usize {
    match change.now {
        Some(_) => BYTES_PER_POINT,
        None => REMOVED_BYTES,
    }
}

fn cost(changes: &[Change]) -> usize {
    DELTA_OVERHEAD_BYTES + changes.iter().map(change_cost).sum::<usize>()
}

/// The most important changes that `room` bytes hold, in order of id; at least one if `must_move`.
fn affordable(changes: &[Change], room: usize, must_move: bool) -> Vec<Change> {
    if cost(changes) <= room {
        return changes.to_vec();
    }
    let mut sent = changes.to_vec();
    sent.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.id.cmp(&b.id)));
    let mut total = DELTA_OVERHEAD_BYTES;
    let fitting = sent
        .iter()
        .take_while(|change| {
            total += change_cost(change);
            total <= room
        })
        .count();
    sent.truncate(fitting.max(usize::from(must_move)));
    sent.sort_by_key(|change| change.id);
    sent
}

/// Takes the changes into the published state and gives the delta that says so.
fn publish(published: &mut PublishedMap, tile: TileKey, sent: &[Change]) -> Delta {
    published.sequence += 1;
    if !sent.is_empty() {
        let entry = published.tiles.entry(tile).or_default();
        *entry = Arc::new(PublishedTile {
            gaussians: applied(&entry.gaussians, sent),
            changed_at: published.sequence,
        });
    }
    let removed = sent.iter().filter(|change| change.now.is_none());
    Delta {
        epoch: published.epoch,
        sequence: published.sequence,
        time: published.time,
        through_ping: published.through_ping,
        origin_m: published.origin_m,
        intensity_unit: published.intensity_unit,
        tile,
        gaussians: sent.iter().filter_map(|change| change.now).collect(),
        removed: removed.map(|change| change.id).collect::<Vec<GaussianId>>(),
    }
}
