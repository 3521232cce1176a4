//! What was added to the poses of a dive, for those who want the way that the map was made with.

use echosplat_model::glam::{DMat3, DQuat, DVec3};
use echosplat_model::{Pose, Timestamp};

use super::filter::{Correction, Found};

/// What was found at the end of each slice, in order of time. Slices are half a second long: an hour's are 1 MB.
#[derive(Debug, Clone, Default)]
pub(super) struct Track(Vec<(Timestamp, Found)>);

impl Track {
    pub(super) fn push(&mut self, time: Timestamp, found: Found) {
        self.0.push((time, found));
    }

    /// For this time: between two slices in proportion, before the first and after the last as there.
    pub(super) fn at(&self, time: Timestamp) -> Found {
        let Self(track) = self;
        let next = track.partition_point(|(of, _)| *of <= time);
        let last = track.len().saturating_sub(1);
        let ends = track
            .get(next.saturating_sub(1))
            .zip(track.get(next.min(last)));
        let Some((before, after)) = ends else {
            return Found::default();
        };
        let all_s = after.0.seconds_since(before.0);
        let share = match all_s > 0.0 {
            true => (time.seconds_since(before.0) / all_s).clamp(0.0, 1.0),
            false => 0.0,
        };
        let between = |a: f64, b: f64| a + share * (b - a);
        let triple = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| between(a[i], b[i]));
        let (before, after) = (before.1, after.1);
        Found {
            correction: Correction {
                shift_m: triple(before.correction.shift_m, after.correction.shift_m),
                turn_rad: between(before.correction.turn_rad, after.correction.turn_rad),
            },
            sigma_m: triple(before.sigma_m, after.sigma_m),
            turn_sigma_rad: between(before.turn_sigma_rad, after.turn_sigma_rad),
        }
    }
}

/// What a map's poses were corrected by over its dive.
#[derive(Debug, Clone)]
pub struct PoseCorrections {
    track: Track,
    world_from_map: DQuat,
}

/// A pose as the map has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CorrectedPose {
    /// World from sensor.
    pub pose: Pose,
    /// How sure it is; none where it is as it came.
    pub sigma: Option<PoseSigma>,
}

/// One sigma of a pose that was corrected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseSigma {
    /// Of its place along the world's x, y and z, metres.
    pub place_m: [f64; 3],
    /// Of its turn about the vertical, radians.
    pub turn_rad: f64,
}

impl PoseCorrections {
    pub(super) fn new(track: Track, world_from_map: DQuat) -> Self {
        Self {
            track,
            world_from_map,
        }
    }

    /// Whether no pose was corrected.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.track.0.is_empty()
    }

    /// A pose of the sensor, world axes, as it came at this time, corrected as the map's were.
    #[must_use]
    pub fn corrected(&self, time: Timestamp, world_from_sensor: Pose) -> CorrectedPose {
        let found = self.track.at(time);
        if !(found.turn_sigma_rad > 0.0) {
            return CorrectedPose {
                pose: world_from_sensor,
                sigma: None,
            };
        }
        let Correction { shift_m, turn_rad } = found.correction;
        let up = self.world_from_map * DVec3::Z;
        let turn = DQuat::from_axis_angle(up, turn_rad);
        let variance_m2 = DVec3::from_array(found.sigma_m).powf(2.0);
        let axes = DMat3::from_quat(self.world_from_map);
        // Of each of the world's axes the part along each of the map's.
        let parts = DMat3::from_cols_array(&axes.to_cols_array().map(|part| part * part));
        let place_m = (parts * variance_m2).to_array().map(f64::sqrt);
        CorrectedPose {
            pose: Pose {
                translation_m: world_from_sensor.translation_m
                    + self.world_from_map * DVec3::from_array(shift_m),
                rotation: (turn * world_from_sensor.rotation).normalize(),
            },
            sigma: Some(PoseSigma {
                place_m,
                turn_rad: found.turn_sigma_rad,
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(nanos: i64) -> Timestamp {
        Timestamp::from_nanos(nanos)
    }

    fn found(x_m: f64) -> Found {
        Found {
            correction: Correction {
                shift_m: [x_m, 0.0, 0.0],
                turn_rad: 0.1 * x_m,
            },
            sigma_m: [0.1, 0.2, 0.3],
            turn_sigma_rad: 0.01,
        }
    }

    #[test]
    fn poses_are_corrected_between_slices_and_before_the_first_of_them_as_they_came() {
        let mut track = Track::default();
        let none = PoseCorrections::new(track.clone(), DQuat::IDENTITY);
        let pose = Pose {
            translation_m: DVec3::new(5.0, 6.0, 7.0),
            rotation: DQuat::from_rotation_y(0.3),
        };
        assert!(none.is_empty());
        let as_it_came = CorrectedPose { pose, sigma: None };
        assert_eq!(none.corrected(at(5), pose), as_it_came);
        for (nanos, found) in [(10, Found::default()), (10, found(1.0)), (30, found(2.0))] {
            track.push(at(nanos), found);
        }
        // Of a map whose x is the world's y.
        let turned = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
        let all = PoseCorrections::new(track, turned);
        assert_eq!(all.corrected(at(9), pose), as_it_came);
        for (nanos, shift_m) in [(10, 1.0), (20, 1.5), (30, 2.0), (40, 2.0)] {
            let corrected = all.corrected(at(nanos), pose);
            let shift = corrected.pose.translation_m - pose.translation_m;
            assert!((shift - DVec3::Y * shift_m).length() < 1e-12, "{shift}");
            let turn = corrected.pose.rotation * pose.rotation.inverse();
            assert!(turn.angle_between(DQuat::from_rotation_z(0.1 * shift_m)) < 1e-6);
            let sigma = corrected.sigma.unwrap();
            for (sigma_m, expected_m) in sigma.place_m.into_iter().zip([0.2, 0.1, 0.3]) {
                assert!((sigma_m - expected_m).abs() < 1e-12, "{sigma:?}");
            }
        }
    }
}
