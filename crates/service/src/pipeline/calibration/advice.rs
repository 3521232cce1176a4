//! From estimates to what to set.

use echosplat_mapper::{Calibration, Estimate};
use echosplat_model::glam::{DQuat, DVec3, EulerRot};
use serde::Serialize;

use crate::config::Config;

/// Something is off if it is beyond so many sigmas and of this size.
const TELLING_SIGMAS: f64 = 4.0;
const LEAST_MS: f64 = 5.0;
const LEAST_DEG: f64 = 0.4;
const LEAST_M: f64 = 0.05;
const LEAST_PERCENT: f64 = 0.4;
/// What can be set, degrees and metres a second.
const MOST_DEVIATION_DEG: f64 = 45.0;
const WATER_MPS: std::ops::RangeInclusive<f64> = 1300.0..=1700.0;

/// One thing that is off.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Advice {
    /// Names the condition.
    pub(crate) code: &'static str,
    /// What is off, by how much, and what to set.
    pub(crate) sentence: String,
}

/// What was configured.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Settings {
    time_offset_s: f64,
    vehicle_from_sensor: DQuat,
    translation_m: DVec3,
    compass_deviation_deg: [f64; 2],
    speed_of_sound_mps: f64,
}

impl Settings {
    pub(crate) fn of(config: &Config) -> Self {
        let mount = config.pose.vehicle_from_sensor.pose();
        Self {
            time_offset_s: config.pose.time_offset_s,
            vehicle_from_sensor: mount.rotation,
            translation_m: mount.translation_m,
            compass_deviation_deg: config.pose.compass_deviation_deg,
            speed_of_sound_mps: config.session.speed_of_sound_mps,
        }
    }

    pub(crate) fn advice(&self, found: &Calibration) -> Vec<Advice> {
        let all = [
            self.clock(found),
            self.mount(found),
            self.lever(found),
            self.compass(found),
            self.sound(found),
        ];
        all.into_iter().flatten().collect()
    }

    fn clock(&self, found: &Calibration) -> Option<Advice> {
        let Estimate { value, sigma, .. } = telling(found.time_offset_ms, LEAST_MS)?;
        let side = if value > 0.0 { "late" } else { "early" };
        let set_s = self.time_offset_s + 1e-3 * value;
        Some(Advice {
            code: "pose-clock",
            sentence: format!(
                "poses are {side} by {:.0} ± {sigma:.0} ms: set pose.time_offset_s = {set_s:.3}",
                value.abs()
            ),
        })
    }

    fn mount(&self, found: &Calibration) -> Option<Advice> {
        let angles = [
            ("yaw", found.mount_yaw_deg),
            ("pitch", found.mount_pitch_deg),
            ("roll", found.mount_roll_deg),
        ];
        let off = angles.map(|(name, angle)| telling(angle, LEAST_DEG).map(|angle| (name, angle)));
        let told = off.iter().flatten();
        let told = told.map(|(name, a)| format!("{:+.1} ± {:.1}° in {name}", a.value, a.sigma));
        let told: Vec<String> = told.collect();
        if told.is_empty() {
            return None;
        }
        let [yaw, pitch, roll] = off.map(|angle| angle.map_or(0.0, |(_, a)| a.value.to_radians()));
        let turn = DQuat::from_scaled_axis(DVec3::new(roll, pitch, yaw));
        Some(Advice {
            code: "pose-mount",
            sentence: format!(
                "the sonar is turned against its mount by {}: {}",
                told.join(" and "),
                set_mount(self.vehicle_from_sensor * turn)
            ),
        })
    }

    fn lever(&self, found: &Calibration) -> Option<Advice> {
        let sides = [("left", found.lever_left_m), ("up", found.lever_up_m)];
        let off = sides.map(|(name, side)| telling(side, LEAST_M).map(|side| (name, side)));
        let told = off.iter().flatten();
        let told = told.map(|(name, m)| format!("{:+.2} ± {:.2} m {name}", m.value, m.sigma));
        let told: Vec<String> = told.collect();
        if told.is_empty() {
            return None;
        }
        let [left, up] = off.map(|side| side.map_or(0.0, |(_, m)| m.value));
        let place_m = self.translation_m + self.vehicle_from_sensor * DVec3::new(0.0, left, up);
        Some(Advice {
            code: "pose-lever",
            sentence: format!(
                "the sonar sits {} of its mount: set pose.vehicle_from_sensor.translation_m \
                 = [{:.2}, {:.2}, {:.2}]",
                told.join(" and "),
                place_m.x,
                place_m.y,
                place_m.z
            ),
        })
    }

