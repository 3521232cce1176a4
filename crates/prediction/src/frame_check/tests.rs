//! Short simulated dives, their poses misread on purpose.

use std::sync::{Arc, LazyLock};

use echosplat_model::Timestamp;
use echosplat_simulator::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene, SimulatedSonar};
use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::*;

/// Of 30 s every third ping.
fn pings_of(scene: &str, kind: DiveKind) -> Vec<VehiclePing> {
    pings_for(scene, kind, NoiseLevel::Nominal, (30.0, 3))
}

fn pings_for(
    scene: &str,
    kind: DiveKind,
    noise: NoiseLevel,
    (duration_s, every): (f64, usize),
) -> Vec<VehiclePing> {
    let scene = Arc::new(Scene::named(scene).unwrap());
    let options = DiveOptions {
        duration_s,
        ..DiveOptions::default()
    };
    let dive = Arc::new(Dive::plan_with(kind, &scene, noise, 3, &options).unwrap());
    let sonar = SimulatedSonar::new(scene, Arc::clone(&dive), noise, 3);
    let trajectory = dive.trajectory(0.5);
    let indices: Vec<usize> = (0..dive.pings()).step_by(every).collect();
    let posed = |index| sonar.posed_ping(index, &trajectory);
    let posed = indices.into_par_iter().filter_map(posed);
    posed
        .map(|ping| VehiclePing::of(&ping, &Pose::IDENTITY))
        .collect()
}

static FENCE: LazyLock<Vec<VehiclePing>> = LazyLock::new(|| pings_of("fence", DiveKind::Survey));

fn judged(pings: &[VehiclePing], mount: &Pose) -> Option<FrameVerdict> {
    judge(pings, mount, &MapperConfig::default())
}

/// The fence's pings with their poses as somebody might send them.
fn fence_as(send: impl Fn(&Pose) -> Pose) -> Vec<VehiclePing> {
    let sent = |ping: &VehiclePing| VehiclePing {
        ping: Arc::clone(&ping.ping),
        world_from_vehicle: send(&ping.world_from_vehicle),
    };
    FENCE.iter().map(sent).collect()
}

fn told_of(send: impl Fn(&Pose) -> Pose) -> FrameReading {
    let verdict = judged(&fence_as(send), &Pose::IDENTITY).unwrap();
    assert!(verdict.is_telling, "{verdict:?}");
    verdict.best
}

#[test]
fn right_poses_are_found_right() {
    let verdict = judged(&FENCE, &Pose::IDENTITY).unwrap();
    assert_eq!(verdict.best, FrameReading::AsGiven);
    assert!(!verdict.is_telling && verdict.gain_nats_per_bin_as_given > 0.02);
    assert!(
        verdict.turned_deg > 60.0 && verdict.pings > 300,
        "{verdict:?}"
    );
}

#[test]
fn quaternions_in_another_order_or_inverted_are_told() {
    let turned = |pose: &Pose, rotation| Pose { rotation, ..*pose };
    let w_first = told_of(|pose| {
        let [x, y, z, w] = pose.rotation.to_array();
        turned(pose, DQuat::from_xyzw(w, x, y, z))
    });
    assert_eq!(w_first, FrameReading::QuaternionWFirst);
    let inverted = told_of(|pose| turned(pose, pose.rotation.conjugate()));
    assert_eq!(inverted, FrameReading::InverseRotation);
    assert_eq!(told_of(Pose::inverse), FrameReading::InversePose);
}

#[test]
fn half_of_ned_is_told() {
    let north_east_down = |place: DVec3| DVec3::new(place.y, place.x, -place.z);
    let told = told_of(|pose| Pose {
        translation_m: north_east_down(pose.translation_m),
        ..*pose
    });
    assert_eq!(told, FrameReading::NedPosition);
}

#[test]
fn a_mount_turned_by_a_right_angle_is_told() {
    for (yaw_deg, reading) in [
        (90.0, FrameReading::MountYaw(90)),
        (-90.0, FrameReading::MountYaw(-90)),
    ] {
        let mount = Pose::from_yaw_pitch_roll(f64::to_radians(yaw_deg), 0.0, 0.0, DVec3::ZERO);
        assert_eq!(told_of(|sensor| *sensor * mount.inverse()), reading);
    }
    let across = Pose::from_yaw_pitch_roll(0.0, 0.0, f64::to_radians(90.0), DVec3::ZERO);
    let told = told_of(|sensor| *sensor * across.inverse());
    assert_eq!(told, FrameReading::MountRoll(90));
}

