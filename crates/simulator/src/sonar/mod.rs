//! The simulated sonar: power over range for a scene, a dive and a moment.

mod device_side;
mod echo;
mod field;
mod frame;
mod gain;
mod level;
mod profile;
mod radiometry;
mod simulated;
mod speckle;

pub(crate) use frame::encoded;
pub use level::NoiseLevel;
pub(crate) use level::PoseNoise;
pub use profile::{Profile, SimulatedPing};
pub use simulated::{SimulatedSonar, echoes_at_rest};

#[cfg(test)]
mod tests;
