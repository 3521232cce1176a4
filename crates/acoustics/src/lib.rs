//! What one ping sees of Gaussians: beam, projection and the measurement of the `online` profile.
//!
//! The fast path is f32 on the map's local coordinates; [`reference`] is its slow, plain twin.
//! This crate deliberately has no map, no evidence and no optimiser, and it does not draw rays:
//! the simulator does that, by itself, so that the two can be held against each other.
//!
//! Lengths are metres in the map's local coordinates, angles radians; the beam's frame is x along its
//! axis, y left, z up. Intensities are linear power per bin, in units of what αρ = 1 sends back from
//! one steradian.
//!
//! What a ping hears of one small Gaussian 5.01 m ahead, and how that changes with it:
//!
//! ```
//! use echosplat_acoustics::{
//!     Beam, GaussianArrays, GradientArrays, PingGeometry, PingPose, OnlineOptions, OnlineRenderer,
//!     SpatialIndex,
//! };
//! use echosplat_model::glam::{Mat3, Quat, Vec3};
//! use echosplat_model::{Gaussian, Standing};
//!
//! let gaussians = GaussianArrays::from_gaussians(&[Gaussian {
//!     id: 0,
//!     mean_m: Vec3::new(5.01, 0.0, 0.0),
//!     rotation: Quat::IDENTITY,
//!     scale_m: Vec3::splat(0.005),
//!     opacity: 0.9,
//!     reflectivity: 0.5,
//!     sigma_m: 0.01,
//!     position_covariance_m2: Gaussian::known_alike_m2(0.01),
//!     probability: 1.0,
//!     standing: Standing::Confident,
//! }]);
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
//! let mut visible = Vec::new();
//! SpatialIndex::new(&gaussians).visible(&geometry, &mut visible);
//! let mut renderer = OnlineRenderer::new(OnlineOptions::default());
//! let intensity = renderer.forward(&geometry, &gaussians, &visible);
//! let loudest = (0..intensity.len()).max_by(|&a, &b| intensity[a].total_cmp(&intensity[b]));
//! assert_eq!(loudest, Some(250)); // 5.01 m / 0.02 m
//!
//! // dL/d(parameters) for L, the sum over all bins.
//! let mut gradients = GradientArrays::zeros(gaussians.len());
//! renderer.backward(&gaussians, &[1.0; 500], &mut gradients);
//! assert!(gradients.reflectivity_log[0] > 0.0);
//! ```

mod beam;
pub mod heard;
pub mod lanes;
pub mod online;
mod parameters;
mod ping_view;
mod projector;
pub mod pulse;
mod real;
pub mod reference;
#[cfg(any(test, feature = "sample"))]
pub mod sample;
pub mod simd_level;
mod spatial_index;
mod triple;

pub use beam::{Beam, BeamError};
pub use online::{OnlineOptions, OnlineRenderer, OnlineRow};
pub use parameters::{
    Clamped, GaussianArrays, GradientArrays, LOG_SCALE_LIMITS, LOG_SCALE_SPREAD,
    OPACITY_LOGIT_LIMIT, OPACITY_MAX, PARAMETER_COUNT, Parameters, REFLECTIVITY_LOG_LIMIT,
    opacity_of, opacity_slope,
};
pub use projector::{PingGeometry, PingPose, Splat, SymmetricMat3};
pub use real::Real;
pub use spatial_index::SpatialIndex;
