use super::*;
use crate::scene::BUILT_IN_SCENES;

fn plan(kind: DiveKind, scene: &str, noise: NoiseLevel, seed: u64) -> (Scene, Dive) {
    let scene = Scene::named(scene).unwrap();
    let dive = Dive::plan(kind, &scene, noise, seed).unwrap();
    (scene, dive)
}

fn at(dive: &Dive, time_s: f64) -> Pose {
    dive.truth_at(Timestamp::from_secs_f64(time_s))
}

#[test]
fn surveys_of_every_scene_keep_their_speed_and_their_distance() {
    for (name, _) in BUILT_IN_SCENES {
        let (scene, dive) = plan(DiveKind::Survey, name, NoiseLevel::None, 1);
        assert!((dive.duration_s() - 240.0).abs() < 0.1);
        let step_s = 0.05;
        for step in 0..(240.0 / step_s) as u32 {
            let time_s = f64::from(step) * step_s;
            let (here, next) = (at(&dive, time_s), at(&dive, time_s + step_s));
            let speed_mps = here.translation_m.distance(next.translation_m) / step_s;
            assert!(
                (0.2..0.4).contains(&speed_mps),
                "{name} {time_s}: {speed_mps}"
            );
            let turn_rps = here.rotation.angle_between(next.rotation) / step_s;
            assert!(
                turn_rps.to_degrees() < 45.0,
                "{name} {time_s}: {}°/s",
                turn_rps.to_degrees()
            );
            assert!(scene.distance(here.translation_m) > 0.45, "{name} {time_s}");
            assert!(scene.is_open_water(here.translation_m), "{name} {time_s}");
        }
    }
}

#[test]
fn the_survey_of_the_fence_is_as_described() {
    let (_, dive) = plan(DiveKind::Survey, "fence", NoiseLevel::Nominal, 1);
    assert_eq!(dive.pings(), 9600);
    assert_eq!(dive.settings().bin_count, 600);
    assert!((dive.settings().range_length_m - 10.0).abs() < 1e-9);
    let poses: Vec<Pose> = (0..9600)
        .step_by(10)
        .map(|i| at(&dive, dive.transmit_s(i)))
        .collect();
    let span = |value: &dyn Fn(&Pose) -> f64| {
        let (low, high) = poses
            .iter()
            .map(value)
            .fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        (low, high)
    };
    let (low, high) = span(&|pose| pose.translation_m.z);
    assert!(low < -1.4 && high > 1.4);
    let (low, high) = span(&|pose| (pose.rotation * DVec3::Y).z.asin().to_degrees());
    assert!(low < -20.0 && high > 20.0 && low > -30.0 && high < 30.0);
    let (low, high) = span(&|pose| pose.translation_m.truncate().to_angle());
    assert!(low < -3.0 && high > 3.0);
}

#[test]
fn a_longer_dive_begins_like_a_shorter_one() {
    let scene = Scene::named("fence").unwrap();
    let of = |duration_s: f64| {
        let options = DiveOptions {
            duration_s,
            ..DiveOptions::default()
        };
        Dive::plan_with(DiveKind::Survey, &scene, NoiseLevel::Nominal, 1, &options).unwrap()
    };
    let (short, long) = (of(60.0), of(120.0));
    assert_eq!(long.pings(), 2 * short.pings());
    assert_eq!(at(&short, 33.3), at(&long, 33.3));
    assert_eq!(short.reported_poses()[1000], long.reported_poses()[1000]);
}

#[test]
fn pan_turns_only_and_level_keeps_its_depth() {
    let (_, pan) = plan(DiveKind::Pan, "fence", NoiseLevel::None, 1);
    let (_, level) = plan(DiveKind::Level, "fence", NoiseLevel::None, 1);
    let (start, level_start) = (at(&pan, 0.0), at(&level, 0.0));
    let mut turned = 0.0f64;
    for i in 0..240 {
        let (here, there) = (at(&pan, f64::from(i)), at(&level, f64::from(i)));
        assert_eq!(here.translation_m, start.translation_m);
        assert!((there.translation_m.z - level_start.translation_m.z).abs() < 1e-12);
        for pose in [here, there] {
            assert!((pose.rotation * DVec3::Z).distance(DVec3::Z) < 1e-9);
        }
        turned = turned.max(here.rotation.angle_between(start.rotation));
    }
    assert!(turned.to_degrees() > 30.0);
    assert!(level_start.translation_m.z.abs() > 0.3);
}

