//! PLY: text, little-endian and big-endian; any scalar types; elements not needed are passed over.

use glam::DVec3;

use super::{Triangle, push_polygon};

const MAX_ELEMENTS: usize = 64;
const MAX_PROPERTIES: usize = 256;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Text,
    Little,
    Big,
}

#[derive(Debug, Clone, Copy)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

struct Property {
    name: String,
    kind: Kind,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

pub(super) fn parse(bytes: &[u8]) -> Result<Vec<Triangle>, String> {
    let (format, elements, body) = header(bytes)?;
    let mut values = Values { format, rest: body };
    let mut corners = Vec::new();
    let mut triangles = Vec::new();
    for element in &elements {
        // Each entry takes at least a byte, so the claim is bounded by what is there.
        if !element.properties.is_empty() && element.count > values.rest.len() {
            return Err(format!(
                "element {} claims {} entries in {} bytes",
                element.name,
                element.count,
                values.rest.len()
            ));
        }
        match element.name.as_str() {
            "vertex" => read_vertices(element, &mut values, &mut corners)?,
            _ => read_faces(element, &mut values, &corners, &mut triangles)?,
        }
    }
    Ok(triangles)
}

fn header(bytes: &[u8]) -> Result<(Format, Vec<Element>, &[u8]), String> {
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut rest = bytes;
    loop {
        let end = rest.iter().position(|&byte| byte == b'\n');
        let end = end.ok_or("the header has no end_header line")?;
        let line = std::str::from_utf8(&rest[..end])
            .map_err(|_| "the header is not text")?
            .trim();
        rest = &rest[end + 1..];
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["end_header"] => break,
            ["format", name, _] => format = Some(parse_format(name)?),
            ["element", name, count] if elements.len() < MAX_ELEMENTS => elements.push(Element {
                name: (*name).to_owned(),
                count: count
                    .parse()
                    .map_err(|_| format!("`{line}`: the count is no number"))?,
                properties: Vec::new(),
            }),
            ["property", kind @ .., name] => {
                let element = elements
                    .last_mut()
                    .filter(|element| element.properties.len() < MAX_PROPERTIES)
                    .ok_or_else(|| format!("`{line}`: too many, or before any element"))?;
                element.properties.push(Property {
                    name: (*name).to_owned(),
                    kind: parse_kind(kind).ok_or_else(|| format!("`{line}`: unknown type"))?,
                });
            }
            ["ply"] | ["comment" | "obj_info", ..] | [] => {}
            _ => return Err(format!("`{line}` is not understood in the header")),
        }
    }
    let format = format.ok_or("the header names no format")?;
    Ok((format, elements, rest))
}

fn parse_format(name: &str) -> Result<Format, String> {
    match name {
        "ascii" => Ok(Format::Text),
        "binary_little_endian" => Ok(Format::Little),
        "binary_big_endian" => Ok(Format::Big),
        _ => Err(format!(
            "format `{name}`; known are ascii, binary_little_endian, binary_big_endian"
        )),
    }
}

fn parse_kind(words: &[&str]) -> Option<Kind> {
    match words {
        ["list", count, item] => Some(Kind::List {
            count: parse_scalar(count)?,
            item: parse_scalar(item)?,
        }),
        [scalar] => parse_scalar(scalar).map(Kind::Scalar),
        _ => None,
    }
}

fn parse_scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

fn read_vertices(
    element: &Element,
    values: &mut Values<'_>,
    corners: &mut Vec<DVec3>,
) -> Result<(), String> {
    for _ in 0..element.count {
        let mut corner = DVec3::NAN;
        for property in &element.properties {
            match &property.kind {
                Kind::Scalar(scalar) => {
                    let value = values.next(*scalar)?;
                    match property.name.as_str() {
                        "x" => corner.x = value,
                        "y" => corner.y = value,
                        "z" => corner.z = value,
                        _ => {}
                    }
                }
                Kind::List { count, item } => {
                    for _ in 0..values.count(*count)? {
                        values.next(*item)?;
                    }
                }
            }
        }
        corners.push(corner);
    }
    Ok(())
}

/// Reads any element; of one called `face` keeps the polygons.
fn read_faces(
    element: &Element,
    values: &mut Values<'_>,
    corners: &[DVec3],
    triangles: &mut Vec<Triangle>,
) -> Result<(), String> {
    let is_face = element.name == "face";
    let mut polygon = Vec::new();
    for _ in 0..element.count {
        for property in &element.properties {
            let (count, item) = match &property.kind {
                Kind::Scalar(scalar) => (1, *scalar),
                Kind::List { count, item } => (values.count(*count)?, *item),
            };
            polygon.clear();
            for _ in 0..count {
                polygon.push(values.next(item)?);
            }
            if is_face && matches!(property.name.as_str(), "vertex_indices" | "vertex_index") {
                // What is no index names a vertex that cannot exist.
                let index = |&value: &f64| {
                    if value >= 0.0 {
                        value as usize
                    } else {
                        usize::MAX
                    }
                };
                let indices = polygon.iter().map(index);
                push_polygon(corners, &indices.collect::<Vec<_>>(), triangles)?;
            }
        }
    }
    Ok(())
}

/// The numbers after the header, one by one.
struct Values<'a> {
    format: Format,
    rest: &'a [u8],
}

impl Values<'_> {
    fn next(&mut self, scalar: Scalar) -> Result<f64, String> {
        match self.format {
            Format::Text => self.next_word(),
            Format::Little | Format::Big => Ok(match scalar {
                Scalar::I8 => f64::from(i8::from_le_bytes(self.take()?)),
                Scalar::U8 => f64::from(u8::from_le_bytes(self.take()?)),
                Scalar::I16 => f64::from(i16::from_le_bytes(self.take()?)),
                Scalar::U16 => f64::from(u16::from_le_bytes(self.take()?)),
                Scalar::I32 => f64::from(i32::from_le_bytes(self.take()?)),
                Scalar::U32 => f64::from(u32::from_le_bytes(self.take()?)),
                Scalar::F32 => f64::from(f32::from_le_bytes(self.take()?)),
                Scalar::F64 => f64::from_le_bytes(self.take()?),
            }),
        }
    }

    /// Length of a list, no longer than the bytes that are left.
    fn count(&mut self, scalar: Scalar) -> Result<usize, String> {
        let count = self.next(scalar)?;
        if !(count >= 0.0 && count <= self.rest.len() as f64) {
            return Err(format!(
                "a list claims {count} items in {} bytes",
                self.rest.len()
            ));
        }
        Ok(count as usize)
    }

    /// The next bytes of a number, the least significant first.
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (head, rest) = self.rest.split_first_chunk::<N>().ok_or("ends too soon")?;
        self.rest = rest;
        let mut bytes = *head;
        if self.format == Format::Big {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn next_word(&mut self) -> Result<f64, String> {
        let text = self.rest.trim_ascii_start();
        let end = text.iter().position(u8::is_ascii_whitespace);
        let (word, rest) = text.split_at(end.unwrap_or(text.len()));
        self.rest = rest;
        let word = std::str::from_utf8(word).map_err(|_| "not text")?;
        let parsed: Result<f64, _> = word.parse();
        parsed.map_err(|_| format!("`{word}` where a number belongs"))
    }
}
