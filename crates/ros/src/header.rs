//! What ROS messages share: the header and its time.

use echosplat_model::Timestamp;

use crate::cdr::{CdrError, CdrReader, CdrWriter};

/// Longest name of a frame that is read or written.
pub const MAX_FRAME_ID_BYTES: usize = 255;

const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// `std_msgs/Header`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header<'a> {
    /// Time of validity.
    pub stamp: Timestamp,
    /// The frame its coordinates are in.
    pub frame_id: &'a str,
}

impl<'a> Header<'a> {
    /// Reads one.
    ///
    /// # Errors
    /// If the message ends before, or a field is none it can be.
    pub fn read(reader: &mut CdrReader<'a>) -> Result<Self, CdrError> {
        let seconds = i64::from(reader.i32("header.stamp.sec")?);
        let nanos = reader.u32("header.stamp.nanosec")?;
        if i64::from(nanos) >= NANOS_PER_SECOND {
            return Err(CdrError::TooLong {
                field: "header.stamp.nanosec",
                found: u64::from(nanos),
                limit: 999_999_999,
            });
        }
        Ok(Self {
            stamp: Timestamp::from_nanos(seconds * NANOS_PER_SECOND + i64::from(nanos)),
            frame_id: reader.string("header.frame_id", MAX_FRAME_ID_BYTES)?,
        })
    }

    /// Seconds saturate at what `builtin_interfaces/Time` holds (until 2038).
    pub fn write(&self, writer: &mut CdrWriter) {
        let nanos = self.stamp.nanos();
        let seconds = nanos.div_euclid(NANOS_PER_SECOND);
        let seconds = seconds.clamp(i64::from(i32::MIN), i64::from(i32::MAX));
        writer.i32(seconds as i32);
        writer.u32(nanos.rem_euclid(NANOS_PER_SECOND) as u32);
        writer.string(self.frame_id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_before_the_epoch_have_positive_nanoseconds() {
        let header = Header {
            stamp: Timestamp::from_nanos(-1),
            frame_id: "map",
        };
        let mut writer = CdrWriter::with_capacity(0);
        header.write(&mut writer);
        let bytes = writer.finish();
        assert_eq!(bytes[4..8], (-1_i32).to_le_bytes());
        assert_eq!(bytes[8..12], 999_999_999_u32.to_le_bytes());
        let mut reader = CdrReader::new(&bytes).unwrap();
        assert_eq!(Header::read(&mut reader), Ok(header));
    }

    #[test]
    fn a_second_of_nanoseconds_is_refused() {
        let mut bytes = vec![0, 1, 0, 0, 1, 0, 0, 0];
        bytes.extend_from_slice(&1_000_000_000_u32.to_le_bytes());
        bytes.extend_from_slice(&[1, 0, 0, 0, 0]);
        let mut reader = CdrReader::new(&bytes).unwrap();
        assert!(Header::read(&mut reader).is_err());
    }
}
