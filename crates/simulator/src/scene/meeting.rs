//! Where a surface is met.

use glam::DVec3;

/// Where a ray meets a surface; `normal` points outward.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Crossing {
    pub(crate) distance: f64,
    pub(crate) normal: DVec3,
}

/// The place of a surface nearest to a point. `signed` is negative inside.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Closest {
    pub(crate) signed: f64,
    pub(crate) place: DVec3,
    pub(crate) normal: DVec3,
}
