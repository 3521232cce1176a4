//! The few messages that poses need, in the units and names of this program.

use std::fmt;

use echosplat_model::glam::{DQuat, DVec3, EulerRot};
use mavlink::dialects::ardupilotmega::{EkfStatusFlags, MavMessage};

use super::origin::Fix;

/// Who sent a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub(crate) struct Sender {
    pub(crate) system: u32,
    pub(crate) component: u8,
}

impl fmt::Display for Sender {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "system {} component {}", self.system, self.component)
    }
}

/// What somebody says that it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Station {
    /// It steers a vehicle, and knows where that is.
    Autopilot,
    Ground,
    Gimbal,
    Camera,
    Companion,
    /// Any other component.
    Other,
}

/// Types of components that are no vehicle. Some of them run an autopilot's program, as antenna trackers do.
const NO_VEHICLES: [&str; 16] = [
    "MAV_TYPE_ANTENNA_TRACKER",
    "MAV_TYPE_ADSB",
    "MAV_TYPE_CHARGING_STATION",
    "MAV_TYPE_FLARM",
    "MAV_TYPE_SERVO",
    "MAV_TYPE_ODID",
    "MAV_TYPE_BATTERY",
    "MAV_TYPE_PARACHUTE",
    "MAV_TYPE_LOG",
    "MAV_TYPE_OSD",
    "MAV_TYPE_IMU",
    "MAV_TYPE_GPS",
    "MAV_TYPE_WINCH",
    "MAV_TYPE_ILLUMINATOR",
    "MAV_TYPE_GRIPPER",
    "MAV_TYPE_RADIO",
];

impl Station {
    /// By the names of its `MAV_AUTOPILOT` and its `MAV_TYPE`.
    pub(crate) fn of_names(autopilot: &str, kind: &str) -> Self {
        match kind {
            "MAV_TYPE_GCS" => Self::Ground,
            "MAV_TYPE_GIMBAL" => Self::Gimbal,
            "MAV_TYPE_CAMERA" => Self::Camera,
            "MAV_TYPE_ONBOARD_CONTROLLER" => Self::Companion,
            kind if NO_VEHICLES.contains(&kind) => Self::Other,
            _ if autopilot == "MAV_AUTOPILOT_INVALID" => Self::Other,
            _ => Self::Autopilot,
        }
    }

    /// For people.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Autopilot => "autopilot",
            Self::Ground => "ground station",
            Self::Gimbal => "gimbal",
            Self::Camera => "camera",
            Self::Companion => "companion computer",
            Self::Other => "other component",
        }
    }
}

/// One message, as it came; nothing is checked yet.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Message {
    /// `ATTITUDE` (30) or `ATTITUDE_QUATERNION` (31).
    Attitude {
        boot_ms: u32,
        ned_from_frd: DQuat,
        is_quaternion: bool,
    },
    /// `LOCAL_POSITION_NED` (32).
    Position {
        boot_ms: u32,
        position_ned_m: DVec3,
        velocity_ned_mps: DVec3,
    },
    /// `ODOMETRY` (331).
    Odometry(Box<Odometry>),
    /// `TIMESYNC` (111): nanoseconds; `tc1` 0 asks, else it answers.
    TimeSync { tc1: i64, ts1: i64 },
    /// `SYSTEM_TIME` (2).
    SystemTime { unix_us: u64, boot_ms: u32 },
    /// `HEARTBEAT` (0).
    Heartbeat(Station),
    /// `GPS_GLOBAL_ORIGIN` (49).
    GlobalOrigin(Fix),
    /// `GLOBAL_POSITION_INT` (33).
    GlobalPosition {
        boot_ms: u32,
        fix: Fix,
        /// Above home, metres.
        height_m: f64,
        velocity_ned_mps: DVec3,
    },
    /// `VFR_HUD` (74): `alt`, of an `ArduSub` above the surface, metres.
    Height(f64),
    /// `EKF_STATUS_REPORT` (193): whether its level velocity is an estimate, and not held at zero.
    EstimateStatus { has_velocity: bool },
    /// `VISION_POSITION_DELTA` (11011).
    PositionDelta {
        /// Since boot of whoever counts; 0 from the Water Linked extension of `BlueOS`.
        time_us: u64,
        delta_us: u64,
        moved_frd_m: DVec3,
        /// Per cent.
        confidence: f64,
    },
    /// `VISION_SPEED_ESTIMATE` (103).
    Speed { time_us: u64, velocity_mps: DVec3 },
}

/// `ODOMETRY` (331).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Odometry {
    /// Since boot, or Unix: its size tells.
    pub(crate) time_us: u64,
    /// `MAV_FRAME` by number.
    pub(crate) frame: u32,
    /// `MAV_FRAME` by number.
    pub(crate) child_frame: u32,
    pub(crate) position_m: DVec3,
    pub(crate) frame_from_body: DQuat,
    /// Along the child frame's axes.
    pub(crate) velocity_mps: DVec3,
    /// Upper triangle, row by row; NaN first if unknown.
    pub(crate) covariance: [f64; 21],
    pub(crate) reset_counter: u8,
    /// Per cent; −1 if it has failed, 0 if unknown.
    pub(crate) quality: i64,
}

impl Odometry {
    /// Whether it knows how fast it is and not where, which `MAVLink` writes NaN.
    pub(crate) fn lacks_position(&self) -> bool {
        self.position_m.is_nan() && self.velocity_mps.is_finite()
    }
}

