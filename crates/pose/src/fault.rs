//! What a message of a vehicle cannot say.

use echosplat_model::glam::{DQuat, DVec3};

/// Farther from a local frame's origin than any dive goes.
const MAX_COORDINATE_M: f64 = 1e8;
/// How far a quaternion's length may be from 1.
const LENGTH_TOLERANCE: f64 = 0.01;

/// Why a message leads to no pose.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum Fault {
    /// A number is NaN or infinite.
    #[error("{0} is not finite")]
    NotFinite(String),
    /// The quaternion is none of a rotation.
    #[error("quaternion has length {0}; it must be 1 ± 0.01")]
    Quaternion(f64),
    /// Anything else, in words.
    #[error("{0}")]
    Malformed(String),
}

/// The rotation, made a unit one.
pub(crate) fn rotation(what: &str, quaternion: DQuat) -> Result<DQuat, Fault> {
    if !quaternion.is_finite() {
        return Err(Fault::NotFinite(format!("orientation of {what}")));
    }
    let length = quaternion.length();
    let is_unit = (length - 1.0).abs() <= LENGTH_TOLERANCE;
    match is_unit {
        true => Ok(quaternion / length),
        false => Err(Fault::Quaternion(length)),
    }
}

/// A position or velocity that can be one.
pub(crate) fn vector(what: &str, vector: DVec3) -> Result<DVec3, Fault> {
    if !vector.is_finite() {
        return Err(Fault::NotFinite(what.to_owned()));
    }
    let is_near = vector.abs().max_element() <= MAX_COORDINATE_M;
    match is_near {
        true => Ok(vector),
        false => Err(Fault::Malformed(format!("{what} is beyond 1e8 m"))),
    }
}

/// Text from outside, fit for a log: cut, and without control characters.
pub(crate) fn quoted(text: &str) -> String {
    let cut: String = text.chars().take(80).collect();
    format!("{cut:?}")
}
