//! Rows of floats to Gaussians, whatever the order of their properties.

use std::io::{self, Read};

use echosplat_model::glam::{Quat, Vec3};
use echosplat_model::{Gaussian, Standing};

use super::header::Header;
use super::{MapFile, MapNotes};

/// Rows taken at a time; memory grows with the bytes that came, not with the header's word.
const ROWS_AT_ONCE: u64 = 1024;

/// Longest row taken; a 3DGS file with every harmonic has 248 bytes.
const MAX_ROW_BYTES: usize = 4096;

/// The position's covariance, in the order of [`Gaussian::position_covariance_m2`].
const COVARIANCE: [&str; 6] = ["cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"];

/// Why a map was refused.
#[derive(Debug, thiserror::Error)]
pub enum PlyError {
    /// No bytes at all.
    #[error("the file is empty")]
    Empty,
    /// Something else than PLY.
    #[error("not a PLY: starts with `{found}`, expected `ply`")]
    NotPly {
        /// The first characters.
        found: String,
    },
    /// PLY, in an encoding maps do not have.
    #[error("format is {0}, expected binary_little_endian")]
    Format(String),
    /// The header says something that cannot be.
    #[error("header: {0}")]
    Header(String),
    /// A property every map has.
    #[error("vertices have no property `{name}`, which a map of Gaussians needs")]
    Missing {
        /// Its name.
        name: &'static str,
    },
    /// Fewer rows than the header says.
    #[error("cut off: the header says {expected} vertices, {found} are there")]
    Cut {
        /// By the header.
        expected: u64,
        /// Whole rows present.
        found: u64,
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
    Io(#[from] io::Error),
}

/// Reads one map file. Properties may come in any order and among others; `reflectivity`, `sigma`, `cov_*` and
/// `probability` may be missing, as in maps of other programs (then 1, infinite, as `sigma` in all directions, and 1).
///
/// # Errors
/// Says what is wrong, and where.
pub fn read(mut reader: impl Read) -> Result<MapFile, PlyError> {
    let header = Header::read(&mut reader)?;
    let columns = Columns::of(&header)?;
    if header.row_byte_count > MAX_ROW_BYTES {
        return Err(PlyError::Header(format!(
            "a vertex has {} bytes, at most {MAX_ROW_BYTES} are taken",
            header.row_byte_count
        )));
    }
    let skipped = (&mut reader).take(header.skipped_byte_count);
    io::copy(&mut { skipped }, &mut io::sink())?;
    let mut map = MapFile {
        origin_m: header.origin_m,
        intensity_unit: header.intensity_unit,
        notes: MapNotes {
            held_out_every: header.held_out_every,
            ..MapNotes::default()
        },
        gaussians: Vec::new(),
    };
    let mut rows = Vec::new();
    while (map.gaussians.len() as u64) < header.vertex_count {
        read_some_rows(&mut reader, &header, &columns, &mut rows, &mut map)?;
    }
    Ok(map)
}

fn read_some_rows(
    reader: &mut impl Read,
    header: &Header,
    columns: &Columns,
    rows: &mut Vec<u8>,
    map: &mut MapFile,
) -> Result<(), PlyError> {
    let done = map.gaussians.len() as u64;
    let wanted = ROWS_AT_ONCE.min(header.vertex_count - done);
    let wanted_bytes = wanted * header.row_byte_count as u64;
    rows.clear();
    reader.take(wanted_bytes).read_to_end(rows)?;
    for (vertex, row) in (done..).zip(rows.chunks_exact(header.row_byte_count)) {
        map.gaussians.push(columns.gaussian(vertex, row)?);
    }
    if (rows.len() as u64) < wanted_bytes {
        return Err(PlyError::Cut {
            expected: header.vertex_count,
            found: map.gaussians.len() as u64,
        });
    }
    Ok(())
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
    fn of(header: &Header) -> Result<Self, PlyError> {
        let at = |name| header.offset_of(name);
        Ok(Self {
            mean: [at("x")?, at("y")?, at("z")?],
            opacity: at("opacity")?,
            scale: [at("scale_0")?, at("scale_1")?, at("scale_2")?],
            rotation: [at("rot_0")?, at("rot_1")?, at("rot_2")?, at("rot_3")?],
            reflectivity: header.find("reflectivity")?,
            sigma: header.find("sigma")?,
            covariance: covariance(header)?,
            probability: header.find("probability")?,
        })
    }

    fn gaussian(&self, vertex: u64, row: &[u8]) -> Result<Gaussian, PlyError> {
        let wrong = |what| PlyError::Vertex { vertex, what };
        let id = u32::try_from(vertex).map_err(|_| wrong("more vertices than have a number"))?;
        let [w, x, y, z] = self.rotation.map(|at| float(row, at));
        let rotation = Quat::from_xyzw(x, y, z, w);
        let length = rotation.length();
        if !(length > 1e-6 && length.is_finite()) {
            return Err(wrong("rot_0..3 is not a quaternion with a length"));
        }
        let sigma_m = self.sigma.map_or(f32::INFINITY, |at| float(row, at));
        let gaussian = Gaussian {
            id,
            mean_m: Vec3::from_array(self.mean.map(|at| float(row, at))),
            rotation: if (length - 1.0).abs() < 1e-6 {
                rotation
            } else {
                rotation / length
            },
            scale_m: Vec3::from_array(self.scale.map(|at| float(row, at).exp())),
            opacity: sigmoid(float(row, self.opacity)),
            reflectivity: self.reflectivity.map_or(1.0, |at| float(row, at)),
            sigma_m,
            position_covariance_m2: match self.covariance {
                Some(places) => places.map(|at| float(row, at)),
                None => Gaussian::known_alike_m2(sigma_m),
            },
            probability: self.probability.map_or(1.0, |at| float(row, at)),
            standing: Standing::Confident,
        };
        if !gaussian.is_sound() {
            return Err(wrong("not finite, or a scale out of range"));
        }
        Ok(gaussian)
    }
}

/// Where the covariance is: all six numbers or none.
fn covariance(header: &Header) -> Result<Option<[usize; 6]>, PlyError> {
    let mut places = [0; 6];
    for (place, name) in places.iter_mut().zip(COVARIANCE) {
        match header.find(name)? {
            Some(at) => *place = at,
            None => return Ok(None),
        }
    }
    Ok(Some(places))
}

/// `at` comes from the header, whose row length the row has.
fn float(row: &[u8], at: usize) -> f32 {
    let bytes = row.get(at..at + 4).and_then(|b| b.try_into().ok());
    f32::from_le_bytes(bytes.unwrap_or(f32::NAN.to_le_bytes()))
}

fn sigmoid(logit: f32) -> f32 {
    (1.0 / (1.0 + f64::from(-logit).exp())) as f32
}
