//! The simulated sonar: power over range for a scene, a dive and a moment.

mod device_side;
mod disturbed;
mod echo;
mod field;
mod frame;
mod gain;
mod level;
mod profile;
mod radiometry;
mod simulated;
mod speckle;

#[cfg(test)]
pub(crate) use echo::MovingSensor;
pub(crate) use echo::{Echo, Listener};
pub(crate) use frame::encoded;
pub use level::NoiseLevel;
pub(crate) use level::PoseNoise;
pub use profile::{Profile, SimulatedPing};
#[cfg(test)]
pub(crate) use radiometry::Radiometry;
pub use simulated::{SimulatedSonar, echoes_at_rest};

#[cfg(test)]
mod tests;
