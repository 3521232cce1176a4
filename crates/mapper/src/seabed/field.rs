//! Heights of the ground on a grid, smoothed between what pings measured of them.

use std::collections::{BTreeMap, BTreeSet};

use echosplat_model::glam::{IVec2, Vec2, Vec3};

use super::BURIED_M;

/// Metres between nodes; found.
pub(crate) const NODE_M: f32 = 0.5;
/// Nodes along a tile; layout.
/// Nodes along the edge of a tile.
const TILE_EDGE: i32 = 16;
/// Nodes of a tile; layout.
const TILE_NODES: usize = 256;
/// Measurements; bounds memory.
/// Newest measurements that a node keeps.
const KEPT: usize = 15;
/// Metres, one sigma of a measurement; found.
const MEASURED_SIGMA_M: f32 = 0.08;
/// Metres, one sigma between unknown nodes; found.
/// One sigma of the step in height from node to node that is expected where nothing is known.
pub(crate) const STEP_SIGMA_M: f32 = 0.06;
/// Sweeps around what changed; bounds work.
/// Sweeps over the nodes around what changed.
const SWEEPS: usize = 6;
/// Measurements; found.
/// Measurements that the height of unknown ground remembers.
const FAR_MEMORY: u32 = 256;
/// Nodes around; found.
/// What is measured tells of so many nodes around it.
const KNOWN_NODES: i32 = 2;
/// Measurements; found.
/// Fewest measurements of a node, its neighbours included, that the map asserts.
const LEAST_MEASUREMENTS: usize = 6;

/// One node of the grid.
#[derive(Debug, Clone, Copy)]
struct Node {
    height_m: f32,
    kept: [f32; KEPT],
    count: u32,
    /// In order of first measurement.
    serial: u32,
}

impl Node {
    fn at(height_m: f32) -> Self {
        Self {
            height_m,
            kept: [0.0; KEPT],
            count: 0,
            serial: 0,
        }
    }

    fn kept(&self) -> &[f32] {
        &self.kept[..(self.count as usize).min(KEPT)]
    }

    fn add(&mut self, height_m: f32) {
        self.kept[self.count as usize % KEPT] = height_m;
        self.count += 1;
    }

    /// Median of what was measured and how many measurements that is.
    fn measured(&self) -> Option<(f32, f32)> {
        let mut kept = self.kept;
        let kept = &mut kept[..self.kept().len()];
        kept.sort_unstable_by(f32::total_cmp);
        let middle = kept.get(kept.len() / 2)?;
        Some((*middle, kept.len() as f32))
    }
}

/// Heights over x and y, map coordinates, metres.
#[derive(Debug, Default)]
pub(crate) struct Field {
    tiles: BTreeMap<[i32; 2], Box<[Node; TILE_NODES]>>,
    changed: BTreeSet<[i32; 2]>,
    /// Where nothing is known at all: the mean of late.
    far_height_m: f32,
    measurements: u32,
    measured_nodes: u32,
}

fn tile_of(node: IVec2) -> [i32; 2] {
    node.div_euclid(IVec2::splat(TILE_EDGE)).to_array()
}

fn index_of(node: IVec2) -> usize {
    let within = node.rem_euclid(IVec2::splat(TILE_EDGE));
    (within.y * TILE_EDGE + within.x) as usize
}

impl Field {
    /// Takes in one measurement of the ground.
    pub(crate) fn add(&mut self, point_m: Vec3) {
        let node = (point_m.truncate() / NODE_M).round().as_ivec2();
        let [x, y] = tile_of(node);
        self.measurements = self.measurements.saturating_add(1);
        let share = self.measurements.min(FAR_MEMORY) as f32;
        self.far_height_m += (point_m.z - self.far_height_m) / share;
        for dy in -1..=1 {
            for dx in -1..=1 {
                let key = [x + dx, y + dy];
                if !self.tiles.contains_key(&key) {
                    let start = self.far_height_m;
                    self.tiles
                        .insert(key, Box::new([Node::at(start); TILE_NODES]));
                }
                self.changed.insert(key);
            }
        }
        if let Some(tile) = self.tiles.get_mut(&[x, y]) {
            let node = &mut tile[index_of(node)];
            if node.count == 0 {
                node.serial = self.measured_nodes;
                self.measured_nodes += 1;
            }
            node.add(point_m.z);
        }
    }

    fn node(&self, node: IVec2) -> Option<&Node> {
        self.tiles
            .get(&tile_of(node))
            .map(|tile| &tile[index_of(node)])
    }

    /// Smooths the nodes around what changed since last time.
    pub(crate) fn smooth(&mut self) {
        let changed = std::mem::take(&mut self.changed);
        for sweep in 0..SWEEPS {
            for &key in &changed {
                self.sweep(key, sweep % 2 == 1);
            }
        }
    }

