//! From deltas and snapshot answers back to the map.

use std::cmp::Reverse;
use std::collections::{BTreeMap, VecDeque};

use echosplat_model::{Delta, Gaussian, GaussianId, Snapshot, TileKey, Timestamp};
use glam::DVec3;
use serde::Serialize;

use super::answer::{SnapshotAnswer, SnapshotRequest};

/// What became of a delta or an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// It is in the map.
    Applied,
    /// It waits for the answer that was asked for.
    Buffered,
    /// Its sequence was in the map already.
    Old,
    /// Deltas before it are missing: a snapshot is needed.
    Gap {
        /// Sequence that should have come.
        expected: u64,
        /// Sequence that came.
        found: u64,
    },
    /// The map started anew: a snapshot is needed.
    NewEpoch {
        /// The epoch that came.
        found: u64,
    },
    /// An answer that does not go with the map as it is: ask again, for everything.
    Unusable,
}

/// What happened so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct AssemblerCounters {
    /// Deltas now in the map.
    pub deltas_applied: u64,
    /// Deltas whose sequence was in the map already.
    pub deltas_old: u64,
    /// Buffered deltas that the answer shows to be of another epoch, or never sent.
    pub deltas_unexplained: u64,
    /// Deltas let go because the buffer for late joiners was full; oldest first.
    pub deltas_overflowed: u64,
    /// Times that a delta was missing.
    pub gaps: u64,
    /// Times that the map of another epoch took the place of the one there was.
    pub epochs: u64,
    /// Answers taken.
    pub snapshots_applied: u64,
    /// Answers that did not go with the map.
    pub snapshots_unusable: u64,
    /// Gaussians let go because the map was full; the newest.
    pub gaussians_overflowed: u64,
}

#[derive(Debug, Default)]
struct Tile {
    gaussians: BTreeMap<GaussianId, Gaussian>,
    changed_at: u64,
}

/// The map at the receiving end. It mirrors the published state tile by tile; until the first
/// answer, and after a gap or a new epoch, it buffers deltas and wants a snapshot.
#[derive(Debug)]
pub struct MapAssembler {
    max_gaussians: usize,
    tiles: BTreeMap<TileKey, Tile>,
    gaussian_count: usize,
    head: Option<Head>,
    needs_snapshot: bool,
    waiting: VecDeque<Waiting>,
    waiting_gaussians: usize,
    /// Of the newest map there was, whatever came between.
    newest_epoch: Option<u64>,
    counters: AssemblerCounters,
}

/// A delta that cannot be applied yet.
#[derive(Debug)]
struct Waiting {
    delta: Delta,
    is_final: bool,
    /// It was here when the snapshot was asked for, so the answer must reach it.
    came_before_asking: bool,
}

/// Where the map stands.
#[derive(Debug, Clone, Copy)]
struct Head {
    epoch: u64,
    sequence: u64,
    time: Timestamp,
    through_ping: u64,
    origin_m: DVec3,
    intensity_unit: f32,
    is_final: bool,
}

impl MapAssembler {
    /// Empty. Holds at most `max_gaussians` in the map and as many again while waiting.
    #[must_use]
    pub fn new(max_gaussians: usize) -> Self {
        Self {
            max_gaussians,
            tiles: BTreeMap::new(),
            gaussian_count: 0,
            head: None,
            needs_snapshot: true,
            waiting: VecDeque::new(),
            waiting_gaussians: 0,
            newest_epoch: None,
            counters: AssemblerCounters::default(),
        }
    }

    /// Takes the next delta. `is_final`: the publisher marked it as the last one.
    pub fn delta(&mut self, delta: Delta, is_final: bool) -> Progress {
        let Some(head) = self.head else {
            return self.buffer(delta, is_final);
        };
        if delta.epoch != head.epoch {
            let found = delta.epoch;
            return self.lose_thread(delta, is_final, Progress::NewEpoch { found });
        }
        if delta.sequence <= head.sequence {
            self.counters.deltas_old += 1;
            return Progress::Old;
        }
        let (expected, found) = (head.sequence.saturating_add(1), delta.sequence);
        if found != expected {
            return self.lose_thread(delta, is_final, Progress::Gap { expected, found });
        }
        self.apply(delta, is_final);
        Progress::Applied
    }

