//! Sizes measured in a map, each with its sigma, and what is different between two maps of one place.
//!
//! All is worked out on [`Sample`]s: places with the covariance that the map gives them, in the world's coordinates,
//! z up. Deliberately absent: files, the Earth, free space (a map does not say where water was seen: what is *gone* was
//! not heard again where the other map heard something near).

mod align;
mod compare;
mod cylinder;
mod grid;
mod linear;
mod plane;
mod profile;
mod sample;

pub use align::{Alignment, align};
pub use compare::{Became, Change, Compared, Kind, compare};
pub use cylinder::{Cylinder, fit_cylinder};
pub use plane::{Plane, fit_plane};
pub use profile::{Bin, Cut, profile, section};
pub use sample::{Distance, Sample, Told, distance, samples_of};

/// Why something cannot be measured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SurveyError {
    /// Too little to measure by.
    #[error("{found} Gaussians there are too few for {what}, which takes {needed}")]
    Few {
        /// What was asked for.
        what: &'static str,
        /// There.
        found: usize,
        /// At least.
        needed: usize,
    },
    /// Its numbers fit nothing of the kind.
    #[error("what is there is no {what}: {why}")]
    Unlike {
        /// What was asked for.
        what: &'static str,
        /// What does not fit.
        why: String,
    },
    /// Nothing of the map is there.
    #[error("the map has nothing within {reach_m} m of {x:.2},{y:.2},{z:.2}")]
    Nothing {
        /// Metres.
        reach_m: f64,
        /// Where, metres.
        x: f64,
        /// Where, metres.
        y: f64,
        /// Where, metres.
        z: f64,
    },
    /// Two maps have nothing in common.
    #[error(
        "the maps share too little to be laid on each other: {share:.0} % of the one lies within {reach_m} m of the other"
    )]
    Apart {
        /// Per cent.
        share: f64,
        /// Metres.
        reach_m: f64,
    },
}
