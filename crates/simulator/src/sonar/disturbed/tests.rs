use std::sync::Arc;

use echosplat_model::Pose;
use glam::DVec3;

use super::*;
use crate::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene};

/// One of each, as `KEY=VALUE`, and whether it changes poses in place of pings.
const EACH: [(&[&str], bool); 10] = [
    (&["copy_offset_m=1.3"], false),
    (&["multiple_ratio=1.7"], false),
    (&["spikes=3"], false),
    (&["walker_mps=0.5"], false),
    (&["fish=20"], false),
    (&["surface_m=4"], false),
    (&["saturated_share=0.2"], false),
    (&["sound_error=0.015", "sound_drift=0.003"], false),
    (&["pose_latency_s=0.03"], true),
    (
        &["mount_yaw_deg=2", "mount_pitch_deg=1", "mount_roll_deg=-1"],
        true,
    ),
];

fn disturbances<'a>(pairs: impl IntoIterator<Item = &'a &'a str>) -> Disturbances {
    let mut disturbances = Disturbances::default();
    for pair in pairs {
        disturbances.set(pair).unwrap();
    }
    disturbances
}

fn sonar(noise: NoiseLevel, pairs: &[&str]) -> SimulatedSonar {
    of_scene(Scene::named("fence").unwrap(), noise, pairs)
}

fn of_scene(scene: Scene, noise: NoiseLevel, pairs: &[&str]) -> SimulatedSonar {
    let options = DiveOptions {
        duration_s: 20.0,
        disturbances: disturbances(pairs),
        ..DiveOptions::default()
    };
    let dive = Dive::plan_with(DiveKind::Survey, &scene, noise, 1, &options).unwrap();
    SimulatedSonar::new(Arc::new(scene), Arc::new(dive), noise, 1)
}

/// Every hundredth ping's power.
fn pings(sonar: &SimulatedSonar) -> Vec<Vec<f32>> {
    let indices = (0..sonar.dive().pings()).step_by(100);
    indices.map(|index| sonar.ping(index).intensity).collect()
}

#[test]
fn each_alone_changes_pings_or_poses_and_the_same_seed_gives_the_same() {
    for noise in [NoiseLevel::Nominal, NoiseLevel::Field] {
        let plain = sonar(noise, &[]);
        let undisturbed = pings(&plain);
        for (pairs, is_of_poses) in EACH {
            let disturbed = sonar(noise, pairs);
            let heard = pings(&disturbed);
            let poses = disturbed.dive().reported_poses();
            assert_eq!(heard != undisturbed, !is_of_poses, "{noise} {pairs:?}");
            let are_same = poses == plain.dive().reported_poses();
            assert_eq!(are_same, !is_of_poses, "{noise} {pairs:?}");
            assert_eq!(heard, pings(&sonar(noise, pairs)), "{noise} {pairs:?}");
            let (settings, own) = (plain.ping(200).settings, disturbed.ping(200).settings);
            assert_eq!(settings, own, "{noise} {pairs:?}");
        }
    }
}

#[test]
fn a_bin_that_a_disturbance_does_not_touch_keeps_its_bits() {
    let plain = sonar(NoiseLevel::Nominal, &[]);
    let with = |pairs: &[&str]| sonar(NoiseLevel::Nominal, pairs);
    let power = |sonar: &SimulatedSonar| {
        let settings = sonar.dive().settings();
        let moment = Moment {
            sequence: 30,
            time_s: 0.75,
            world_from_sensor: sonar.dive().pose_during(0.75, 0.0),
        };
        let pose_after = |later_s| sonar.dive().pose_during(0.75, later_s);
        sonar.received(&moment, &settings, pose_after).power
    };
    let unchanged = |pairs: &[&str]| {
        let (before, after) = (power(&plain), power(&with(pairs)));
        let bins = before.iter().zip(&after);
        bins.filter(|(a, b)| a.to_bits() == b.to_bits()).count()
    };
    assert_eq!(unchanged(&[]), 600);
    // Three pulses of four bins touch fifteen at most.
    assert!((585..600).contains(&unchanged(&["spikes=3"])));
    assert!((595..600).contains(&unchanged(&["walker_mps=0.5"])));
    assert_eq!(unchanged(&["saturated_share=0.5"]), 600);
    assert!((1..600).contains(&unchanged(&["copy_offset_m=1.3"])));
    assert!((1..600).contains(&unchanged(&["multiple_ratio=1.7"])));
}

