//! `tf2_msgs/msg/TFMessage`: where frames lie in others.

use echosplat_model::Pose;

use crate::{CdrWriter, Header};

/// `geometry_msgs/msg/TransformStamped`.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform<'a> {
    /// Time of validity, and the outer frame.
    pub header: Header<'a>,
    /// The inner frame.
    pub child_frame_id: &'a str,
    /// The inner frame in the outer one, metres.
    pub outer_from_child: Pose,
}

/// The message of these transforms.
#[must_use]
pub fn encode(transforms: &[Transform<'_>]) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(16 + 256 * transforms.len());
    writer.count(transforms.len());
    for transform in transforms {
        transform.header.write(&mut writer);
        writer.string(transform.child_frame_id);
        writer.f64s(&transform.outer_from_child.translation_m.to_array());
        writer.f64s(&transform.outer_from_child.rotation.to_array());
    }
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CdrError, CdrReader};
    use echosplat_model::Timestamp;
    use glam::{DQuat, DVec3};

    #[test]
    fn each_transform_is_aligned_behind_the_one_before() -> Result<(), CdrError> {
        let transform = |frame_id, child_frame_id, x| Transform {
            header: Header {
                stamp: Timestamp::from_nanos(1_500_000_000),
                frame_id,
            },
            child_frame_id,
            outer_from_child: Pose {
                rotation: DQuat::from_xyzw(0.5, -0.5, 0.5, 0.5),
                translation_m: DVec3::new(x, 2.0, 3.0),
            },
        };
        let bytes = encode(&[transform("map", "base_link", 1.0), transform("a", "b", 9.0)]);
        let mut reader = CdrReader::new(&bytes)?;
        assert_eq!(reader.u32("count")?, 2);
        for (frame_id, child, x) in [("map", "base_link", 1.0), ("a", "b", 9.0)] {
            let header = Header::read(&mut reader)?;
            assert_eq!(
                (header.stamp.nanos(), header.frame_id),
                (1_500_000_000, frame_id)
            );
            assert_eq!(reader.string("child", 255)?, child);
            assert_eq!(reader.f64s("translation"), Ok([x, 2.0, 3.0]));
            assert_eq!(reader.f64s("rotation"), Ok([0.5, -0.5, 0.5, 0.5]));
        }
        reader.finish()
    }
}
