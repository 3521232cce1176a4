//! What candidates begin with where the map knows something of their places already.
//!
//! Cost: nine cells around each Gaussian of the map in the tiles concerned, three layers of them.

use echosplat_model::Standing;
use echosplat_model::glam::Vec3;
use foldhash::{HashMap, HashMapExt};
use rayon::prelude::*;

use crate::refine::places::Places;
use crate::spawn::directional_reflectivity::DirectionalReflectivity;
use crate::spawn::gaussians::{Gaussians, Stage, Verdict};
use crate::spawn::kept::Kept;

/// Fraction of strength, derived: `SIDE_LOBE_FRACTION`.
/// All other places begin with this fraction of the middle strength of the tiles: what side lobes have when
/// they are let go, so that a few steps let go of them or raise them.
const LEAST_FRACTION: f32 = 0.05;

/// Gives every candidate of `draft` the strength that the Gaussians `known` of `map` have at its place.
pub(crate) fn inherit(draft: &mut Gaussians, map: &Gaussians, known: &[u32], voxel_m: f32) {
    let known = known.iter().map(|&slot| slot as usize);
    let known: Vec<usize> = known.filter(|&s| map.stage[s] == Stage::Worked).collect();
    let strengths = known.iter().map(|&slot| strength(map, slot, voxel_m));
    let mut strengths: Vec<f32> = strengths.collect();
    if strengths.is_empty() {
        return;
    }
    let middle = strengths.len() / 2;
    let middle = *strengths.select_nth_unstable_by(middle, f32::total_cmp).1;
    let candidates: Vec<usize> = draft.slots().filter(|&s| draft.is_worked_on(s)).collect();
    let centers = candidates.iter().map(|&slot| (slot, draft.home_m[slot]));
    let places = Places::of(centers, voxel_m);
    for &slot in &candidates {
        draft.strength[slot] = DirectionalReflectivity::default();
    }
    let shares = |&slot: &usize| match map.verdict[slot] {
        Verdict::Published(Standing::Confident) => places.shares(map.mean_m[slot]),
        _ => {
            let place = places.at(map.home_m[slot]);
            place.map(|place| (place, 1.0)).into_iter().collect()
        }
    };
    let shares: Vec<Vec<(usize, f32)>> = known.par_iter().map(shares).collect();
    for (&slot, shares) in known.iter().zip(shares) {
        let whole = whole_of(map, slot, voxel_m);
        for (place, fraction) in shares {
            let mut share = whole;
            share.scale(fraction);
            draft.strength[place].add(&share);
        }
    }
    let mut kept: HashMap<usize, Vec<&Kept>> = HashMap::new();
    let mut strength_of: HashMap<usize, DirectionalReflectivity> = HashMap::new();
    for slot in known {
        if let Some(told) = &map.kept[slot]
            && let Some(place) = places.at(map.home_m[slot])
        {
            kept.entry(place).or_default().push(told);
            strength_of
                .entry(place)
                .or_default()
                .add(&whole_of(map, slot, voxel_m));
        }
    }
    for (place, children) in kept {
        let told = Kept::mean(children.into_iter());
        draft.kept[place] = told.map(|told| {
            Box::new(Kept {
                strength: strength_of[&place],
                ..told
            })
        });
    }
    let least = Vec3::splat(LEAST_FRACTION * middle);
    for slot in candidates {
        let DirectionalReflectivity { ahead, behind } = draft.strength[slot];
        draft.strength[slot] = DirectionalReflectivity {
            ahead: ahead.max(least),
            behind: behind.max(least),
        };
    }
}

/// Strengths of a round Gaussian of one voxel that sends back as much.
fn whole_of(map: &Gaussians, slot: usize, voxel_m: f32) -> DirectionalReflectivity {
    let mut whole = map.strength[slot];
    whole.scale(area_of(map, slot) / whole_area(voxel_m));
    whole
}

/// The strongest of them.
fn strength(map: &Gaussians, slot: usize, voxel_m: f32) -> f32 {
    map.strongest(slot) * area_of(map, slot) / whole_area(voxel_m)
}

/// What it covers seen along its shortest axis, over 2π.
pub(crate) fn area_of(map: &Gaussians, slot: usize) -> f32 {
    let scale_m = map.scale_m[slot];
    scale_m.element_product() / scale_m.min_element()
}

/// The same of a round Gaussian of one voxel.
pub(crate) fn whole_area(voxel_m: f32) -> f32 {
    (0.5 * voxel_m).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::IVec3;

    const VOXEL_M: f32 = 0.1;

    fn at(x: i32) -> Vec3 {
        (IVec3::new(x, 0, 0).as_vec3() + 0.5) * VOXEL_M
    }

    fn row_of(strength: f32) -> Gaussians {
        let mut gaussians = Gaussians::default();
        for x in 0..5 {
            gaussians.spawn(at(x), (0, x as u16), 0.5 * VOXEL_M, strength);
        }
        gaussians
    }

    /// A map of one Gaussian at the middle of the row, and what a row of candidates gets of it.
    fn inherited(verdict: Verdict) -> Vec<f32> {
        let mut map = Gaussians::default();
        let slot = map.spawn(at(2), (0, 2), 0.5 * VOXEL_M, 1.0) as usize;
        (map.stage[slot], map.verdict[slot]) = (Stage::Worked, verdict);
        let mut draft = row_of(7.0);
        inherit(&mut draft, &map, &[slot as u32], VOXEL_M);
        (0..5).map(|slot| draft.strongest(slot)).collect()
    }

    #[test]
    fn a_confident_surface_is_shared_with_the_places_around_it_and_nothing_is_lost() {
        let strengths = inherited(Verdict::Published(Standing::Confident));
        assert!(
            strengths[2] > strengths[1] && strengths[1] > 0.1,
            "{strengths:?}"
        );
        let sum: f32 = strengths[1..4].iter().sum();
        assert!((sum - 1.0).abs() < 1e-5, "{strengths:?}");
        assert!(
            (strengths[0] - LEAST_FRACTION).abs() < 1e-6,
            "{strengths:?}"
        );
    }

    #[test]
    fn what_is_ambiguous_stays_where_it_is() {
        let strengths = inherited(Verdict::Published(Standing::Ambiguous));
        assert!((strengths[2] - 1.0).abs() < 1e-6 && strengths[1] < 0.06);
    }

    #[test]
    fn without_a_map_candidates_keep_what_they_began_with() {
        let mut draft = row_of(7.0);
        inherit(&mut draft, &Gaussians::default(), &[], VOXEL_M);
        assert!((draft.strongest(3) - 7.0).abs() < 1e-6);
    }
}
