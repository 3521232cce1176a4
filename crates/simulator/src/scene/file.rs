//! The scene file as TOML: one array of tables per kind of solid. Unknown keys are errors.

use std::path::PathBuf;

use glam::DVec3;
use serde::de::{Deserialize, Deserializer, Error};
use toml::Spanned;

/// Furthest from the origin, so that f64 keeps a tenth of a micrometre.
const MAX_COORDINATE_M: f64 = 1e8;
const MAX_LENGTH_M: f64 = 1e4;

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneFile {
    pub(super) name: String,
    /// For readers only.
    #[serde(default, rename = "description")]
    _description: String,
    #[serde(default)]
    pub(super) survey: SurveyHints,
    #[serde(default)]
    pub(super) viewpoints: ViewpointHints,
    #[serde(default)]
    pub(super) sphere: Vec<Spanned<SphereEntry>>,
    #[serde(default)]
    pub(super) capsule: Vec<Spanned<RodEntry>>,
    #[serde(default)]
    pub(super) cylinder: Vec<Spanned<RodEntry>>,
    #[serde(default, rename = "box")]
    pub(super) block: Vec<Spanned<BlockEntry>>,
    #[serde(default)]
    pub(super) ellipsoid: Vec<Spanned<EllipsoidEntry>>,
    #[serde(default)]
    pub(super) plane: Vec<Spanned<PlaneEntry>>,
    #[serde(default)]
    pub(super) height_field: Vec<Spanned<HeightFieldEntry>>,
    #[serde(default)]
    pub(super) mesh: Vec<Spanned<MeshEntry>>,
}

/// How a survey moves past a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum SurveyPath {
    /// Around the structure, facing it.
    #[default]
    Around,
    /// Back and forth before it, facing `heading_deg`.
    Along,
}

/// What a scene asks of a survey of it; what is left out follows from its bounds.
#[derive(Debug, Clone, Default, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct SurveyHints {
    pub(crate) path: SurveyPath,
    /// Direction faced along the path, degrees from east, counter-clockwise.
    #[serde(deserialize_with = "optional_angle")]
    pub(crate) heading_deg: Option<f64>,
    /// Horizontal distance kept from the structure's bounds.
    #[serde(deserialize_with = "optional_length")]
    pub(crate) standoff_m: Option<f64>,
    /// Mean height of the sensor.
    #[serde(deserialize_with = "optional_coordinate")]
    pub(crate) depth_z_m: Option<f64>,
    /// Heave to each side of it.
    #[serde(deserialize_with = "optional_length")]
    pub(crate) heave_m: Option<f64>,
    /// Range the sonar listens to.
    #[serde(deserialize_with = "optional_length")]
    pub(crate) range_m: Option<f64>,
}

/// What a scene asks of a viewpoint dive.
#[derive(Debug, Clone, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ViewpointHints {
    /// Views kept.
    #[serde(deserialize_with = "view_count")]
    pub(crate) count: usize,
    /// Distance of the four planes from the structure's bounds.
    #[serde(deserialize_with = "optional_length")]
    pub(crate) standoff_m: Option<f64>,
}

