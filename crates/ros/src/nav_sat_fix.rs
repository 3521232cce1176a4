//! `sensor_msgs/msg/NavSatFix`: a fix of a satellite receiver, as its bytes have it.

use echosplat_model::Timestamp;

use crate::{CdrError, CdrReader, CdrWriter, Header};

/// `COVARIANCE_TYPE_UNKNOWN`: what stands in the covariance means nothing.
pub const COVARIANCE_UNKNOWN: u8 = 0;

/// The message; whether its numbers make sense is the caller's to say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NavSatFix {
    /// When it was measured.
    pub stamp: Timestamp,
    /// Below 0 without a fix.
    pub status: i8,
    /// Degrees north.
    pub latitude_deg: f64,
    /// Degrees east.
    pub longitude_deg: f64,
    /// Metres over the ellipsoid of WGS 84; NaN where there is none.
    pub altitude_m: f64,
    /// Row by row over east, north and up, square metres.
    pub covariance_m2: [f64; 9],
    /// What is known of it: [`COVARIANCE_UNKNOWN`], approximated (1), its diagonal (2), all (3).
    pub covariance_type: u8,
}

impl NavSatFix {
    /// Reads one in CDR.
    ///
    /// # Errors
    /// If the bytes are no such message.
    pub fn decode(bytes: &[u8]) -> Result<Self, CdrError> {
        let mut reader = CdrReader::new(bytes)?;
        let stamp = Header::read(&mut reader)?.stamp;
        let status = reader.u8("status.status")?.cast_signed();
        reader.u16("status.service")?;
        let [latitude_deg, longitude_deg, altitude_m] = reader.f64s("latitude")?;
        let covariance_m2 = reader.f64s("position_covariance")?;
        let covariance_type = reader.u8("position_covariance_type")?;
        reader.finish()?;
        Ok(Self {
            stamp,
            status,
            latitude_deg,
            longitude_deg,
            altitude_m,
            covariance_m2,
            covariance_type,
        })
    }

    /// The message in CDR, of a receiver of GPS.
    #[must_use]
    pub fn encode(&self, frame_id: &str) -> Vec<u8> {
        let mut writer = CdrWriter::with_capacity(160);
        let stamp = self.stamp;
        Header { stamp, frame_id }.write(&mut writer);
        writer.u8(self.status.cast_unsigned());
        writer.u16(1);
        writer.f64s(&[self.latitude_deg, self.longitude_deg, self.altitude_m]);
        writer.f64s(&self.covariance_m2);
        writer.u8(self.covariance_type);
        writer.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `rosbags` 0.11 writes it (`Typestore.serialize_cdr`), frame `gps`.
    const OF_ROSBAGS: &str = "00010000050000000700000004000000677073000000010000000000cdcccccccc144e4033333333333338400000000000002840000000000000f03f0000000000000000000000000000000000000000000000000000000000000040000000000000000000000000000000000000000000000000000000000000104002";

    #[test]
    fn what_others_write_is_read() {
        let bytes: Vec<u8> = (0..OF_ROSBAGS.len() / 2)
            .map(|i| u8::from_str_radix(&OF_ROSBAGS[2 * i..2 * i + 2], 16).unwrap())
            .collect();
        let fix = NavSatFix::decode(&bytes).unwrap();
        assert_eq!(fix.stamp, Timestamp::from_nanos(5_000_000_007));
        let place = [fix.latitude_deg, fix.longitude_deg, fix.altitude_m];
        assert!(
            place
                .iter()
                .zip([60.1625, 24.2, 12.0])
                .all(|(a, b)| (a - b).abs() < 1e-12)
        );
        assert_eq!((fix.status, fix.covariance_type), (0, 2));
        assert!((fix.covariance_m2[4] - 2.0).abs() < 1e-12);
        assert_eq!(fix.encode("gps"), bytes);
        for length in 0..bytes.len() {
            assert!(NavSatFix::decode(&bytes[..length]).is_err(), "{length}");
        }
        let without_fix = NavSatFix { status: -1, ..fix };
        assert_eq!(
            NavSatFix::decode(&without_fix.encode("")).unwrap().status,
            -1
        );
    }
}
