//! The measurement of one ping by many Gaussians, forward and backward: the fast kernels.
//!
//! ```text
//! I_b = Σ_i T_i ρ_i α_i Ω_i g(φ̄_i) σ_b/√(σ_b²+Σθθ) exp(−ΔΘ²/2(σ_b²+Σθθ)) [Φ((r_{b+1}−r′)/s) − Φ((r_b−r′)/s)]
//! ```
//!
//! Eight Gaussians are projected at a time, then each is spread over its bins eight at a time. With occlusion,
//! T comes between: Gaussians pass from near to far over a raster of azimuth and elevation, on which each
//! leaves `ln(1 − α f)` in the share f of every cell that it covers. Sums run in the order of the Gaussians'
//! positions: the same Gaussians and ping geometry give the same bits, in whatever order they are named, at
//! any thread count, on one processor feature level.
//!
//! The plain twin is [`crate::reference::online`].

pub(crate) mod constants;
mod occlusion;
pub(crate) mod raster;
mod rows;
mod sight;
mod sight_back;
pub(crate) mod spread;

use fearless_simd::{Level, dispatch};

use crate::PingGeometry;
use crate::parameters::{GaussianArrays, GradientArrays, PARAMETER_COUNT};
use crate::simd_level;
use occlusion::Occlusion;
pub use rows::OnlineRow;
use rows::RowGradient;
use sight::View;
use spread::{Loss, PADDING};

/// What the measurement includes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OnlineOptions {
    /// Whether Gaussians hide one another.
    pub occlusion: bool,
}

/// Renders pings and their gradients. Its buffers grow to the largest ping and stay: calls after
/// that allocate nothing.
#[derive(Debug, Clone)]
pub struct OnlineRenderer {
    options: OnlineOptions,
    level: Level,
    geometry: Option<PingGeometry>,
    visible: Vec<u32>,
    rows: Vec<OnlineRow>,
    occlusion: Occlusion,
    /// Shape `[bin_count + padding]`.
    intensity: Vec<f32>,
    /// Of that shape, for some rows at a time; else 0.
    partial: Vec<f32>,
    loss: Loss,
    row_gradients: Vec<RowGradient>,
    pair_count: u64,
    not_finite: u64,
}

impl OnlineRenderer {
    /// For the level of the process, [`simd_level::level`].
    #[must_use]
    pub fn new(options: OnlineOptions) -> Self {
        Self::with_level(options, simd_level::level())
    }

    /// For one processor feature level: results differ between levels in their last digits.
    #[must_use]
    pub fn with_level(options: OnlineOptions, level: Level) -> Self {
        Self {
            options,
            level,
            geometry: None,
            visible: Vec::new(),
            rows: Vec::new(),
            occlusion: Occlusion::default(),
            intensity: Vec::new(),
            partial: Vec::new(),
            loss: Loss::default(),
            row_gradients: Vec::new(),
            pair_count: 0,
            not_finite: 0,
        }
    }

    /// Predicted intensity per bin without noise, shape `[bin_count]`. `visible` are positions in
    /// `gaussians`, in any order, each once; those that do not exist, have numbers that are not
    /// finite or lie outside the cut-offs of [`PingGeometry::project`] are left out.
    pub fn forward(
        &mut self,
        geometry: &PingGeometry,
        gaussians: &GaussianArrays,
        visible: &[u32],
    ) -> &[f32] {
        let fields = gaussians.fields();
        self.sort_visible(visible, shortest(&fields));
        self.geometry = Some(*geometry);
        self.rows.clear();
        self.intensity.clear();
        self.intensity
            .resize(geometry.bin_count as usize + PADDING, 0.0);
        self.partial.resize(self.intensity.len(), 0.0);
        let view = View::new(geometry);
        let occlusion = self.options.occlusion;
        if occlusion {
            self.occlusion.raster.fit(geometry);
        }
        let (rows, visible) = (&mut self.rows, &self.visible);
        self.pair_count = dispatch!(self.level, simd => {
            sight::project(simd, &view, &fields, visible, occlusion, rows);
            if occlusion {
                self.occlusion.forward(simd, rows);
            }
            spread::spread(simd, geometry, rows, &mut self.partial, &mut self.intensity)
        });
        self.intensity()
    }

    /// Adds dL/d(parameters) to `gradients`, given dL/dI of the last forward, shape `[bin_count]`,
    /// whose Gaussians must be unchanged. Values and gradients that are not finite count as 0 and
    /// in [`Self::not_finite_count`].
    pub fn backward(
        &mut self,
        gaussians: &GaussianArrays,
        d_intensity: &[f32],
        gradients: &mut GradientArrays,
    ) {
        let Some(geometry) = self.geometry else {
            return;
        };
        let fields = gaussians.fields();
        let count = shortest(&fields);
        if self.rows.iter().any(|row| row.index as usize >= count) {
            return;
        }
        self.not_finite += self.loss.set(d_intensity, geometry.bin_count as usize);
        self.row_gradients.clear();
        let view = View::new(&geometry);
        let occlusion = self.options.occlusion;
        let (rows, row_gradients) = (&self.rows, &mut self.row_gradients);
        self.not_finite += dispatch!(self.level, simd => {
            spread::spread_back(simd, &geometry, rows, &self.loss, row_gradients);
            if occlusion {
                self.occlusion.backward(simd, rows, row_gradients);
            }
            sight_back::accumulate(simd, &view, &fields, rows, row_gradients, occlusion, gradients)
        });
    }

    /// The last forward's intensity, shape `[bin_count]`.
    #[must_use]
    pub fn intensity(&self) -> &[f32] {
        let bins = self.intensity.len().saturating_sub(PADDING);
        &self.intensity[..bins]
    }

    /// Gaussian–bin pairs of the last forward.
    #[must_use]
    pub fn pair_count(&self) -> u64 {
        self.pair_count
    }

    /// Numbers of losses and gradients left out so far because they were not finite.
    #[must_use]
    pub fn not_finite_count(&self) -> u64 {
        self.not_finite
    }

    /// The Gaussians that the last forward's ping saw, in the order of their positions.
    #[must_use]
    pub fn rows(&self) -> &[OnlineRow] {
        &self.rows
    }

    /// Appends one of [`Self::rows`]' energies per bin of [`OnlineRow::bins`] for αρ = 1,
    /// transmittance included: its row of the measurement's system matrix.
    pub fn row_energies(&self, row: &OnlineRow, energies: &mut Vec<f32>) {
        let Some(geometry) = &self.geometry else {
            return;
        };
        dispatch!(self.level, simd => spread::append_row(simd, geometry, row, energies));
    }

    fn sort_visible(&mut self, visible: &[u32], count: usize) {
        self.visible.clear();
        self.visible.extend_from_slice(visible);
        if !visible.is_sorted_by(|a, b| a < b) {
            self.visible.sort_unstable();
            self.visible.dedup();
        }
        let existing = self
            .visible
            .partition_point(|&index| (index as usize) < count);
        self.visible.truncate(existing);
    }
}

/// Number of Gaussians that all arrays hold.
fn shortest(fields: &[&[f32]; PARAMETER_COUNT]) -> usize {
    fields.iter().map(|field| field.len()).min().unwrap_or(0)
}

#[cfg(test)]
mod tests;
