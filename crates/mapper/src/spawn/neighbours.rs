//! Which Gaussians lie beside which.
//!
//! Cost: a sort of all, then for each cell of a grid one pass over the 27 around it and a distance for each pair in them.

use std::ops::Range;

use echosplat_model::glam::{IVec3, Vec3};
use rayon::prelude::*;

use crate::spawn::gaussians::Gaussians;

/// Cells that one thread looks around at a time; layout.
const CELLS_AT_ONCE: usize = 128;

/// Some of the Gaussians, sorted by cell.
#[derive(Debug)]
pub(crate) struct Neighbours {
    cell_m: f32,
    cells: Vec<Cell>,
    /// [`order_of`] each cell; they are in this order.
    orders: Vec<u128>,
    /// In order of cell, then of slot.
    places: Vec<Place>,
}

#[derive(Debug)]
struct Cell {
    at: IVec3,
    members: Range<usize>,
    strongest: f32,
}

/// What questions ask of a Gaussian, copied to where its neighbours are.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    pub(crate) mean_m: Vec3,
    slot: u32,
    /// In the direction in which it is strongest.
    pub(crate) strength: f32,
}

/// What lies around one Gaussian.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surroundings<'a> {
    pub(crate) slot: usize,
    pub(crate) center_m: Vec3,
    reach_m: f32,
    near: &'a [Place],
}

impl Surroundings<'_> {
    /// Those within reach in a fixed order, itself among them.
    pub(crate) fn places(&self) -> impl Iterator<Item = &Place> + '_ {
        let reach_m2 = self.reach_m * self.reach_m;
        let is_near =
            move |place: &&Place| place.mean_m.distance_squared(self.center_m) <= reach_m2;
        self.near.iter().filter(is_near)
    }

    /// Their slots.
    pub(crate) fn slots(&self) -> impl Iterator<Item = usize> + '_ {
        self.places().map(|place| place.slot as usize)
    }
}

impl Neighbours {
    /// Of the Gaussians that `keep` lets in, for questions of what is within `reach_m`.
    pub(crate) fn new(
        gaussians: &Gaussians,
        reach_m: f32,
        keep: impl Fn(usize) -> bool + Sync,
    ) -> Self {
        let cell_of = |slot: usize| (gaussians.mean_m[slot] / reach_m).floor().as_ivec3();
        // Cell and slot in one number, which sorts faster than what they stand for.
        let slots = (0..gaussians.slot_count()).into_par_iter();
        let kept = slots.filter(|&slot| gaussians.alive[slot] && keep(slot));
        let mut keys: Vec<u128> = kept
            .map(|slot| order_of(cell_of(slot)) << 32 | slot as u128)
            .collect();
        keys.par_sort_unstable();
        let place = |&key: &u128| {
            let slot = key as u32;
            Place {
                mean_m: gaussians.mean_m[slot as usize],
                slot,
                strength: gaussians.strongest(slot as usize),
            }
        };
        let places: Vec<Place> = keys.par_iter().map(place).collect();
        let (mut cells, mut orders): (Vec<Cell>, Vec<u128>) = (Vec::new(), Vec::new());
        for (index, (key, place)) in keys.iter().zip(&places).enumerate() {
            let order = key >> 32;
            match cells.last_mut() {
                Some(last) if orders.last() == Some(&order) => {
                    last.members.end = index + 1;
                    last.strongest = last.strongest.max(place.strength);
                }
                _ => {
                    orders.push(order);
                    cells.push(Cell {
                        at: cell_of(place.slot as usize),
                        members: index..index + 1,
                        strongest: place.strength,
                    });
                }
            }
        }
        Self {
            cell_m: reach_m,
            cells,
            orders,
            places,
        }
    }

