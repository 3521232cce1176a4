//! The text before the rows.

use std::fmt;
use std::io::{self, Read, Write};

use crate::{PlyError, refuse_newer, shown};

/// Longest header taken: far more than any 3DGS file's.
const MAX_HEADER_BYTES: usize = 64 << 10;
const MAX_ELEMENTS: usize = 64;
const MAX_PROPERTIES: usize = 256;

/// How numbers are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// As decimal numbers.
    Text,
    /// The least significant byte first.
    LittleEndian,
    /// The most significant byte first.
    BigEndian,
}

impl Format {
    const ALL: [Self; 3] = [Self::Text, Self::LittleEndian, Self::BigEndian];

    /// As the header has it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Text => "ascii",
            Self::LittleEndian => "binary_little_endian",
            Self::BigEndian => "binary_big_endian",
        }
    }
}

/// What a number is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    /// `char`.
    I8,
    /// `uchar`.
    U8,
    /// `short`.
    I16,
    /// `ushort`.
    U16,
    /// `int`.
    I32,
    /// `uint`.
    U32,
    /// `float`.
    F32,
    /// `double`.
    F64,
}

impl Scalar {
    /// With its name, and the other name that it may have.
    const NAMES: [(Self, &'static str, &'static str); 8] = [
        (Self::I8, "char", "int8"),
        (Self::U8, "uchar", "uint8"),
        (Self::I16, "short", "int16"),
        (Self::U16, "ushort", "uint16"),
        (Self::I32, "int", "int32"),
        (Self::U32, "uint", "uint32"),
        (Self::F32, "float", "float32"),
        (Self::F64, "double", "float64"),
    ];

    fn parse(name: &str) -> Option<Self> {
        let known = |(_, own, other): &&(Self, &str, &str)| *own == name || *other == name;
        Self::NAMES.iter().find(known).map(|(scalar, ..)| *scalar)
    }

    /// As the header has it.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize].1
    }
}

/// What a property of a row is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// One number.
    Scalar(Scalar),
    /// As many numbers as the one before them says.
    List {
        /// How their count is written.
        count: Scalar,
        /// How each is.
        item: Scalar,
    },
}

impl Kind {
    fn parse(words: &[&str]) -> Option<Self> {
        match words {
            ["list", count, item] => Some(Self::List {
                count: Scalar::parse(count)?,
                item: Scalar::parse(item)?,
            }),
            [scalar] => Scalar::parse(scalar).map(Self::Scalar),
            _ => None,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scalar(scalar) => f.write_str(scalar.name()),
            Self::List { count, item } => write!(f, "list {} {}", count.name(), item.name()),
        }
    }
}

/// One column of an element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Property {
    /// Its name.
    pub name: String,
    /// What it holds.
    pub kind: Kind,
}

/// Rows of one kind.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Element {
    /// Its name, like `vertex`.
    pub name: String,
    /// How many rows the header says there are.
    pub count: u64,
    /// In the order of a row.
    pub properties: Vec<Property>,
}

impl Element {
    /// With a `float` of each name.
    #[must_use]
    pub fn of_floats(name: &str, count: usize, properties: &[&str]) -> Self {
        let float = |name: &&str| Property {
            name: (*name).to_owned(),
            kind: Kind::Scalar(Scalar::F32),
        };
        Self {
            name: name.to_owned(),
            count: count as u64,
            properties: properties.iter().map(float).collect(),
        }
    }

    /// The same with a number of this type of each name behind them.
    #[must_use]
    pub fn with(mut self, scalar: Scalar, properties: &[&str]) -> Self {
        self.properties
            .extend(properties.iter().map(|name| Property {
                name: (*name).to_owned(),
                kind: Kind::Scalar(scalar),
            }));
        self
    }

    /// With one list of `int` of at most 255 items.
    #[must_use]
    pub fn of_lists(name: &str, count: usize, property: &str) -> Self {
        Self {
            name: name.to_owned(),
            count: count as u64,
            properties: vec![Property {
                name: property.to_owned(),
                kind: Kind::List {
                    count: Scalar::U8,
                    item: Scalar::I32,
                },
            }],
        }
    }

