//! Points of a file: PLY vertices (text or binary), or lines of `x y z`.

use echosplat_ply::{Header, Kind, PlyError, Reader, Scalar};
use glam::DVec3;

/// Why a point file was refused.
#[derive(Debug, thiserror::Error)]
pub enum PointFileError {
    /// A PLY that cannot be read.
    #[error("PLY: {0}")]
    Ply(#[from] PlyError),
    /// A PLY without points.
    #[error("PLY: it has no element `vertex` with float or double x, y and z")]
    NoPlaces,
    /// A line that is no point.
    #[error("line {line}: expected `x y z`, three finite numbers")]
    Line {
        /// Counted from 1.
        line: usize,
    },
    /// A vertex that is no point.
    #[error("vertex {vertex} is not finite")]
    Vertex {
        /// Counted from 0.
        vertex: u64,
    },
    /// The file could not be read.
    #[error("{0}")]
    Io(#[from] std::io::Error),
}

/// Whether it is a PLY with triangles.
pub(crate) fn has_faces(bytes: &[u8]) -> bool {
    let header = Header::read(&mut { bytes });
    header.is_ok_and(|header| header.element("face").is_some_and(|face| face.count > 0))
}

/// Reads all points.
pub(crate) fn parse(bytes: &[u8]) -> Result<Vec<DVec3>, PointFileError> {
    if !bytes.starts_with(b"ply") {
        return lines(bytes);
    }
    vertices(bytes)
}

fn lines(bytes: &[u8]) -> Result<Vec<DVec3>, PointFileError> {
    let mut points = Vec::new();
    for (index, line) in bytes.split(|b| *b == b'\n').enumerate() {
        let line = String::from_utf8_lossy(line);
        let line = line.trim_start_matches('\u{feff}').trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let fields = line.split(|c: char| c.is_whitespace() || ",;".contains(c));
        let numbers: Vec<f64> = fields
            .filter(|field| !field.is_empty())
            .take(3)
            .map_while(|field| field.parse().ok())
            .collect();
        points.push(point_of(&numbers).ok_or(PointFileError::Line { line: index + 1 })?);
    }
    Ok(points)
}

fn point_of(numbers: &[f64]) -> Option<DVec3> {
    let point = DVec3::from_array(numbers.try_into().ok()?);
    point.is_finite().then_some(point)
}

/// The vertices.
fn vertices(bytes: &[u8]) -> Result<Vec<DVec3>, PointFileError> {
    let mut reader = Reader::new(bytes)?;
    let vertex = reader.header().element("vertex");
    let axis = |name| match vertex?.find(name)? {
        (at, Kind::Scalar(Scalar::F32 | Scalar::F64)) => Some(at),
        _ => None,
    };
    let (Some(x), Some(y), Some(z)) = (axis("x"), axis("y"), axis("z")) else {
        return Err(PointFileError::NoPlaces);
    };
    let mut points = Vec::new();
    loop {
        let element = reader.next_element(|element, vertex, row| {
            if element.name == "vertex" {
                let numbers = [x, y, z].map(|at| row.value(at));
                points.push(point_of(&numbers).ok_or(PointFileError::Vertex { vertex })?);
            }
            Ok::<_, PointFileError>(())
        })?;
        if element.is_none_or(|element| element.name == "vertex") {
            return Ok(points);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn lines_of_numbers_are_points() {
        let points = parse(b"# x y z\n1 2 3\n\n4;5;6;99\n-1e-3,0,7 red\n").unwrap();
        let expected = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [-1e-3, 0.0, 7.0]];
        assert_eq!(points, expected.map(DVec3::from_array));
        let error = parse(b"1 2 3\n1 2\n").unwrap_err();
        assert!(error.to_string().starts_with("line 2"));
        assert!(parse(b"1 2 nan").is_err());
    }

    #[test]
    fn both_kinds_of_ply_are_read() {
        let head = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\nelement vertex 2\nproperty uchar red\n\
                 property double y\nproperty float x\nproperty float z\nend_header\n"
            )
        };
        let text = head("ascii") + "255 2 1 3\n0 5 4 6\n";
        let mut binary = head("binary_little_endian").into_bytes();
        for (y, x, z) in [(2.0_f64, 1.0_f32, 3.0_f32), (5.0, 4.0, 6.0)] {
            binary.push(9);
            binary.extend(y.to_le_bytes());
            binary.extend(x.to_le_bytes());
            binary.extend(z.to_le_bytes());
        }
        let expected = vec![DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)];
        assert_eq!(parse(text.as_bytes()).unwrap(), expected);
        assert_eq!(parse(&binary).unwrap(), expected);
        let cut = parse(&binary[..binary.len() - 1]).unwrap_err();
        assert!(cut.to_string().contains("cut off"), "{cut}");
        assert!(!has_faces(&binary));
    }

    #[test]
    fn a_claimed_count_is_not_believed() {
        let bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 18446744073709551615\n\
            property float x\nproperty float y\nproperty float z\nend_header\n";
        assert!(parse(bytes).is_err());
        assert!(parse(b"ply\nformat ascii 1.0\nelement vertex 1\nend_header\n").is_err());
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(junk in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&junk);
            let with_head = [&b"ply\nelement vertex 9\nproperty float x\nend_header\n"[..], &junk];
            let _ = parse(&with_head.concat());
        }
    }
}
