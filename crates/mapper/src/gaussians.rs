//! The Gaussians as arrays of each quantity, with stable ids.

use echosplat_acoustics::SymmetricMat3;
use echosplat_model::glam::{Mat3, Quat, Vec3};
use echosplat_model::{GaussianId, Standing};

use crate::evidence::BlockIndex;

/// What the last assessment found of a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Published with its standing.
    Published(Standing),
    /// Other Gaussians explain its echoes: kept, not published.
    ExplainedAway,
}

/// Arrays indexed by slot. A slot is used again after its Gaussian is gone, an id never.
#[derive(Debug, Default)]
pub(crate) struct Gaussians {
    pub(crate) id: Vec<GaussianId>,
    pub(crate) alive: Vec<bool>,
    /// Where it was born; it stays within a voxel of there.
    pub(crate) home_m: Vec<Vec3>,
    pub(crate) home: Vec<(BlockIndex, u16)>,
    pub(crate) mean_m: Vec<Vec3>,
    pub(crate) rotation: Vec<Quat>,
    pub(crate) scale_m: Vec<Vec3>,
    pub(crate) covariance_m2: Vec<SymmetricMat3>,
    /// αρ, linear power against the strongest echo.
    pub(crate) strength: Vec<f32>,
    pub(crate) sigma_m: Vec<f32>,
    pub(crate) verdict: Vec<Verdict>,
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
        self.id[s] = id;
        self.alive[s] = true;
        self.home_m[s] = home_m;
        self.home[s] = home;
        self.mean_m[s] = home_m;
        self.set_shape(s, Quat::IDENTITY, Vec3::splat(scale_m));
        self.strength[s] = strength;
        self.sigma_m[s] = f32::INFINITY;
        self.verdict[s] = Verdict::Published(Standing::Ambiguous);
        slot
    }

    pub(crate) fn remove(&mut self, slot: u32) {
        self.alive[slot as usize] = false;
        self.strength[slot as usize] = 0.0;
        self.free.push(slot);
    }

    pub(crate) fn set_shape(&mut self, slot: usize, rotation: Quat, scale_m: Vec3) {
        let axes = Mat3::from_quat(rotation) * Mat3::from_diagonal(scale_m);
        self.rotation[slot] = rotation;
        self.scale_m[slot] = scale_m;
        self.covariance_m2[slot] = SymmetricMat3::of(axes * axes.transpose());
    }

    fn grow(&mut self) -> u32 {
        self.id.push(0);
        self.alive.push(false);
        self.home_m.push(Vec3::ZERO);
        self.home.push((0, 0));
        self.mean_m.push(Vec3::ZERO);
        self.rotation.push(Quat::IDENTITY);
        self.scale_m.push(Vec3::ONE);
        self.covariance_m2.push(SymmetricMat3::default());
        self.strength.push(0.0);
        self.sigma_m.push(f32::INFINITY);
        self.verdict.push(Verdict::ExplainedAway);
        (self.id.len() - 1) as u32
    }

    /// Slots in use, in order.
    pub(crate) fn slots(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.id.len()).filter(|&slot| self.alive[slot])
    }
}