    /// Buffers `delta` and, the first time, says why a snapshot is needed.
    fn lose_thread(&mut self, delta: Delta, is_final: bool, why: Progress) -> Progress {
        self.buffer(delta, is_final);
        if self.needs_snapshot {
            return Progress::Buffered;
        }
        self.needs_snapshot = true;
        if matches!(why, Progress::Gap { .. }) {
            self.counters.gaps += 1;
        }
        why
    }

    fn buffer(&mut self, delta: Delta, is_final: bool) -> Progress {
        self.waiting_gaussians += weight(&delta);
        self.waiting.push_back(Waiting {
            delta,
            is_final,
            came_before_asking: false,
        });
        while self.waiting_gaussians > self.max_gaussians {
            let Some(dropped) = self.waiting.pop_front() else {
                break;
            };
            self.waiting_gaussians -= weight(&dropped.delta);
            self.counters.deltas_overflowed += 1;
        }
        Progress::Buffered
    }

    fn apply(&mut self, delta: Delta, is_final: bool) {
        let tile = self.tiles.entry(delta.tile).or_default();
        let before = tile.gaussians.len();
        for id in &delta.removed {
            tile.gaussians.remove(id);
        }
        let others = self.gaussian_count - before;
        let room = self.max_gaussians.saturating_sub(others);
        for gaussian in delta.gaussians {
            let known = tile.gaussians.contains_key(&gaussian.id);
            if known || tile.gaussians.len() < room {
                tile.gaussians.insert(gaussian.id, gaussian);
            } else {
                self.counters.gaussians_overflowed += 1;
            }
        }
        tile.changed_at = delta.sequence;
        self.gaussian_count = others + tile.gaussians.len();
        if tile.gaussians.is_empty() {
            self.tiles.remove(&delta.tile);
        }
        self.counters.deltas_applied += 1;
        self.head = Some(Head {
            epoch: delta.epoch,
            sequence: delta.sequence,
            time: delta.time,
            through_ping: delta.through_ping,
            origin_m: delta.origin_m,
            intensity_unit: delta.intensity_unit,
            is_final,
        });
    }

    /// Takes an answer, then every buffered delta that follows it.
    pub fn snapshot(&mut self, answer: SnapshotAnswer) -> Progress {
        let known = self.head.filter(|head| head.epoch == answer.epoch);
        let usable = match (answer.since, known) {
            // Only what changed: it must start where the map stands, or before, and lead on.
            (Some(since), Some(head)) => since <= head.sequence && answer.sequence >= head.sequence,
            (Some(_), None) => false,
            (None, _) => true,
        };
        if !usable {
            self.counters.snapshots_unusable += 1;
            self.head = None;
            self.needs_snapshot = true;
            return Progress::Unusable;
        }
        if answer.since.is_none() {
            self.tiles.clear();
        }
        self.counters.snapshots_applied += 1;
        let before = self.newest_epoch.replace(answer.epoch);
        self.counters.epochs += u64::from(before.is_some_and(|epoch| epoch != answer.epoch));
        self.replace_tiles(answer);
        self.needs_snapshot = false;
        self.drain_waiting()
    }

    fn replace_tiles(&mut self, answer: SnapshotAnswer) {
        for state in answer.tiles {
            let tile = Tile {
                gaussians: state.gaussians.into_iter().map(|g| (g.id, g)).collect(),
                changed_at: answer.sequence,
            };
            match tile.gaussians.is_empty() {
                true => self.tiles.remove(&state.tile),
                false => self.tiles.insert(state.tile, tile),
            };
        }
        self.gaussian_count = self.tiles.values().map(|tile| tile.gaussians.len()).sum();
        self.let_overflow_go();
        self.head = Some(Head {
            epoch: answer.epoch,
            sequence: answer.sequence,
            time: answer.time,
            through_ping: answer.through_ping,
            origin_m: answer.origin_m,
            intensity_unit: answer.intensity_unit,
            is_final: answer.is_final,
        });
    }

