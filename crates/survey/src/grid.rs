//! Places by cell, for whoever looks for what is near.

use std::collections::{BTreeSet, HashMap};

use echosplat_model::glam::DVec3;

pub(crate) type Cell = [i64; 3];

/// Metres; Gaussians of a map so near to each other are worked out of the same echoes, and err alike.
const ALIKE_M: f64 = 0.2;

/// Metres; what is so near to each other was seen at one time, with one error of the poses.
pub(crate) const SHARED_M: f64 = 1.0;

/// Of these places, without a unit, how many count as known for themselves.
pub(crate) fn independent_share(places_m: &[DVec3]) -> f64 {
    cells(places_m, ALIKE_M) as f64 / places_m.len().max(1) as f64
}

/// How many cells of this edge, metres, these places lie in.
pub(crate) fn cells(places_m: &[DVec3], edge_m: f64) -> usize {
    let cells: BTreeSet<Cell> = places_m.iter().map(|at| cell(*at, edge_m)).collect();
    cells.len()
}

/// Metres; edge of a cell. Surfaces of maps have a Gaussian in each.
const CELL_M: f64 = 0.2;

/// Places by cell, looked for within one reach.
#[derive(Debug)]
pub(crate) struct Grid {
    reach_m: f64,
    places_m: Vec<DVec3>,
    cells: HashMap<Cell, Vec<usize>>,
}

impl Grid {
    pub(crate) fn new(places_m: impl Iterator<Item = DVec3>, reach_m: f64) -> Self {
        let places_m: Vec<DVec3> = places_m.collect();
        let mut cells: HashMap<Cell, Vec<usize>> = HashMap::new();
        for (index, place) in places_m.iter().enumerate() {
            cells.entry(cell(*place, CELL_M)).or_default().push(index);
        }
        Self {
            reach_m,
            places_m,
            cells,
        }
    }

    /// All within reach: by rings of cells outward, in one order.
    pub(crate) fn near(&self, at_m: DVec3) -> impl Iterator<Item = (usize, f64)> {
        let rings = (self.reach_m / CELL_M).ceil() as i64;
        (0..=rings).flat_map(move |ring| self.in_ring(at_m, ring))
    }

    fn in_ring(&self, at_m: DVec3, ring: i64) -> impl Iterator<Item = (usize, f64)> {
        let [x, y, z] = cell(at_m, CELL_M);
        let span = move || -ring..=ring;
        let columns = span().flat_map(move |i| span().map(move |j| (i, j)));
        let around = columns.flat_map(move |(i, j)| {
            // Inside the ring's walls only its floor and its ceiling are of it.
            let is_wall = i.abs() == ring || j.abs() == ring;
            let step = if is_wall {
                1
            } else {
                (2 * ring).max(1) as usize
            };
            span().step_by(step).map(move |k| [x + i, y + j, z + k])
        });
        let held = around.filter_map(|cell| self.cells.get(&cell)).flatten();
        held.filter_map(move |&index| {
            let apart_m = self.places_m[index].distance(at_m);
            (apart_m <= self.reach_m).then_some((index, apart_m))
        })
    }

    /// The nearest within reach, and how far it is.
    pub(crate) fn nearest(&self, at_m: DVec3) -> Option<(usize, f64)> {
        let rings = (self.reach_m / CELL_M).ceil() as i64;
        let mut best: Option<(usize, f64)> = None;
        for ring in 0..=rings {
            // What lies in this ring is at least so far.
            let least_m = (ring - 1) as f64 * CELL_M;
            if best.is_some_and(|(_, apart_m)| apart_m <= least_m) {
                break;
            }
            let found = self.in_ring(at_m, ring).min_by(|a, b| a.1.total_cmp(&b.1));
            best = match (best, found) {
                (Some(held), Some(found)) if held.1 <= found.1 => Some(held),
                (held, found) => found.or(held),
            };
        }
        best
    }
}

pub(crate) fn cell(at_m: DVec3, edge_m: f64) -> Cell {
    (at_m / edge_m).floor().to_array().map(|index| index as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_near_is_found_as_by_asking_all() {
        let place = |i: u32| {
            let turn = f64::from(i) * 2.399_963;
            DVec3::new(turn.cos(), turn.sin(), (0.37 * f64::from(i)).sin()) * (0.02 * f64::from(i))
        };
        let places: Vec<DVec3> = (0..120).map(place).collect();
        let grid = Grid::new(places.iter().copied(), 0.5);
        for at in (0..120).map(|i| place(i) * 1.1 + DVec3::new(0.05, -0.03, 0.02)) {
            let mut all: Vec<(usize, f64)> =
                places.iter().map(|p| p.distance(at)).enumerate().collect();
            all.retain(|(_, apart_m)| *apart_m <= 0.5);
            all.sort_by(|a, b| a.1.total_cmp(&b.1));
            let mut found: Vec<(usize, f64)> = grid.near(at).collect();
            found.sort_by(|a, b| a.1.total_cmp(&b.1));
            assert_eq!(found, all);
            assert_eq!(grid.nearest(at), all.first().copied());
        }
    }
}
