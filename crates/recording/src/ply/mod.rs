//! Maps as 3DGS PLY: binary little-endian, floats in the order of [`PROPERTIES`], then [`COLORS`] and [`WHY`].
//!
//! Many programs take every column of such a file for a float. Four bytes and three doubles take the room of seven floats, so
//! that those programs find the rows, and all floats in them.
//!
//! `opacity` is a logit, `scale_*` are natural logarithms of metres, `rot_*` is w x y z, the colour
//! is 0.5 + 0.2820948 · `f_dc` and shows reflectivity in decibels (again as bytes `red green blue alpha`, which
//! point cloud tools show); `nx ny nz` is the shortest axis.
//! Last come `reflectivity` (linear), `sigma` (one sigma of the position along its least known direction, metres, may be
//! infinite), the position's covariance `cov_*` (square metres, world axes) and `probability`, that there is surface
//! within 0.10 m. `reason`, `clear_observations` and `measured` say which test gave a Gaussian its verdict
//! ([`echosplat_model::Why`]). Added to x y z, the
//! header's `comment origin_m X Y Z` gives the world's coordinates; times opacity, reflectivity and
//! the solid angle of a Gaussian, `comment intensity_unit U` gives what a ping measures of it. Where
//! pings were kept from the map to judge it by, `comment held_out_every N` says which. `comment georeference …` says where
//! on Earth the world lies ([`Georeference::line`]). `comment echosplat_map N` is the
//! version of all this; a file without is of the first, and one of a later than is known here is refused.

pub(crate) mod notes;
mod placed;
mod read;
mod write;

use std::fmt;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use echosplat_georeference::Georeference;
use echosplat_input::open_file;
use echosplat_model::glam::DVec3;
use echosplat_model::{Gaussian, Standing, Unsound};
use echosplat_ply::{Header, PlyError};

use crate::export::Up;
use crate::replace::Replacement;
pub use placed::georeference_map;
pub use read::{MapFileError, read};
pub(crate) use write::HARMONIC_0;
pub use write::write;

/// A header names the properties, and what the numbers mean in a few lines.
const MOST_HEADER_BYTES: u64 = 4096;

/// The floats of a vertex in the order they are written.
pub const PROPERTIES: [&str; 26] = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "f_dc_0",
    "f_dc_1",
    "f_dc_2",
    "opacity",
    "scale_0",
    "scale_1",
    "scale_2",
    "rot_0",
    "rot_1",
    "rot_2",
    "rot_3",
    "reflectivity",
    "sigma",
    "cov_xx",
    "cov_xy",
    "cov_xz",
    "cov_yy",
    "cov_yz",
    "cov_zz",
    "probability",
];

/// The bytes of a vertex behind them: its colour, 0 to 255.
pub const COLORS: [&str; 4] = ["red", "green", "blue", "alpha"];

/// The doubles behind these, whole numbers from 0 to 255: which test gave it its verdict, how many observations were clear, and what the test measured.
///
/// `Open3D` 0.20 reads no file with a column `clear`, which its dictionaries have as a method.
pub const WHY: [&str; 3] = ["reason", "clear_observations", "measured"];
/// The same as earlier versions wrote them.
const WHY_BEFORE: [&str; 3] = ["reason", "clear", "measured"];

/// Bytes of a vertex.
pub const ROW_BYTES: usize =
    PROPERTIES.len() * size_of::<f32>() + COLORS.len() + WHY.len() * size_of::<f64>();

// As many bytes as if all were floats: programs that take every column for one find the rows.
const _: () = assert!(
    ROW_BYTES == (PROPERTIES.len() + COLORS.len() + WHY.len()) * size_of::<f32>(),
    "a row of a map is as long as one of floats alone"
);

/// What a map's header says besides where its Gaussians are.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MapNotes {
    /// The last of so many pings was kept from the map each time; 0 if none was, or nothing is said.
    pub held_out_every: u64,
    /// Axis of the file that points up. A map that was read is upright, whatever the file's is.
    pub up: Up,
    /// Where on Earth the world lies, if that is known.
    pub georeference: Option<Georeference>,
    /// Comment lines for people; not read back.
    pub comments: Vec<String>,
}

/// What one map file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct MapFile {
    /// Added to every mean gives the world's coordinates, metres.
    pub origin_m: DVec3,
    /// Intensity per steradian, in the pings' own unit, that αρ = 1 sends back; 1 in files of other
    /// programs.
    pub intensity_unit: f32,
    /// Of the header.
    pub notes: MapNotes,
    /// In the file's order; read ones are numbered from 0 and taken as confident.
    pub gaussians: Vec<Gaussian>,
    /// Vertices of a file that was read that are no Gaussians, and so are not among them.
    pub refused: Refused,
    /// What a file that was read does not say, each with what is taken for granted instead.
    pub lacks: Vec<&'static str>,
}

/// Vertices that are no Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Refused {
    /// How many.
    pub count: u64,
    /// The first, counted from 0 in its file, and why.
    pub first: Option<(u64, Unsound)>,
}

impl Refused {
    fn add(&mut self, vertex: u64, why: Unsound) {
        self.count += 1;
        self.first.get_or_insert((vertex, why));
    }
}

