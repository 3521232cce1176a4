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
/// Sigmas in range, found: 3·10⁻³ of the energy is left out.
/// Bins this many sigmas from the mean are left out: 3·10⁻³ of the energy.
pub(crate) const RANGE_REACH_SIGMAS: f32 = 3.0;
/// Power, bound: sums over a ping stay finite.
/// What would send back more than this is left out: sums over a ping stay finite.
pub(crate) const STRONGEST: f32 = 1e30;
