//! What is wrong with a dive that was asked for.

use super::DiveKind;
use crate::disturbances::DisturbanceError;

/// Why a dive cannot be planned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DiveError {
    /// Not a kind of dive.
    #[error("no dive is called `{0}`; there are survey, viewpoints, pan and level")]
    UnknownKind(String),
    /// An option out of range.
    #[error("dive option {name} is {value}; allowed is {low} to {high}")]
    Option {
        /// Which.
        name: &'static str,
        /// What it was.
        value: f64,
        /// Least allowed.
        low: f64,
        /// Most allowed.
        high: f64,
    },
    /// A disturbance out of range.
    #[error(transparent)]
    Disturbance(#[from] DisturbanceError),
    /// The vehicle would fly.
    #[error(
        "surface_m is {surface_m}, but the vehicle goes up to z = {highest_m:.2} m; the water's surface must lie above"
    )]
    SurfaceTooLow {
        /// Height of the water's surface.
        surface_m: f64,
        /// Of the track's highest place.
        highest_m: f64,
    },
    /// Every way past the structure meets a solid.
    #[error(
        "no {kind} of `{scene}` keeps {clearance_m} m from every surface; give [survey] standoff_m and depth_z_m"
    )]
    NoRoom {
        /// Kind of dive.
        kind: DiveKind,
        /// Name of the scene.
        scene: String,
        /// What has to be kept.
        clearance_m: f64,
    },
    /// Too few views of a viewpoint dive see anything.
    #[error("only {found} of {wanted} views of `{scene}` see anything; check its [viewpoints]")]
    SparseViews {
        /// Name of the scene.
        scene: String,
        /// Views that do.
        found: usize,
        /// Views asked for.
        wanted: usize,
    },
}
