//! Which Gaussians lie beside which.
//!
//! Cost: a sort of all, then for each cell of a grid one look at the 27 around it and a distance for
//! each pair in them.

use std::ops::Range;

use echosplat_model::glam::{IVec3, Vec3};
use rayon::prelude::*;

use crate::spawn::gaussians::Gaussians;

/// Some of the Gaussians, sorted by cell.
#[derive(Debug)]
pub(crate) struct Neighbours {
    cell_m: f32,
    /// In order of z, y, x.
    cells: Vec<Cell>,
    /// In order of cell, then of slot.
    places: Vec<Place>,
}

#[derive(Debug)]
struct Cell {
    at: IVec3,
    members: Range<usize>,
    strongest: f32,
}

#[derive(Debug, Clone, Copy)]
struct Place {
    cell: IVec3,
    mean_m: Vec3,
    slot: usize,
    strength: f32,
}

/// What lies around one Gaussian.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surroundings<'a> {
    pub(crate) slot: usize,
    center_m: Vec3,
    reach_m: f32,
    near: &'a [Place],
}

impl Surroundings<'_> {
    /// Slots within reach in a fixed order, its own among them.
    pub(crate) fn slots(&self) -> impl Iterator<Item = usize> + '_ {
        let reach_m2 = self.reach_m * self.reach_m;
        let is_near =
            move |place: &&Place| place.mean_m.distance_squared(self.center_m) <= reach_m2;
        self.near.iter().filter(is_near).map(|place| place.slot)
    }
}

impl Neighbours {
    /// Of the Gaussians that `keep` lets in, for questions of what is within `reach_m`.
    pub(crate) fn new(gaussians: &Gaussians, reach_m: f32, keep: impl Fn(usize) -> bool) -> Self {
        let slots: Vec<usize> = gaussians.slots().filter(|&slot| keep(slot)).collect();
        let place = |slot: usize| Place {
            cell: (gaussians.mean_m[slot] / reach_m).floor().as_ivec3(),
            mean_m: gaussians.mean_m[slot],
            slot,
            strength: gaussians.strongest(slot),
        };
        let mut places: Vec<Place> = slots.into_par_iter().map(place).collect();
        places.par_sort_unstable_by_key(|place| (order_of(place.cell), place.slot));
        let mut cells: Vec<Cell> = Vec::new();
        for (index, place) in places.iter().enumerate() {
            match cells.last_mut() {
                Some(last) if last.at == place.cell => {
                    last.members.end = index + 1;
                    last.strongest = last.strongest.max(place.strength);
                }
                _ => cells.push(Cell {
                    at: place.cell,
                    members: index..index + 1,
                    strongest: place.strength,
                }),
            }
        }
        Self {
            cell_m: reach_m,
            cells,
            places,
        }
    }

    /// What `each` makes of the Gaussians held that are `asked` for and their surroundings, in a fixed order.
    pub(crate) fn map<T: Send>(
        &self,
        asked: impl Fn(usize) -> bool + Sync,
        each: impl Fn(Surroundings<'_>) -> T + Sync,
    ) -> Vec<(usize, T)> {
        let of_cell = |near: &mut Vec<Place>, cell: &Cell| {
            let members = self.members(cell).iter();
            let members: Vec<&Place> = members.filter(|place| asked(place.slot)).collect();
            if members.is_empty() {
                return Vec::new();
            }
            near.clear();
            for beside in self.around(cell.at) {
                near.extend_from_slice(self.members(beside));
            }
            let found = members.into_iter().map(|place| {
                let around = Surroundings {
                    slot: place.slot,
                    center_m: place.mean_m,
                    reach_m: self.cell_m,
                    near,
                };
                (place.slot, each(around))
            });
            found.collect::<Vec<_>>()
        };
        let found = self.cells.par_iter().map_init(Vec::new, of_cell);
        found.flatten_iter().collect()
    }

    /// The strongest strength within reach of those Gaussians held that are `asked` for, with their
    /// slots.
    pub(crate) fn peaks(&self, asked: impl Fn(usize) -> bool + Sync) -> Vec<(usize, f32)> {
        let of_cell = |cell: &Cell| {
            let is_asked = |place: &&Place| asked(place.slot);
            if !self.members(cell).iter().any(|place| is_asked(&place)) {
                return Vec::new();
            }
            let mut beside: Vec<&Cell> = self.around(cell.at).collect();
            // The strongest first: most of the others need no look.
            beside.sort_unstable_by(|a, b| b.strongest.total_cmp(&a.strongest));
            let peak_of = |place: &Place| (place.slot, self.peak_among(&beside, place));
            let members = self.members(cell).iter();
            members.filter(is_asked).map(peak_of).collect::<Vec<_>>()
        };
        self.cells.par_iter().map(of_cell).flatten_iter().collect()
    }

    fn peak_among(&self, cells: &[&Cell], place: &Place) -> f32 {
        let reach_m2 = self.cell_m * self.cell_m;
        let mut peak = place.strength;
        for cell in cells {
            if cell.strongest <= peak {
                return peak;
            }
            for other in self.members(cell) {
                let is_near = other.mean_m.distance_squared(place.mean_m) <= reach_m2;
                if is_near && other.strength > peak {
                    peak = other.strength;
                }
            }
        }
        peak
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
            let start = self.cells.partition_point(|cell| order_of(cell.at) < first);
            let in_row = self.cells[start..].iter();
            in_row.take_while(move |cell| order_of(cell.at) <= last)
        })
    }
}

fn order_of(cell: IVec3) -> (i32, i32, i32) {
    (cell.z, cell.y, cell.x)
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
    fn a_peak_is_the_strongest_within_reach() {
        let mut gaussians = Gaussians::default();
        for (x, strength) in [(0.0, 1.0), (0.3, 3.0), (0.65, 2.0), (1.2, 0.5)] {
            gaussians.spawn(Vec3::new(x, 0.0, 0.0), (0, 0), 0.1, strength);
        }
        let peaks = Neighbours::new(&gaussians, 0.4, |_| true).peaks(|slot| slot != 1);
        assert_eq!(peaks, [(0, 3.0), (2, 3.0), (3, 0.5)]);
    }
}
