//! A pose as JSON: the fields of the pose message on the bus, and what else a pose carries.

use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Pose, PoseUncertainty, StampedPose, Timestamp};
use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
struct PoseRecord {
    stamp_ns: i64,
    #[serde(default)]
    frame_id: String,
    #[serde(default)]
    child_frame_id: String,
    position: [f64; 3],
    orientation_xyzw: [f64; 4],
    #[serde(default)]
    uncertainty: Option<PoseUncertainty>,
    #[serde(default)]
    epoch: u32,
}

pub(super) fn to_json(pose: &StampedPose) -> Vec<u8> {
    let record = PoseRecord {
        stamp_ns: pose.time.nanos(),
        frame_id: "world".into(),
        child_frame_id: "vehicle".into(),
        position: pose.world_from_vehicle.translation_m.to_array(),
        orientation_xyzw: pose.world_from_vehicle.rotation.to_array(),
        uncertainty: pose.uncertainty,
        epoch: pose.epoch,
    };
    // Numbers and strings only: nothing here can fail to become JSON.
    serde_json::to_vec(&record).unwrap_or_default()
}

/// `None` for what is no pose; not finite numbers are `null` in JSON and so refused.
pub(super) fn of_json(bytes: &[u8]) -> Option<StampedPose> {
    let record: PoseRecord = serde_json::from_slice(bytes).ok()?;
    let rotation = DQuat::from_array(record.orientation_xyzw);
    let pose = Pose {
        rotation,
        translation_m: DVec3::from_array(record.position),
    };
    let has_length = rotation.length() > 1e-6;
    (has_length && pose.is_finite()).then_some(StampedPose {
        time: Timestamp::from_nanos(record.stamp_ns),
        world_from_vehicle: pose,
        uncertainty: record.uncertainty,
        epoch: record.epoch,
    })
}
