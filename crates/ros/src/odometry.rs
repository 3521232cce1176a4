//! `nav_msgs/msg/Odometry` of a pose, and back without the loss of a bit.
//!
//! Covariances are written as they were told, whatever they are. All zeros mean unknown, as ROS has it.
//! The twist is left at zero.

use echosplat_model::{Pose, PoseCovariance, StampedPose, Timestamp};
use glam::{DQuat, DVec3};

use crate::{CdrError, CdrReader, CdrWriter, Header, MAX_FRAME_ID_BYTES};

/// The message of this pose; its epoch has no field there. Times beyond 1901 to 2038 saturate.
#[must_use]
pub fn encode(pose: &StampedPose, frame_id: &str, child_frame_id: &str) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(800);
    let stamp = pose.time;
    Header { stamp, frame_id }.write(&mut writer);
    writer.string(child_frame_id);
    writer.f64s(&pose.world_from_vehicle.translation_m.to_array());
    writer.f64s(&pose.world_from_vehicle.rotation.to_array());
    let covariance = pose.uncertainty.map(|covariance| covariance.rows());
    writer.f64s(&covariance.unwrap_or([0.0; 36]));
    writer.f64s(&[0.0; 6 + 36]); // twist and its covariance
    writer.finish()
}

/// A pose of epoch 0 as the message has it; whether its numbers make sense is the caller's to say.
///
/// # Errors
/// If the bytes are no such message.
pub fn decode(bytes: &[u8]) -> Result<StampedPose, CdrError> {
    let mut reader = CdrReader::new(bytes)?;
    let header = Header::read(&mut reader)?;
    let time: Timestamp = header.stamp;
    reader.string("child_frame_id", MAX_FRAME_ID_BYTES)?;
    let position = reader.f64s("pose.position")?;
    let orientation = reader.f64s("pose.orientation")?;
    let covariance = reader.f64s("pose.covariance")?;
    reader.f64s::<6>("twist.twist")?;
    reader.f64s::<36>("twist.covariance")?;
    reader.finish()?;
    Ok(StampedPose {
        time,
        world_from_vehicle: Pose {
            rotation: DQuat::from_array(orientation),
            translation_m: DVec3::from_array(position),
        },
        uncertainty: PoseCovariance::of_rows(&covariance),
        epoch: 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose(nanos: i64, x: f64, uncertainty: Option<PoseCovariance>) -> StampedPose {
        StampedPose {
            time: Timestamp::from_nanos(nanos),
            world_from_vehicle: Pose {
                rotation: DQuat::from_xyzw(0.1, -0.0, 1.0 / 3.0, 0.9),
                translation_m: DVec3::new(x, f64::MIN_POSITIVE, -1e7 - 0.1),
            },
            uncertainty,
            epoch: 0,
        }
    }

    fn sigma(position_m: f64, attitude_rad: f64) -> Option<PoseCovariance> {
        Some(PoseCovariance::alike(position_m, attitude_rad))
    }

    #[test]
    fn the_message_has_the_length_other_writers_give_it() {
        // Header 4+4+(4+4), child 4+2, padding to 24; 7 + 36 + 6 + 36 numbers; encapsulation.
        let bytes = encode(&pose(5, 1.0, None), "map", "b");
        assert_eq!(bytes.len(), 4 + 24 + 8 * (7 + 36 + 6 + 36));
        assert_eq!(bytes[4 + 24..4 + 32], 1.0_f64.to_le_bytes());
    }

    #[test]
    fn what_is_told_of_some_axes_alone_comes_back() {
        let some = PoseCovariance {
            position_m2: [4e-4, -1e-5, 0.0, 4e-4, 0.0, 1e6],
            attitude_rad2: [f64::INFINITY, -1.0, 1e-5],
        };
        for uncertainty in [None, sigma(0.0, 0.1), sigma(0.3, 0.0), Some(some)] {
            let sent = pose(-1, 0.0, uncertainty);
            assert_eq!(decode(&encode(&sent, "map", "base_link")), Ok(sent));
        }
    }

    #[test]
    fn every_cut_is_refused() {
        let good = encode(&pose(1, 2.0, None), "map", "base_link");
        for end in 0..good.len() {
            assert!(decode(&good[..end]).is_err(), "cut at {end}");
        }
    }

    proptest! {
        #[test]
        fn every_bit_comes_back(
            seconds in -2_000_000_000_i64..2_000_000_000, nanos in 0_i64..1_000_000_000,
            x in any::<f64>().prop_filter("finite", |x| x.is_finite()),
            p in 1e-150_f64..1e150, a in 1e-150_f64..1e150,
        ) {
            let sent = pose(seconds * 1_000_000_000 + nanos, x, sigma(p, a));
            let found = decode(&encode(&sent, "map", "base_link"));
            prop_assert_eq!(found, Ok(sent));
        }

        #[test]
        fn no_bytes_upset_it(bytes in proptest::collection::vec(any::<u8>(), 0..900)) {
            let _ = decode(&bytes);
        }
    }
}