impl Default for ViewpointHints {
    fn default() -> Self {
        Self {
            count: 249,
            standoff_m: None,
        }
    }
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SphereEntry {
    #[serde(deserialize_with = "point")]
    pub(super) center_m: DVec3,
    #[serde(deserialize_with = "length")]
    pub(super) radius_m: f64,
    #[serde(default = "one", deserialize_with = "share")]
    pub(super) reflectivity: f64,
    #[serde(default, deserialize_with = "exponent")]
    pub(super) specular: f64,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RodEntry {
    #[serde(deserialize_with = "point")]
    pub(super) from_m: DVec3,
    #[serde(deserialize_with = "point")]
    pub(super) to_m: DVec3,
    #[serde(deserialize_with = "length")]
    pub(super) radius_m: f64,
    #[serde(default = "one", deserialize_with = "share")]
    pub(super) reflectivity: f64,
    #[serde(default, deserialize_with = "exponent")]
    pub(super) specular: f64,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BlockEntry {
    #[serde(deserialize_with = "point")]
    pub(super) center_m: DVec3,
    /// Whole lengths of its edges.
    #[serde(deserialize_with = "size")]
    pub(super) size_m: DVec3,
    /// Yaw, pitch, roll as of a vehicle.
    #[serde(default, deserialize_with = "angles")]
    pub(super) yaw_pitch_roll_deg: DVec3,
    #[serde(default = "one", deserialize_with = "share")]
    pub(super) reflectivity: f64,
    #[serde(default, deserialize_with = "exponent")]
    pub(super) specular: f64,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EllipsoidEntry {
    #[serde(deserialize_with = "point")]
    pub(super) center_m: DVec3,
    /// Half its lengths along its own axes.
    #[serde(deserialize_with = "size")]
    pub(super) semi_axes_m: DVec3,
    /// Yaw, pitch, roll as of a vehicle.
    #[serde(default, deserialize_with = "angles")]
    pub(super) yaw_pitch_roll_deg: DVec3,
    #[serde(default = "one", deserialize_with = "share")]
    pub(super) reflectivity: f64,
    #[serde(default, deserialize_with = "exponent")]
    pub(super) specular: f64,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlaneEntry {
    #[serde(deserialize_with = "point")]
    pub(super) point_m: DVec3,
    #[serde(default = "up", deserialize_with = "direction")]
    pub(super) normal: DVec3,
    #[serde(default = "one", deserialize_with = "share")]
    pub(super) reflectivity: f64,
    #[serde(default, deserialize_with = "exponent")]
    pub(super) specular: f64,
    #[serde(default = "yes")]
    pub(super) seabed: bool,
}

/// `z = center + Σ amplitude · sin(2π · along / wavelength + phase)`, as triangles.
#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HeightFieldEntry {
    #[serde(deserialize_with = "point")]
    pub(super) center_m: DVec3,
    /// Whole lengths along x and y.
    #[serde(deserialize_with = "size2")]
    pub(super) size_m: [f64; 2],
    #[serde(deserialize_with = "length")]
    pub(super) cell_m: f64,
    #[serde(default)]
    pub(super) waves: Vec<Wave>,
    #[serde(default = "one", deserialize_with = "share")]
    pub(super) reflectivity: f64,
    #[serde(default, deserialize_with = "exponent")]
    pub(super) specular: f64,
    #[serde(default = "yes")]
    pub(super) seabed: bool,
}

#[derive(Debug, Clone, Copy, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Wave {
    #[serde(deserialize_with = "length")]
    pub(super) amplitude_m: f64,
    #[serde(deserialize_with = "length")]
    pub(super) wavelength_m: f64,
    /// Direction it runs in, degrees from x towards y.
    #[serde(default, deserialize_with = "angle")]
    pub(super) heading_deg: f64,
    #[serde(default, deserialize_with = "angle")]
    pub(super) phase_deg: f64,
}

#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MeshEntry {
    /// STL, OBJ or PLY, relative to the scene's file.
    pub(super) file: PathBuf,
    /// Metres per unit of the file.
    #[serde(default = "one", deserialize_with = "length")]
    pub(super) scale: f64,
    #[serde(default, deserialize_with = "point")]
    pub(super) translation_m: DVec3,
    #[serde(default, deserialize_with = "angles")]
    pub(super) yaw_pitch_roll_deg: DVec3,
    #[serde(default = "one", deserialize_with = "share")]
    pub(super) reflectivity: f64,
    #[serde(default, deserialize_with = "exponent")]
    pub(super) specular: f64,
    #[serde(default)]
    pub(super) seabed: bool,
}

fn one() -> f64 {
    1.0
}

fn yes() -> bool {
    true
}

fn up() -> DVec3 {
    DVec3::Z
}

/// `value` if it lies in `low..=high`; NaN never does.
fn within<E: Error>(value: f64, low: f64, high: f64) -> Result<f64, E> {
    if value >= low && value <= high {
        return Ok(value);
    }
    Err(E::custom(format_args!(
        "{value} is out of range; allowed is {low} to {high}"
    )))
}

fn all_within<E: Error, const N: usize>(
    values: [f64; N],
    low: f64,
    high: f64,
) -> Result<[f64; N], E> {
    for value in values {
        within(value, low, high)?;
    }
    Ok(values)
}

fn length<'de, D: Deserializer<'de>>(source: D) -> Result<f64, D::Error> {
    within(f64::deserialize(source)?, 1e-4, MAX_LENGTH_M)
}

fn share<'de, D: Deserializer<'de>>(source: D) -> Result<f64, D::Error> {
    within(f64::deserialize(source)?, 0.0, 1.0)
}

fn exponent<'de, D: Deserializer<'de>>(source: D) -> Result<f64, D::Error> {
    within(f64::deserialize(source)?, 0.0, 1000.0)
}

fn angle<'de, D: Deserializer<'de>>(source: D) -> Result<f64, D::Error> {
    within(f64::deserialize(source)?, -360.0, 360.0)
}

fn optional_angle<'de, D: Deserializer<'de>>(source: D) -> Result<Option<f64>, D::Error> {
    angle(source).map(Some)
}

fn optional_length<'de, D: Deserializer<'de>>(source: D) -> Result<Option<f64>, D::Error> {
    length(source).map(Some)
}

fn optional_coordinate<'de, D: Deserializer<'de>>(source: D) -> Result<Option<f64>, D::Error> {
    let value = f64::deserialize(source)?;
    within(value, -MAX_COORDINATE_M, MAX_COORDINATE_M).map(Some)
}

fn view_count<'de, D: Deserializer<'de>>(source: D) -> Result<usize, D::Error> {
    within(f64::deserialize(source)?, 1.0, 100_000.0).map(|count| count as usize)
}

fn point<'de, D: Deserializer<'de>>(source: D) -> Result<DVec3, D::Error> {
    let values = <[f64; 3]>::deserialize(source)?;
    all_within(values, -MAX_COORDINATE_M, MAX_COORDINATE_M).map(DVec3::from)
}

fn size<'de, D: Deserializer<'de>>(source: D) -> Result<DVec3, D::Error> {
    all_within(<[f64; 3]>::deserialize(source)?, 1e-4, MAX_LENGTH_M).map(DVec3::from)
}

fn size2<'de, D: Deserializer<'de>>(source: D) -> Result<[f64; 2], D::Error> {
    all_within(<[f64; 2]>::deserialize(source)?, 1e-4, MAX_LENGTH_M)
}

fn angles<'de, D: Deserializer<'de>>(source: D) -> Result<DVec3, D::Error> {
    all_within(<[f64; 3]>::deserialize(source)?, -360.0, 360.0).map(DVec3::from)
}

fn direction<'de, D: Deserializer<'de>>(source: D) -> Result<DVec3, D::Error> {
    let values = all_within(<[f64; 3]>::deserialize(source)?, -1e6, 1e6)?;
    DVec3::from(values)
        .try_normalize()
        .ok_or_else(|| D::Error::custom("a normal needs a length; [0, 0, 1] is up"))
}
