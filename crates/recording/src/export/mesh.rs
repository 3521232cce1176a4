//! Surfaces as PLY and OBJ.

use std::collections::HashMap;
use std::io::{self, Write};

use echosplat_model::glam::DVec3;
use echosplat_ply::{Element, Format, Header, Written, write_floats, write_list};
use echosplat_surface::{Surface, Vertex};

use super::{SINGLE_PRECISION_M, Up, world_of};
use crate::ply::notes;

/// Of a vertex. The last three are the same number: of a mesh one viewer keeps `quality` alone, another what is
/// called `scalar_…`, and neither keeps `sigma`.
const PROPERTIES: [&str; 9] = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "sigma",
    "quality",
    "scalar_sigma",
];

/// What a mesh's file got.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WrittenMesh {
    /// Its vertices.
    pub vertex_count: usize,
    /// Its triangles.
    pub triangle_count: usize,
}

impl WrittenMesh {
    pub(super) fn of(surface: &Surface) -> Self {
        Self {
            vertex_count: surface.vertices.len(),
            triangle_count: surface.triangles.len(),
        }
    }
}

/// Writes PLY, binary little-endian: `x y z` (metres), `nx ny nz` (unit) and `sigma` (metres, may be
/// infinite; again as `quality` and `scalar_sigma`) of each vertex, and triangles as `vertex_indices`. In world
/// coordinates, unless `origin_m` is too far from the world's origin for single precision: then relative to it, as
/// the header's `comment origin_m X Y Z` says. No two vertices are at one place, and every triangle has an area.
///
/// # Errors
/// Of the writer.
pub fn write_mesh_ply(
    surface: &Surface,
    origin_m: DVec3,
    up: Up,
    mut writer: impl Write,
) -> io::Result<WrittenMesh> {
    let (surface, origin_m) = up.turned_surface(surface.clone(), origin_m);
    let is_near = origin_m.length() <= SINGLE_PRECISION_M;
    let (added_m, left_m) = match is_near {
        true => (origin_m, DVec3::ZERO),
        false => (DVec3::ZERO, origin_m),
    };
    let place = |vertex: &Vertex| world_of(added_m, vertex.position_m).as_vec3().to_array();
    // Adding 0 makes one of both zeros.
    let surface = welded(&surface, |vertex| place(vertex).map(|x| f64::from(x + 0.0)));
    let header = Header {
        format: Format::LittleEndian,
        comments: [Written::MESH.comment(), notes::origin(left_m)]
            .into_iter()
            .chain(notes::up_axis(up))
            .collect(),
        elements: vec![
            Element::of_floats("vertex", surface.vertices.len(), &PROPERTIES),
            Element::of_lists("face", surface.triangles.len(), "vertex_indices"),
        ],
    };
    header.write(&mut writer)?;
    for vertex in &surface.vertices {
        let ([x, y, z], [nx, ny, nz]) = (place(vertex), vertex.normal.to_array());
        let sigma_m = vertex.sigma_m;
        write_floats(
            &mut writer,
            &[x, y, z, nx, ny, nz, sigma_m, sigma_m, sigma_m],
        )?;
    }
    for triangle in &surface.triangles {
        write_list(&mut writer, triangle)?;
    }
    writer.flush()?;
    Ok(WrittenMesh::of(&surface))
}

/// The surface with one vertex at each place and without triangles that have no area there. `place_m` is what the
/// file will say: places that differ by less than its precision are one.
fn welded(surface: &Surface, place_m: impl Fn(&Vertex) -> [f64; 3]) -> Surface {
    let mut first_at: HashMap<[u64; 3], u32> = HashMap::new();
    let places: Vec<[f64; 3]> = surface.vertices.iter().map(place_m).collect();
    let firsts: Vec<u32> = places
        .iter()
        .zip(0..)
        .map(|(place, number)| *first_at.entry(place.map(f64::to_bits)).or_insert(number))
        .collect();
    let area_m2 = |triangle: [u32; 3]| {
        let [a, b, c] = triangle.map(|number| DVec3::from_array(places[number as usize]));
        (b - a).cross(c - a).length()
    };
    let triangles = surface.triangles.iter();
    let triangles = triangles.map(|triangle| triangle.map(|number| firsts[number as usize]));
    let mut kept = Surface::default();
    let mut numbers = vec![u32::MAX; places.len()];
    for triangle in triangles.filter(|triangle| area_m2(*triangle) > 0.0) {
        let renumbered = triangle.map(|old| {
            let number = &mut numbers[old as usize];
            if *number == u32::MAX {
                *number = kept.vertices.len() as u32;
                kept.vertices.push(surface.vertices[old as usize]);
            }
            *number
        });
        kept.triangles.push(renumbered);
    }
    kept
}

