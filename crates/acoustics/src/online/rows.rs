//! Rows of the system matrix: what is kept of each Gaussian in one ping, between projection, raster
//! and bins.

use std::ops::Range;

/// A row of the system matrix: one Gaussian in one ping.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OnlineRow {
    /// Which Gaussian: its position in the arrays.
    pub index: u32,
    /// First bin it reaches.
    pub first_bin: u32,
    /// Number of bins it reaches; 0 for one beyond the ping that still shadows others.
    pub bin_count: u32,
    /// Share of the sound that gets through to it, T: 1 without occlusion.
    pub transmittance: f32,
    /// Energy over all bins for αρT = 1: solid angle times sensitivity.
    pub energy: f32,
    /// Opacity α.
    pub opacity: f32,
    /// Reflectivity ρ.
    pub reflectivity: f32,
    /// Mean range r̄, by which Gaussians shadow one another.
    pub range_m: f32,
    /// What the mean range on the beam's axis is more than that, r′ − r̄: apart, so that edges of
    /// bins lose no digits against it.
    pub offset_m: f32,
    /// One over sigma in range, 1/s.
    pub inverse_sigma: f32,
    /// Its place on the raster.
    pub(super) shadow: Shadow,
}

impl OnlineRow {
    /// Bins it reaches.
    #[must_use]
    pub fn bins(&self) -> Range<usize> {
        self.first_bin as usize..(self.first_bin + self.bin_count) as usize
    }
}

/// A Gaussian on the raster: mean, Cholesky factor of its covariance with a cell's added, and the
/// share of a cell that it covers at its centre.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Shadow {
    pub(super) azimuth_rad: f32,
    pub(super) elevation_rad: f32,
    pub(super) inverse_width: f32,
    pub(super) slope: f32,
    pub(super) inverse_height: f32,
    pub(super) height_rad: f32,
    pub(super) peak: f32,
    /// Sum over cells of sensitivity times covered share; 0 beside the raster.
    pub(super) overlap: f32,
}

/// The gradient of the loss by the numbers of one row; all 0 where the loss does not depend on it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct RowGradient {
    /// By the logarithm of its energy.
    pub(super) log_energy: f32,
    /// By r′.
    pub(super) range: f32,
    /// By s².
    pub(super) variance: f32,
    /// By α, through what it hides.
    pub(super) opacity: f32,
    /// Sums over covered cells of `f·dL/df`, times powers of the whitened distance `(y₁, y₂)`:
    /// 1, y₁, y₂, y₁², y₁y₂, y₂².
    pub(super) moments: [f32; 6],
}