    fn sweep(&mut self, key: [i32; 2], backwards: bool) {
        let corner = IVec2::from_array(key) * TILE_EDGE;
        let stiffness = STEP_SIGMA_M.powi(-2);
        for step in 0..TILE_NODES as i32 {
            let step = if backwards {
                TILE_NODES as i32 - 1 - step
            } else {
                step
            };
            let at = corner + IVec2::new(step % TILE_EDGE, step / TILE_EDGE);
            let Some(node) = self.node(at) else { continue };
            let (mut sum, mut weight) = (0.0, 0.0);
            if let Some((median_m, count)) = node.measured() {
                let w = count * MEASURED_SIGMA_M.powi(-2);
                sum += w * median_m;
                weight += w;
            }
            for side in [IVec2::X, IVec2::NEG_X, IVec2::Y, IVec2::NEG_Y] {
                if let Some(beside) = self.node(at + side) {
                    sum += stiffness * beside.height_m;
                    weight += stiffness;
                }
            }
            if let Some(tile) = self.tiles.get_mut(&key) {
                tile[step as usize].height_m = sum / weight;
            }
        }
    }

    /// Height between the nodes around a place.
    pub(crate) fn height_m(&self, place_m: Vec2) -> f32 {
        let position = place_m / NODE_M;
        let low = position.floor();
        let fraction = position - low;
        let low = low.as_ivec2();
        let at = |dx, dy| {
            self.node(low + IVec2::new(dx, dy))
                .map_or(self.far_height_m, |node| node.height_m)
        };
        let near = at(0, 0) + fraction.x * (at(1, 0) - at(0, 0));
        let far = at(0, 1) + fraction.x * (at(1, 1) - at(0, 1));
        near + fraction.y * (far - near)
    }

    /// Whether anything was measured within [`KNOWN_NODES`] of a place.
    pub(crate) fn is_known(&self, place_m: Vec2) -> bool {
        let at = (place_m / NODE_M).round().as_ivec2();
        let reach = -KNOWN_NODES..=KNOWN_NODES;
        reach.clone().any(|dy| {
            let mut row = reach.clone().map(|dx| at + IVec2::new(dx, dy));
            row.any(|node| self.node(node).is_some_and(|node| node.count > 0))
        })
    }

    /// Whether the way from a sensor to an onset leads through ground that was measured, at less than half of the way: what
    /// is but somewhat deeper may be right, and what was measured before wrong.
    pub(crate) fn is_between(&self, sensor_m: Vec3, onset_m: Vec3) -> bool {
        let way_m = 0.5 * (onset_m - sensor_m);
        let steps = (way_m.truncate().length() / NODE_M).ceil();
        (1..=steps as u32).any(|step| {
            let at_m = sensor_m + way_m * (step as f32 / steps);
            let place_m = at_m.truncate();
            self.is_known(place_m) && at_m.z < self.height_m(place_m) - BURIED_M
        })
    }

    /// Every node that was measured often enough, in a fixed order.
    pub(crate) fn measured(&self) -> impl Iterator<Item = Ground> + '_ {
        self.tiles.iter().flat_map(move |(&key, tile)| {
            let corner = IVec2::from_array(key) * TILE_EDGE;
            tile.iter().enumerate().filter_map(move |(index, node)| {
                let at = corner + IVec2::new(index as i32 % TILE_EDGE, index as i32 / TILE_EDGE);
                if node.count == 0 {
                    return None;
                }
                self.ground_at(at, node)
            })
        })
    }

    fn ground_at(&self, at: IVec2, node: &Node) -> Option<Ground> {
        let (mut count, mut square) = (0, 0.0);
        for dy in -1..=1 {
            for dx in -1..=1 {
                if let Some(beside) = self.node(at + IVec2::new(dx, dy)) {
                    let off = |height_m: &f32| (height_m - beside.height_m).clamp(-0.5, 0.5);
                    count += beside.kept().len();
                    square += beside.kept().iter().map(off).map(|d| d * d).sum::<f32>();
                }
            }
        }
        (count >= LEAST_MEASUREMENTS).then(|| Ground {
            serial: node.serial,
            place_m: at.as_vec2() * NODE_M,
            spread_m: (square / count as f32).sqrt(),
        })
    }

    /// Upward unit normal at a place.
    pub(crate) fn normal(&self, place_m: Vec2) -> Vec3 {
        let slope = |step: Vec2| {
            let (ahead, behind) = (self.height_m(place_m + step), self.height_m(place_m - step));
            (ahead - behind) / (2.0 * NODE_M)
        };
        let (x, y) = (slope(Vec2::X * NODE_M), slope(Vec2::Y * NODE_M));
        Vec3::new(-x, -y, 1.0).normalize()
    }
}

/// A node that pings measured.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ground {
    /// In order of first measurement.
    pub(crate) serial: u32,
    pub(crate) place_m: Vec2,
    /// Root mean square of the measurements around it about the heights.
    pub(crate) spread_m: f32,
}