    fn compass(&self, found: &Calibration) -> Option<Advice> {
        let (sine, cosine) = (found.compass_sine_deg, found.compass_cosine_deg);
        let most_deg = sine.value.hypot(cosine.value);
        let sigma_deg = sine.sigma.max(cosine.sigma);
        let is_off = sine.is_believed && most_deg > (TELLING_SIGMAS * sigma_deg).max(LEAST_DEG);
        if !is_off {
            return None;
        }
        // From the sonar's heading to the vehicle's, and from turns to the left by the angle from the world's x to turns
        // to the right by the angle from its y.
        let ahead = self.vehicle_from_sensor * DVec3::X;
        let (across, along) = ahead.y.atan2(ahead.x).sin_cos();
        let b_deg = -(sine.value * across + cosine.value * along);
        let c_deg = -(sine.value * along - cosine.value * across);
        let [set_b_deg, set_c_deg] = self.compass_deviation_deg;
        let (set_b_deg, set_c_deg) = (set_b_deg + b_deg + 0.0, set_c_deg + c_deg + 0.0);
        let can_be_set = set_b_deg.abs().max(set_c_deg.abs()) <= MOST_DEVIATION_DEG;
        let advice = match can_be_set {
            true => format!("set pose.compass_deviation_deg = [{set_b_deg:.1}, {set_c_deg:.1}]"),
            false => "that is more than can be set; compensate the compass itself".to_owned(),
        };
        Some(Advice {
            code: "pose-compass",
            sentence: format!(
                "the compass deviates by up to {most_deg:.1} ± {sigma_deg:.1}°: {advice}"
            ),
        })
    }

    fn sound(&self, found: &Calibration) -> Option<Advice> {
        let Estimate { value, sigma, .. } = telling(found.sound_speed_percent, LEAST_PERCENT)?;
        let side = if value > 0.0 { "faster" } else { "slower" };
        let set_mps = self.speed_of_sound_mps * (1.0 + 0.01 * value);
        let advice = match WATER_MPS.contains(&set_mps.round()) {
            true => format!("set session.speed_of_sound_mps = {set_mps:.0}"),
            false => format!(
                "no water has {set_mps:.0} m/s, so ranges are wrong for another reason; look how the sonar is set up"
            ),
        };
        Some(Advice {
            code: "sound-speed",
            sentence: format!(
                "sound is {:.1} ± {sigma:.1} % {side} than ranges were worked out with: {advice}",
                value.abs()
            ),
        })
    }
}

/// What to set for a sonar that is turned like this.
pub(crate) fn set_mount(vehicle_from_sensor: DQuat) -> String {
    let (yaw, pitch, roll) = vehicle_from_sensor.to_euler(EulerRot::ZYX);
    // In tenths of a degree; a zero is added since there is one below zero too.
    let shown = |angle: f64| (10.0 * angle.to_degrees()).round() / 10.0 + 0.0;
    let [yaw, pitch, roll] = [yaw, pitch, roll].map(shown);
    format!("set pose.vehicle_from_sensor.yaw_pitch_roll_deg = [{yaw:.1}, {pitch:.1}, {roll:.1}]")
}

