//! One line of the DVL.

use echosplat_model::glam::DVec3;
use serde::Deserialize;

/// A report that poses are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Report {
    /// `position_local`.
    Position {
        /// Seconds, Unix or since the DVL was switched on.
        stamp_s: f64,
        /// x forward, y right, z down at the last reset.
        position_m: DVec3,
        /// About x, then y, then z.
        roll_pitch_yaw_deg: DVec3,
        /// 0 without any trouble.
        status: i64,
    },
    /// `velocity`.
    Velocity {
        /// Of the echo, microseconds.
        valid_us: i64,
        /// Of sending, on the same clock.
        sent_us: i64,
        /// In the DVL's frame: forward, right, down.
        velocity_mps: DVec3,
        /// It sees the bottom.
        is_valid: bool,
    },
}

#[derive(Deserialize)]
struct Position {
    ts: f64,
    x: f64,
    y: f64,
    z: f64,
    roll: f64,
    pitch: f64,
    yaw: f64,
    #[serde(default)]
    status: i64,
}

#[derive(Deserialize)]
struct Velocity {
    vx: f64,
    vy: f64,
    vz: f64,
    velocity_valid: bool,
    /// Left out by `json_v2`: then the velocity is of no use between positions.
    time_of_validity: Option<i64>,
    time_of_transmission: Option<i64>,
}

impl Report {
    /// `Ok(None)` for answers to commands and for reports that came later than this program.
    ///
    /// # Errors
    /// What is wrong with the line.
    pub(super) fn parse(line: &[u8]) -> Result<Option<Self>, String> {
        #[derive(Deserialize)]
        struct Kind {
            r#type: String,
        }
        let no_json = |error| format!("line of the DVL is no report: {error}");
        let kind: Kind = serde_json::from_slice(line).map_err(no_json)?;
        match kind.r#type.as_str() {
            "position_local" => {
                let wrong = |error| format!("position_local: {error}");
                let position = serde_json::from_slice(line).map_err(wrong)?;
                Ok(Some(Self::of_position(&position)))
            }
            "velocity" => {
                let wrong = |error| format!("velocity: {error}");
                let velocity = serde_json::from_slice(line).map_err(wrong)?;
                Ok(Self::of_velocity(&velocity))
            }
            _ => Ok(None),
        }
    }

    fn of_position(p: &Position) -> Self {
        Self::Position {
            stamp_s: p.ts,
            position_m: DVec3::new(p.x, p.y, p.z),
            roll_pitch_yaw_deg: DVec3::new(p.roll, p.pitch, p.yaw),
            status: p.status,
        }
    }

    fn of_velocity(v: &Velocity) -> Option<Self> {
        let valid_us = v.time_of_validity?;
        Some(Self::Velocity {
            valid_us,
            sent_us: v.time_of_transmission.unwrap_or(valid_us),
            velocity_mps: DVec3::new(v.vx, v.vy, v.vz),
            is_valid: v.velocity_valid,
        })
    }
}
