//! Whether what seems to be ground lies where the vehicle's height and tilt say, or always at the same range, as
//! reverberation does, whatever the vehicle does.
//!
//! A unit that stands and does not tilt cannot tell the two apart. One that only tilts or turns could, but all that it
//! sees it sees from one place: like any other structure, ground needs more than that.

use echosplat_model::glam::Vec3;

/// Onsets, found: a vehicle heaves within seconds.
/// Onsets that the running means remember: a vehicle heaves and tilts within seconds.
const MEMORY: f32 = 64.0;
/// Onsets; found.
/// Onsets before the means are any.
const LEAST_ONSETS: u32 = 16;
/// Metres; found.
/// An onset further off than this is of something else and counts as this.
const MOST_OFF_M: f32 = 0.5;
/// Onsets; found.
/// Neighbouring onsets share the vehicle's motion and part of their speckle.
const ALIKE: f32 = 8.0;
/// Nats, derived: ln 100 over reverberation.
/// Natural logarithm of 100: the likelihood ratio of ground over reverberation.
const ENOUGH: f32 = 4.6;
/// Metres, found: resting poses wander.
/// Poses wander by some decimetres while a vehicle rests.
const LEAST_BASELINE_M: f32 = 1.0;

/// What onsets say of it, up to now.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Proof {
    onsets: u32,
    mean_range_m: f32,
    mean_height_m: f32,
    /// Sums of squares of how far onsets were off the means, as heights.
    off_range_m2: f32,
    off_height_m2: f32,
    /// Corners of the box that the sensor was in.
    low_m: Vec3,
    high_m: Vec3,
}

impl Proof {
    /// Takes in the place of an onset, that of the sensor, and metres down per metre of range, in map coordinates.
    pub(crate) fn add(&mut self, onset_m: Vec3, sensor_m: Vec3, descent: f32) {
        if self.onsets == 0 {
            (self.low_m, self.high_m) = (sensor_m, sensor_m);
        }
        self.low_m = self.low_m.min(sensor_m);
        self.high_m = self.high_m.max(sensor_m);
        let (range_m, height_m) = ((onset_m - sensor_m).length(), onset_m.z);
        let share = (self.onsets as f32 + 1.0).min(MEMORY);
        let off_range_m = (range_m - self.mean_range_m) * descent;
        let off_height_m = height_m - self.mean_height_m;
        self.mean_range_m += (range_m - self.mean_range_m) / share;
        self.mean_height_m += off_height_m / share;
        self.onsets = self.onsets.saturating_add(1);
        if self.onsets > LEAST_ONSETS {
            let square = |off_m: f32| off_m.clamp(-MOST_OFF_M, MOST_OFF_M).powi(2);
            self.off_range_m2 += square(off_range_m);
            self.off_height_m2 += square(off_height_m);
        }
    }

    /// Log likelihood of ground over reverberation, both normal about their means with the spread that they showed.
    pub(crate) fn log_ratio(&self) -> f32 {
        let count = self.onsets.saturating_sub(LEAST_ONSETS) as f32 / ALIKE;
        let [range, height] = [self.off_range_m2, self.off_height_m2].map(|sum| sum.max(1e-12));
        0.5 * count * (range / height).ln()
    }

    pub(crate) fn is_enough(&self) -> bool {
        self.log_ratio() > ENOUGH && (self.high_m - self.low_m).length() > LEAST_BASELINE_M
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a sensor that heaves by 20 cm and goes ahead at some speed, and onsets at some range.
    fn proof(speed_mps: f32, range_m: impl Fn(f32) -> f32) -> Proof {
        let mut proof = Proof::default();
        for index in 0..1000 {
            let time_s = 0.1 * index as f32;
            let off_m = 0.05 * ((index * 37 % 101) as f32 / 50.0 - 1.0);
            let sensor_m = Vec3::new(speed_mps * time_s, 0.0, heave_m(time_s));
            let direction = Vec3::new((1.0 - DESCENT * DESCENT).sqrt(), 0.0, -DESCENT);
            let onset_m = sensor_m + direction * (range_m(time_s) + off_m);
            proof.add(onset_m, sensor_m, DESCENT);
        }
        proof
    }

    const DESCENT: f32 = 0.42;

    fn heave_m(time_s: f32) -> f32 {
        0.2 * (0.3 * time_s).sin()
    }

    #[test]
    fn an_onset_that_follows_the_vehicle_is_ground_and_one_that_does_not_is_not() {
        let ground = |time_s: f32| (2.0 + heave_m(time_s)) / DESCENT;
        assert!(proof(0.3, ground).is_enough());
        assert!(!proof(0.3, |_| 5.0).is_enough());
    }

    #[test]
    fn one_place_is_not_enough() {
        let ground = |time_s: f32| (2.0 + heave_m(time_s)) / DESCENT;
        let proof = proof(0.0, ground);
        assert!(proof.log_ratio() > ENOUGH && !proof.is_enough());
    }
}