fn telling(estimate: Estimate, least: f64) -> Option<Estimate> {
    let Estimate {
        value,
        sigma,
        is_believed,
    } = estimate;
    let is_off = is_believed && value.abs() > TELLING_SIGMAS * sigma && value.abs() > least;
    is_off.then_some(estimate)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nothing() -> Calibration {
        let zero = Estimate {
            value: 0.0,
            sigma: 0.1,
            is_believed: true,
        };
        Calibration {
            time_offset_ms: zero,
            mount_roll_deg: zero,
            mount_pitch_deg: zero,
            mount_yaw_deg: zero,
            lever_left_m: zero,
            lever_up_m: zero,
            sound_speed_percent: zero,
            compass_sine_deg: zero,
            compass_cosine_deg: zero,
            landmarks: 100,
            observations: 1000,
        }
    }

    fn said(config: &Config, found: &Calibration) -> Vec<String> {
        let advice = Settings::of(config).advice(found);
        advice.into_iter().map(|advice| advice.sentence).collect()
    }

    #[test]
    fn what_is_off_comes_with_what_to_set_on_top_of_what_was_set() {
        let mut config = Config::default();
        config.pose.time_offset_s = 0.1;
        config.pose.vehicle_from_sensor.yaw_pitch_roll_deg = [90.0, 0.0, 0.0];
        config.session.speed_of_sound_mps = 1480.0;
        let is = |value: f64, sigma: f64| Estimate {
            value,
            sigma,
            is_believed: true,
        };
        let found = Calibration {
            time_offset_ms: is(31.0, 3.0),
            mount_yaw_deg: is(-2.0, 0.2),
            lever_left_m: is(0.2, 0.01),
            sound_speed_percent: is(1.5, 0.2),
            compass_sine_deg: is(-2.0, 0.2),
            compass_cosine_deg: is(1.0, 0.2),
            ..nothing()
        };
        assert_eq!(
            said(&config, &found),
            [
                "poses are late by 31 ± 3 ms: set pose.time_offset_s = 0.131",
                "the sonar is turned against its mount by -2.0 ± 0.2° in yaw: set \
                 pose.vehicle_from_sensor.yaw_pitch_roll_deg = [88.0, 0.0, 0.0]",
                "the sonar sits +0.20 ± 0.01 m left of its mount: set \
                 pose.vehicle_from_sensor.translation_m = [-0.20, 0.00, 0.00]",
                "the compass deviates by up to 2.2 ± 0.2°: set pose.compass_deviation_deg = [2.0, 1.0]",
                "sound is 1.5 ± 0.2 % faster than ranges were worked out with: set \
                 session.speed_of_sound_mps = 1502",
            ]
        );
    }

    #[test]
    fn what_is_small_or_unsure_or_not_believed_is_not_told() {
        let late = |value: f64, sigma: f64, is_believed: bool| Calibration {
            time_offset_ms: Estimate {
                value,
                sigma,
                is_believed,
            },
            ..nothing()
        };
        let config = Config::default();
        assert_eq!(said(&config, &late(30.0, 1.0, true)).len(), 1);
        for found in [
            late(4.0, 0.1, true),
            late(30.0, 10.0, true),
            late(30.0, 1.0, false),
        ] {
            assert!(said(&config, &found).is_empty(), "{found:?}");
        }
    }

    #[test]
    fn whatever_is_advised_can_be_set() {
        use crate::advised::{advised, configured};
        let is = |value: f64| Estimate {
            value,
            sigma: 1e-3,
            is_believed: true,
        };
        let mut set = 0;
        for step in [-9.7, -3.1, -1.0, -0.51, 0.51, 1.0, 3.1, 9.7, 60.0] {
            let mut config = Config::default();
            config.pose.time_offset_s = -1.795e9;
            config.pose.compass_deviation_deg = [20.0, -44.0];
            config.pose.vehicle_from_sensor.yaw_pitch_roll_deg = [179.0, -89.0, 33.0];
            config.session.speed_of_sound_mps = 1540.0;
            let found = Calibration {
                time_offset_ms: is(100.0 * step),
                mount_yaw_deg: is(step),
                mount_pitch_deg: is(-step),
                mount_roll_deg: is(0.7 * step),
                lever_left_m: is(0.3 * step),
                lever_up_m: is(-0.2 * step),
                sound_speed_percent: is(step),
                compass_sine_deg: is(step),
                compass_cosine_deg: is(step),
                ..nothing()
            };
            for sentence in said(&config, &found) {
                let (_, settings) = advised(&sentence);
                assert_eq!(
                    settings.len(),
                    sentence.matches("set pose.").count()
                        + sentence.matches("set session.").count()
                );
                configured(&settings);
                set += settings.len();
            }
        }
        assert!(set > 30, "{set}");
    }
}
