//! Directional reflectivity: a strength towards each of the six faces of a cube.

use echosplat_model::glam::{BVec3, Vec3};

/// Strength towards the six faces of a cube: seen along the unit vector `u` towards the sensor, it
/// is `Σ u_k² s_k` over the three faces turned to the sensor. A surface's back, hidden by the
/// structure itself, and a specular return need no more than this.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct DirectionalReflectivity {
    /// Towards +x, +y, +z.
    pub(crate) ahead: Vec3,
    /// Towards −x, −y, −z.
    pub(crate) behind: Vec3,
}

impl DirectionalReflectivity {
    /// The same in all directions.
    pub(crate) fn even(strength: f32) -> Self {
        Self {
            ahead: Vec3::splat(strength),
            behind: Vec3::splat(strength),
        }
    }

    /// Strength seen along `towards`.
    #[cfg(test)]
    pub(crate) fn seen(&self, towards: Vec3) -> f32 {
        let faces = Vec3::select(towards.cmpge(Vec3::ZERO), self.ahead, self.behind);
        faces.dot(towards * towards)
    }

    /// Strength of the strongest of some faces; of all if they are none.
    pub(crate) fn strongest(&self, faces: Faces) -> f32 {
        if faces == Faces::default() {
            return self.ahead.max(self.behind).max_element();
        }
        let ahead = Vec3::select(faces.ahead, self.ahead, Vec3::ZERO);
        let behind = Vec3::select(faces.behind, self.behind, Vec3::ZERO);
        ahead.max(behind).max_element()
    }

    /// Adds face by face.
    pub(crate) fn add(&mut self, other: &Self) {
        self.ahead += other.ahead;
        self.behind += other.behind;
    }

    /// Of all faces.
    pub(crate) fn sum(&self) -> f32 {
        self.ahead.element_sum() + self.behind.element_sum()
    }

    /// Multiplies every face.
    pub(crate) fn scale(&mut self, factor: f32) {
        self.ahead *= factor;
        self.behind *= factor;
    }
}

/// Faces of a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Faces {
    /// +x, +y, +z.
    pub(crate) ahead: BVec3,
    /// −x, −y, −z.
    pub(crate) behind: BVec3,
}

impl Faces {
    /// Adds those of another.
    pub(crate) fn join(&mut self, other: Self) {
        self.ahead |= other.ahead;
        self.behind |= other.behind;
    }
}
