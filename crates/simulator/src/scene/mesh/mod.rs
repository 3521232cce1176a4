//! Triangles from files and from formulas. Counts a file claims are held against the bytes it has
//! before anything is made room for.

mod obj;
mod ply;
mod stl;

use std::io::Read;
use std::path::Path;

use glam::DVec3;

use super::SceneError;
use super::file::HeightFieldEntry;

/// Corners of a triangle.
pub(super) type Triangle = [DVec3; 3];

const MAX_MESH_BYTES: u64 = 256 << 20;
const MAX_TRIANGLE_COUNT: usize = 2_000_000;
const MAX_COORDINATE: f64 = 1e8;

/// The whole file, if it holds no more than `max_bytes`.
pub(super) fn read_bounded(path: &Path, max_bytes: u64) -> Result<Vec<u8>, SceneError> {
    let io = |source| SceneError::Io {
        path: path.to_owned(),
        source,
    };
    let file = std::fs::File::open(path).map_err(io)?;
    let mut bytes = Vec::new();
    // One byte more tells a file of just that size from a longer one.
    file.take(max_bytes + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    if bytes.len() as u64 > max_bytes {
        let message = format!("longer than the {max_bytes} bytes allowed");
        return Err(io(std::io::Error::new(
            std::io::ErrorKind::FileTooLarge,
            message,
        )));
    }
    Ok(bytes)
}

/// Reads an STL, OBJ or PLY file, told apart by what it holds, then by its name.
pub(super) fn load(path: &Path) -> Result<Vec<Triangle>, SceneError> {
    let bytes = read_bounded(path, MAX_MESH_BYTES)?;
    let named_obj = path
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("obj"));
    parse(&bytes, named_obj).map_err(|message| SceneError::Mesh {
        path: path.to_owned(),
        message,
    })
}

fn parse(bytes: &[u8], named_obj: bool) -> Result<Vec<Triangle>, String> {
    let triangles = if bytes.starts_with(b"ply") {
        ply::parse(bytes)?
    } else if named_obj {
        obj::parse(bytes)?
    } else {
        stl::parse(bytes)?
    };
    if triangles.is_empty() {
        return Err("holds no triangle".to_owned());
    }
    if triangles.len() > MAX_TRIANGLE_COUNT {
        let count = triangles.len();
        return Err(format!(
            "{count} triangles; at most {MAX_TRIANGLE_COUNT} are allowed"
        ));
    }
    let is_usable = |corner: &DVec3| corner.abs().max_element() <= MAX_COORDINATE;
    match triangles.iter().position(|t| !t.iter().all(is_usable)) {
        Some(index) => Err(format!(
            "triangle {index} has a corner that is not finite or beyond {MAX_COORDINATE}"
        )),
        None => Ok(triangles),
    }
}

/// The triangles of a polygon around its first corner. Indices count from 0.
fn push_polygon(
    corners: &[DVec3],
    polygon: &[usize],
    triangles: &mut Vec<Triangle>,
) -> Result<(), String> {
    let corner = |index: usize| {
        corners.get(index).copied().ok_or_else(|| {
            format!(
                "a face names vertex {index} of {} (counted from 0)",
                corners.len()
            )
        })
    };
    let Some((&first, rest)) = polygon.split_first() else {
        return Ok(());
    };
    for pair in rest.windows(2) {
        triangles.push([corner(first)?, corner(pair[0])?, corner(pair[1])?]);
    }
    Ok(())
}

/// Two triangles per cell, facing up.
pub(super) fn height_field(
    field: &HeightFieldEntry,
    [columns, rows]: [usize; 2],
) -> impl Iterator<Item = Triangle> {
    let corner = move |column: usize, row: usize| {
        let x = (column as f64 / columns as f64 - 0.5) * field.size_m[0];
        let y = (row as f64 / rows as f64 - 0.5) * field.size_m[1];
        field.center_m + DVec3::new(x, y, height(field, x, y))
    };
    (0..rows * columns).flat_map(move |cell| {
        let (column, row) = (cell % columns, cell / columns);
        let [a, b] = [corner(column, row), corner(column + 1, row)];
        let [c, d] = [corner(column + 1, row + 1), corner(column, row + 1)];
        [[a, b, c], [a, c, d]]
    })
}

/// Above the field's centre, at a place relative to it.
fn height(field: &HeightFieldEntry, x: f64, y: f64) -> f64 {
    let wave = |wave: &super::file::Wave| {
        let (sin, cos) = wave.heading_deg.to_radians().sin_cos();
        let turns = (x * cos + y * sin) / wave.wavelength_m;
        let phase = std::f64::consts::TAU * turns + wave.phase_deg.to_radians();
        wave.amplitude_m * phase.sin()
    };
    field.waves.iter().map(wave).sum()
}

#[cfg(test)]
mod tests;
