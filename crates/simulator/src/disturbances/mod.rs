//! What a real place puts between a unit and the structure, each as a switch of its own, off by default.
//!
//! Every switch is a function of the dive's seed, the ping's number and the time, with a stream of random
//! numbers of its own: switching one on changes nothing else of a dive. The decibel scale and the steps
//! of automatic gain are those of the undisturbed dive.

mod copies;
mod fish;
mod interference;
mod keys;
mod multiples;
mod navigation;
mod saturation;
mod sound;
mod surface;

pub use copies::EchoCopies;
pub use fish::Fish;
pub(crate) use fish::Swimmer;
pub use interference::{Spikes, Walker};
pub use keys::{DISTURBANCE_KEYS, DisturbanceError, DisturbanceKey};
pub use multiples::EchoMultiples;
pub use navigation::NavigationError;
pub use saturation::Saturation;
pub use sound::SoundSpeed;
pub use surface::WaterSurface;

/// Everything that can be added to a dive. By default nothing is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Disturbances {
    /// Every echo heard once more, later.
    pub copies: EchoCopies,
    /// Every echo heard once more, at a multiple of its range.
    pub multiples: EchoMultiples,
    /// Another sonar's pulses at random ranges.
    pub spikes: Spikes,
    /// Another sonar's pulse that walks through the pings.
    pub walker: Walker,
    /// Fish that swim through the dive.
    pub fish: Fish,
    /// The water's surface as a mirror.
    pub surface: WaterSurface,
    /// The receiver's stop.
    pub saturation: Saturation,
    /// A speed of sound other than the reported one.
    pub sound: SoundSpeed,
    /// Poses that come late, and a mount other than the configured one.
    pub navigation: NavigationError,
}

/// Decibels to a factor on power.
fn power(decibels: f64) -> f64 {
    10f64.powf(0.1 * decibels)
}