    fn let_overflow_go(&mut self) {
        while self.gaussian_count > self.max_gaussians {
            let Some((_, tile)) = self.tiles.pop_last() else {
                return;
            };
            self.gaussian_count -= tile.gaussians.len();
            self.counters.gaussians_overflowed += tile.gaussians.len() as u64;
        }
    }

    /// Applies what was buffered, as far as it follows; what lies beyond a new gap is kept. Let go
    /// are deltas of another epoch (of an older one they are worthless, and a newer one shows
    /// itself again with its next delta), and those beyond an answer that was asked for after
    /// they came: the publisher never sent them.
    fn drain_waiting(&mut self) -> Progress {
        self.waiting_gaussians = 0;
        for waiting in std::mem::take(&mut self.waiting) {
            let Some(head) = self.head else { break };
            let next = head.sequence.saturating_add(1);
            let is_beyond = waiting.delta.sequence > next && waiting.came_before_asking;
            if waiting.delta.epoch == head.epoch && !is_beyond {
                self.delta(waiting.delta, waiting.is_final);
            } else {
                self.counters.deltas_unexplained += 1;
            }
        }
        Progress::Applied
    }

    /// Forgets where it stands: whoever published has gone and may come back with another map.
    pub fn restart(&mut self) {
        self.head = None;
        self.needs_snapshot = true;
        self.waiting.clear();
        self.waiting_gaussians = 0;
    }

    /// Whether an answer to [`MapAssembler::request`] is needed to go on.
    #[must_use]
    pub fn needs_snapshot(&self) -> bool {
        self.needs_snapshot
    }

    /// What to ask for now: what changed since the map as it stands, or everything.
    #[must_use]
    pub fn request(&mut self) -> SnapshotRequest {
        for waiting in &mut self.waiting {
            waiting.came_before_asking = true;
        }
        SnapshotRequest {
            bbox_m: None,
            epoch: self.head.map(|head| head.epoch),
            since: self.head.map(|head| head.sequence),
        }
    }

    /// Epoch and sequence of the map as it stands.
    #[must_use]
    pub fn position(&self) -> Option<(u64, u64)> {
        self.head.map(|head| (head.epoch, head.sequence))
    }

    /// Transmit time of the newest ping whose evidence is in the map as it stands.
    #[must_use]
    pub fn time(&self) -> Option<Timestamp> {
        self.head.map(|head| head.time)
    }

    /// Whether the map is whole and the publisher said that nothing more will come.
    #[must_use]
    pub fn is_final(&self) -> bool {
        !self.needs_snapshot && self.head.is_some_and(|head| head.is_final)
    }

    /// How many Gaussians the map holds.
    #[must_use]
    pub fn gaussian_count(&self) -> usize {
        self.gaussian_count
    }

    /// What happened so far.
    #[must_use]
    pub fn counters(&self) -> AssemblerCounters {
        self.counters
    }

    /// The map as it stands, Gaussians in order of id. `None` before the first answer. One that
    /// just moved to another tile may still be in both; the newer one is given.
    #[must_use]
    pub fn to_snapshot(&self) -> Option<Snapshot> {
        let head = self.head?;
        let mut entries: Vec<(u64, &Gaussian)> = Vec::with_capacity(self.gaussian_count);
        for tile in self.tiles.values() {
            entries.extend(tile.gaussians.values().map(|g| (tile.changed_at, g)));
        }
        entries.sort_by_key(|(changed_at, gaussian)| (gaussian.id, Reverse(*changed_at)));
        entries.dedup_by_key(|(_, gaussian)| gaussian.id);
        Some(Snapshot {
            epoch: head.epoch,
            sequence: head.sequence,
            time: head.time,
            through_ping: head.through_ping,
            origin_m: head.origin_m,
            intensity_unit: head.intensity_unit,
            gaussians: entries.into_iter().map(|(_, gaussian)| *gaussian).collect(),
        })
    }
}

/// What a buffered delta counts as; one for itself, so that empty ones are bounded too.
fn weight(delta: &Delta) -> usize {
    1 + delta.gaussians.len() + delta.removed.len()
}