#[test]
fn a_copy_is_the_ping_once_more_at_its_offset() {
    let (plain, copied) = (
        sonar(NoiseLevel::None, &[]),
        sonar(NoiseLevel::None, &["copy_offset_m=1.5", "copy_db=10"]),
    );
    let mut heard = 0;
    for index in (0..800).step_by(20) {
        let (before, after) = (plain.ping(index).intensity, copied.ping(index).intensity);
        // 90 bins of 10 m / 600.
        for bin in 90..600 {
            let expected = before[bin] + 0.1 * before[bin - 90];
            assert!((after[bin] - expected).abs() < 2e-3 * expected + 1e-4);
            heard += usize::from(before[bin - 90] > 10.0);
        }
    }
    assert!(heard > 100, "{heard}");
}

/// A ball of 5 cm, its near side 5.95 m ahead of the sensor.
const BALL: &str = "name = \"t\"\n[[sphere]]\ncenter_m = [6, 0, 0]\nradius_m = 0.05";

fn loudest_m(sonar: &SimulatedSonar, time_s: f64) -> f64 {
    let settings = sonar.dive().settings();
    let ping = sonar.ping_along(0, time_s, &settings, |_| Pose::IDENTITY);
    let bins = ping.intensity.iter().enumerate();
    let (bin, _) = bins.max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
    settings.bin_center_m(bin)
}

#[test]
fn ranges_are_those_of_the_reported_speed_of_sound() {
    let of_ball = |pairs: &[&str]| {
        let sonar = of_scene(Scene::parse(BALL, None).unwrap(), NoiseLevel::None, pairs);
        [0.0, 10.0, 20.0].map(|time_s| loudest_m(&sonar, time_s))
    };
    let true_m = of_ball(&[])[0];
    assert!((true_m - 5.96).abs() < 0.02, "{true_m}");
    let wrong = ["sound_error=0.03", "sound_drift=-0.06"];
    for (range_m, error) in of_ball(&wrong).iter().zip([0.03, 0.0, -0.03]) {
        // Half a bin each.
        assert!(
            (range_m - true_m / (1.0 + error)).abs() < 0.018,
            "{error}: {range_m}"
        );
    }
}

#[test]
fn the_asked_share_of_echo_bins_is_clipped_at_one_level() {
    for noise in [NoiseLevel::Nominal, NoiseLevel::Field] {
        let (plain, clipped) = (sonar(noise, &[]), sonar(noise, &["saturated_share=0.2"]));
        let powers = plain.echo_bins();
        let above = powers
            .iter()
            .filter(|power| **power >= clipped.stop)
            .count();
        let share = above as f64 / powers.len() as f64;
        assert!(
            powers.len() > 1000 && (share - 0.2).abs() < 1e-3,
            "{noise}: {share}"
        );
        let most_db = 10.0 * clipped.stop.log10();
        let mut at_stop = 0;
        for index in (0..800).step_by(20) {
            let profile = clipped.ping(index).profile;
            assert!(f64::from(profile.max_pwr_db) <= most_db + 1e-5);
            let full = profile
                .pwr_results
                .iter()
                .filter(|raw| **raw == u16::MAX)
                .count();
            at_stop += usize::from(full > 1);
        }
        assert!(at_stop > 10, "{noise}: {at_stop}");
        let fixed = sonar(noise, &["saturated_db=15"]);
        assert!((fixed.stop - 10f64.powf(1.5)).abs() < 1e-9);
    }
}

