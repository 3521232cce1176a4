//! CDR, the byte layout of ROS 2 messages: plain CDR version 1, little-endian.
//!
//! Four bytes of encapsulation (`00 01 00 00`), then each number aligned to its own size counted
//! from behind them; a string is a `u32` length with its NUL, a sequence a `u32` count. Source:
//! OMG DDS-XTypes 1.3, section 7.4.1. Only what the messages of this project need.

use thiserror::Error;

/// `PLAIN_CDR`, little-endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Serialisers may round a message up to a multiple of four bytes.
const MAX_PADDING_BYTES: usize = 3;

/// Why bytes are no such message.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum CdrError {
    /// Not little-endian plain CDR.
    #[error("encapsulation is {found:02x?}; only little-endian CDR, [00, 01], is read")]
    Encapsulation {
        /// The first two bytes, if there are two.
        found: Vec<u8>,
    },
    /// The bytes end inside a field.
    #[error("message ends inside {field}")]
    Truncated {
        /// Name of the field.
        field: &'static str,
    },
    /// A length or count beyond what is allowed.
    #[error("{field} says {found}; at most {limit} is allowed")]
    TooLong {
        /// Name of the field.
        field: &'static str,
        /// By the sender's word.
        found: u64,
        /// Allowed.
        limit: u64,
    },
    /// A string that is not UTF-8 or does not end with NUL.
    #[error("{field} is not a text that ends with NUL")]
    Text {
        /// Name of the field.
        field: &'static str,
    },
    /// More bytes than the message has.
    #[error("{bytes} bytes follow the end of the message")]
    Trailing {
        /// How many.
        bytes: usize,
    },
}

/// Reads fields in order; never beyond the bytes, never allocating.
#[derive(Debug)]
pub struct CdrReader<'a> {
    body: &'a [u8],
    position: usize,
}

impl<'a> CdrReader<'a> {
    /// Of a whole message.
    ///
    /// # Errors
    /// If it is not little-endian plain CDR.
    pub fn new(bytes: &'a [u8]) -> Result<Self, CdrError> {
        match bytes {
            [0, 1, _, _, body @ ..] => Ok(Self { body, position: 0 }),
            _ => Err(CdrError::Encapsulation {
                found: bytes.iter().take(2).copied().collect(),
            }),
        }
    }

    fn align(&mut self, size: usize) {
        self.position = self.position.next_multiple_of(size);
    }

    /// So many bytes as they are.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn bytes(&mut self, field: &'static str, count: usize) -> Result<&'a [u8], CdrError> {
        let rest = self.body.get(self.position..);
        let found = rest.and_then(|rest| rest.get(..count));
        let found = found.ok_or(CdrError::Truncated { field })?;
        self.position += count;
        Ok(found)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], CdrError> {
        self.align(N);
        let bytes = self.bytes(field, N)?;
        bytes.try_into().map_err(|_| CdrError::Truncated { field })
    }

    /// An octet.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn u8(&mut self, field: &'static str) -> Result<u8, CdrError> {
        Ok(self.array::<1>(field)?[0])
    }

    /// A `uint16`.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn u16(&mut self, field: &'static str) -> Result<u16, CdrError> {
        Ok(u16::from_le_bytes(self.array(field)?))
    }

    /// A `uint32`.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn u32(&mut self, field: &'static str) -> Result<u32, CdrError> {
        Ok(u32::from_le_bytes(self.array(field)?))
    }

    /// An `int32`.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn i32(&mut self, field: &'static str) -> Result<i32, CdrError> {
        Ok(i32::from_le_bytes(self.array(field)?))
    }

    /// A `float64`.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn f64(&mut self, field: &'static str) -> Result<f64, CdrError> {
        Ok(f64::from_le_bytes(self.array(field)?))
    }

    /// So many `float64`.
    ///
    /// # Errors
    /// If the message ends before.
    pub fn f64s<const N: usize>(&mut self, field: &'static str) -> Result<[f64; N], CdrError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64(field)?;
        }
        Ok(values)
    }

    /// A length or count, refused above `limit`.
    ///
    /// # Errors
    /// If it is larger, or the message ends before.
    pub fn count(&mut self, field: &'static str, limit: usize) -> Result<usize, CdrError> {
        let found = self.u32(field)?;
        match usize::try_from(found) {
            Ok(count) if count <= limit => Ok(count),
            _ => Err(CdrError::TooLong {
                field,
                found: u64::from(found),
                limit: limit as u64,
            }),
        }
    }

    /// A string of at most `limit` bytes. Length 0, which some writers use for "", is taken.
    ///
    /// # Errors
    /// If it is longer, no UTF-8 that ends with NUL, or the message ends before.
    pub fn string(&mut self, field: &'static str, limit: usize) -> Result<&'a str, CdrError> {
        let length = self.count(field, limit + 1)?;
        if length == 0 {
            return Ok("");
        }
        let [text @ .., 0] = self.bytes(field, length)? else {
            return Err(CdrError::Text { field });
        };
        std::str::from_utf8(text).map_err(|_| CdrError::Text { field })
    }

    /// That the message ends here, padding aside.
    ///
    /// # Errors
    /// Says how many bytes follow.
    pub fn finish(self) -> Result<(), CdrError> {
        let bytes = self.body.len().saturating_sub(self.position);
        match bytes <= MAX_PADDING_BYTES {
            true => Ok(()),
            false => Err(CdrError::Trailing { bytes }),
        }
    }
}