/// Writes OBJ: `v` in world coordinates, metres to a tenth of a millimetre, and `f`. OBJ has no place
/// for sigma. No two vertices are at one place, and every triangle has an area.
///
/// # Errors
/// Of the writer.
pub fn write_mesh_obj(
    surface: &Surface,
    origin_m: DVec3,
    up: Up,
    mut writer: impl Write,
) -> io::Result<WrittenMesh> {
    let (surface, origin_m) = up.turned_surface(surface.clone(), origin_m);
    let place = |vertex: &Vertex| {
        let place_m = world_of(origin_m, vertex.position_m).to_array();
        place_m.map(|x| (x * 1e4).round() / 1e4 + 0.0)
    };
    let surface = welded(&surface, place);
    writeln!(writer, "# {}", Written::MESH.comment())?;
    if up != Up::Z {
        writeln!(writer, "# up_axis {}", up.name())?;
    }
    for vertex in &surface.vertices {
        let [x, y, z] = place(vertex);
        writeln!(writer, "v {x:.4} {y:.4} {z:.4}")?;
    }
    for triangle in &surface.triangles {
        // OBJ counts from 1.
        let [a, b, c] = triangle.map(|number| u64::from(number) + 1);
        writeln!(writer, "f {a} {b} {c}")?;
    }
    writer.flush()?;
    Ok(WrittenMesh::of(&surface))
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::Vec3;

    fn surface(places_m: &[[f32; 3]], triangles: Vec<[u32; 3]>) -> Surface {
        let vertices = places_m.iter().map(|place| Vertex {
            position_m: Vec3::from_array(*place),
            normal: Vec3::Z,
            sigma_m: 0.25,
        });
        Surface {
            vertices: vertices.collect(),
            triangles,
        }
    }

    fn triangle() -> Surface {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        surface(&corners, vec![[0, 1, 2]])
    }

    fn ply(surface: &Surface, origin_m: DVec3, up: Up) -> (String, Vec<[f32; 9]>, Vec<u8>) {
        let mut bytes = Vec::new();
        write_mesh_ply(surface, origin_m, up, &mut bytes).unwrap();
        let end = b"end_header\n";
        let at = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let head = String::from_utf8(bytes[..at].to_vec()).unwrap();
        let count = head.split("element vertex ").nth(1).unwrap();
        let count: usize = count.lines().next().unwrap().parse().unwrap();
        let (rows, faces) = bytes[at..].split_at(count * 9 * 4);
        let values = rows.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b));
        let values: Vec<f32> = values.collect();
        (head, values.as_chunks().0.to_vec(), faces.to_vec())
    }

    fn obj(surface: &Surface, origin_m: DVec3) -> Vec<String> {
        let mut obj = Vec::new();
        write_mesh_obj(surface, origin_m, Up::Z, &mut obj).unwrap();
        let text = String::from_utf8(obj).unwrap();
        text.lines().map(str::to_owned).collect()
    }

    #[test]
    fn a_ply_has_sigmas_and_faces() {
        let (head, rows, faces) = ply(&triangle(), DVec3::new(100.0, 0.0, -5.0), Up::Z);
        assert!(head.contains("comment origin_m 0.0 0.0 0.0\nelement vertex 3\n"));
        assert!(head.contains("property float sigma\nproperty float quality\n"));
        assert!(head.contains("property float scalar_sigma\nelement face 1\n"));
        let expected = [101.0, 0.0, -5.0, 0.0, 0.0, 1.0, 0.25, 0.25, 0.25];
        assert_eq!(rows[1].map(f32::to_bits), expected.map(f32::to_bits));
        assert_eq!(faces, [3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
    }

    #[test]
    fn far_from_the_worlds_origin_a_ply_is_relative_and_an_obj_is_not() {
        let far_m = DVec3::new(500_000.0, 4e6, 0.0);
        let (head, rows, _) = ply(&triangle(), far_m, Up::Z);
        assert!(head.contains("comment origin_m 500000.0 4000000.0 0.0\n"));
        assert_eq!(rows[1][..3], [1.0, 0.0, 0.0]);
        let lines = obj(&triangle(), far_m);
        assert_eq!(lines[2], "v 500001.0000 4000000.0000 0.0000");
        assert_eq!(lines[4..], ["f 1 2 3"]);
    }

    #[test]
    fn up_turns_places_normals_and_origin() {
        let (head, rows, _) = ply(&triangle(), DVec3::new(1.0, 2.0, 3.0), Up::Y);
        assert!(head.contains("comment up_axis y\n"), "{head}");
        assert_eq!(rows[2][..6], [1.0, 3.0, -3.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn one_vertex_a_place_and_no_triangle_without_an_area() {
        let places_m = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [-0.0, 0.0, 0.0],
            [2.0, 0.0, 0.0],
            [5.0, 5.0, 1e-9],
            [5.0, 5.0, 0.0],
        ];
        // One sound, its twin's corner, a point, a line, and one whose corners meet in the file alone.
        let triangles = vec![[0, 1, 2], [3, 2, 1], [0, 3, 1], [0, 1, 4], [5, 6, 2]];
        let many = surface(&places_m, triangles);
        let (_, rows, faces) = ply(&many, DVec3::new(3.0, 0.0, 10.0), Up::Z);
        assert_eq!((rows.len(), faces.len()), (3, 2 * 13));
        let lines = obj(&many, DVec3::ZERO);
        assert_eq!(lines[4..], ["f 1 2 3", "f 1 3 2"]);
    }
}