#[test]
fn spikes_stand_above_the_mean_noise_by_what_was_asked() {
    for noise in [NoiseLevel::Nominal, NoiseLevel::Field] {
        let pairs = ["spikes=1", "spike_db=30", "spike_bins=8"];
        let (plain, spiky) = (sonar(noise, &[]), sonar(noise, &pairs));
        let mut levels = Vec::new();
        for index in (5..800).step_by(10) {
            let (before, after) = (plain.ping(index), spiky.ping(index));
            let noise_power = plain.mean_noise(&before.settings);
            let added = before.intensity.iter().zip(&after.intensity);
            let added = added.map(|(a, b)| f64::from(b - a) / noise_power);
            levels.push(added.fold(0.0, f64::max));
        }
        levels.sort_by(f64::total_cmp);
        let middle_db = 10.0 * levels[levels.len() / 2].log10();
        assert!((middle_db - 30.0).abs() < 0.3, "{noise}: {middle_db}");
    }
}

#[test]
fn fish_and_images_are_added_to_the_echoes_that_are_there() {
    let plain = sonar(NoiseLevel::None, &[]);
    for pairs in [["fish=40", "fish_db=-20"], ["surface_m=4", "surface_db=0"]] {
        let disturbed = sonar(NoiseLevel::None, &pairs);
        let (mut more, mut less) = (0, 0);
        for index in (0..800).step_by(20) {
            let (before, after) = (plain.ping(index), disturbed.ping(index));
            let bins = before.intensity.iter().zip(&after.intensity);
            for (before, after) in bins {
                more += usize::from(*after > 1.01 * before + 1e-3);
                less += usize::from(*after < 0.99 * before - 1e-3);
            }
        }
        assert!(more > 100 && less == 0, "{pairs:?}: {more} {less}");
    }
}

#[test]
fn a_fish_is_heard_where_it_swims() {
    let pairs = ["fish=1", "fish_db=-20"];
    let sonar = of_scene(Scene::named("empty").unwrap(), NoiseLevel::None, &pairs);
    let fish = sonar.swimmers[0].at(7.0);
    // 4 m before it, looking at it.
    let pose = Pose {
        rotation: glam::DQuat::IDENTITY,
        translation_m: fish - 4.0 * DVec3::X,
    };
    let settings = sonar.dive().settings();
    let ping = sonar.ping_along(0, 7.0, &settings, |_| pose);
    let bins = ping.intensity.iter().enumerate();
    let (bin, _) = bins.max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
    assert!((settings.bin_center_m(bin) - 4.0).abs() < 0.02);
}

#[test]
fn reported_poses_are_late_and_turned_by_what_was_asked() {
    let pairs = ["pose_latency_s=0.1", "mount_yaw_deg=2"];
    let sonar = sonar(NoiseLevel::None, &pairs);
    let dive = sonar.dive();
    let pose = dive.reported_poses()[500];
    let held = dive.pose_during(pose.time.as_secs_f64() - 0.1, 0.0);
    let reported = pose.world_from_vehicle;
    assert!(reported.translation_m.distance(held.translation_m) < 1e-9);
    let turn = reported.rotation.inverse() * held.rotation;
    assert!((turn.to_scaled_axis() - DVec3::Z * 2f64.to_radians()).length() < 1e-9);
}

#[test]
fn a_surface_below_the_vehicle_and_numbers_out_of_range_are_refused() {
    let scene = Scene::named("fence").unwrap();
    let refused = |change: fn(&mut Disturbances)| {
        let mut options = DiveOptions::default();
        change(&mut options.disturbances);
        let dive = Dive::plan_with(DiveKind::Survey, &scene, NoiseLevel::None, 1, &options);
        dive.unwrap_err().to_string()
    };
    let low = refused(|d| d.surface.height_m = 0.5);
    assert!(
        low.contains("0.5") && low.contains("must lie above"),
        "{low}"
    );
    let many = refused(|d| d.spikes.per_ping = 1e9);
    assert!(many.contains("spikes") && many.contains("64"), "{many}");
}
