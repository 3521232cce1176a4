//! What one ping sees of Gaussians: beam, projection and the measurement of the `online` profile.
//!
//! The fast path is f32 on the map's local coordinates; [`reference`] is its slow, plain twin.
//! This crate deliberately has no map, no evidence and no optimiser, and it does not draw rays:
//! the simulator does that, by itself, so that the two can be held against each other.

mod beam;
pub mod lanes;
mod normal;
pub mod online;
pub mod packed;
pub mod paper;
mod parameters;
mod ping_view;
mod projector;
mod real;
pub mod reference;
pub mod sample;
pub mod sample_paper;
mod spatial_index;
mod triple;

pub use beam::{Beam, BeamError};
pub use normal::normal_cdf;
pub use online::{OnlineOptions, OnlineRenderer, OnlineRow};
pub use parameters::{
    Clamped, GaussianArrays, GradientArrays, LOG_SCALE_LIMITS, LOG_SCALE_SPREAD,
    OPACITY_LOGIT_LIMIT, OPACITY_MAX, PARAMETER_COUNT, Parameters, REFLECTIVITY_LOG_LIMIT,
    opacity_of, opacity_slope,
};
pub use projector::{Look, LookPose, Splat, SymmetricMat3};
pub use real::Real;
pub use spatial_index::SpatialIndex;
