//! Triangles from files and from formulas. Counts a file claims are held against the bytes it has
//! before anything is made room for.

mod obj;
mod ply;
mod stl;

use std::path::Path;

use glam::DVec3;

use super::SceneError;
use super::file::HeightFieldEntry;

/// Corners of a triangle.
pub(super) type Triangle = [DVec3; 3];

/// Largest mesh taken.
pub(super) const MAX_MESH_BYTES: u64 = 256 << 20;
const MAX_TRIANGLE_COUNT: usize = 2_000_000;
const MAX_COORDINATE: f64 = 1e8;

/// Reads an STL, OBJ or PLY file that a scene names.
pub(super) fn load(path: &Path) -> Result<Vec<Triangle>, SceneError> {
    // A dive's meshes are copied, too: what can be read once alone is none.
    let bytes = echosplat_input::read_file(path, MAX_MESH_BYTES);
    of_bytes(&bytes.map_err(|source| unreadable(path, source))?, path)
}

pub(super) fn unreadable(path: &Path, source: std::io::Error) -> SceneError {
    SceneError::Io {
        path: path.to_owned(),
        source,
    }
}

/// What an STL, OBJ or PLY file at `path` holds, told apart by that, then by its name.
pub(super) fn of_bytes(bytes: &[u8], path: &Path) -> Result<Vec<Triangle>, SceneError> {
    let named_obj = path
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("obj"));
    parse(bytes, named_obj).map_err(|message| SceneError::Mesh {
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

/// A mesh or a map whose comment says that its z does not point up lies on its side in a world of ENU.
fn refuse_turned(comment: &str) -> Result<(), String> {
    match comment.strip_prefix("up_axis ").map(str::trim) {
        None | Some("z") => Ok(()),
        Some(axis) => Err(format!(
            "its {axis} points up, as `export --up {axis}` made it; here z has to: export it without --up"
        )),
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
