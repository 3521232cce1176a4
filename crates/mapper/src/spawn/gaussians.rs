//! The Gaussians as arrays of each quantity, with stable ids.

use echosplat_measurement::SymmetricMat3;
use echosplat_model::glam::{Mat3, Quat, Vec3};
use echosplat_model::{GaussianId, Reason, Standing, Why};

use crate::accumulate::evidence::{BlockIndex, spare};
use crate::spawn::directional_reflectivity::{DirectionalReflectivity, Faces};
use crate::spawn::kept::Kept;

/// Probability, measured on 29 dives.
/// Of places that the map says nothing for, this fraction has surface within 0.10 m by chance: those it holds lie about
/// the structure.
pub(crate) const BY_CHANCE: f32 = 0.05;
/// What the last assessment found of a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Published with its standing.
    Published(Standing),
    /// Other Gaussians explain its echoes: kept, not published.
    ExplainedAway,
}

/// How far a Gaussian has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stage {
    /// Spawned where evidence asked for it, and not worked out since.
    Spawned,
    /// Strength, place and verdict are worked out from pings.
    Worked,
    /// Held still beside those that are being worked out.
    Background,
    /// Of voxels that are no more: published until what is in the new ones is worked out, and part of nothing else.
    Former,
}

/// Arrays indexed by slot. A slot is used again after its Gaussian is gone, an id never.
#[derive(Debug, Default)]
pub(crate) struct Gaussians {
    pub(crate) id: Vec<GaussianId>,
    /// The id it was spawned with, which no other ever has: what is in a map stays as it is from then on until it is gone.
    pub(crate) birth: Vec<GaussianId>,
    pub(crate) alive: Vec<bool>,
    /// Where it was spawned; it stays within a voxel of there.
    pub(crate) home_m: Vec<Vec3>,
    pub(crate) home: Vec<(BlockIndex, u16)>,
    pub(crate) mean_m: Vec<Vec3>,
    pub(crate) rotation: Vec<Quat>,
    pub(crate) scale_m: Vec<Vec3>,
    pub(crate) covariance_m2: Vec<SymmetricMat3>,
    /// αρ towards each face, in the unit of the pings' intensity.
    pub(crate) strength: Vec<DirectionalReflectivity>,
    /// Faces that a ping has told the strength of; the others hold what they began with.
    pub(crate) known: Vec<Faces>,
    /// Its share of the Gaussian it was split from: ⅛, or 1 if it was not split.
    pub(crate) child_share: Vec<f32>,
    pub(crate) sigma_m: Vec<f32>,
    /// Of its position; see [`crate::classify::certainty`].
    pub(crate) position_covariance_m2: Vec<SymmetricMat3>,
    /// That there is surface beside it.
    pub(crate) probability: Vec<f32>,
    /// That it is asserted where its observations fix it.
    pub(crate) is_likely: Vec<bool>,
    pub(crate) verdict: Vec<Verdict>,
    /// Which test gave the verdict.
    pub(crate) why: Vec<Why>,
    pub(crate) stage: Vec<Stage>,
    /// What forgotten pings told.
    pub(crate) kept: Vec<Option<Box<Kept>>>,
    free: Vec<u32>,
    next_id: GaussianId,
}

impl Gaussians {
    /// Slots, alive or free.
    pub(crate) fn slot_count(&self) -> usize {
        self.id.len()
    }

    pub(crate) fn alive_count(&self) -> usize {
        self.id.len() - self.free.len()
    }

    /// A round Gaussian of one voxel, at the centre of its home.
    pub(crate) fn spawn(
        &mut self,
        home_m: Vec3,
        home: (BlockIndex, u16),
        scale_m: f32,
        strength: f32,
    ) -> u32 {
        let id = self.next_id;
        self.next_id += 1;
        let slot = self.free.pop().unwrap_or_else(|| self.grow());
        let s = slot as usize;
        (self.id[s], self.birth[s]) = (id, id);
        self.alive[s] = true;
        self.home_m[s] = home_m;
        self.home[s] = home;
        self.mean_m[s] = home_m;
        self.set_shape(s, Quat::IDENTITY, Vec3::splat(scale_m));
        self.strength[s] = DirectionalReflectivity::even(strength);
        self.known[s] = Faces::default();
        self.child_share[s] = 1.0;
        self.sigma_m[s] = f32::INFINITY;
        self.position_covariance_m2[s] = SymmetricMat3::isotropic(f32::INFINITY);
        self.probability[s] = BY_CHANCE;
        self.is_likely[s] = false;
        self.verdict[s] = Verdict::Published(Standing::Ambiguous);
        self.why[s] = Why::of(Reason::NotWorkedOut, 0.0, 0.0);
        self.stage[s] = Stage::Spawned;
        self.kept[s] = None;
        slot
    }

    /// A copy of another map's Gaussian, with an id of its own.
    pub(crate) fn adopt(&mut self, other: &Self, slot: usize, stage: Stage) -> u32 {
        let copy = self.spawn(other.home_m[slot], other.home[slot], 1.0, 0.0);
        let c = copy as usize;
        self.mean_m[c] = other.mean_m[slot];
        self.rotation[c] = other.rotation[slot];
        self.scale_m[c] = other.scale_m[slot];
        self.covariance_m2[c] = other.covariance_m2[slot];
        self.strength[c] = other.strength[slot];
        self.known[c] = other.known[slot];
        self.child_share[c] = other.child_share[slot];
        self.sigma_m[c] = other.sigma_m[slot];
        self.position_covariance_m2[c] = other.position_covariance_m2[slot];
        self.probability[c] = other.probability[slot];
        self.is_likely[c] = other.is_likely[slot];
        self.verdict[c] = other.verdict[slot];
        self.why[c] = other.why[slot];
        self.stage[c] = stage;
        copy
    }

