//! Places on the grid of voxels, found by where they are.

use echosplat_model::glam::{IVec3, Vec3};
use foldhash::{HashMap, HashMapExt};

/// Voxels, found.
/// A surface goes on beside itself: what a Gaussian shares with the places around it falls by a normal distribution
/// of this standard deviation, in voxels.
const SPREAD_VOXELS: f32 = 0.8;

/// At most one place a voxel, each with a number of the caller's.
#[derive(Debug)]
pub(crate) struct Places {
    voxel_m: f32,
    place_of: HashMap<IVec3, (usize, Vec3)>,
}

impl Places {
    /// Places by number and centre, in metres.
    pub(crate) fn of(centers: impl Iterator<Item = (usize, Vec3)>, voxel_m: f32) -> Self {
        let mut places = Self {
            voxel_m,
            place_of: HashMap::new(),
        };
        for (place, center_m) in centers {
            let cell = places.cell(center_m);
            places.place_of.insert(cell, (place, center_m));
        }
        places
    }

    fn cell(&self, at_m: Vec3) -> IVec3 {
        (at_m / self.voxel_m).floor().as_ivec3()
    }

    /// The place in whose voxel this is.
    pub(crate) fn at(&self, at_m: Vec3) -> Option<usize> {
        self.place_of.get(&self.cell(at_m)).map(|&(place, _)| place)
    }

    /// Places in this voxel and the 26 around it.
    fn near(&self, at_m: Vec3) -> impl Iterator<Item = &(usize, Vec3)> {
        let cell = self.cell(at_m);
        let cells = (0..27).map(move |i| cell + IVec3::new(i % 3, i / 3 % 3, i / 9) - IVec3::ONE);
        cells.filter_map(|cell| self.place_of.get(&cell))
    }

    /// Whether there is a place in this voxel or the 26 around it.
    pub(crate) fn any_near(&self, at_m: Vec3) -> bool {
        self.near(at_m).next().is_some()
    }

    /// The places in this voxel and the 26 around it, each with its fraction of what is here. The fractions add up to 1;
    /// the list is empty where there is no place.
    pub(crate) fn shares(&self, at_m: Vec3) -> Vec<(usize, f32)> {
        let mut shares: Vec<(usize, f32)> = self
            .near(at_m)
            .map(|&(place, center_m)| {
                let away = center_m.distance(at_m) / (SPREAD_VOXELS * self.voxel_m);
                (place, (-0.5 * away * away).exp())
            })
            .collect();
        let all: f32 = shares.iter().map(|(_, fraction)| fraction).sum();
        for (_, fraction) in &mut shares {
            *fraction /= all;
        }
        shares
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn center_m(x: i32) -> Vec3 {
        (IVec3::new(x, 0, 0).as_vec3() + 0.5) * 0.1
    }

    #[test]
    fn what_is_shared_is_whole_and_nearer_places_have_more() {
        let places = Places::of((0..5).map(|x| (x as usize, center_m(x))), 0.1);
        let shares = places.shares(center_m(2) + Vec3::X * 0.02);
        let fraction: HashMap<usize, f32> = shares.iter().copied().collect();
        assert_eq!(fraction.len(), 3);
        assert!(
            (fraction.values().sum::<f32>() - 1.0).abs() < 1e-6,
            "{fraction:?}"
        );
        assert!(
            fraction[&2] > fraction[&3] && fraction[&3] > fraction[&1],
            "{fraction:?}"
        );
    }

    #[test]
    fn a_place_is_found_by_its_voxel_and_none_has_shares_of_what_is_far() {
        let places = Places::of([(7, center_m(-1))].into_iter(), 0.1);
        assert_eq!(places.at(center_m(-1) + Vec3::X * 0.04), Some(7));
        assert_eq!(places.at(center_m(0)), None);
        assert!(places.shares(center_m(1)).is_empty());
        assert!(places.any_near(center_m(0)) && !places.any_near(center_m(1)));
    }
}
