//! Headings freed from the deviation of the vehicle's compass.

use std::f64::consts::FRAC_PI_2;

use echosplat_model::Pose;
use echosplat_model::glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// What the vehicle's own iron and currents do to its compass: the coefficients B and C of a deviation card, degrees. The true
/// heading is the told one, `h`, and `B sin h + C cos h` more, clockwise from the world's y axis, which is north in ENU.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct CompassDeviation {
    /// What is added to a heading of east, degrees.
    pub b_deg: f64,
    /// What is added to a heading of north, degrees.
    pub c_deg: f64,
}

impl CompassDeviation {
    /// How much the true heading is further clockwise than the told one, radians.
    #[must_use]
    pub fn at_rad(&self, heading_rad: f64) -> f64 {
        let (sine, cosine) = heading_rad.sin_cos();
        (self.b_deg * sine + self.c_deg * cosine).to_radians()
    }

    /// The pose with its true heading, where it is.
    #[must_use]
    pub fn corrected(&self, world_from_vehicle: &Pose) -> Pose {
        let ahead = world_from_vehicle.rotation * DVec3::X;
        let heading_rad = FRAC_PI_2 - ahead.y.atan2(ahead.x);
        let turn = DQuat::from_rotation_z(-self.at_rad(heading_rad));
        Pose {
            rotation: turn * world_from_vehicle.rotation,
            ..*world_from_vehicle
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_card_turns_each_heading_by_what_it_says_of_it() {
        let card = CompassDeviation {
            b_deg: 3.0,
            c_deg: -2.0,
        };
        for (told_deg, true_deg) in [(0.0, -2.0), (90.0, 93.0), (180.0, 182.0), (270.0, 267.0)] {
            let yaw_rad = |heading_deg: f64| (90.0 - heading_deg).to_radians();
            let at_m = DVec3::new(1.0, 2.0, -3.0);
            let told = Pose::from_yaw_pitch_roll(yaw_rad(told_deg), 0.1, -0.4, at_m);
            let expected = Pose::from_yaw_pitch_roll(yaw_rad(true_deg), 0.1, -0.4, at_m);
            let found = card.corrected(&told);
            let apart = (found.rotation * expected.rotation.conjugate()).xyz();
            assert!(apart.length() < 1e-9, "{told_deg}");
            assert_eq!(found.translation_m, at_m);
        }
    }
}
