//! The text before the rows.

use std::io::{self, Read};

use echosplat_model::glam::DVec3;

use super::PlyError;

/// Longest header taken: far more than any 3DGS file's.
const MAX_HEADER_BYTES: usize = 64 << 10;

/// What the header says of the vertices.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) origin_m: DVec3,
    pub(super) intensity_unit: f32,
    pub(super) held_out_every: u64,
    pub(super) vertex_count: u64,
    /// Bytes of other elements' rows before the first vertex.
    pub(super) skipped_byte_count: u64,
    pub(super) row_byte_count: usize,
    properties: Vec<Property>,
}

#[derive(Debug)]
struct Property {
    name: String,
    kind: String,
    offset: usize,
}

impl Header {
    pub(super) fn read(reader: &mut impl Read) -> Result<Self, PlyError> {
        let mut lines = Lines { reader, taken: 0 };
        let first = lines.next()?;
        if first != "ply" {
            return Err(PlyError::NotPly {
                found: shown(&first),
            });
        }
        let mut parser = Parser::default();
        loop {
            let line = lines.next()?;
            if line == "end_header" {
                return parser.finish();
            }
            parser.line(&line)?;
        }
    }

    /// Byte offset of a float property in a row.
    pub(super) fn offset_of(&self, name: &'static str) -> Result<usize, PlyError> {
        self.find(name)?.ok_or(PlyError::Missing { name })
    }

    /// As [`Header::offset_of`], `None` if the file has no such property.
    pub(super) fn find(&self, name: &'static str) -> Result<Option<usize>, PlyError> {
        let Some(property) = self.properties.iter().find(|p| p.name == name) else {
            return Ok(None);
        };
        if property.kind != "float" && property.kind != "float32" {
            return Err(PlyError::Header(format!(
                "property `{name}` is of type {}, expected float",
                property.kind
            )));
        }
        Ok(Some(property.offset))
    }
}

/// Header lines read byte by byte, so that not a byte of the rows is taken.
struct Lines<'r, R> {
    reader: &'r mut R,
    taken: usize,
}

impl<R: Read> Lines<'_, R> {
    fn next(&mut self) -> Result<String, PlyError> {
        let mut line = Vec::new();
        loop {
            let mut byte = [0];
            match self.reader.read_exact(&mut byte) {
                Ok(()) => {}
                Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => {
                    return Err(match self.taken {
                        0 => PlyError::Empty,
                        _ if line.is_empty() => PlyError::Header("ends before `end_header`".into()),
                        _ => PlyError::NotPly {
                            found: shown(&String::from_utf8_lossy(&line)),
                        },
                    });
                }
                Err(e) => return Err(e.into()),
            }
            self.taken += 1;
            if self.taken > MAX_HEADER_BYTES {
                return Err(PlyError::Header(format!(
                    "no `end_header` in its first {MAX_HEADER_BYTES} bytes"
                )));
            }
            if byte == *b"\n" {
                let text = String::from_utf8_lossy(&line);
                return Ok(text.trim_end().to_owned());
            }
            line.push(byte[0]);
        }
    }
}

fn shown(text: &str) -> String {
    text.chars().take(40).filter(|c| !c.is_control()).collect()
}

#[derive(Default)]
struct Parser {
    origin_m: DVec3,
    intensity_unit: Option<f32>,
    held_out_every: u64,
    format_seen: bool,
    element: Element,
    skipped_byte_count: u64,
    vertex: Option<(u64, Vec<Property>, usize)>,
}

#[derive(Default)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
    byte_count: usize,
    has_list: bool,
}

impl Parser {
    fn line(&mut self, line: &str) -> Result<(), PlyError> {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["format", "binary_little_endian", _] => self.format_seen = true,
            ["format", other, ..] => return Err(PlyError::Format(shown(other))),
            ["comment", "origin_m", x, y, z] => self.origin_m = origin(x, y, z)?,
            ["comment", "intensity_unit", unit] => self.intensity_unit = Some(positive(unit)?),
            ["comment", "held_out_every", every] => self.held_out_every = every_nth(every)?,
            ["comment" | "obj_info", ..] | [] => {}
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad_line(line))?;
                self.close_element()?;
                self.element = Element {
                    name: name.to_owned(),
                    count,
                    ..Element::default()
                };
            }
            ["property", "list", ..] => self.element.has_list = true,
            ["property", kind, name] => self.property(kind, name)?,
            _ => return Err(bad_line(line)),
        }
        Ok(())
    }

    fn property(&mut self, kind: &str, name: &str) -> Result<(), PlyError> {
        let size = match kind {
            "char" | "uchar" | "int8" | "uint8" => 1,
            "short" | "ushort" | "int16" | "uint16" => 2,
            "int" | "uint" | "int32" | "uint32" | "float" | "float32" => 4,
            "double" | "float64" => 8,
            other => {
                let other = shown(other);
                return Err(PlyError::Header(format!("unknown property type `{other}`")));
            }
        };
        self.element.properties.push(Property {
            name: name.to_owned(),
            kind: kind.to_owned(),
            offset: self.element.byte_count,
        });
        self.element.byte_count += size;
        Ok(())
    }

    /// Elements before the vertices are skipped by their size, those after are not looked at.
    fn close_element(&mut self) -> Result<(), PlyError> {
        let element = std::mem::take(&mut self.element);
        if self.vertex.is_some() || element.name.is_empty() {
            return Ok(());
        }
        if element.has_list {
            let name = shown(&element.name);
            return Err(PlyError::Header(format!(
                "element `{name}` has a list property; expected floats only up to the vertices"
            )));
        }
        if element.name == "vertex" {
            self.vertex = Some((element.count, element.properties, element.byte_count));
        } else {
            let size = element.count.saturating_mul(element.byte_count as u64);
            self.skipped_byte_count = self.skipped_byte_count.saturating_add(size);
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Header, PlyError> {
        if !self.format_seen {
            return Err(PlyError::Format("none".into()));
        }
        self.close_element()?;
        let (vertex_count, properties, row_byte_count) = self
            .vertex
            .ok_or_else(|| PlyError::Header("no `element vertex`".into()))?;
        Ok(Header {
            origin_m: self.origin_m,
            intensity_unit: self.intensity_unit.unwrap_or(1.0),
            held_out_every: self.held_out_every,
            vertex_count,
            skipped_byte_count: self.skipped_byte_count,
            row_byte_count,
            properties,
        })
    }
}

fn origin(x: &str, y: &str, z: &str) -> Result<DVec3, PlyError> {
    let number = |text: &str| text.parse().unwrap_or(f64::NAN);
    let origin_m = DVec3::new(number(x), number(y), number(z));
    if !origin_m.is_finite() {
        return Err(PlyError::Header(
            "`comment origin_m` needs three finite numbers".into(),
        ));
    }
    Ok(origin_m)
}

fn positive(unit: &str) -> Result<f32, PlyError> {
    let unit: f32 = unit.parse().unwrap_or(f32::NAN);
    if !(unit > 0.0 && unit.is_finite()) {
        return Err(PlyError::Header(
            "`comment intensity_unit` needs a positive number".into(),
        ));
    }
    Ok(unit)
}

fn every_nth(every: &str) -> Result<u64, PlyError> {
    match every.parse() {
        Ok(every @ 2..) => Ok(every),
        _ => Err(PlyError::Header(
            "`comment held_out_every` needs a whole number of 2 or more".into(),
        )),
    }
}

fn bad_line(line: &str) -> PlyError {
    PlyError::Header(format!("line `{}` is not understood", shown(line)))
}
