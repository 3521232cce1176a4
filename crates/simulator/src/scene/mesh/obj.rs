//! Wavefront OBJ: vertices and faces; all else is passed over.

use echosplat_ply::refuse_newer;
use glam::DVec3;

use super::{Triangle, push_polygon, refuse_turned};

/// Corners of one face, so that a hostile line costs no more than its bytes.
const MAX_POLYGON: usize = 4096;

pub(super) fn parse(bytes: &[u8]) -> Result<Vec<Triangle>, String> {
    let text = std::str::from_utf8(bytes).map_err(|error| format!("not text: {error}"))?;
    let mut corners = Vec::new();
    let mut triangles = Vec::new();
    let mut polygon = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => corners.push(point(words, index)?),
            Some("f") => {
                polygon.clear();
                for word in words.take(MAX_POLYGON) {
                    polygon.push(vertex_index(word, corners.len(), index)?);
                }
                push_polygon(&corners, &polygon, &mut triangles)
                    .map_err(|message| format!("line {}: {message}", index + 1))?;
            }
            Some("#") => {
                let comment = line.trim_start()[1..].trim_start();
                refuse_newer([comment]).map_err(|error| error.to_string())?;
                refuse_turned(comment)?;
            }
            _ => {}
        }
    }
    Ok(triangles)
}

/// Three numbers; `line` counts from 0.
pub(super) fn point<'a>(
    mut words: impl Iterator<Item = &'a str>,
    line: usize,
) -> Result<DVec3, String> {
    let mut number = || {
        let word = words.next().unwrap_or("nothing");
        let parsed: Result<f64, _> = word.parse();
        parsed.map_err(|_| format!("line {}: `{word}` where a number belongs", line + 1))
    };
    Ok(DVec3::new(number()?, number()?, number()?))
}

/// `7`, `7/2`, `7//3`, `7/2/3`; negative ones count back from the newest vertex.
fn vertex_index(word: &str, count: usize, line: usize) -> Result<usize, String> {
    let bad = || format!("line {}: `{word}` is no vertex of {count} so far", line + 1);
    let number: i64 = word
        .split('/')
        .next()
        .and_then(|first| first.parse().ok())
        .ok_or_else(bad)?;
    let index = match number {
        1.. => number - 1,
        0 => return Err(bad()),
        _ => count as i64 + number,
    };
    usize::try_from(index).map_err(|_| bad())
}
