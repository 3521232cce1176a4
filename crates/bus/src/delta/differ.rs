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
struct Plan<'g> {
    tile: TileKey,
    changes: Vec<Change<'g>>,
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
        let placed = sound
            .iter()
            .map(|&gaussian| (tile_of(gaussian.mean_m, tile_edge_m), gaussian));
        let placed: Vec<(TileKey, &Gaussian)> = placed.collect();
        // Neighbours in a snapshot mostly lie in one tile.
        for together in placed.chunk_by(|a, b| a.0 == b.0) {
            let of_tile = tiles.entry(together[0].0).or_default();
            of_tile.extend(together.iter().map(|(_, gaussian)| **gaussian));
        }
        for gaussians in tiles.values_mut() {
            if !gaussians.is_sorted_by(|a, b| a.id < b.id) {
                gaussians.sort_by_key(|gaussian| gaussian.id);
                gaussians.dedup_by_key(|gaussian| gaussian.id);
            }
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
        for plan in plans(published, &target.tiles, rounds_waited) {
            let wanted = plan.changes.len();
            let sent = affordable(plan.changes, room, deltas.is_empty());
            if sent.len() < wanted {
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
fn plans<'g>(
    published: &PublishedMap,
    tiles: &'g BTreeMap<TileKey, Vec<Gaussian>>,
    rounds_waited: &BTreeMap<TileKey, u32>,
) -> Vec<Plan<'g>> {
    let gone = published.tiles.keys();
    let gone = gone.filter(|tile| !tiles.contains_key(tile));
    let mut plans: Vec<_> = tiles
        .keys()
        .chain(gone)
        .filter_map(|&tile| {
            let old = published.tiles.get(&tile);
            let old = old.map_or(&[][..], |old| &old.gaussians);
            let new = tiles.get(&tile).map_or(&[][..], Vec::as_slice);
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

fn change_cost(change: &Change<'_>) -> usize {
    match change.now {
        Some(_) => BYTES_PER_POINT,
        None => REMOVED_BYTES,
    }
}

fn cost(changes: &[Change<'_>]) -> usize {
    DELTA_OVERHEAD_BYTES + changes.iter().map(change_cost).sum::<usize>()
}

/// The most important changes that `room` bytes hold, in order of id; at least one if `must_move`.
///
/// Only those that could fit are sorted: most tiles of a large map wait, round after round.
fn affordable(mut changes: Vec<Change<'_>>, room: usize, must_move: bool) -> Vec<Change<'_>> {
    if cost(&changes) <= room {
        return changes;
    }
    let most = room.saturating_sub(DELTA_OVERHEAD_BYTES) / REMOVED_BYTES.min(BYTES_PER_POINT);
    let most = most.max(usize::from(must_move));
    if most == 0 {
        return Vec::new();
    }
    let first = |a: &Change<'_>, b: &Change<'_>| b.score.total_cmp(&a.score).then(a.id.cmp(&b.id));
    if most < changes.len() {
        changes.select_nth_unstable_by(most, first);
        changes.truncate(most);
    }
    changes.sort_by(first);
    let mut total = DELTA_OVERHEAD_BYTES;
    let fitting = changes
        .iter()
        .take_while(|change| {
            total += change_cost(change);
            total <= room
        })
        .count();
    changes.truncate(fitting.max(usize::from(must_move)));
    changes.sort_by_key(|change| change.id);
    changes
}

/// Takes the changes into the published state and gives the delta that says so.
fn publish(published: &mut PublishedMap, tile: TileKey, sent: &[Change<'_>]) -> Delta {
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
        gaussians: sent
            .iter()
            .filter_map(|change| change.now.copied())
            .collect(),
        removed: removed.map(|change| change.id).collect::<Vec<GaussianId>>(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::gaussian;

    #[test]
    fn what_fits_is_what_matters_most_of_all_that_waits() {
        let gaussians: Vec<Gaussian> = (0..500).map(gaussian).collect();
        let change = |id: GaussianId| Change {
            id,
            now: (!id.is_multiple_of(3)).then(|| &gaussians[id as usize]),
            // Many alike, as new Gaussians are.
            score: f64::from(id * 7919 % 5) / 4.0,
        };
        let all: Vec<Change<'_>> = (0..500).map(change).collect();
        let mut sorted = all.clone();
        sorted.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.id.cmp(&b.id)));
        for room in (0..60_000).step_by(701) {
            for must_move in [false, true] {
                let sent = affordable(all.clone(), room, must_move);
                assert!(sent.is_sorted_by_key(|change| change.id));
                let mut first = sorted[..sent.len()].to_vec();
                first.sort_by_key(|change| change.id);
                assert_eq!(sent, first);
                let is_least = must_move && sent.len() == 1;
                assert!(sent.is_empty() || is_least || cost(&sent) <= room);
                // One more would not fit.
                let more = sorted.get(..=sent.len());
                assert!(more.is_none_or(|more| cost(more) > room));
                assert!(!must_move || !sent.is_empty());
            }
        }
    }
}