#[test]
fn viewpoints_are_on_four_planes_and_face_the_middle() {
    let (_, dive) = plan(DiveKind::Viewpoints, "fence", NoiseLevel::Nominal, 1);
    assert_eq!(dive.pings(), 249 * BEAMS_PER_VIEW);
    let mut sides = [0; 4];
    for view in 0..249 {
        let first = view * BEAMS_PER_VIEW;
        assert_eq!(dive.view_of(first + 63), Some(view as u32));
        let (right, left) = (
            at(&dive, dive.transmit_s(first)),
            at(&dive, dive.transmit_s(first + 63)),
        );
        assert_eq!(right.translation_m, left.translation_m);
        // 63 steps of 60°/64 to port.
        let turned = (right.rotation.conjugate() * left.rotation).to_scaled_axis();
        assert!(turned.distance(DVec3::Z * (63.0 / 64.0 * 60f64).to_radians()) < 1e-9);
        let middle = right.rotation.slerp(left.rotation, 0.5);
        let towards = (-right.translation_m).normalize();
        let off_deg = (middle * DVec3::X).angle_between(towards).to_degrees();
        assert!(off_deg < 20.0, "{off_deg}");
        let place = right.translation_m;
        let side = [place.x + 7.6, place.x - 7.6, place.y + 4.6, place.y - 4.6];
        let nearest = (0..4)
            .min_by(|&a, &b| side[a].abs().total_cmp(&side[b].abs()))
            .unwrap();
        assert!(side[nearest].abs() < 1e-9);
        sides[nearest] += 1;
    }
    assert!(sides.iter().all(|&count| count > 10), "{sides:?}");
}

#[test]
fn no_view_is_from_under_the_seabed() {
    // The pipeline lies on its seabed, so that the planes of views reach below it.
    let (scene, dive) = plan(DiveKind::Viewpoints, "pipeline", NoiseLevel::None, 1);
    let under = DVec3::new(0.0, 6.0, -3.6);
    assert!(!scene.is_open_water(under) && !scene.contains(under, 0.0));
    for view in 0..dive.pings() / BEAMS_PER_VIEW {
        let place = at(&dive, dive.transmit_s(view * BEAMS_PER_VIEW)).translation_m;
        let overhead = scene.cast(place, DVec3::Z, 100.0);
        assert!(
            !overhead.is_some_and(|hit| hit.is_seabed),
            "{view}: {place}"
        );
    }
}

#[test]
fn the_truss_has_886_views() {
    let (_, dive) = plan(DiveKind::Viewpoints, "truss", NoiseLevel::None, 1);
    assert_eq!(dive.pings(), 886 * BEAMS_PER_VIEW);
    assert_eq!(dive.settings().bin_count, 1200);
}

#[test]
fn nothing_is_interpolated_between_the_beams_of_a_view() {
    let (_, dive) = plan(DiveKind::Viewpoints, "fence", NoiseLevel::None, 1);
    let trajectory = dive.trajectory(0.5);
    for index in [0, 1, 63, 64, 1000] {
        let time_s = dive.transmit_s(index);
        let truth = at(&dive, time_s);
        for range_m in [0.0, 5.0, 12.0] {
            let time = Timestamp::from_secs_f64(time_s + range_m / 1500.0);
            let found = trajectory.at(time).unwrap().world_from_vehicle;
            assert!(found.translation_m.distance(truth.translation_m) < 1e-9);
            assert!(
                found.rotation.angle_between(truth.rotation) < 1e-6,
                "{index} {range_m}"
            );
        }
    }
}

#[test]
fn reported_poses_cover_every_ping_and_have_the_errors_of_their_level() {
    for (noise, position_m, attitude_deg) in [
        (NoiseLevel::None, 0.0, 0.0),
        (NoiseLevel::Nominal, 0.0283, 0.2236),
        (NoiseLevel::Harsh, 0.128, 1.118),
    ] {
        let (mut square_m2, mut square_deg2, mut count) = (0.0, 0.0, 0.0);
        for seed in 0..8 {
            let (_, dive) = plan(DiveKind::Survey, "fence", noise, seed);
            let poses = dive.reported_poses();
            assert!(poses[0].time < Timestamp::ZERO);
            let end = poses[poses.len() - 1].time.as_secs_f64();
            assert!(end > dive.duration_s());
            let gap_s = poses
                .windows(2)
                .map(|pair| pair[1].time.seconds_since(pair[0].time))
                .fold(0.0, f64::max);
            let expected_s = if noise == NoiseLevel::Harsh {
                3.0
            } else {
                0.02
            };
            assert!((gap_s - expected_s).abs() < 0.03, "{gap_s}");
            for pose in poses.iter().step_by(7) {
                let truth = dive.truth_at(pose.time);
                let error = truth.inverse() * pose.world_from_vehicle;
                square_m2 += error.translation_m.length_squared();
                square_deg2 += error
                    .rotation
                    .to_scaled_axis()
                    .length_squared()
                    .to_degrees()
                    .to_degrees();
                count += 3.0;
            }
        }
        let sigma_m = (square_m2 / count).sqrt();
        let sigma_deg = (square_deg2 / count).sqrt();
        assert!(
            (sigma_m - position_m).abs() <= 0.1 * position_m + 1e-9,
            "{noise}: {sigma_m}"
        );
        assert!(
            (sigma_deg - attitude_deg).abs() <= 0.1 * attitude_deg + 1e-6,
            "{noise}: {sigma_deg}"
        );
    }
}