    /// Where in a row the property of this name is, and what it holds.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<(usize, Kind)> {
        let at = self.properties.iter().position(|p| p.name == name)?;
        Some((at, self.properties[at].kind))
    }
}

/// What a file says of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Of all rows.
    pub format: Format,
    /// Each without the word `comment`, in order.
    pub comments: Vec<String>,
    /// In order of their rows.
    pub elements: Vec<Element>,
}

impl Header {
    /// Reads it, and not a byte of the rows.
    ///
    /// # Errors
    /// Says which line is wrong, or that it is no header; also of a file of a newer version.
    pub fn read(reader: &mut impl Read) -> Result<Self, PlyError> {
        let mut lines = Lines { reader, taken: 0 };
        let first = lines.next()?;
        if first != "ply" {
            return Err(PlyError::NotPly {
                found: shown(&first),
            });
        }
        let mut format = None;
        let mut header = Self {
            format: Format::Text,
            comments: Vec::new(),
            elements: Vec::new(),
        };
        loop {
            let line = lines.next()?;
            match line.split_whitespace().collect::<Vec<_>>()[..] {
                ["end_header"] => break,
                ["format", name, _] => format = Some(parse_format(name)?),
                _ => header.take(&line)?,
            }
        }
        let none = || PlyError::Header("it names no format".to_owned());
        header.format = format.ok_or_else(none)?;
        refuse_newer(header.comments.iter().map(String::as_str))?;
        Ok(header)
    }

    fn take(&mut self, line: &str) -> Result<(), PlyError> {
        let wrong = || PlyError::Header(format!("line `{}` is not understood", shown(line)));
        match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["comment", ..] => {
                let text = line.trim_start().strip_prefix("comment");
                self.comments.push(text.unwrap_or("").trim().to_owned());
            }
            ["obj_info", ..] | [] => {}
            ["element", name, count] if self.elements.len() < MAX_ELEMENTS => {
                self.elements.push(Element {
                    name: name.to_owned(),
                    count: count.parse().map_err(|_| wrong())?,
                    properties: Vec::new(),
                });
            }
            ["property", ref kind @ .., name] => {
                let element = self.elements.last_mut().ok_or_else(wrong)?;
                if element.properties.len() == MAX_PROPERTIES {
                    let text = format!("more than {MAX_PROPERTIES} properties of one element");
                    return Err(PlyError::Header(text));
                }
                element.properties.push(Property {
                    name: name.to_owned(),
                    kind: Kind::parse(kind).ok_or_else(wrong)?,
                });
            }
            _ => return Err(wrong()),
        }
        Ok(())
    }

    /// The first element of this name.
    #[must_use]
    pub fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == name)
    }

    /// Writes it; comments must have no line breaks.
    ///
    /// # Errors
    /// Of the writer.
    pub fn write(&self, writer: &mut impl Write) -> io::Result<()> {
        writeln!(writer, "ply\nformat {} 1.0", self.format.name())?;
        for comment in &self.comments {
            writeln!(writer, "comment {comment}")?;
        }
        for element in &self.elements {
            writeln!(writer, "element {} {}", element.name, element.count)?;
            for property in &element.properties {
                writeln!(writer, "property {} {}", property.kind, property.name)?;
            }
        }
        writeln!(writer, "end_header")
    }
}

fn parse_format(name: &str) -> Result<Format, PlyError> {
    let found = Format::ALL.into_iter().find(|format| format.name() == name);
    found.ok_or_else(|| {
        let known = Format::ALL.map(Format::name).join(", ");
        PlyError::Header(format!("format `{}`; known are {known}", shown(name)))
    })
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
                    return Err(self.ended(&line));
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

    fn ended(&self, line: &[u8]) -> PlyError {
        match self.taken {
            0 => PlyError::Empty,
            taken if taken == line.len() => PlyError::NotPly {
                found: shown(&String::from_utf8_lossy(line)),
            },
            _ => PlyError::Header("it ends before `end_header`".to_owned()),
        }
    }
}
