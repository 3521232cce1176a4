//! Rows of floats to Gaussians, whatever the order of their properties.

use std::io::{BufRead, BufReader, Read};

use echosplat_model::glam::{Quat, Vec3};
use echosplat_model::{Gaussian, Standing};
use echosplat_ply::{Element, Format, Kind, PlyError, Reader, Row, Scalar};

use super::{MapFile, notes};

/// The position's covariance, in the order of [`Gaussian::position_covariance_m2`].
const COVARIANCE: [&str; 6] = ["cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"];

/// Why a map was refused.
#[derive(Debug, thiserror::Error)]
pub enum MapFileError {
    /// No PLY, or one that cannot be read.
    #[error(transparent)]
    Ply(#[from] PlyError),
    /// PLY, in an encoding maps do not have.
    #[error("format is {}, expected binary_little_endian", .0.name())]
    Format(Format),
    /// A comment that maps have says something that cannot be.
    #[error("header: {0}")]
    Comment(&'static str),
    /// No vertices.
    #[error("header: no `element vertex`")]
    NoVertices,
    /// A property every map has.
    #[error("vertices have no property `{name}`, which a map of Gaussians needs")]
    Missing {
        /// Its name.
        name: &'static str,
    },
    /// A property of another type than maps have.
    #[error("header: property `{name}` is of type {kind}, expected float")]
    NoFloat {
        /// Its name.
        name: &'static str,
        /// Its type.
        kind: Kind,
    },
    /// A row that is no Gaussian.
    #[error("vertex {vertex}: {what}")]
    Vertex {
        /// Counted from 0.
        vertex: u64,
        /// What cannot be.
        what: &'static str,
    },
    /// The file could not be read.
    #[error("reading the map: {0}")]
    Io(#[from] std::io::Error),
}

/// Reads one map file. Properties may come in any order and among others; `reflectivity`, `sigma`, `cov_*` and
/// `probability` may be missing, as in maps of other programs (then 1, infinite, as `sigma` in all directions, and 1).
///
/// # Errors
/// Says what is wrong, and where.
pub fn read(reader: impl Read) -> Result<MapFile, MapFileError> {
    read_from(Reader::new(BufReader::new(reader))?)
}

fn read_from(mut reader: Reader<impl BufRead>) -> Result<MapFile, MapFileError> {
    let header = reader.header();
    if header.format != Format::LittleEndian {
        return Err(MapFileError::Format(header.format));
    }
    let mut map = notes::read(&header.comments)?;
    let vertex = header.element("vertex").ok_or(MapFileError::NoVertices)?;
    let columns = Columns::of(vertex)?;
    let gaussians = &mut map.gaussians;
    // What comes after the vertices is not looked at.
    loop {
        let element = reader.next_element(|element, number, row| {
            if element.name == "vertex" {
                gaussians.push(columns.gaussian(number, row)?);
            }
            Ok::<_, MapFileError>(())
        })?;
        if element.is_none_or(|element| element.name == "vertex") {
            return Ok(map);
        }
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
}

impl Columns {
    fn of(vertex: &Element) -> Result<Self, MapFileError> {
        let find = |name| match vertex.find(name) {
            None => Ok(None),
            Some((at, Kind::Scalar(Scalar::F32))) => Ok(Some(at)),
            Some((_, kind)) => Err(MapFileError::NoFloat { name, kind }),
        };
        let at = |name| find(name)?.ok_or(MapFileError::Missing { name });
        Ok(Self {
            mean: [at("x")?, at("y")?, at("z")?],
            opacity: at("opacity")?,
            scale: [at("scale_0")?, at("scale_1")?, at("scale_2")?],
            rotation: [at("rot_0")?, at("rot_1")?, at("rot_2")?, at("rot_3")?],
            reflectivity: find("reflectivity")?,
            sigma: find("sigma")?,
            covariance: covariance(find)?,
            probability: find("probability")?,
        })
    }

    fn gaussian(&self, vertex: u64, row: &Row) -> Result<Gaussian, MapFileError> {
        let wrong = |what| MapFileError::Vertex { vertex, what };
        let float = |at| row.value(at) as f32;
        let id = u32::try_from(vertex).map_err(|_| wrong("more vertices than have a number"))?;
        let [w, x, y, z] = self.rotation.map(float);
        let rotation = Quat::from_xyzw(x, y, z, w);
        let length = rotation.length();
        if !(length > 1e-6 && length.is_finite()) {
            return Err(wrong("rot_0..3 is not a quaternion with a length"));
        }
        let sigma_m = self.sigma.map_or(f32::INFINITY, float);
        let gaussian = Gaussian {
            id,
            mean_m: Vec3::from_array(self.mean.map(float)),
            rotation: if (length - 1.0).abs() < 1e-6 {
                rotation
            } else {
                rotation / length
            },
            scale_m: Vec3::from_array(self.scale.map(|at| float(at).exp())),
            opacity: sigmoid(float(self.opacity)),
            reflectivity: self.reflectivity.map_or(1.0, float),
            sigma_m,
            position_covariance_m2: match self.covariance {
                Some(places) => places.map(float),
                None => Gaussian::known_alike_m2(sigma_m),
            },
            probability: self.probability.map_or(1.0, float),
            standing: Standing::Confident,
        };
        if !gaussian.is_sound() {
            return Err(wrong("not finite, or a scale out of range"));
        }
        Ok(gaussian)
    }
}

/// Where the covariance is: all six numbers or none.
fn covariance(
    find: impl Fn(&'static str) -> Result<Option<usize>, MapFileError>,
) -> Result<Option<[usize; 6]>, MapFileError> {
    let mut places = [0; 6];
    for (place, name) in places.iter_mut().zip(COVARIANCE) {
        match find(name)? {
            Some(at) => *place = at,
            None => return Ok(None),
        }
    }
    Ok(Some(places))
}

fn sigmoid(logit: f32) -> f32 {
    (1.0 / (1.0 + f64::from(-logit).exp())) as f32
}
