//! The ways in which poses and mounts are usually misread, and what each would mean.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

use echosplat_model::{Pose, enu_from_ned};
use glam::DQuat;
use serde::Serialize;

/// Degrees, found.
/// By less than half of it maps are hardly false, and the calibration tells.
const TILT_DEG: i32 = 20;

/// One thing that may be wrong with how poses are read.
///
/// The fan is the same when it is rolled by half a turn, so `NedFrd` is told only by a mount that such
/// a roll changes, and a roll by −90° is that by 90°.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind", content = "deg")]
pub enum FrameReading {
    /// Nothing: ENU and forward-left-up, xyzw, `world_from_vehicle`, the mount as configured.
    AsGiven,
    /// Position and attitude are north-east-down and forward-right-down.
    NedFrd,
    /// Only the position is north-east-down.
    NedPosition,
    /// Only the attitude is that of forward-right-down in north-east-down.
    NedAttitude,
    /// The quaternion comes as wxyz.
    QuaternionWFirst,
    /// The rotation is `vehicle_from_world`.
    InverseRotation,
    /// Rotation and translation are `vehicle_from_world`.
    InversePose,
    /// The unit is turned further about the vehicle's z axis, degrees.
    MountYaw(i32),
    /// The unit is turned further about its own y axis, degrees; positive looks down.
    MountPitch(i32),
    /// The unit is turned further about the direction it looks in, degrees.
    MountRoll(i32),
}

impl FrameReading {
    /// All that are compared, as given first.
    pub const ALL: [Self; 13] = [
        Self::AsGiven,
        Self::NedFrd,
        Self::NedPosition,
        Self::NedAttitude,
        Self::QuaternionWFirst,
        Self::InverseRotation,
        Self::InversePose,
        Self::MountYaw(90),
        Self::MountYaw(-90),
        Self::MountYaw(180),
        Self::MountPitch(90),
        Self::MountPitch(-90),
        Self::MountRoll(90),
    ];

    /// Tilts of the mount that are compared, as given first: what lies between them and twice as far agrees better with
    /// one of them than as given.
    pub const TILTS: [Self; 7] = [
        Self::AsGiven,
        Self::MountYaw(TILT_DEG),
        Self::MountYaw(-TILT_DEG),
        Self::MountPitch(TILT_DEG),
        Self::MountPitch(-TILT_DEG),
        Self::MountRoll(TILT_DEG),
        Self::MountRoll(-TILT_DEG),
    ];

    /// Whether it is one of those.
    #[must_use]
    pub fn is_tilt(&self) -> bool {
        matches!(self, Self::MountYaw(deg) | Self::MountPitch(deg) | Self::MountRoll(deg) if deg.abs() == TILT_DEG)
    }

    /// `world_from_sensor` if this is what is wrong with a pose as it was read and the mount as it is
    /// configured.
    #[must_use]
    pub fn apply(&self, world_from_vehicle: &Pose, vehicle_from_sensor: &Pose) -> Pose {
        self.vehicle(world_from_vehicle) * self.mount(vehicle_from_sensor)
    }

    fn vehicle(&self, read: &Pose) -> Pose {
        let position_enu = enu_from_ned(read.translation_m);
        let rotation_enu = enu_from_ned_rotation() * read.rotation * flu_from_frd_rotation();
        let (rotation, translation_m) = match self {
            Self::NedFrd => (rotation_enu, position_enu),
            Self::NedPosition => (read.rotation, position_enu),
            Self::NedAttitude => (rotation_enu, read.translation_m),
            Self::QuaternionWFirst => (w_first(read.rotation), read.translation_m),
            Self::InverseRotation => (read.rotation.conjugate(), read.translation_m),
            Self::InversePose => return read.inverse(),
            Self::AsGiven | Self::MountYaw(_) | Self::MountPitch(_) | Self::MountRoll(_) => {
                return *read;
            }
        };
        Pose {
            rotation,
            translation_m,
        }
    }

    fn mount(&self, configured: &Pose) -> Pose {
        let rotation = configured.rotation;
        let radians = |degrees: i32| f64::from(degrees).to_radians();
        let rotation = match *self {
            Self::MountYaw(degrees) => DQuat::from_rotation_z(radians(degrees)) * rotation,
            Self::MountPitch(degrees) => rotation * DQuat::from_rotation_y(radians(degrees)),
            Self::MountRoll(degrees) => rotation * DQuat::from_rotation_x(radians(degrees)),
            _ => rotation,
        };
        Pose {
            rotation,
            ..*configured
        }
    }

    /// How the sonar is turned on the vehicle if this is what is wrong with the mount as configured; `None` if it is the
    /// poses, or by how much has to be found yet.
    #[must_use]
    pub fn mount_instead(&self, vehicle_from_sensor: &Pose) -> Option<DQuat> {
        let is_mount = matches!(
            self,
            Self::MountYaw(_) | Self::MountPitch(_) | Self::MountRoll(_)
        );
        (is_mount && !self.is_tilt()).then(|| self.mount(vehicle_from_sensor).rotation)
    }

