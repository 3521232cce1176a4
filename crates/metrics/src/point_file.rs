//! Points of a file: PLY vertices (text or binary), or lines of `x y z`.

use glam::DVec3;

/// Why a point file was refused.
#[derive(Debug, thiserror::Error)]
pub enum PointFileError {
    /// The PLY header.
    #[error("PLY header: {0}")]
    Header(String),
    /// A line that is no point.
    #[error("line {line}: expected `x y z`, three finite numbers")]
    Line {
        /// Counted from 1.
        line: usize,
    },
    /// A vertex that is no point.
    #[error("vertex {vertex} of {count} is missing, cut off or not finite")]
    Vertex {
        /// Counted from 0.
        vertex: usize,
        /// As the header says.
        count: usize,
    },
    /// The file could not be read.
    #[error("{0}")]
    Io(#[from] std::io::Error),
}

/// Whether it is a PLY with triangles.
pub(crate) fn has_faces(bytes: &[u8]) -> bool {
    Header::parse(bytes).is_ok_and(|header| header.face_count > 0)
}

/// Reads all points.
pub(crate) fn parse(bytes: &[u8]) -> Result<Vec<DVec3>, PointFileError> {
    if !bytes.starts_with(b"ply") {
        return lines(bytes);
    }
    let header = Header::parse(bytes)?;
    let body = &bytes[header.byte_count..];
    if header.is_text {
        text_rows(&header, body)
    } else {
        binary_rows(&header, body)
    }
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

/// What a PLY's header says of its vertices, which come first.
struct Header {
    byte_count: usize,
    is_text: bool,
    vertex_count: usize,
    face_count: usize,
    /// Type and byte offset of each property of a vertex.
    kinds: Vec<(Kind, usize)>,
    /// Places of x, y and z among the properties.
    places: [usize; 3],
    row_byte_count: usize,
}

#[derive(Clone, Copy)]
enum Kind {
    F32,
    F64,
    Other,
}

impl Header {
    fn parse(bytes: &[u8]) -> Result<Self, PointFileError> {
        let wrong = |what: &str| PointFileError::Header(what.to_owned());
        let end = b"end_header";
        let limit = bytes.len().min(1 << 16);
        let found = bytes[..limit].windows(end.len()).position(|w| w == end);
        let end_at = found.ok_or_else(|| wrong("no `end_header`"))?;
        let rest = &bytes[end_at..];
        let line_end = rest.iter().position(|b| *b == b'\n');
        let byte_count = end_at + line_end.ok_or_else(|| wrong("cut off"))? + 1;
        let mut header = Self {
            byte_count,
            is_text: false,
            vertex_count: 0,
            face_count: 0,
            kinds: Vec::new(),
            places: [usize::MAX; 3],
            row_byte_count: 0,
        };
        let text = String::from_utf8_lossy(&bytes[..end_at]).into_owned();
        header.take_lines(&text)?;
        if header.places.contains(&usize::MAX) {
            return Err(wrong("no element `vertex` with float or double x, y and z"));
        }
        Ok(header)
    }

    fn take_lines(&mut self, text: &str) -> Result<(), PointFileError> {
        let wrong = |line: &str| {
            let line: String = line.chars().take(60).collect();
            PointFileError::Header(format!("line `{line}` is not understood"))
        };
        let mut in_vertex = false;
        for line in text.lines().skip(1) {
            match line.split_whitespace().collect::<Vec<_>>()[..] {
                ["format", "ascii", _] => self.is_text = true,
                ["format", "binary_little_endian", _] | [] | ["comment" | "obj_info", ..] => {}
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| wrong(line))?;
                    in_vertex = name == "vertex";
                    match name {
                        "vertex" => self.vertex_count = count,
                        "face" => self.face_count = count,
                        _ if self.vertex_count == 0 => return Err(wrong(line)),
                        _ => {}
                    }
                }
                ["property", kind, name] if in_vertex => {
                    self.property(kind, name).ok_or_else(|| wrong(line))?;
                }
                ["property", ..] if !in_vertex => {}
                _ => return Err(wrong(line)),
            }
        }
        Ok(())
    }

    fn property(&mut self, kind: &str, name: &str) -> Option<()> {
        let (kind, size) = match kind {
            "char" | "uchar" | "int8" | "uint8" => (Kind::Other, 1),
            "short" | "ushort" | "int16" | "uint16" => (Kind::Other, 2),
            "int" | "uint" | "int32" | "uint32" => (Kind::Other, 4),
            "float" | "float32" => (Kind::F32, 4),
            "double" | "float64" => (Kind::F64, 8),
            _ => return None,
        };
        let axis = ["x", "y", "z"].iter().position(|axis| *axis == name);
        if let (Some(axis), Kind::F32 | Kind::F64) = (axis, kind) {
            self.places[axis] = self.kinds.len();
        }
        self.kinds.push((kind, self.row_byte_count));
        self.row_byte_count += size;
        Some(())
    }

    fn vertex_error(&self, vertex: usize) -> PointFileError {
        PointFileError::Vertex {
            vertex,
            count: self.vertex_count,
        }
    }
}

fn text_rows(header: &Header, body: &[u8]) -> Result<Vec<DVec3>, PointFileError> {
    let text = String::from_utf8_lossy(body);
    let mut rows = text.lines().filter(|line| !line.trim().is_empty());
    let mut points = Vec::new();
    for vertex in 0..header.vertex_count {
        let fields: Vec<&str> = rows.next().unwrap_or("").split_whitespace().collect();
        let number = |place: usize| fields.get(place).and_then(|f| f.parse().ok());
        let numbers: Vec<f64> = header.places.iter().map_while(|&p| number(p)).collect();
        points.push(point_of(&numbers).ok_or_else(|| header.vertex_error(vertex))?);
    }
    Ok(points)
}

fn binary_rows(header: &Header, body: &[u8]) -> Result<Vec<DVec3>, PointFileError> {
    let mut rows = body.chunks_exact(header.row_byte_count);
    let mut points = Vec::new();
    for vertex in 0..header.vertex_count {
        let row = rows.next().unwrap_or(&[]);
        let number = |&place: &usize| {
            let (kind, offset) = header.kinds[place];
            match kind {
                Kind::F32 => Some(f64::from(f32::from_le_bytes(bytes_at(row, offset)?))),
                Kind::F64 => Some(f64::from_le_bytes(bytes_at(row, offset)?)),
                Kind::Other => None,
            }
        };
        let numbers: Vec<f64> = header.places.iter().map_while(number).collect();
        points.push(point_of(&numbers).ok_or_else(|| header.vertex_error(vertex))?);
    }
    Ok(points)
}

fn bytes_at<const N: usize>(row: &[u8], offset: usize) -> Option<[u8; N]> {
    row.get(offset..offset + N)?.try_into().ok()
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
        assert!(cut.to_string().starts_with("vertex 1 of 2"));
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