/// As in `3 vertices are no Gaussians and left out; the first is vertex 17: its rotation …`.
impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.count, self.first) {
            (1, Some((vertex, why))) => {
                write!(f, "vertex {vertex} is no Gaussian and left out: {why}")
            }
            (count, Some((vertex, why))) => write!(
                f,
                "{count} vertices are no Gaussians and left out; the first is vertex {vertex}: {why}"
            ),
            (_, None) => write!(f, "no vertex is left out"),
        }
    }
}

impl Default for MapFile {
    fn default() -> Self {
        Self {
            origin_m: DVec3::ZERO,
            intensity_unit: 1.0,
            notes: MapNotes::default(),
            gaussians: Vec::new(),
            refused: Refused::default(),
            lacks: Vec::new(),
        }
    }
}

/// What a map of two files got.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WrittenMap {
    /// In the file asked for.
    pub confident_count: usize,
    /// In the file beside it.
    pub ambiguous_count: usize,
    /// Not sound ([`Gaussian::check`]), so in neither.
    pub left_out_count: usize,
}

/// `OUT.ambiguous.ply` of an `OUT.ply`.
#[must_use]
pub fn ambiguous_path(path: &Path) -> PathBuf {
    path.with_extension("ambiguous.ply")
}

/// Writes what the map asserts to `path` and the ambiguous rest beside it. Both are on disk before
/// the first takes its place, so that a reader, a crash or a full disk never leaves half a map.
///
/// # Errors
/// Of the file system; an earlier map is then as it was.
pub fn write_map(
    path: &Path,
    origin_m: DVec3,
    intensity_unit: f32,
    gaussians: &[Gaussian],
    notes: &MapNotes,
) -> io::Result<WrittenMap> {
    let of = |standing| -> Vec<Gaussian> {
        let sound = gaussians.iter().filter(|g| g.is_sound());
        sound.filter(|g| g.standing == standing).copied().collect()
    };
    let map = |gaussians| MapFile {
        origin_m,
        intensity_unit,
        notes: notes.clone(),
        gaussians,
        ..MapFile::default()
    };
    let confident = map(of(Standing::Confident));
    let ambiguous = map(of(Standing::Ambiguous));
    let beside = Replacement::write(&ambiguous_path(path), |w| write(&ambiguous, w))?;
    let main = Replacement::write(path, |w| write(&confident, w))?;
    beside.put_in_place()?;
    main.put_in_place()?;
    let written = confident.gaussians.len() + ambiguous.gaussians.len();
    Ok(WrittenMap {
        confident_count: confident.gaussians.len(),
        ambiguous_count: ambiguous.gaussians.len(),
        left_out_count: gaussians.len() - written,
    })
}

/// Bytes of the files of a map of so many Gaussians, both parts together, within a block of a disk.
#[must_use]
pub fn map_byte_count(gaussian_count: usize) -> u64 {
    (gaussian_count * ROW_BYTES) as u64 + 2 * MOST_HEADER_BYTES
}

/// Reads a map and, if there is one beside it, its ambiguous part, numbered on. Vertices that are no
/// Gaussians are left out and counted.
///
/// # Errors
/// Says what in which file is wrong.
pub fn read_map(path: &Path) -> Result<MapFile, MapFileError> {
    let mut map = read(BufReader::new(open_file(path)?))?;
    let path = ambiguous_path(path);
    let wrong = |source: MapFileError| MapFileError::Beside {
        name: path.file_name().unwrap_or_default().display().to_string(),
        source: Box::new(source),
    };
    let beside = match open_file(&path) {
        Ok(file) => read(BufReader::new(file)).map_err(wrong)?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(map),
        Err(error) => return Err(wrong(error.into())),
    };
    let shift_m = (beside.origin_m - map.origin_m).as_vec3();
    let per_unit = beside.intensity_unit / map.intensity_unit;
    map.refused.count += beside.refused.count;
    map.refused.first = map.refused.first.or(beside.refused.first);
    for gaussian in beside.gaussians {
        let vertex = u64::from(gaussian.id);
        let moved = Gaussian {
            id: u32::try_from(map.gaussians.len()).unwrap_or(u32::MAX),
            mean_m: gaussian.mean_m + shift_m,
            reflectivity: gaussian.reflectivity * per_unit,
            standing: Standing::Ambiguous,
            ..gaussian
        };
        match moved.check() {
            Ok(()) => map.gaussians.push(moved),
            Err(why) => map.refused.add(vertex, why),
        }
    }
    Ok(map)
}

/// Whether there is a file that would be missed: a map with a Gaussian, or something else than a map.
#[must_use]
pub fn is_worth_keeping(path: &Path) -> bool {
    let file = match open_file(path) {
        Ok(file) => file,
        Err(error) => return error.kind() != io::ErrorKind::NotFound,
    };
    match Header::read(&mut BufReader::new(file)) {
        Ok(header) => header
            .element("vertex")
            .is_none_or(|vertex| vertex.count > 0),
        Err(PlyError::Empty) => false,
        Err(_) => true,
    }
}

#[cfg(test)]
mod tests;
