//! The projector against cases worked by hand: target and rolled, pitched, heaved pose in; range
//! bin, azimuth and elevation out. Bins are 0.02 m long and begin at range 0. The simulator is held
//! to cases of its own, so that a sign both got wrong would have to be wrong on paper too.

use echosplat_measurement::{Beam, PingGeometry, PingPose, SymmetricMat3};
use echosplat_model::Pose;
use echosplat_model::glam::{DMat3, DVec3, Vec3};

/// Why, target, sensor's position, yaw–pitch–roll in degrees, and what comes out: bin, azimuth and
/// elevation in degrees; `None` where the beam does not reach.
type Case = (
    &'static str,
    [f64; 3],
    [f64; 3],
    [f64; 3],
    Option<(usize, f64, f64)>,
);

const CASES: [Case; 12] = [
    (
        "ahead: r = 5.01, 5.01/0.02 = 250.5",
        [5.01, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        Some((250, 0.0, 0.0)),
    ),
    (
        "above: r = √(4² + 1.5²) = 4.2720 → 213.6; φ = atan(1.5/4) = 20.556°",
        [4.0, 0.0, 1.5],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        Some((213, 0.0, 20.556)),
    ),
    (
        "a little to port: θ = atan(0.05/5) = 0.573°; r = √(25 + 0.0025) = 5.00025 → 250.01",
        [5.0, 0.05, 0.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        Some((250, 0.573, 0.0)),
    ),
    (
        "heaved up 1 m: z = −1, r = √(9 + 1) = 3.1623 → 158.1; φ = −atan(1/3) = −18.435°",
        [3.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, 0.0],
        Some((158, 0.0, -18.435)),
    ),
    (
        "heaved down 1 m: the same echo, φ = +18.435°",
        [3.0, 0.0, 0.0],
        [0.0, 0.0, -1.0],
        [0.0, 0.0, 0.0],
        Some((158, 0.0, 18.435)),
    ),
    (
        "heaved up 3 m: φ = −45°, outside the fan",
        [3.0, 0.0, 0.0],
        [0.0, 0.0, 3.0],
        [0.0, 0.0, 0.0],
        None,
    ),
    (
        "rolled 90°, port side up: the sensor's left \
         axis points up, its up axis to starboard; y = +1 lies against its up axis: φ = −14.036°, \
         r = √17 = 4.1231 → 206.2",
        [4.0, 1.0, 0.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 90.0],
        Some((206, 0.0, -14.036)),
    ),
    (
        "rolled 90°, what was above is now to port, θ = 14°: out of the beam",
        [4.0, 0.0, 1.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 90.0],
        None,
    ),
    (
        "rolled 45°: the fan holds (0, −1, 1)/√2; target 1.2 along it: y = −0.8485, z = 0.8485, \
         r = √(16 + 1.44) = 4.1761 → 208.8; φ = atan(1.2/4) = 16.699°",
        [4.0, -0.848_528, 0.848_528],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 45.0],
        Some((208, 0.0, 16.699)),
    ),
    (
        "facing north from (10, −5, −2): a target 6.01 m north, level → 300.5",
        [10.0, 1.01, -2.0],
        [10.0, -5.0, -2.0],
        [90.0, 0.0, 0.0],
        Some((300, 0.0, 0.0)),
    ),
    (
        "nose down 30° (positive pitch): straight ahead is (cos 30°, 0, −sin 30°)·4.01 → 200.5",
        [3.472_762, 0.0, -2.005],
        [0.0, 0.0, 0.0],
        [0.0, 30.0, 0.0],
        Some((200, 0.0, 0.0)),
    ),
    (
        "behind: never",
        [-5.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        None,
    ),
];

fn geometry(position_m: [f64; 3], yaw_pitch_roll_deg: [f64; 3]) -> PingGeometry {
    let [yaw, pitch, roll] = yaw_pitch_roll_deg.map(f64::to_radians);
    let pose = Pose::from_yaw_pitch_roll(yaw, pitch, roll, DVec3::from(position_m));
    PingGeometry {
        pose: PingPose {
            position_m: pose.translation_m.as_vec3(),
            axes: DMat3::from_quat(pose.rotation).as_mat3(),
            drift_per_m: Vec3::ZERO,
            reference_range_m: 5.0,
        },
        range_start_m: 0.0,
        bin_length_m: 0.02,
        bin_count: 600,
        range_variance_m2: 1e-8,
        azimuth_variance_rad2: 0.0,
        beam: Beam::default(),
    }
}

#[test]
fn targets_fall_where_a_hand_calculation_puts_them() {
    for (why, target_m, position_m, attitude_deg, expected) in CASES {
        let geometry = geometry(position_m, attitude_deg);
        let point = SymmetricMat3::isotropic(1e-4);
        let splat = geometry.project(DVec3::from(target_m).as_vec3(), &point);
        let found = splat.map(|s| {
            (
                (s.range_m / geometry.bin_length_m) as usize,
                f64::from(s.azimuth_rad.to_degrees()),
                f64::from(s.elevation_rad.to_degrees()),
            )
        });
        match (found, expected) {
            (None, None) => {}
            (Some((bin, azimuth, elevation)), Some(wanted)) => {
                assert_eq!(bin, wanted.0, "{why}");
                assert!((azimuth - wanted.1).abs() < 2e-3, "{why}: θ {azimuth}");
                assert!((elevation - wanted.2).abs() < 2e-3, "{why}: φ {elevation}");
            }
            (found, _) => panic!("{why}: found {found:?}"),
        }
    }
}