#[test]
fn field_poses_walk_away_over_the_ground_and_in_heading_alone() {
    // Mean squares over seeds, after so many seconds: of the ground, of depth, of heading, of tilt.
    let errors = |time_s: f64| {
        let mut squares = [0.0; 4];
        let seeds = 60;
        for seed in 0..seeds {
            let scene = Scene::named("fence").unwrap();
            let options = DiveOptions {
                duration_s: 101.0,
                pings_per_s: 1.0,
                ..DiveOptions::default()
            };
            let level = NoiseLevel::Field;
            let dive = Dive::plan_with(DiveKind::Survey, &scene, level, seed, &options).unwrap();
            let poses = dive.reported_poses().iter();
            let about_then = poses.filter(|p| (p.time.as_secs_f64() - time_s).abs() < 0.5);
            for pose in about_then.clone() {
                let (truth, read) = (dive.truth_at(pose.time), pose.world_from_vehicle);
                let shift = read.translation_m - truth.translation_m;
                let turn = (read.rotation * truth.rotation.inverse()).to_scaled_axis();
                let turn = turn.map(f64::to_degrees);
                let own = [
                    0.5 * shift.truncate().length_squared(),
                    shift.z * shift.z,
                    turn.z * turn.z,
                    0.5 * turn.truncate().length_squared(),
                ];
                let share = 1.0 / (about_then.clone().count() as f64 * seeds as f64);
                squares = std::array::from_fn(|i| squares[i] + share * own[i]);
            }
        }
        squares.map(f64::sqrt)
    };
    let (begin, end) = (errors(0.5), errors(100.0));
    let near = |found: f64, expected: f64| (found / expected - 1.0).abs() < 0.25;
    // White 1 cm and 0.1°; with 2 cm and 0.1° of the walk √5 cm and √2 tenths of a degree.
    assert!(
        begin
            .iter()
            .zip([0.01, 0.01, 0.1, 0.1])
            .all(|(f, e)| near(*f, e)),
        "{begin:?}"
    );
    let expected = [0.0224, 0.01, 0.141, 0.1];
    assert!(
        end.iter().zip(expected).all(|(f, e)| near(*f, e)),
        "{end:?}"
    );
}

#[test]
fn seeds_differ_and_repeat() {
    let (_, one) = plan(DiveKind::Survey, "pier", NoiseLevel::Nominal, 1);
    let (_, again) = plan(DiveKind::Survey, "pier", NoiseLevel::Nominal, 1);
    let (_, other) = plan(DiveKind::Survey, "pier", NoiseLevel::Nominal, 2);
    assert_eq!(one.reported_poses(), again.reported_poses());
    assert!(
        at(&one, 1.0)
            .translation_m
            .distance(at(&other, 1.0).translation_m)
            > 0.1
    );
}

#[test]
fn options_out_of_range_and_scenes_without_room_are_refused() {
    let scene = Scene::named("fence").unwrap();
    for duration_s in [f64::NAN, 0.0, 1e9] {
        let options = DiveOptions {
            duration_s,
            ..DiveOptions::default()
        };
        let refused = Dive::plan_with(DiveKind::Survey, &scene, NoiseLevel::None, 1, &options);
        assert!(matches!(
            refused,
            Err(DiveError::Option {
                name: "duration_s",
                ..
            })
        ));
    }
    let shell = "name = \"full\"\n[[sphere]]\ncenter_m = [0, 0, 0]\nradius_m = 1\n[[plane]]\npoint_m = [0, 0, 50]";
    let full = Scene::parse(shell, None).unwrap();
    let refused = Dive::plan(DiveKind::Survey, &full, NoiseLevel::None, 1).unwrap_err();
    assert!(refused.to_string().contains("standoff_m"), "{refused}");
    assert!("dash".parse::<DiveKind>().is_err());
}
