//! What is looked for.

use echosplat_model::Pose;
use glam::DVec3;

/// How poses are taken to belong to pings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setting {
    /// Added to the pings' times before poses are looked up.
    pub time_offset_s: f64,
    /// The mount's yaw about up, then pitch about left, then roll about forward.
    pub yaw_pitch_roll_deg: [f64; 3],
    /// The sensor's place on the vehicle: forward, left, up.
    pub translation_m: DVec3,
}

/// One number of a [`Setting`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Seconds.
    TimeOffset,
    /// Degrees about up.
    Yaw,
    /// Degrees about left.
    Pitch,
    /// Degrees about forward.
    Roll,
}

impl Quantity {
    /// From one value that is tried first to the next: within the first level's peak are at least two.
    pub(super) fn step(self) -> f64 {
        match self {
            Self::TimeOffset => 0.25,
            Self::Yaw | Self::Pitch | Self::Roll => 4.0,
        }
    }

    /// Steps either way: a minute between opening a log and the first ping, and a mount that was written down
    /// without its tilt of up to a third of a right angle.
    pub(super) fn steps(self) -> i32 {
        match self {
            Self::TimeOffset => 240,
            Self::Yaw | Self::Pitch | Self::Roll => 9,
        }
    }

    /// Maxima further apart than this are not the same one.
    pub(super) fn apart(self) -> f64 {
        2.0 * self.step()
    }
}

impl Setting {
    /// With one number of it so much larger.
    #[must_use]
    pub fn shifted(mut self, quantity: Quantity, shift: f64) -> Self {
        match quantity {
            Quantity::TimeOffset => self.time_offset_s += shift,
            Quantity::Yaw => self.yaw_pitch_roll_deg[0] += shift,
            Quantity::Pitch => self.yaw_pitch_roll_deg[1] += shift,
            Quantity::Roll => self.yaw_pitch_roll_deg[2] += shift,
        }
        self
    }

    /// `vehicle_from_sensor`.
    pub(super) fn mount(&self) -> Pose {
        let [yaw, pitch, roll] = self.yaw_pitch_roll_deg.map(f64::to_radians);
        Pose::from_yaw_pitch_roll(yaw, pitch, roll, self.translation_m)
    }
}
