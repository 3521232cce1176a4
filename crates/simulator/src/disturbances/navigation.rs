//! Reported poses that are late, of a vehicle that carries its sonar otherwise than configured.

use std::f64::consts::FRAC_PI_2;

use echosplat_model::Pose;
use glam::{DQuat, DVec3};

/// Steps from the true heading to the told one; each leaves at most eight tenths of the error.
const TOLD_STEPS: usize = 40;

/// What is systematically wrong with the reported poses, beside the noise of the dive's level.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NavigationError {
    /// How much later than they held poses are stamped, seconds, −1 to 1: what filters, links and stamps at
    /// arrival cost.
    pub latency_s: f64,
    /// How the sonar is truly turned in its mount where `vehicle_from_sensor` is the identity: yaw, then
    /// pitch, then roll, degrees, −45 to 45 each. Positive looks to the left.
    pub mount_yaw_deg: f64,
    /// Positive lowers the nose.
    pub mount_pitch_deg: f64,
    /// Positive lifts the left side.
    pub mount_roll_deg: f64,
    /// How much the true heading is further clockwise than the told one, by the sine of the told one, degrees, −30 to 30:
    /// coefficient B of the compass's deviation.
    pub compass_b_deg: f64,
    /// The same, by the cosine: coefficient C.
    pub compass_c_deg: f64,
}

impl NavigationError {
    /// When the pose held that is stamped `time_s`, seconds.
    pub(crate) fn held_at_s(&self, time_s: f64) -> f64 {
        time_s - self.latency_s
    }

    /// Of the sensor's pose that of the vehicle which carries it.
    pub(crate) fn world_from_vehicle(&self, world_from_sensor: &Pose) -> Pose {
        let degrees = [
            self.mount_yaw_deg,
            self.mount_pitch_deg,
            self.mount_roll_deg,
        ];
        let is_set = |angle: &f64| angle.abs() > 0.0;
        if !degrees.iter().any(is_set) {
            return self.by_compass(world_from_sensor);
        }
        let [yaw, pitch, roll] = degrees.map(f64::to_radians);
        let vehicle_from_sensor = Pose::from_yaw_pitch_roll(yaw, pitch, roll, DVec3::ZERO);
        self.by_compass(&(*world_from_sensor * vehicle_from_sensor.inverse()))
    }

    /// With the heading that the compass tells.
    fn by_compass(&self, world_from_vehicle: &Pose) -> Pose {
        let Self {
            compass_b_deg,
            compass_c_deg,
            ..
        } = *self;
        if !(compass_b_deg.abs() > 0.0 || compass_c_deg.abs() > 0.0) {
            return *world_from_vehicle;
        }
        let ahead = world_from_vehicle.rotation * DVec3::X;
        let heading_rad = FRAC_PI_2 - ahead.y.atan2(ahead.x);
        let mut told_rad = heading_rad;
        for _ in 0..TOLD_STEPS {
            let (sine, cosine) = told_rad.sin_cos();
            told_rad = heading_rad - (compass_b_deg * sine + compass_c_deg * cosine).to_radians();
        }
        Pose {
            rotation: DQuat::from_rotation_z(heading_rad - told_rad) * world_from_vehicle.rotation,
            ..*world_from_vehicle
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_vehicle_with_its_true_mount_carries_the_sensor_where_it_is() {
        let error = NavigationError {
            latency_s: 0.03,
            mount_yaw_deg: 2.0,
            mount_pitch_deg: -1.0,
            mount_roll_deg: 3.0,
            ..NavigationError::default()
        };
        let sensor = Pose::from_yaw_pitch_roll(1.0, 0.2, -0.3, DVec3::new(1.0, 2.0, 3.0));
        let mount = Pose::from_yaw_pitch_roll(
            2f64.to_radians(),
            (-1f64).to_radians(),
            3f64.to_radians(),
            DVec3::ZERO,
        );
        let back = error.world_from_vehicle(&sensor) * mount;
        assert!(back.rotation.angle_between(sensor.rotation) < 1e-7);
        assert!(back.translation_m.distance(sensor.translation_m) < 1e-12);
        assert!((error.held_at_s(5.0) - 4.97).abs() < 1e-12);
        let east = Pose::from_yaw_pitch_roll(0.0, 0.0, 0.2, DVec3::ONE);
        let deviating = NavigationError {
            compass_b_deg: 5.0,
            ..NavigationError::default()
        };
        let told = deviating.world_from_vehicle(&east);
        // Told 5° short of east but for what the sine falls short there.
        let ahead = told.rotation * DVec3::X;
        let told_deg = ahead.x.atan2(ahead.y).to_degrees();
        assert!((told_deg + 5.0 * told_deg.to_radians().sin() - 90.0).abs() < 1e-6);
        assert!((told_deg - 85.0).abs() < 0.1 && told.translation_m == east.translation_m);
        let none = NavigationError::default();
        assert_eq!(none.world_from_vehicle(&sensor), sensor);
        assert_eq!(none.held_at_s(5.0).to_bits(), 5f64.to_bits());
    }
}
