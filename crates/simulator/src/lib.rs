//! The simulated sonar: scenes with exact geometry, dives past them, and what an `OmniScan` 450 FS
//! would have heard, as pings and as the bytes of its protocol.
//!
//! It deliberately has no sockets, no clock and no threads of its own: time and bytes come in as
//! arguments, and everything is a pure function of scene, dive and seed, in any order.

// Guards are written so that NaN fails them.
#![allow(clippy::neg_cmp_op_on_partial_ord)]

mod beam;
mod device;
mod disturbances;
mod dive;
mod random;
mod scene;
mod seen;
mod sonar;

pub use beam::{
    AZIMUTH_SIGMA_RAD, ELEVATION_HALF_WIDTH_RAD, HALF_POWER_AZIMUTH_RAD, azimuth_weight,
    elevation_weight, pulse_sigma_m,
};
pub use device::{DeviceCounters, SimulatedDevice};
pub use disturbances::{
    DISTURBANCE_KEYS, DisturbanceError, DisturbanceKey, Disturbances, EchoCopies, EchoMultiples,
    Fish, NavigationError, Saturation, SoundSpeed, Spikes, Walker, WaterSurface,
};
pub use dive::{BEAMS_PER_VIEW, Dive, DiveError, DiveKind, DiveOptions};
pub use scene::{BUILT_IN_SCENES, Hit, Scene, SceneError, SurfacePoint, SurveyPath};
pub use seen::seen_surface;
pub use sonar::{NoiseLevel, Profile, SimulatedPing, SimulatedSonar, echoes_at_rest};
