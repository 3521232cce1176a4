//! The bytes of ROS 1's messages: little-endian, without padding; a text is its length and its bytes.

use echosplat_model::Timestamp;
use echosplat_ros::MAX_FRAME_ID_BYTES;

const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// Reads fields in order; never beyond the bytes.
pub(crate) struct Ros1Reader<'a>(&'a [u8]);

impl<'a> Ros1Reader<'a> {
    pub(crate) fn new(message: &'a [u8]) -> Self {
        Self(message)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let ends = || "the message ends before its last field".to_owned();
        let (bytes, rest) = self.0.split_first_chunk().ok_or_else(ends)?;
        self.0 = rest;
        Ok(*bytes)
    }

    /// So many bytes as they are.
    pub(crate) fn bytes<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.array()
    }

    fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    /// How many follow.
    pub(crate) fn count(&mut self, limit: usize) -> Result<usize, String> {
        let count = self.u32()? as usize;
        match count <= limit {
            true => Ok(count),
            false => Err(format!(
                "{count} transforms in one message, at most {limit} are read"
            )),
        }
    }

    pub(crate) fn string(&mut self) -> Result<&'a str, String> {
        let length = self.u32()? as usize;
        let bytes = self.0.split_at_checked(length);
        let (bytes, rest) = bytes
            .filter(|_| length <= MAX_FRAME_ID_BYTES)
            .ok_or("a name of a frame is longer than 255 bytes or than the message")?;
        self.0 = rest;
        std::str::from_utf8(bytes).map_err(|_| "a name of a frame is no text".to_owned())
    }

    /// `std_msgs/Header`: its time and its frame.
    pub(crate) fn header(&mut self) -> Result<(Timestamp, &'a str), String> {
        let _sequence = self.u32()?;
        let (seconds, nanos) = (i64::from(self.u32()?), i64::from(self.u32()?));
        let stamp = Timestamp::from_nanos(seconds * NANOS_PER_SECOND + nanos);
        Ok((stamp, self.string()?))
    }

    pub(crate) fn f64s<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.array()?);
        }
        Ok(numbers)
    }
}
