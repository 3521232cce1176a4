//! Surfaces as PLY and OBJ.

use std::io::{self, Write};

use echosplat_model::glam::DVec3;
use echosplat_ply::{Element, Format, Header, write_floats, write_list};
use echosplat_surface::{Surface, Vertex};

use super::{SINGLE_PRECISION_M, world_of};
use crate::ply::notes;

/// Of a vertex.
const PROPERTIES: [&str; 7] = ["x", "y", "z", "nx", "ny", "nz", "sigma"];

/// Writes PLY, binary little-endian: `x y z` (metres), `nx ny nz` (unit) and `sigma` (metres, may be
/// infinite) of each vertex, and triangles as `vertex_indices`. In world coordinates, unless `origin_m`
/// is too far from the world's origin for single precision: then relative to it, as the header's
/// `comment origin_m X Y Z` says.
///
/// # Errors
/// Of the writer.
pub fn write_mesh_ply(
    surface: &Surface,
    origin_m: DVec3,
    mut writer: impl Write,
) -> io::Result<()> {
    let is_near = origin_m.length() <= SINGLE_PRECISION_M;
    let (added_m, left_m) = match is_near {
        true => (origin_m, DVec3::ZERO),
        false => (DVec3::ZERO, origin_m),
    };
    let [vertices, faces] = [surface.vertices.len(), surface.triangles.len()];
    let header = Header {
        format: Format::LittleEndian,
        comments: vec![notes::origin(left_m)],
        elements: vec![
            Element::of_floats("vertex", vertices, &PROPERTIES),
            Element::of_lists("face", faces, "vertex_indices"),
        ],
    };
    header.write(&mut writer)?;
    for vertex in &surface.vertices {
        write_floats(&mut writer, &row(vertex, added_m))?;
    }
    for triangle in &surface.triangles {
        write_list(&mut writer, triangle)?;
    }
    writer.flush()
}

fn row(vertex: &Vertex, origin_m: DVec3) -> [f32; PROPERTIES.len()] {
    let [x, y, z] = world_of(origin_m, vertex.position_m).as_vec3().to_array();
    let [nx, ny, nz] = vertex.normal.to_array();
    [x, y, z, nx, ny, nz, vertex.sigma_m]
}

/// Writes OBJ: `v` in world coordinates, metres to a tenth of a millimetre, and `f`. OBJ has no place
/// for sigma.
///
/// # Errors
/// Of the writer.
pub fn write_mesh_obj(
    surface: &Surface,
    origin_m: DVec3,
    mut writer: impl Write,
) -> io::Result<()> {
    for vertex in &surface.vertices {
        let (x, y, z) = world_of(origin_m, vertex.position_m).into();
        writeln!(writer, "v {x:.4} {y:.4} {z:.4}")?;
    }
    for triangle in &surface.triangles {
        // OBJ counts from 1.
        let [a, b, c] = triangle.map(|number| u64::from(number) + 1);
        writeln!(writer, "f {a} {b} {c}")?;
    }
    writer.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::Vec3;

    fn triangle() -> Surface {
        let vertex = |position_m| Vertex {
            position_m,
            normal: Vec3::Z,
            sigma_m: 0.25,
        };
        Surface {
            vertices: vec![vertex(Vec3::ZERO), vertex(Vec3::X), vertex(Vec3::Y)],
            triangles: vec![[0, 1, 2]],
        }
    }

    fn ply(origin_m: DVec3) -> (String, Vec<f32>, Vec<u8>) {
        let mut bytes = Vec::new();
        write_mesh_ply(&triangle(), origin_m, &mut bytes).unwrap();
        let end = b"end_header\n";
        let at = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let (rows, faces) = bytes[at..].split_at(3 * 7 * 4);
        let values = rows.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b));
        let head = String::from_utf8(bytes[..at].to_vec()).unwrap();
        (head, values.collect(), faces.to_vec())
    }

    #[test]
    fn a_ply_has_sigmas_and_faces() {
        let (head, values, faces) = ply(DVec3::new(100.0, 0.0, -5.0));
        assert!(head.contains("comment origin_m 0.0 0.0 0.0\nelement vertex 3\n"));
        assert!(head.contains("property float sigma\nelement face 1\n"));
        assert_eq!(values[7..14], [101.0, 0.0, -5.0, 0.0, 0.0, 1.0, 0.25]);
        assert_eq!(faces, [3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
    }

    #[test]
    fn far_from_the_worlds_origin_a_ply_is_relative_and_an_obj_is_not() {
        let far_m = DVec3::new(500_000.0, 4e6, 0.0);
        let (head, values, _) = ply(far_m);
        assert!(head.contains("comment origin_m 500000.0 4000000.0 0.0\n"));
        assert_eq!(values[7..10], [1.0, 0.0, 0.0]);
        let mut obj = Vec::new();
        write_mesh_obj(&triangle(), far_m, &mut obj).unwrap();
        let text = String::from_utf8(obj).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[1], "v 500001.0000 4000000.0000 0.0000");
        assert_eq!(lines[3..], ["f 1 2 3"]);
    }
}