/// As it would be posed with a mount that is not turned as the sonar is.
fn tilted(pings: &[VehiclePing], [yaw, pitch, roll]: [f64; 3]) -> Option<FrameVerdict> {
    let [yaw, pitch, roll] = [yaw, pitch, roll].map(f64::to_radians);
    let mount = Pose::from_yaw_pitch_roll(yaw, pitch, roll, DVec3::ZERO);
    let told = |ping: &VehiclePing| VehiclePing {
        ping: Arc::clone(&ping.ping),
        world_from_vehicle: ping.world_from_vehicle * mount.inverse(),
    };
    let told: Vec<VehiclePing> = pings.iter().map(told).collect();
    judge_tilt(&told, &Pose::IDENTITY, &MapperConfig::default())
}

#[test]
fn a_mount_tilted_by_tens_of_degrees_is_told_and_one_that_is_not_never_is() {
    let survey = DiveKind::Survey;
    let mut wrong = Vec::new();
    for scene in ["fence", "wall", "pier", "pipeline"] {
        for noise in [NoiseLevel::Nominal, NoiseLevel::Field] {
            let pings = pings_for(scene, survey, noise, (90.0, 7));
            let right = tilted(&pings, [0.0; 3]);
            if right.is_some_and(|verdict| verdict.is_telling) {
                wrong.push(format!("{scene} {noise:?}: {right:?}"));
            }
            if !["fence", "wall"].contains(&scene) || noise != NoiseLevel::Nominal {
                continue;
            }
            for (tilt, reading) in [
                ([0.0, 20.0, 0.0], FrameReading::MountPitch(20)),
                ([0.0, -20.0, 0.0], FrameReading::MountPitch(-20)),
                ([20.0, 0.0, 0.0], FrameReading::MountYaw(20)),
                ([-20.0, 0.0, 0.0], FrameReading::MountYaw(-20)),
            ] {
                let told = tilted(&pings, tilt);
                if !told.is_some_and(|told| told.is_telling && told.best == reading) {
                    wrong.push(format!("{scene} {noise:?} {tilt:?}: {told:?}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_mount_is_taken_off_a_sensor_s_pose() {
    let mount = Pose::from_yaw_pitch_roll(0.4, 0.3, 0.0, DVec3::new(0.2, 0.1, -0.3));
    let vehicle = Pose::from_yaw_pitch_roll(-1.0, 0.1, 0.2, DVec3::new(5.0, 6.0, -7.0));
    let posed = PosedPing {
        ping: Arc::clone(&FENCE[0].ping),
        world_from_sensor: vehicle * mount,
        twist: echosplat_model::Twist::default(),
        reference_range_m: 5.0,
        uncertainty: None,
        jitter: None,
    };
    let found = VehiclePing::of(&posed, &mount).world_from_vehicle;
    assert!((found.translation_m - vehicle.translation_m).length() < 1e-9);
    assert!(found.rotation.angle_between(vehicle.rotation) < 1e-6);
}

#[test]
fn dives_that_cannot_tell_say_nothing() {
    assert_eq!(
        judged(&pings_of("empty", DiveKind::Survey), &Pose::IDENTITY),
        None
    );
    let at_rest = fence_as(|_| FENCE[0].world_from_vehicle);
    assert_eq!(judged(&at_rest, &Pose::IDENTITY), None);
    assert_eq!(judged(&FENCE[..40], &Pose::IDENTITY), None);
    assert_eq!(judged(&[], &Pose::IDENTITY), None);
    let pan = judged(&pings_of("fence", DiveKind::Pan), &Pose::IDENTITY);
    assert!(!pan.is_some_and(|verdict| verdict.is_telling), "{pan:?}");
}

#[test]
fn poses_that_are_not_numbers_or_far_away_are_borne() {
    let nowhere = fence_as(|pose| Pose {
        translation_m: DVec3::NAN,
        ..*pose
    });
    assert_eq!(judged(&nowhere, &Pose::IDENTITY), None);
    // Each further from the first than voxels are numbered.
    let scattered = fence_as(|pose| Pose {
        translation_m: pose.translation_m * 1e9,
        ..*pose
    });
    let verdict = judged(&scattered, &Pose::IDENTITY);
    assert!(
        !verdict.is_some_and(|verdict| verdict.is_telling),
        "{verdict:?}"
    );
}

#[test]
fn silence_says_nothing() {
    let silent = |ping: &VehiclePing| {
        let settings = *ping.ping.settings();
        let power = vec![0.0; settings.bin_count];
        let ping_time = Timestamp::ZERO;
        let silent = Ping::new(0, ping_time, settings, power).unwrap();
        VehiclePing {
            ping: Arc::new(silent),
            world_from_vehicle: ping.world_from_vehicle,
        }
    };
    let silent: Vec<VehiclePing> = FENCE.iter().map(silent).collect();
    assert_eq!(judged(&silent, &Pose::IDENTITY), None);
}
