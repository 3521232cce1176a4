//! The map as the evaluator sees it: the means of its Gaussians, in the world.

use echosplat_model::{Gaussian, Pose, Snapshot, Standing};
use glam::{DQuat, DVec3};

/// A Gaussian is a disc, not a dot, if its shortest axis is below this share of its middle one.
const FLAT_SHARE: f32 = 0.5;

/// One Gaussian that the map asserts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapPoint {
    /// Its mean, world coordinates, metres.
    pub position: DVec3,
    /// Unit direction of its shortest axis, world axes, if it is flat: shortest scale below half
    /// of the middle one.
    pub shortest_axis: Option<DVec3>,
}

/// A map, split by what it asserts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MapPoints {
    /// What the map asserts as surface.
    pub confident: Vec<MapPoint>,
    /// Means of the ambiguous ones, world coordinates, metres.
    pub ambiguous: Vec<DVec3>,
    /// Gaussians that are not finite, in neither.
    pub left_out_count: usize,
}

impl MapPoints {
    /// Of Gaussians relative to `origin_m`, told apart by their standing.
    #[must_use]
    pub fn new(origin_m: DVec3, gaussians: &[Gaussian]) -> Self {
        let mut points = Self::default();
        for gaussian in gaussians {
            let position = origin_m + gaussian.mean_m.as_dvec3();
            if !gaussian.is_sound() || !position.is_finite() {
                points.left_out_count += 1;
                continue;
            }
            match gaussian.standing {
                Standing::Ambiguous => points.ambiguous.push(position),
                Standing::Confident => points.confident.push(MapPoint {
                    position,
                    shortest_axis: shortest_axis(gaussian),
                }),
            }
        }
        points
    }

    /// The same map elsewhere.
    #[must_use]
    pub fn moved(mut self, to_from_here: &Pose) -> Self {
        for point in &mut self.confident {
            point.position = *to_from_here * point.position;
            let axis = point.shortest_axis;
            point.shortest_axis = axis.map(|axis| to_from_here.rotation * axis);
        }
        for position in &mut self.ambiguous {
            *position = *to_from_here * *position;
        }
        self
    }

    /// Means of what is asserted.
    #[must_use]
    pub fn positions(&self) -> Vec<DVec3> {
        let confident = self.confident.iter();
        confident.map(|point| point.position).collect()
    }

    /// Of bare points, all asserted.
    #[must_use]
    pub fn of_positions(positions: impl IntoIterator<Item = DVec3>) -> Self {
        let point = |position| MapPoint {
            position,
            shortest_axis: None,
        };
        Self {
            confident: positions.into_iter().map(point).collect(),
            ..Self::default()
        }
    }
}

impl From<&Snapshot> for MapPoints {
    fn from(snapshot: &Snapshot) -> Self {
        Self::new(snapshot.origin_m, &snapshot.gaussians)
    }
}

fn shortest_axis(gaussian: &Gaussian) -> Option<DVec3> {
    let mut scales_m = gaussian.scale_m.to_array();
    scales_m.sort_unstable_by(f32::total_cmp);
    let is_flat = scales_m[0] < FLAT_SHARE * scales_m[1];
    let q = gaussian.rotation.to_array().map(f64::from);
    let rotation = DQuat::from_array(q).normalize();
    let axis = rotation * DVec3::AXES[gaussian.scale_m.min_position()];
    (is_flat && axis.is_finite()).then_some(axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};

    fn gaussian(scale_m: Vec3, standing: Standing) -> Gaussian {
        Gaussian {
            id: 0,
            mean_m: Vec3::new(0.5, 0.0, 0.0),
            rotation: Quat::from_rotation_z(std::f32::consts::FRAC_PI_2),
            scale_m,
            opacity: 0.5,
            reflectivity: 0.5,
            sigma_m: 0.1,
            position_covariance_m2: Gaussian::known_alike_m2(0.1),
            probability: 1.0,
            standing,
            why: echosplat_model::Why::default(),
        }
    }

    #[test]
    fn gaussians_become_points_in_the_world() {
        let origin_m = DVec3::new(1e6, 2.0, 3.0);
        let map = [
            gaussian(Vec3::new(0.1, 0.3, 0.3), Standing::Confident),
            gaussian(Vec3::new(0.2, 0.3, 0.3), Standing::Confident),
            gaussian(Vec3::ONE, Standing::Ambiguous),
            gaussian(Vec3::new(f32::NAN, 1.0, 1.0), Standing::Confident),
        ];
        let points = MapPoints::new(origin_m, &map);
        assert_eq!(
            points.confident[0].position,
            DVec3::new(1_000_000.5, 2.0, 3.0)
        );
        let axis = points.confident[0].shortest_axis.unwrap();
        assert!((axis.dot(DVec3::Y).abs() - 1.0).abs() < 1e-6);
        assert_eq!(points.confident[1].shortest_axis, None);
        assert_eq!(points.ambiguous.len(), 1);
        assert_eq!(points.left_out_count, 1);

        let back = Pose::from_yaw_pitch_roll(std::f64::consts::FRAC_PI_2, 0.0, 0.0, -origin_m);
        let moved = points.clone().moved(&back);
        let expected = DVec3::new(-2.0, 1_000_000.5, 0.0) + DVec3::new(-1e6, -2.0, 0.0);
        assert!(moved.positions()[0].distance(expected) < 1e-6);
        let axis = moved.confident[0].shortest_axis.unwrap();
        assert!((axis.dot(DVec3::X).abs() - 1.0).abs() < 1e-6);
        assert_eq!(moved.ambiguous.len(), 1);
    }
}
