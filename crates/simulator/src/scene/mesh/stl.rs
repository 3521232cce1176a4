//! STL, binary and text.

use glam::DVec3;

use super::Triangle;

const HEADER_BYTES: usize = 84;
const FACET_BYTES: usize = 50;
const NORMAL_BYTES: usize = 12;

pub(super) fn parse(bytes: &[u8]) -> Result<Vec<Triangle>, String> {
    let claimed = bytes
        .get(80..HEADER_BYTES)
        .and_then(|field| field.try_into().ok())
        .map(u32::from_le_bytes);
    // Binary files may begin with `solid` too, so their length decides.
    let fits = |count: u32| {
        (count as usize)
            .checked_mul(FACET_BYTES)
            .is_some_and(|body| bytes.len() - HEADER_BYTES == body)
    };
    match claimed {
        Some(count) if fits(count) => Ok(binary(&bytes[HEADER_BYTES..])),
        _ if bytes.trim_ascii_start().starts_with(b"solid") => text(bytes),
        Some(count) => Err(format!(
            "neither text nor binary STL: {count} facets take {} bytes, the file has {}",
            HEADER_BYTES as u64 + u64::from(count) * FACET_BYTES as u64,
            bytes.len()
        )),
        None => Err("too short for an STL file, and neither PLY nor named .obj".to_owned()),
    }
}

fn binary(facets: &[u8]) -> Vec<Triangle> {
    let coordinate = |field: &[u8]| match field.try_into() {
        Ok(bytes) => f64::from(f32::from_le_bytes(bytes)),
        Err(_) => f64::NAN,
    };
    let corner = |facet: &[u8], index: usize| {
        let at = |axis: usize| {
            let start = NORMAL_BYTES + 12 * index + 4 * axis;
            coordinate(&facet[start..start + 4])
        };
        DVec3::new(at(0), at(1), at(2))
    };
    facets
        .chunks_exact(FACET_BYTES)
        .map(|facet| [0, 1, 2].map(|index| corner(facet, index)))
        .collect()
}

fn text(bytes: &[u8]) -> Result<Vec<Triangle>, String> {
    let text = std::str::from_utf8(bytes).map_err(|error| format!("not text: {error}"))?;
    let mut corners = Vec::new();
    let mut triangles = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("vertex") => corners.push(super::obj::point(words, index)?),
            Some("endloop") => {
                let triangle: Triangle = corners.as_slice().try_into().map_err(|_| {
                    let count = corners.len();
                    format!("line {}: a facet of {count} vertices, not 3", index + 1)
                })?;
                triangles.push(triangle);
                corners.clear();
            }
            _ => {}
        }
    }
    Ok(triangles)
}