/// Writes fields in order.
#[derive(Debug)]
pub struct CdrWriter {
    bytes: Vec<u8>,
}

impl CdrWriter {
    /// Empty but for the encapsulation.
    #[must_use]
    pub fn with_capacity(byte_count: usize) -> Self {
        let mut bytes = Vec::with_capacity(byte_count);
        bytes.extend_from_slice(&ENCAPSULATION);
        Self { bytes }
    }

    fn align(&mut self, size: usize) {
        let body = self.bytes.len() - ENCAPSULATION.len();
        let padding = body.next_multiple_of(size) - body;
        self.bytes.resize(self.bytes.len() + padding, 0);
    }

    /// Bytes as they are.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        self.align(N);
        self.bytes(&bytes);
    }

    /// An octet.
    pub fn u8(&mut self, value: u8) {
        self.number([value]);
    }

    /// A `uint16`.
    pub fn u16(&mut self, value: u16) {
        self.number(value.to_le_bytes());
    }

    /// A `uint32`.
    pub fn u32(&mut self, value: u32) {
        self.number(value.to_le_bytes());
    }

    /// An `int32`.
    pub fn i32(&mut self, value: i32) {
        self.number(value.to_le_bytes());
    }

    /// A `float64`.
    pub fn f64(&mut self, value: f64) {
        self.number(value.to_le_bytes());
    }

    /// So many `float64`.
    pub fn f64s(&mut self, values: &[f64]) {
        values.iter().for_each(|value| self.f64(*value));
    }

    /// A length or count. Saturates at `u32::MAX`, which nothing here comes near.
    pub fn count(&mut self, count: usize) {
        self.u32(u32::try_from(count).unwrap_or(u32::MAX));
    }

    /// A string, with its NUL.
    pub fn string(&mut self, text: &str) {
        self.count(text.len() + 1);
        self.bytes(text.as_bytes());
        self.bytes(&[0]);
    }

    /// The whole message.
    #[must_use]
    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Worked out by hand: the body starts at byte 4, and alignment counts from there.
    const BYTES: [u8; 32] = [
        0, 1, 0, 0, // encapsulation
        7, // u8 at 0
        0, 0, 0, // padding to 4
        3, 0, 0, 0, // string length with NUL, at 4
        b'a', b'b', 0, // at 8
        0, // padding to 12
        0xFE, 0xFF, 0xFF, 0xFF, // i32 -2 at 12
        1,    // u8 at 16
        0, 0, 0, 0, 0, 0, 0, // padding to 24
        0, 0, 0, 0, // the first half of an f64
    ];

    #[test]
    fn every_field_lies_where_the_rules_put_it() {
        let mut reader = CdrReader::new(&BYTES).unwrap();
        assert_eq!(reader.u8("a"), Ok(7));
        assert_eq!(reader.string("b", 16), Ok("ab"));
        assert_eq!(reader.i32("c"), Ok(-2));
        assert_eq!(reader.u8("d"), Ok(1));
        assert_eq!(reader.f64("e"), Err(CdrError::Truncated { field: "e" }));
    }

    #[test]
    fn the_writer_makes_the_same_bytes() {
        let mut writer = CdrWriter::with_capacity(0);
        writer.u8(7);
        writer.string("ab");
        writer.i32(-2);
        writer.u8(1);
        assert_eq!(writer.finish(), BYTES[..21]);
    }

    #[test]
    fn an_f64_is_aligned_to_eight_behind_the_encapsulation() {
        let mut bytes = vec![0, 1, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0];
        bytes.extend_from_slice(&1.5_f64.to_le_bytes());
        let mut reader = CdrReader::new(&bytes).unwrap();
        assert_eq!(reader.u8("a"), Ok(9));
        assert_eq!(reader.f64("b"), Ok(1.5));
        assert_eq!(reader.finish(), Ok(()));
    }

    #[test]
    fn lengths_are_judged_before_they_are_believed() {
        let bytes = [0, 1, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF];
        let refused = CdrReader::new(&bytes).unwrap().string("name", 255);
        assert!(matches!(refused, Err(CdrError::TooLong { limit: 256, .. })));
        let bytes = [0, 1, 0, 0, 2, 0, 0, 0, b'a', b'b'];
        let unended = CdrReader::new(&bytes).unwrap().string("name", 255);
        assert_eq!(unended, Err(CdrError::Text { field: "name" }));
    }

    #[test]
    fn other_encapsulations_and_trailing_bytes_are_refused() {
        for bytes in [&[][..], &[0], &[0, 0, 0, 0], &[0, 7, 0, 0], &[0, 1, 0]] {
            assert!(CdrReader::new(bytes).is_err());
        }
        let padded = CdrReader::new(&[0, 1, 0, 0, 0, 0, 0]).unwrap();
        assert_eq!(padded.finish(), Ok(()));
        let long = CdrReader::new(&[0, 1, 0, 0, 0, 0, 0, 0]).unwrap();
        assert_eq!(long.finish(), Err(CdrError::Trailing { bytes: 4 }));
    }
}
