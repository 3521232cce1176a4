//! Candidates that were let go, taken again beside what stayed.
//!
//! Strengths that have converged stand on few places of a surface. Filled again, it is covered, and places that
//! nothing strong is near stay away.
//!
//! Cost: 27 cells around each Gaussian, once a work-out.

use echosplat_model::glam::Vec3;

use crate::accumulate::evidence::BlockIndex;
use crate::refine::places::Places;
use crate::spawn::directional_reflectivity::{DirectionalReflectivity, Faces};
use crate::spawn::gaussians::{Gaussians, Verdict};

/// A place that a work-out began with: its centre, and its block and voxel.
pub(crate) type Candidate = (Vec3, (BlockIndex, u16));

/// Every Gaussian that is worked on gives way to the candidates around it, which share its strength and the faces it
/// is known from.
pub(crate) fn refill(draft: &mut Gaussians, candidates: &[Candidate], voxel_m: f32) {
    let centers = candidates.iter().map(|&(center_m, _)| center_m);
    let places = Places::of(centers.enumerate(), voxel_m);
    let mut got: Vec<Option<(DirectionalReflectivity, Faces)>> = vec![None; candidates.len()];
    let worked_on: Vec<usize> = draft.slots().filter(|&s| draft.is_worked_on(s)).collect();
    for slot in worked_on {
        for (place, fraction) in places.shares(draft.mean_m[slot]) {
            let (strength, known) = got[place].get_or_insert_default();
            let mut share = draft.strength[slot];
            share.scale(fraction);
            strength.add(&share);
            known.join(draft.known[slot]);
        }
        draft.remove(slot as u32);
    }
    for (&(center_m, home), got) in candidates.iter().zip(got) {
        if let Some((strength, known)) = got {
            let slot = draft.spawn(center_m, home, 0.5 * voxel_m, 0.0) as usize;
            (draft.strength[slot], draft.known[slot]) = (strength, known);
            draft.verdict[slot] = Verdict::ExplainedAway;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spawn::gaussians::Stage;
    use echosplat_model::glam::{BVec3, IVec3};

    const VOXEL_M: f32 = 0.1;

    fn row() -> Vec<Candidate> {
        let center_m = |x: i32| (IVec3::new(x, 0, 0).as_vec3() + 0.5) * VOXEL_M;
        (0..9).map(|x| (center_m(x), (3, x as u16))).collect()
    }

    fn spawn(draft: &mut Gaussians, (center_m, home): Candidate, strength: f32) -> usize {
        draft.spawn(center_m, home, 0.5 * VOXEL_M, strength) as usize
    }

    #[test]
    fn candidates_beside_what_stayed_share_its_strength_and_nothing_is_lost() {
        let (row, mut draft) = (row(), Gaussians::default());
        let (two, four) = (
            spawn(&mut draft, row[2], 1.0),
            spawn(&mut draft, row[4], 3.0),
        );
        draft.known[two].ahead = BVec3::new(true, false, false);
        draft.known[four].behind = BVec3::new(false, true, false);
        refill(&mut draft, &row, VOXEL_M);
        let slots: Vec<usize> = draft.slots().collect();
        let mut voxels: Vec<u16> = slots.iter().map(|&slot| draft.home[slot].1).collect();
        voxels.sort_unstable();
        assert_eq!(voxels, [1, 2, 3, 4, 5]);
        let sum: f32 = slots.iter().map(|&slot| draft.strength[slot].ahead.x).sum();
        assert!((sum - 4.0).abs() < 1e-5, "{sum}");
        let between = slots.iter().find(|&&slot| draft.home[slot].1 == 3).unwrap();
        let known = draft.known[*between];
        assert!(known.ahead.x && known.behind.y && !known.ahead.y);
    }

    #[test]
    fn what_is_held_still_is_left_as_it_is() {
        let (row, mut draft) = (row(), Gaussians::default());
        let held = spawn(&mut draft, row[4], 1.0);
        draft.stage[held] = Stage::Background;
        refill(&mut draft, &row, VOXEL_M);
        assert_eq!(draft.alive_count(), 1);
        assert!((draft.strongest(held) - 1.0).abs() < 1e-6);
    }
}