    /// What `each` makes of the Gaussians held that are `asked` for and their surroundings, in a fixed order.
    pub(crate) fn map<T: Send>(
        &self,
        asked: impl Fn(usize) -> bool + Sync,
        each: impl Fn(Surroundings<'_>) -> T + Sync,
    ) -> Vec<(usize, T)> {
        let of_cells = |near: &mut Vec<Place>, cells: &[Cell]| {
            let mut found = Vec::new();
            for cell in cells {
                let members = self.members(cell);
                if !members.iter().any(|place| asked(place.slot as usize)) {
                    continue;
                }
                near.clear();
                for beside in self.around(cell.at) {
                    near.extend_from_slice(self.members(beside));
                }
                for place in members.iter().filter(|place| asked(place.slot as usize)) {
                    let around = Surroundings {
                        slot: place.slot as usize,
                        center_m: place.mean_m,
                        reach_m: self.cell_m,
                        near,
                    };
                    found.push((place.slot as usize, each(around)));
                }
            }
            found
        };
        let parts = self.cells.par_chunks(CELLS_AT_ONCE);
        let parts: Vec<Vec<(usize, T)>> = parts.map_init(Vec::new, of_cells).collect();
        parts.into_iter().flatten().collect()
    }

    /// Whether something within reach is so strong that they are at most `fraction` of it, of those Gaussians held that are
    /// `asked` for, in a fixed order. What has no strength always is.
    pub(crate) fn outshone(
        &self,
        fraction: f32,
        asked: impl Fn(usize) -> bool + Sync,
    ) -> Vec<(usize, bool)> {
        let of_cells = |cells: &[Cell]| {
            let (mut found, mut beside) = (Vec::new(), Vec::new());
            for cell in cells {
                let is_asked = |place: &&Place| asked(place.slot as usize);
                let members = || self.members(cell).iter().filter(is_asked);
                let strengths = members().map(|place| place.strength);
                let Some(weakest) = strengths.reduce(f32::min) else {
                    continue;
                };
                // Most cells hold nothing that is strong enough.
                let around = self.around(cell.at);
                beside.clear();
                beside.extend(around.filter(|cell| outshines(cell.strongest, weakest, fraction)));
                let is_outshone = |place: &Place| {
                    let mut beside = beside.iter();
                    beside.any(|cell| self.outshine(cell, place, fraction))
                };
                found.extend(members().map(|place| (place.slot as usize, is_outshone(place))));
            }
            found
        };
        let parts = self.cells.par_chunks(CELLS_AT_ONCE);
        let parts: Vec<Vec<(usize, bool)>> = parts.map(of_cells).collect();
        parts.into_iter().flatten().collect()
    }

    /// Whether the cell has something within reach that outshines the place.
    fn outshine(&self, cell: &Cell, place: &Place, fraction: f32) -> bool {
        let reach_m2 = self.cell_m * self.cell_m;
        outshines(cell.strongest, place.strength, fraction)
            && self.members(cell).iter().any(|other| {
                outshines(other.strength, place.strength, fraction)
                    && other.mean_m.distance_squared(place.mean_m) <= reach_m2
            })
    }

    fn members(&self, cell: &Cell) -> &[Place] {
        &self.places[cell.members.clone()]
    }

    /// The cell at `center` and those around it, as far as they hold anything.
    fn around(&self, center: IVec3) -> impl Iterator<Item = &Cell> {
        let rows = (-1..=1).flat_map(|z| (-1..=1).map(move |y| IVec3::new(0, y, z)));
        rows.flat_map(move |row| {
            let row = center.saturating_add(row);
            let first = order_of(row.saturating_sub(IVec3::X));
            let last = order_of(row.saturating_add(IVec3::X));
            let start = self.orders.partition_point(|&order| order < first);
            let in_row = self.orders[start..].iter().zip(&self.cells[start..]);
            let in_row = in_row.take_while(move |&(&order, _)| order <= last);
            in_row.map(|(_, cell)| cell)
        })
    }
}

/// Whether the weaker strength is at most `fraction` of the stronger; none at all always is.
fn outshines(stronger: f32, weaker: f32, fraction: f32) -> bool {
    !(weaker > fraction * stronger.max(f32::MIN_POSITIVE))
}

/// Cells in order of z, y, x.
fn order_of(cell: IVec3) -> u128 {
    let from_zero = |of: i32| u128::from(of.cast_unsigned() ^ 1 << 31);
    from_zero(cell.z) << 64 | from_zero(cell.y) << 32 | from_zero(cell.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_within_reach_are_found_across_cells() {
        let mut gaussians = Gaussians::default();
        for i in 0..200 {
            let i = i as f32;
            let at_m = Vec3::new((1.7 * i).sin(), (2.9 * i).sin(), (4.3 * i).sin());
            gaussians.spawn(at_m, (0, 0), 0.1, 1.0);
        }
        let even = |slot: usize| slot.is_multiple_of(2);
        let reach_m = 0.4;
        let asked = |slot: usize| slot.is_multiple_of(4);
        let found = Neighbours::new(&gaussians, reach_m, even).map(asked, |around| {
            let mut slots: Vec<usize> = around.slots().collect();
            slots.sort_unstable();
            slots
        });
        assert_eq!(found.len(), 50);
        for (slot, near) in found {
            let is_near = |&other: &usize| {
                even(other) && gaussians.mean_m[slot].distance(gaussians.mean_m[other]) <= reach_m
            };
            let expected: Vec<usize> = gaussians.slots().filter(is_near).collect();
            assert_eq!(near, expected);
        }
    }

    #[test]
    fn what_is_far_stronger_outshines_within_reach() {
        let mut gaussians = Gaussians::default();
        let row = [
            (0.0, 1.0),
            (0.3, 3.0),
            (0.65, 2.0),
            (0.7, 0.2),
            (1.2, 0.2),
            (3.0, 0.0),
        ];
        for (x, strength) in row {
            gaussians.spawn(Vec3::new(x, 0.0, 0.0), (0, 0), 0.1, strength);
        }
        let neighbours = Neighbours::new(&gaussians, 0.4, |_| true);
        let outshone = |fraction: f32| neighbours.outshone(fraction, |slot| slot != 1);
        let of = |so: [bool; 5]| [0, 2, 3, 4, 5].into_iter().zip(so).collect::<Vec<_>>();
        assert_eq!(outshone(0.4), of([true, false, true, false, true]));
        assert_eq!(outshone(0.05), of([false, false, false, false, true]));
    }
}