    /// Whether a slot is in use and being worked out, rather than held still.
    pub(crate) fn is_worked_on(&self, slot: usize) -> bool {
        self.alive[slot] && self.stage[slot] != Stage::Background
    }

    /// Lets one go; one that is gone stays so, and its slot is free once.
    pub(crate) fn remove(&mut self, slot: u32) {
        if !std::mem::take(&mut self.alive[slot as usize]) {
            return;
        }
        self.strength[slot as usize] = DirectionalReflectivity::default();
        self.kept[slot as usize] = None;
        self.free.push(slot);
    }

    /// Lets all of them go.
    pub(crate) fn remove_all(&mut self, slots: &[usize]) {
        for &slot in slots {
            self.remove(slot as u32);
        }
    }

    /// Lets go of all but what was worked out and is published, which stays as it is, in no voxel.
    pub(crate) fn leave_voxels(&mut self) {
        let slots: Vec<usize> = self.slots().collect();
        for slot in slots {
            let is_shown = matches!(self.verdict[slot], Verdict::Published(_));
            match self.stage[slot] {
                Stage::Worked | Stage::Former if is_shown => self.stage[slot] = Stage::Former,
                _ => self.remove(slot as u32),
            }
        }
    }

    /// Lets go of what voxels that are no more had.
    pub(crate) fn let_former_go(&mut self) {
        let slots = self.slots();
        let former: Vec<usize> = slots.filter(|&s| self.stage[s] == Stage::Former).collect();
        self.remove_all(&former);
    }

    pub(crate) fn set_shape(&mut self, slot: usize, rotation: Quat, scale_m: Vec3) {
        let axes = Mat3::from_quat(rotation) * Mat3::from_diagonal(scale_m);
        self.rotation[slot] = rotation;
        self.scale_m[slot] = scale_m;
        self.covariance_m2[slot] = SymmetricMat3::of(axes * axes.transpose());
    }

    /// None yet, with room for so many.
    pub(crate) fn with_room(count: usize) -> Self {
        let mut gaussians = Self::default();
        gaussians.reserve(count);
        gaussians
    }

    /// Room for so many more slots and no more than that.
    pub(crate) fn reserve(&mut self, count: usize) {
        self.id.reserve_exact(count);
        self.birth.reserve_exact(count);
        self.alive.reserve_exact(count);
        self.home_m.reserve_exact(count);
        self.home.reserve_exact(count);
        self.mean_m.reserve_exact(count);
        self.rotation.reserve_exact(count);
        self.scale_m.reserve_exact(count);
        self.covariance_m2.reserve_exact(count);
        self.strength.reserve_exact(count);
        self.known.reserve_exact(count);
        self.child_share.reserve_exact(count);
        self.sigma_m.reserve_exact(count);
        self.position_covariance_m2.reserve_exact(count);
        self.probability.reserve_exact(count);
        self.is_likely.reserve_exact(count);
        self.verdict.reserve_exact(count);
        self.why.reserve_exact(count);
        self.stage.reserve_exact(count);
        self.kept.reserve_exact(count);
    }

    fn grow(&mut self) -> u32 {
        if self.id.len() == self.id.capacity() {
            self.reserve(spare(self.id.len()));
        }
        self.id.push(0);
        self.birth.push(0);
        self.alive.push(false);
        self.home_m.push(Vec3::ZERO);
        self.home.push((0, 0));
        self.mean_m.push(Vec3::ZERO);
        self.rotation.push(Quat::IDENTITY);
        self.scale_m.push(Vec3::ONE);
        self.covariance_m2.push(SymmetricMat3::default());
        self.strength.push(DirectionalReflectivity::default());
        self.known.push(Faces::default());
        self.child_share.push(1.0);
        self.sigma_m.push(f32::INFINITY);
        self.position_covariance_m2
            .push(SymmetricMat3::isotropic(f32::INFINITY));
        self.probability.push(0.0);
        self.is_likely.push(false);
        self.verdict.push(Verdict::ExplainedAway);
        self.why.push(Why::default());
        self.stage.push(Stage::Spawned);
        self.kept.push(None);
        (self.id.len() - 1) as u32
    }

    /// How much of what it covers a Gaussian adds: eight children of one lie behind one another in two layers.
    pub(crate) fn layers(&self, slot: usize) -> f32 {
        if self.child_share[slot] < 1.0 {
            0.5
        } else {
            1.0
        }
    }

    /// Strength of a slot's strongest face, of those that are known.
    pub(crate) fn strongest(&self, slot: usize) -> f32 {
        self.strength[slot].strongest(self.known[slot])
    }

    /// Slots in use, in order.
    pub(crate) fn slots(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.id.len()).filter(|&slot| self.alive[slot])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slot_is_used_again_once_and_its_id_never() {
        let mut gaussians = Gaussians::default();
        let mut spawn = |gone: Option<u32>| {
            if let Some(slot) = gone {
                gaussians.remove_all(&[slot as usize, slot as usize]);
                assert!(!gaussians.is_worked_on(slot as usize));
            }
            let slot = gaussians.spawn(Vec3::ZERO, (0, 0), 0.1, 1.0);
            (slot, gaussians.id[slot as usize], gaussians.alive_count())
        };
        let (first, second) = (spawn(None), spawn(None));
        let third = spawn(Some(first.0));
        let fourth = spawn(None);
        assert_eq!([first.0, second.0, third.0, fourth.0], [0, 1, 0, 2]);
        assert_eq!([first.1, second.1, third.1, fourth.1], [0, 1, 2, 3]);
        assert_eq!((third.2, fourth.2), (2, 3));
    }
}