/// Yaw about down, then pitch about right, then roll about forward.
pub(crate) fn ned_from_frd(roll_rad: f64, pitch_rad: f64, yaw_rad: f64) -> DQuat {
    DQuat::from_euler(EulerRot::ZYX, yaw_rad, pitch_rad, roll_rad)
}

/// `MAVLink` writes quaternions w, x, y, z.
pub(crate) fn of_wxyz(q: [f64; 4]) -> DQuat {
    DQuat::from_xyzw(q[1], q[2], q[3], q[0])
}

fn vector(x: f32, y: f32, z: f32) -> DVec3 {
    DVec3::new(f64::from(x), f64::from(y), f64::from(z))
}

/// `relative_alt` of `GLOBAL_POSITION_INT`.
pub(crate) fn millimetres(height_mm: i32) -> f64 {
    f64::from(height_mm) * 1e-3
}

/// Velocities of `GLOBAL_POSITION_INT`, centimetres a second.
pub(crate) fn of_cmps(cmps: [f64; 3]) -> DVec3 {
    DVec3::from_array(cmps) * 1e-2
}

/// An estimate that nothing aids is held where it is, and its velocity at zero.
pub(crate) fn has_velocity(flags: EkfStatusFlags) -> bool {
    flags.contains(EkfStatusFlags::EKF_VELOCITY_HORIZ)
        && !flags.contains(EkfStatusFlags::EKF_CONST_POS_MODE)
}

impl Message {
    /// `None` for the hundreds of others.
    pub(crate) fn of_mavlink(message: &MavMessage) -> Option<Self> {
        Some(match message {
            MavMessage::ATTITUDE_QUATERNION(m) => Self::Attitude {
                boot_ms: m.time_boot_ms,
                ned_from_frd: of_wxyz([m.q1, m.q2, m.q3, m.q4].map(f64::from)),
                is_quaternion: true,
            },
            MavMessage::ATTITUDE(m) => Self::Attitude {
                boot_ms: m.time_boot_ms,
                ned_from_frd: ned_from_frd(m.roll.into(), m.pitch.into(), m.yaw.into()),
                is_quaternion: false,
            },
            MavMessage::LOCAL_POSITION_NED(m) => Self::Position {
                boot_ms: m.time_boot_ms,
                position_ned_m: vector(m.x, m.y, m.z),
                velocity_ned_mps: vector(m.vx, m.vy, m.vz),
            },
            MavMessage::ODOMETRY(m) => Self::Odometry(Box::new(Odometry {
                time_us: m.time_usec,
                frame: m.frame_id as u32,
                child_frame: m.child_frame_id as u32,
                position_m: vector(m.x, m.y, m.z),
                frame_from_body: of_wxyz(m.q.map(f64::from)),
                velocity_mps: vector(m.vx, m.vy, m.vz),
                covariance: m.pose_covariance.map(f64::from),
                reset_counter: m.reset_counter,
                quality: m.quality.into(),
            })),
            MavMessage::TIMESYNC(m) => Self::TimeSync {
                tc1: m.tc1,
                ts1: m.ts1,
            },
            MavMessage::SYSTEM_TIME(m) => Self::SystemTime {
                unix_us: m.time_unix_usec,
                boot_ms: m.time_boot_ms,
            },
            MavMessage::HEARTBEAT(m) => Self::Heartbeat(Station::of_names(
                &format!("{:?}", m.autopilot),
                &format!("{:?}", m.mavtype),
            )),
            MavMessage::GPS_GLOBAL_ORIGIN(m) => Self::GlobalOrigin(Fix {
                latitude_e7: m.latitude,
                longitude_e7: m.longitude,
                height_mm: m.altitude,
            }),
            MavMessage::GLOBAL_POSITION_INT(m) => Self::GlobalPosition {
                boot_ms: m.time_boot_ms,
                fix: Fix {
                    latitude_e7: m.lat,
                    longitude_e7: m.lon,
                    height_mm: m.alt,
                },
                height_m: millimetres(m.relative_alt),
                velocity_ned_mps: of_cmps([m.vx, m.vy, m.vz].map(f64::from)),
            },
            MavMessage::VFR_HUD(m) => Self::Height(m.alt.into()),
            MavMessage::EKF_STATUS_REPORT(m) => Self::EstimateStatus {
                has_velocity: has_velocity(m.flags),
            },
            MavMessage::VISION_POSITION_DELTA(m) => Self::PositionDelta {
                time_us: m.time_usec,
                delta_us: m.time_delta_usec,
                moved_frd_m: DVec3::from_array(m.position_delta.map(f64::from)),
                confidence: m.confidence.into(),
            },
            MavMessage::VISION_SPEED_ESTIMATE(m) => Self::Speed {
                time_us: m.usec,
                velocity_mps: vector(m.x, m.y, m.z),
            },
            _ => return None,
        })
    }

    /// Whether it tells a velocity of the vehicle to its autopilot, and so may come from somebody else: a companion computer.
    pub(crate) fn is_aiding(&self) -> bool {
        match self {
            Self::PositionDelta { .. } | Self::Speed { .. } => true,
            Self::Odometry(odometry) => odometry.lacks_position(),
            _ => false,
        }
    }

    /// Whether it says where or how the vehicle is.
    pub(crate) fn is_of_pose(&self) -> bool {
        matches!(
            self,
            Self::Attitude { .. } | Self::Position { .. } | Self::Odometry(_)
        )
    }
}
