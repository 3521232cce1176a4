//! Where the measurement cuts and floors: one place for kernels and twin.

/// Sigmas across; found: the beam is 17 dB down.
pub(crate) const BEAM_REACH_SIGMAS: f32 = 2.8;
/// Metres, assumed: nothing is seen nearer.
pub(crate) const NEAREST_M: f32 = 0.05;
/// Cosine off the beam's axis, at least; assumed.
/// Least cosine of the angle from the beam's axis.
pub(crate) const SIDEWAYS: f32 = 0.25;
/// Sensitivity of the fan, at least; assumed.
pub(crate) const LEAST_FAN: f32 = 1e-3;
/// Square metres, assumed: (0.1 mm)².
/// Floor of the variance in range: a tenth of a millimetre.
pub(crate) const LEAST_VARIANCE_M2: f32 = 1e-8;
/// Cross-section squared over (2π)², derived: its inverse fits f32.
/// Least squared cross-section (over (2π)²): where f32 still holds it and its inverse.
pub(crate) const LEAST_AREA2_M4: f32 = 1e-30;
/// Sigmas in range, found: 3·10⁻³ of the energy is left out.
/// Bins this many sigmas from the mean are left out: 3·10⁻³ of the energy.
pub(crate) const RANGE_REACH_SIGMAS: f32 = 3.0;
/// Sigmas, assumed: cells beyond are left out.
/// Raster cells this many sigmas from the mean are left out.
pub(crate) const RASTER_REACH_SIGMAS: f32 = 3.5;
/// Sigmas of half the raster's width, derived: [`BEAM_REACH_SIGMAS`].
/// Half the raster's width over sigma of beam and attitude.
pub(crate) const RASTER_HALF_WIDTH_SIGMAS: f64 = 2.8;
/// Half-widths of half its height, derived: the fan's edge.
/// Half the raster's height over the fan's half width.
pub(crate) const RASTER_HALF_HEIGHT: f64 = 1.3;
/// Degrees, grid of occlusion.
/// Height of a raster cell.
pub(crate) const RASTER_ROW_DEG: f64 = 0.5;
/// Transmittance, assumed: less counts as 0.
pub(crate) const LEAST_TRANSMITTANCE: f32 = 1e-4;
/// Weighted coverage, assumed: less lies beside the raster.
/// A Gaussian whose weighted coverage is below this lies beside the raster.
pub(crate) const LEAST_OVERLAP: f32 = 1e-20;
/// Power, bound: sums over a ping stay finite.
/// What would send back more than this is left out: sums over a ping stay finite.
pub(crate) const STRONGEST: f32 = 1e30;
