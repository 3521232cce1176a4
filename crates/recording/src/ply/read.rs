//! Rows of floats to Gaussians, whatever the order of their properties.

use std::io::{BufRead, BufReader, Read};

use echosplat_georeference::GeoreferenceError;
use echosplat_model::glam::{Quat, Vec3};
use echosplat_model::{Gaussian, SCALE_LIMITS_M, Standing, Unsound, Why};
use echosplat_ply::{Element, Kind, PlyError, Reader, Row};

use super::{MapFile, WHY, WHY_BEFORE, notes};
use crate::export::Up;

/// The position's covariance, in the order of [`Gaussian::position_covariance_m2`].
const COVARIANCE: [&str; 6] = ["cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"];

/// Why a map was refused.
#[derive(Debug, thiserror::Error)]
pub enum MapFileError {
    /// No PLY, or one that cannot be read.
    #[error(transparent)]
    Ply(#[from] PlyError),
    /// A comment that maps have says something that cannot be.
    #[error("header: {0}")]
    Comment(&'static str),
    /// A comment says a place that there is not.
    #[error("header: `comment georeference`: {0}")]
    Georeference(GeoreferenceError),
    /// No vertices.
    #[error("header: no `element vertex`")]
    NoVertices,
    /// A property every map has.
    #[error("vertices have no property `{name}`, which a map of Gaussians needs")]
    Missing {
        /// Its name.
        name: &'static str,
    },
    /// A property that is a list.
    #[error("header: property `{name}` is of type {kind}, expected a number")]
    NoNumber {
        /// Its name.
        name: &'static str,
        /// Its type.
        kind: Kind,
    },
    /// More vertices than a Gaussian has numbers.
    #[error("more than {} vertices", u32::MAX)]
    Many,
    /// Vertices, and none that is a Gaussian.
    #[error("none of its {count} vertices is a Gaussian; vertex 0: {why}")]
    NoGaussians {
        /// Of the file.
        count: u64,
        /// What cannot be of the first.
        why: Unsound,
    },
    /// The file of the ambiguous Gaussians, which stands beside the map.
    #[error("in {name} beside it: {source}")]
    Beside {
        /// Its name.
        name: String,
        /// What is wrong with it.
        source: Box<MapFileError>,
    },
    /// The file could not be read.
    #[error("reading the map: {0}")]
    Io(#[from] std::io::Error),
}

/// Reads one map file, as it was written or as an editor saved it again: in any encoding of PLY, with properties in any
/// order, of any type of number and among others, and with `scalar_` before their names. `reflectivity`, `sigma`, `cov_*`
/// and `probability` may be missing (then 1, infinite, as `sigma` in all directions, and 1), as may the comments;
/// [`MapFile::lacks`] says what is. Without [`WHY`] no reason is known.
/// A vertex that is no Gaussian ([`Gaussian::admitted`]) is left out and counted.
///
/// # Errors
/// Says what is wrong, and where; also if there are vertices and none is a Gaussian.
pub fn read(reader: impl Read) -> Result<MapFile, MapFileError> {
    read_from(Reader::new(BufReader::new(reader))?)
}

fn read_from(mut reader: Reader<impl BufRead>) -> Result<MapFile, MapFileError> {
    let header = reader.header();
    let mut map = notes::read(&header.comments)?;
    let vertex = header.element("vertex").ok_or(MapFileError::NoVertices)?;
    let columns = Columns::of(vertex)?;
    map.lacks.extend(columns.lacks());
    // What comes after the vertices is not looked at.
    loop {
        let element = reader.next_element(|element, number, row| {
            if element.name == "vertex" {
                match columns.gaussian(number, row)? {
                    Ok(gaussian) => map.gaussians.push(gaussian),
                    Err(why) => map.refused.add(number, why),
                }
            }
            Ok::<_, MapFileError>(())
        })?;
        if element.is_none_or(|element| element.name == "vertex") {
            break;
        }
    }
    match map.refused.first {
        Some((_, why)) if map.gaussians.is_empty() => {
            let count = map.refused.count;
            Err(MapFileError::NoGaussians { count, why })
        }
        _ => Ok(Up::upright(map)),
    }
}

/// Where in a row each number lies.
struct Columns {
    mean: [usize; 3],
    opacity: usize,
    scale: [usize; 3],
    rotation: [usize; 4],
    reflectivity: Option<usize>,
    sigma: Option<usize>,
    covariance: Option<[usize; 6]>,
    probability: Option<usize>,
    why: Option<[usize; 3]>,
}

impl Columns {
    fn of(vertex: &Element) -> Result<Self, MapFileError> {
        let find = |name| {
            let of_editor = format!("scalar_{name}");
            match vertex.find(name).or_else(|| vertex.find(&of_editor)) {
                None => Ok(None),
                Some((at, Kind::Scalar(_))) => Ok(Some(at)),
                Some((_, kind)) => Err(MapFileError::NoNumber { name, kind }),
            }
        };
        let at = |name| find(name)?.ok_or(MapFileError::Missing { name });
        Ok(Self {
            mean: [at("x")?, at("y")?, at("z")?],
            opacity: at("opacity")?,
            scale: [at("scale_0")?, at("scale_1")?, at("scale_2")?],
            rotation: [at("rot_0")?, at("rot_1")?, at("rot_2")?, at("rot_3")?],
            reflectivity: find("reflectivity")?,
            sigma: find("sigma")?,
            covariance: all_of(find, COVARIANCE)?,
            probability: find("probability")?,
            why: match all_of(find, WHY)? {
                None => all_of(find, WHY_BEFORE)?,
                found => found,
            },
        })
    }

    /// What is taken for granted instead.
    fn lacks(&self) -> impl Iterator<Item = &'static str> {
        let missing = [
            (
                self.sigma.is_none(),
                "sigma, so that no place is known to be sure",
            ),
            (self.reflectivity.is_none(), "reflectivity, taken as 1"),
            (self.probability.is_none(), "probability, taken as 1"),
        ];
        missing
            .into_iter()
            .filter(|(is_missing, _)| *is_missing)
            .map(|(_, what)| what)
    }

    fn gaussian(&self, vertex: u64, row: &Row) -> Result<Result<Gaussian, Unsound>, MapFileError> {
        let float = |at| row.value(at) as f32;
        let id = u32::try_from(vertex).map_err(|_| MapFileError::Many)?;
        let [w, x, y, z] = self.rotation.map(float);
        let sigma_m = self.sigma.map_or(f32::INFINITY, float);
        let gaussian = Gaussian {
            id,
            mean_m: Vec3::from_array(self.mean.map(float)),
            rotation: Quat::from_xyzw(x, y, z, w),
            scale_m: Vec3::from_array(self.scale.map(|at| scale_m(float(at)))),
            opacity: sigmoid(float(self.opacity)),
            reflectivity: self.reflectivity.map_or(1.0, float),
            sigma_m,
            position_covariance_m2: match self.covariance {
                Some(places) => places.map(float),
                None => Gaussian::known_alike_m2(sigma_m),
            },
            probability: self.probability.map_or(1.0, float),
            standing: Standing::Confident,
            // Numbers beyond a byte saturate, and are no reason that is known.
            why: self.why.map_or_else(Why::default, |places| {
                Why::of_bytes(places.map(|at| float(at) as u8))
            }),
        };
        Ok(gaussian.admitted())
    }
}

/// Where these are: all of them or none.
fn all_of<const N: usize>(
    find: impl Fn(&'static str) -> Result<Option<usize>, MapFileError>,
    names: [&'static str; N],
) -> Result<Option<[usize; N]>, MapFileError> {
    let mut places = [0; N];
    for (place, name) in places.iter_mut().zip(names) {
        match find(name)? {
            Some(at) => *place = at,
            None => return Ok(None),
        }
    }
    Ok(Some(places))
}

/// Of its natural logarithm. What was written of a scale at a limit is not rounded beyond it.
fn scale_m(logarithm: f32) -> f32 {
    let (least_m, most_m) = SCALE_LIMITS_M.into_inner();
    match (least_m.ln()..=most_m.ln()).contains(&logarithm) {
        true => logarithm.exp().clamp(least_m, most_m),
        false => logarithm.exp(),
    }
}

fn sigmoid(logit: f32) -> f32 {
    (1.0 / (1.0 + f64::from(-logit).exp())) as f32
}
