//! What one ping sees of Gaussians: beam, projection and the measurement of the `online` profile.
//!
//! The fast path is f32 on the map's local coordinates; [`reference`] is its slow, plain f64 twin.
//! This crate deliberately has no map, no evidence and no optimiser, and it does not draw rays:
//! the simulator does that, by itself, so that the two can be held against each other.

mod beam;
mod normal;
mod projector;
pub mod reference;

pub use beam::{Beam, BeamError};
pub use normal::normal_cdf;
pub use projector::{Look, LookPose, Splat, SymmetricMat3};
