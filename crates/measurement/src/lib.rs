//! What one ping hears of Gaussians: the one place that says so.
//!
//! It reads like the method, a room a step:
//!
//! 1. **Geometry.** [`PingGeometry`] is a ping before anything of the map: pose, drift, bins, and how sharp it is. [`Beam`] is
//!    where the sonar is sensitive.
//! 2. **Footprint.** [`heard`] finds those Gaussians that a ping hears, and says how much energy each sends back, and when.
//! 3. **Pulse.** [`pulse`] is what an echo of one width puts into the bins around it.
//! 4. **Spread.** One convolution for each width in use puts all energies into the bins: `Î`.
//! 5. **Gather.** Another brings back what the bins say of each Gaussian: the sums of the multiplicative step, score and Fisher
//!    information.
//!
//! [`Scene`] and [`Listener`] do all of it for Gaussians that stay as they are; the mapper, whose Gaussians change between passes,
//! uses [`heard::Hearing`]. Kernels are f32 on the map's local coordinates, eight Gaussians or bins at a time; [`twin`] is the
//! same in f64 by plain loops, and tests hold one to the other. This crate deliberately has no map, no evidence and no
//! optimiser, and it does not draw rays: the simulator does that, by itself, so that the two can be held against each other.
//!
//! Lengths are metres in the map's local coordinates, angles radians; the beam's frame is x along its axis, y left, z up.
//! Intensities are linear power per bin; a strength is power per steradian.
//!
//! What a ping hears of one small Gaussian 5.01 m ahead:
//!
//! ```
//! use echosplat_measurement::heard::Detail;
//! use echosplat_measurement::{
//!     Beam, Element, Listener, PingGeometry, PingPose, Scene, SymmetricMat3,
//! };
//! use echosplat_model::glam::{Mat3, Vec3};
//!
//! let ahead = Vec3::new(5.01, 0.0, 0.0);
//! let scene = Scene::of(&[Element::even(ahead, SymmetricMat3::isotropic(0.005), 0.5)]);
//! let geometry = PingGeometry {
//!     pose: PingPose {
//!         position_m: Vec3::ZERO,
//!         axes: Mat3::IDENTITY,
//!         drift_per_m: Vec3::ZERO,
//!         reference_range_m: 5.0,
//!     },
//!     range_start_m: 0.0,
//!     bin_length_m: 0.02,
//!     bin_count: 500,
//!     range_variance_m2: 1e-6,
//!     azimuth_variance_rad2: 0.0,
//!     beam: Beam::default(),
//! };
//!
//! let mut listener = Listener::default();
//! let intensity = listener.hear(&scene, &geometry, 1e-6, Detail::Strength).to_vec();
//! let loudest = (0..500).max_by(|&a, &b| intensity[a].total_cmp(&intensity[b]));
//! assert_eq!(loudest, Some(250)); // 5.01 m / 0.02 m
//!
//! // Had all of it been twice as loud, the strength's step would be up by nearly √2.
//! let louder: Vec<f32> = intensity.iter().map(|power| 2.0 * power).collect();
//! let [numerator, denominator] = listener.step_sums(&louder)[0];
//! assert!((numerator / denominator - 2.0).abs() < 1e-5);
//! ```

mod beam;
mod constants;
mod geometry;
pub mod heard;
pub mod lanes;
mod ping_view;
pub mod pulse;
mod scene;
pub mod simd_level;
#[cfg(test)]
mod tests;
mod triple;
pub mod twin;

pub use beam::{Beam, BeamError};
pub use geometry::{PingGeometry, PingPose, Splat, SymmetricMat3};
pub use scene::{Element, Listener, Scene};
