//! Fish: small scatterers that swim through the dive.

use glam::DVec3;

use super::power;
use crate::random::{Purpose, Random};
use crate::sonar::Listener;

/// How fast they swim: about a body length a second. Chosen.
const SPEED_MPS: f64 = 0.3;
/// How much further than track and structure they swim.
const MARGIN_M: f64 = 0.5;
/// Of what a fish's distance must be short of a surface before it for the fish to be seen.
const TOLERANCE_M: f64 = 0.005;
const NEAREST_M: f64 = 0.2;

/// Fish that swim straight through the box around track and structure, and turn at its walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fish {
    /// How many, whole, 0 to 1000.
    pub count: f64,
    /// Target strength of each, decibels re 1 m², −80 to 0. By default −37 dB: 33 cm long by
    /// TS = 20 log l − 67.4 of fish with a swim bladder (Foote 1987, at 38 kHz); higher frequencies give a
    /// few decibels less.
    pub target_strength_db: f64,
}

impl Default for Fish {
    fn default() -> Self {
        Self {
            count: 0.0,
            target_strength_db: -37.0,
        }
    }
}

impl Fish {
    /// Those of a dive in the box between two corners, world axes.
    pub(crate) fn swimmers(&self, seed: u64, low: DVec3, high: DVec3) -> Vec<Swimmer> {
        let (low, high) = (low - MARGIN_M, high + MARGIN_M);
        let swimmer = |index: u64| {
            let mut random = Random::new(seed, Purpose::Fish, index);
            let share = DVec3::new(random.unit(), random.unit(), random.unit());
            Swimmer {
                low,
                size: high - low,
                start: low + share * (high - low),
                velocity_mps: SPEED_MPS * random.normal3().normalize_or_zero(),
                backscatter_m2: power(self.target_strength_db),
            }
        };
        (0..self.count as u64).map(swimmer).collect()
    }
}

/// One fish.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Swimmer {
    low: DVec3,
    size: DVec3,
    start: DVec3,
    velocity_mps: DVec3,
    /// Backscattering cross section, 10^(TS/10).
    backscatter_m2: f64,
}

impl Swimmer {
    /// Where it is in the world.
    pub(crate) fn at(&self, time_s: f64) -> DVec3 {
        let travelled = self.start - self.low + self.velocity_mps * time_s;
        let period = 2.0 * self.size;
        let folded = travelled - period * (travelled / period).floor();
        self.low + folded.min(period - folded)
    }

    /// Range and power of its echo in a ping transmitted `time_s` into the dive; `None` where something
    /// stands before it. Power as that of surfaces: a surface across the beam that sends by Lambert's law
    /// has a target strength of A/π, so the fish counts as π σ / r² of solid angle.
    pub(crate) fn echo(&self, listener: &Listener<'_>, time_s: f64) -> Option<(f64, f64)> {
        let place = self.at(time_s);
        let (_, near) = listener.sensor.at(0.0);
        let (rotation, origin) = listener.sensor.at(place.distance(near));
        let range_m = place.distance(origin).max(NEAREST_M);
        let ray = (place - origin) / range_m;
        let sensitivity = listener.fan.sensitivity(rotation.transpose() * ray);
        let before_m = range_m - TOLERANCE_M;
        if !(sensitivity > 0.0) || listener.scene.cast(origin, ray, before_m).is_some() {
            return None;
        }
        let solid_angle = std::f64::consts::PI * self.backscatter_m2 / (range_m * range_m);
        let passed_on = listener.radiometry.over_range(range_m);
        Some((range_m, sensitivity * solid_angle * passed_on))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::beam::{Fan, SideLobes};
    use crate::scene::Scene;
    use crate::sonar::{MovingSensor, Radiometry};
    use echosplat_model::Pose;

    const LOW: DVec3 = DVec3::new(-4.0, -3.0, -2.0);
    const HIGH: DVec3 = DVec3::new(4.0, 3.0, 1.0);

    fn shoal() -> Vec<Swimmer> {
        let fish = Fish {
            count: 30.0,
            ..Fish::default()
        };
        fish.swimmers(1, LOW, HIGH)
    }

    #[test]
    fn fish_swim_at_their_speed_and_stay_in_the_dive() {
        assert_eq!(shoal().len(), 30);
        let mut straight = 0;
        for fish in shoal() {
            for second in 0..300 {
                let (now, then) = (fish.at(f64::from(second)), fish.at(f64::from(second) + 0.1));
                assert!(now.cmpge(LOW - 0.501).all() && now.cmple(HIGH + 0.501).all());
                // Where it turns at a wall it comes less far.
                assert!(now.distance(then) < 0.030_001);
                straight += usize::from(now.distance(then) > 0.029_999);
            }
        }
        assert!(straight > 30 * 280, "{straight}");
    }

    #[test]
    fn no_two_seeds_and_no_two_fish_swim_alike() {
        let (one, other) = (
            shoal(),
            Fish {
                count: 2.0,
                ..Fish::default()
            }
            .swimmers(2, LOW, HIGH),
        );
        assert!(one[0].at(0.0).distance(one[1].at(0.0)) > 1e-3);
        assert!(one[0].at(0.0).distance(other[0].at(0.0)) > 1e-3);
        assert_eq!(one[0].at(9.0), shoal()[0].at(9.0));
    }

    fn echo_of(scene: &str, place: DVec3, radiometry: Radiometry) -> Option<(f64, f64)> {
        let scene = Scene::parse(&format!("name = \"t\"\n{scene}"), None).unwrap();
        let sensor = MovingSensor::new(10.0, |_| Pose::IDENTITY);
        let fan = Fan::new(SideLobes::Without);
        let listener = Listener {
            scene: &scene,
            sensor: &sensor,
            fan: &fan,
            radiometry,
        };
        let fish = Swimmer {
            low: place - 1.0,
            size: DVec3::splat(2.0),
            start: place,
            velocity_mps: DVec3::ZERO,
            backscatter_m2: 1e-4,
        };
        fish.echo(&listener, 3.0)
    }

    #[test]
    fn a_fish_is_heard_at_its_range_as_loud_as_its_target_strength() {
        let (range_m, power) = echo_of("", DVec3::new(4.0, 0.0, 0.0), Radiometry::Even).unwrap();
        assert!((range_m - 4.0).abs() < 1e-9);
        assert!((power / (std::f64::consts::PI * 1e-4 / 16.0) - 1.0).abs() < 1e-9);
        // In the sea that falls with r⁴ and absorption.
        let sea = |x| {
            echo_of("", DVec3::new(x, 0.0, 0.0), Radiometry::Sea)
                .unwrap()
                .1
        };
        let fall_db = 10.0 * (sea(2.0) / sea(8.0)).log10();
        assert!(
            (fall_db - 10.0 * 256f64.log10() - 1.2).abs() < 1e-6,
            "{fall_db}"
        );
        // At the fan's edge by half.
        let edge = DVec3::new(25f64.to_radians().cos(), 0.0, 25f64.to_radians().sin()) * 4.0;
        let (_, at_edge) = echo_of("", edge, Radiometry::Even).unwrap();
        assert!((at_edge / power - 0.5).abs() < 1e-9);
    }

    #[test]
    fn a_fish_behind_a_wall_is_not_heard() {
        let wall = "[[box]]\ncenter_m = [3, 0, 0]\nsize_m = [0.1, 2, 2]";
        assert!(echo_of(wall, DVec3::new(4.0, 0.0, 0.0), Radiometry::Even).is_none());
        assert!(echo_of(wall, DVec3::new(2.0, 0.0, 0.0), Radiometry::Even).is_some());
    }
}
