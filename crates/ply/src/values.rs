//! The numbers after the header, one by one.

use std::io::{self, BufRead};

use crate::header::{Format, Scalar};
use crate::shown;

/// Longest word of a text file that may be a number.
const MAX_WORD_BYTES: usize = 64;

pub(crate) struct Values<R> {
    source: R,
    format: Format,
    /// The line of the last word has been read to its end.
    at_line_start: bool,
}

/// Why there is no number.
pub(crate) enum NoValue {
    Ended,
    Wrong(String),
    Io(io::Error),
}

impl From<io::Error> for NoValue {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Self::Ended,
            _ => Self::Io(error),
        }
    }
}

impl<R: BufRead> Values<R> {
    pub(crate) fn new(source: R, format: Format) -> Self {
        Self {
            source,
            format,
            at_line_start: true,
        }
    }

    pub(crate) fn next(&mut self, scalar: Scalar) -> Result<f64, NoValue> {
        if self.format == Format::Text {
            return self.next_word();
        }
        Ok(match scalar {
            Scalar::I8 => f64::from(i8::from_le_bytes(self.bytes()?)),
            Scalar::U8 => f64::from(u8::from_le_bytes(self.bytes()?)),
            Scalar::I16 => f64::from(i16::from_le_bytes(self.bytes()?)),
            Scalar::U16 => f64::from(u16::from_le_bytes(self.bytes()?)),
            Scalar::I32 => f64::from(i32::from_le_bytes(self.bytes()?)),
            Scalar::U32 => f64::from(u32::from_le_bytes(self.bytes()?)),
            Scalar::F32 => f64::from(f32::from_le_bytes(self.bytes()?)),
            Scalar::F64 => f64::from_le_bytes(self.bytes()?),
        })
    }

    /// What follows the numbers of a row on their line is no part of the next row.
    pub(crate) fn end_row(&mut self) -> io::Result<()> {
        if self.format == Format::Text && !self.at_line_start {
            self.source.skip_until(b'\n')?;
            self.at_line_start = true;
        }
        Ok(())
    }

    /// The next bytes of a number, the least significant first.
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], NoValue> {
        let mut bytes = [0; N];
        self.source.read_exact(&mut bytes)?;
        if self.format == Format::BigEndian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn next_word(&mut self) -> Result<f64, NoValue> {
        let mut word = Vec::new();
        while let Some(&byte) = self.source.fill_buf()?.first() {
            let is_space = byte.is_ascii_whitespace();
            if is_space && !word.is_empty() {
                break;
            }
            self.source.consume(1);
            if is_space {
                continue;
            }
            word.push(byte);
            if word.len() > MAX_WORD_BYTES {
                break;
            }
        }
        if word.is_empty() {
            return Err(NoValue::Ended);
        }
        self.at_line_start = false;
        let word = String::from_utf8_lossy(&word);
        let number = word.parse().ok().filter(|_| word.len() <= MAX_WORD_BYTES);
        number.ok_or_else(|| NoValue::Wrong(format!("`{}` where a number belongs", shown(&word))))
    }
}
