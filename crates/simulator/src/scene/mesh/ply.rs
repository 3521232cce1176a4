//! PLY: `vertex` and `face`; elements not needed are passed over.

use echosplat_ply::{Element, PlyError, Reader, Row};
use glam::DVec3;

use super::obj::point;
use super::{Triangle, push_polygon, refuse_turned};

pub(super) fn parse(bytes: &[u8]) -> Result<Vec<Triangle>, String> {
    let mut reader = Reader::new(bytes).map_err(|error| error.to_string())?;
    let mut mesh = Mesh::default();
    for (line, comment) in reader.header().comments.iter().enumerate() {
        refuse_turned(comment)?;
        if let Some(words) = comment.strip_prefix("origin_m ") {
            mesh.origin_m = point(words.split_ascii_whitespace(), line)?;
        }
    }
    loop {
        let element = reader.next_element(|element, _, row| mesh.take(element, row));
        if element.map_err(|Wrong(what)| what)?.is_none() {
            return Ok(mesh.triangles);
        }
    }
}

/// What is wrong with a mesh.
struct Wrong(String);

impl From<PlyError> for Wrong {
    fn from(error: PlyError) -> Self {
        Self(error.to_string())
    }
}

#[derive(Default)]
struct Mesh {
    /// Added to each vertex; a mesh far from the world's origin says it in its header.
    origin_m: DVec3,
    corners: Vec<DVec3>,
    triangles: Vec<Triangle>,
}

impl Mesh {
    fn take(&mut self, element: &Element, row: &Row) -> Result<(), Wrong> {
        match element.name.as_str() {
            "vertex" => {
                let number = |name| element.find(name).map_or(f64::NAN, |(at, _)| row.value(at));
                let place_m = DVec3::from_array(["x", "y", "z"].map(number));
                self.corners.push(self.origin_m + place_m);
                Ok(())
            }
            "face" => self.polygon(element, row).map_err(Wrong),
            _ => Ok(()),
        }
    }

    fn polygon(&mut self, element: &Element, row: &Row) -> Result<(), String> {
        let names = ["vertex_indices", "vertex_index"];
        let Some((at, _)) = names.iter().find_map(|name| element.find(name)) else {
            return Ok(());
        };
        // What is no index names a vertex that cannot exist.
        let index = |&value: &f64| match value >= 0.0 {
            true => value as usize,
            false => usize::MAX,
        };
        let polygon: Vec<usize> = row.list(at).iter().map(index).collect();
        push_polygon(&self.corners, &polygon, &mut self.triangles)
    }
}