    /// What poses look like and what to send instead, or how the sonar looks ([`Self::mount_instead`] says what to set).
    #[must_use]
    pub fn sentence(&self) -> &'static str {
        match self {
            Self::AsGiven => "poses and mount fit what the sonar hears",
            Self::MountYaw(TILT_DEG) => {
                "the sonar looks some 20° to the left of where its mount says: `echosplat calibrate` of the log finds by \
                 how much; set the yaw in pose.vehicle_from_sensor.yaw_pitch_roll_deg"
            }
            Self::MountYaw(deg) if *deg == -TILT_DEG => {
                "the sonar looks some 20° to the right of where its mount says: `echosplat calibrate` of the log finds by \
                 how much; set the yaw in pose.vehicle_from_sensor.yaw_pitch_roll_deg"
            }
            Self::MountPitch(TILT_DEG) => {
                "the sonar looks some 20° down from where its mount says: `echosplat calibrate` of the log finds by how \
                 much; set the pitch in pose.vehicle_from_sensor.yaw_pitch_roll_deg"
            }
            Self::MountPitch(deg) if *deg == -TILT_DEG => {
                "the sonar looks some 20° up from where its mount says: `echosplat calibrate` of the log finds by how \
                 much; set the pitch in pose.vehicle_from_sensor.yaw_pitch_roll_deg"
            }
            Self::MountRoll(deg) if deg.abs() == TILT_DEG => {
                "the sonar is rolled by some 20° against its mount: `echosplat calibrate` of the log finds by how much; \
                 set the roll in pose.vehicle_from_sensor.yaw_pitch_roll_deg"
            }
            Self::NedFrd => {
                "poses look like NED/FRD: send ENU with the body forward-left-up, or use a source \
                 that converts (mavlink)"
            }
            // With a mount that looks ahead the two are one: turn either, and they belong together.
            Self::NedPosition | Self::NedAttitude => {
                "position and attitude do not belong together, as if one were NED/FRD and the other \
                 ENU: send both as ENU, with the body forward-left-up"
            }
            Self::QuaternionWFirst => {
                "the quaternion looks like w x y z: send x y z w, the real part last"
            }
            Self::InverseRotation => {
                "the rotation looks like vehicle_from_world: send its inverse, world_from_vehicle \
                 (negate x, y and z of the quaternion)"
            }
            Self::InversePose => {
                "poses look like vehicle_from_world: send their inverse, where the vehicle is in \
                 the world"
            }
            Self::MountYaw(degrees) if *degrees == 180 => "the sonar looks the other way",
            Self::MountYaw(degrees) if *degrees < 0 => {
                "the sonar looks to the right of where it is said to"
            }
            Self::MountYaw(_) => "the sonar looks to the left of where it is said to",
            Self::MountPitch(degrees) if *degrees < 0 => {
                "the sonar looks up from where it is said to"
            }
            Self::MountPitch(_) => "the sonar looks down from where it is said to",
            Self::MountRoll(_) => {
                "the wide axis of the sonar's beam lies across the one it is said to"
            }
        }
    }
}

/// Half a turn about the horizontal halfway between east and north.
fn enu_from_ned_rotation() -> DQuat {
    DQuat::from_xyzw(FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0, 0.0)
}

/// Half a turn about forward; its own inverse.
fn flu_from_frd_rotation() -> DQuat {
    DQuat::from_rotation_x(PI)
}

/// What was sent as wxyz and read as xyzw.
fn w_first(read: DQuat) -> DQuat {
    DQuat::from_xyzw(read.y, read.z, read.w, read.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::flu_from_frd;
    use glam::DVec3;

    fn poses() -> [Pose; 2] {
        let at = DVec3::new(3.0, -2.0, 1.0);
        [
            Pose::from_yaw_pitch_roll(0.7, -0.2, 0.3, at),
            Pose::from_yaw_pitch_roll(-2.9, 0.1, -0.4, -at),
        ]
    }

    fn is_near(a: &Pose, b: &Pose) -> bool {
        let apart = a.inverse() * *b;
        apart.translation_m.length() < 1e-9 && apart.rotation.xyz().length() < 1e-9
    }

    #[test]
    fn ned_becomes_enu_as_its_points_do() {
        for ned_from_frd in poses() {
            let read = FrameReading::NedFrd.apply(&ned_from_frd, &Pose::IDENTITY);
            let point_frd = DVec3::new(0.3, 0.8, -2.0);
            let expected = enu_from_ned(ned_from_frd * point_frd);
            assert!((read * flu_from_frd(point_frd) - expected).length() < 1e-9);
        }
    }

    #[test]
    fn quaternions_and_inverses_are_undone() {
        for pose in poses() {
            let [x, y, z, w] = pose.rotation.to_array();
            let w_first = Pose {
                rotation: DQuat::from_xyzw(w, x, y, z),
                ..pose
            };
            let read = FrameReading::QuaternionWFirst.apply(&w_first, &Pose::IDENTITY);
            assert!(is_near(&read, &pose));
            let read = FrameReading::InversePose.apply(&pose.inverse(), &Pose::IDENTITY);
            assert!(is_near(&read, &pose));
        }
    }

    #[test]
    fn a_mount_is_turned_where_it_sits() {
        let [vehicle, mount] = poses();
        let forward = |reading: FrameReading, mount: &Pose| {
            let sensor = reading.apply(&Pose::IDENTITY, mount);
            assert_eq!(sensor.translation_m, mount.translation_m);
            sensor.rotation * DVec3::X
        };
        let left = forward(FrameReading::MountYaw(90), &Pose::IDENTITY);
        let down = forward(FrameReading::MountPitch(90), &Pose::IDENTITY);
        assert!((left - DVec3::Y).length() < 1e-9 && (down + DVec3::Z).length() < 1e-9);
        let ahead = forward(FrameReading::MountRoll(90), &mount);
        assert!((ahead - mount.rotation * DVec3::X).length() < 1e-9);
        let as_given = FrameReading::AsGiven.apply(&vehicle, &mount);
        assert!(is_near(&as_given, &(vehicle * mount)));
    }

    #[test]
    fn readings_say_what_to_do_each_its_own_but_for_halves_of_ned() {
        let said = FrameReading::ALL.iter().map(FrameReading::sentence);
        let mut said: Vec<&str> = said.collect();
        said.sort_unstable();
        said.dedup();
        assert_eq!(said.len() + 1, FrameReading::ALL.len());
    }
}
