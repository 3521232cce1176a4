//! The paper's renderer: (14) to (30) over one image of many beams, and its exact gradient.
//!
//! It is the paper's to the letter where that says something, and where it does not:
//! * pixel `p = 0` of (20) is the middle of the first range bin; with one beam `ε_θ` is the whole
//!   field of view and the beam its middle, where (20) would put every azimuth into the one column;
//! * a kernel (25) is cut at 3.5 sigma, which also bounds the set of pixels of (29);
//! * `least_pixel_variance` is added to both diagonals of (24), so that a Gaussian smaller than a
//!   pixel does not fall between pixels;
//! * a pixel is done, its transmittance 0, once less than 10⁻⁴ is left;
//! * Gaussians within 5 cm of the sensor or 0.06° of its z axis, where (19) has no meaning, and those
//!   with a number that is not finite are left out;
//! * azimuth does not wrap: a Gaussian behind the sensor lies on one side of the seam at ±180°.

mod band;
#[cfg(test)]
mod extremes;
mod gradient;
mod kernel;
mod order;
mod projection;
mod renderer;
mod stroke;
#[cfg(test)]
mod tests;
mod view;

pub use renderer::PaperRenderer;
pub use view::{PaperView, Transmittance};

/// Where a kernel is cut: beyond, `f < 0.0022` counts as negligible.
pub const REACH_SIGMAS: f32 = 3.5;
/// A pixel of which less than this is left counts as opaque.
pub const LEAST_TRANSMITTANCE: f32 = 1e-4;
/// Gaussians nearer than this are left out.
pub const LEAST_RANGE_M: f32 = 0.05;
/// Gaussians nearer to the sensor's z axis than this share of their range are left out.
pub const LEAST_AXIS_RATIO: f32 = 1e-3;
/// Shorter and longer quaternions are left out: their squares would not be normal numbers.
pub const QUATERNION_LENGTHS: [f32; 2] = [1e-12, 1e12];
/// Larger variances in (24), pixels², are left out: a Gaussian of 10⁹ pixels says nothing.
pub const COVARIANCE_MAX: f32 = 1e18;
/// Larger reflectivities are left out: sums of them would not be finite.
pub const REFLECTIVITY_MAX: f32 = 1e30;
