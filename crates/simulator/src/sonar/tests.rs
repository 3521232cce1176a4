use std::sync::Arc;

use echosplat_model::{PingSettings, Pose};
use glam::DVec3;

use super::device_side::DeviceSide;
use super::echo::{MovingSensor, power_per_bin};
use super::radiometry::Radiometry;
use super::*;
use crate::beam::{Fan, SideLobes};
use crate::random::{Purpose, Random};
use crate::scene::Scene;
use crate::{Dive, DiveKind, DiveOptions};

const SETTINGS: PingSettings = PingSettings {
    range_start_m: 0.0,
    range_length_m: 10.0,
    bin_count: 500,
    speed_of_sound_mps: 1500.0,
    frequency_hz: 451_127.0,
    pulse_duration_s: 2e-5,
    gain_index: 0,
};

fn parse(solids: &str) -> Scene {
    Scene::parse(&format!("name = \"t\"\n{solids}"), None).unwrap()
}

/// Noiseless power of `count` pings with different rays, averaged.
fn echoes(scene: &Scene, pose: Pose, settings: &PingSettings, count: u64) -> Vec<f64> {
    echoes_by(Radiometry::Even, scene, pose, settings, count)
}

fn echoes_by(
    radiometry: Radiometry,
    scene: &Scene,
    pose: Pose,
    settings: &PingSettings,
    count: u64,
) -> Vec<f64> {
    let sensor = MovingSensor::new(settings.range_end_m(), |_| pose);
    let fan = Fan::new(SideLobes::Without);
    let mut mean = vec![0.0; settings.bin_count];
    for index in 0..count {
        let mut random = Random::new(1, Purpose::Rays, index);
        let power = power_per_bin(scene, &sensor, settings, &fan, radiometry, &mut random);
        for (mean, power) in mean.iter_mut().zip(power) {
            *mean += power / count as f64;
        }
    }
    mean
}

fn total(power: &[f64]) -> f64 {
    power.iter().sum()
}

fn peak(power: &[f64]) -> usize {
    (0..power.len())
        .max_by(|&a, &b| power[a].total_cmp(&power[b]))
        .unwrap()
}

/// A target and a sensor, worked by hand. Bins are 0.02 m long and begin at range 0.
struct Case {
    why: &'static str,
    target_m: [f64; 3],
    yaw_pitch_roll_deg: [f64; 3],
    position_m: [f64; 3],
    /// Bin of the echo, azimuth and elevation in degrees; no bin if it is out of the beam.
    bin: Option<usize>,
    azimuth_deg: f64,
    elevation_deg: f64,
}

/// The target is a ball of 2 cm radius: its near side is 0.02 m, one bin, before its centre, and
/// most of its power comes from the first centimetre behind that.
const CASES: [Case; 14] = [
    Case {
        why: "straight ahead: r = 5.01 − 0.02 = 4.99, 4.99 / 0.02 = 249.5",
        target_m: [5.01, 0.0, 0.0],
        yaw_pitch_roll_deg: [0.0, 0.0, 0.0],
        position_m: [0.0, 0.0, 0.0],
        bin: Some(249),
        azimuth_deg: 0.0,
        elevation_deg: 0.0,
    },
    Case {
        why: "3-4-5 in the x–z plane: r = 5, 4.98 / 0.02 = 249; φ = atan(1.4 / 4.8) = 16.26°",
        target_m: [4.809, 0.0, 1.4026],
        yaw_pitch_roll_deg: [0.0, 0.0, 0.0],
        position_m: [0.0, 0.0, 0.0],
        bin: Some(249),
        azimuth_deg: 0.0,
        elevation_deg: 16.26,
    },
    Case {
        why: "5° to port of a beam 0.8° wide: nothing",
        target_m: [4.981, 0.4358, 0.0],
        yaw_pitch_roll_deg: [0.0, 0.0, 0.0],
        position_m: [0.0, 0.0, 0.0],
        bin: None,
        azimuth_deg: 5.0,
        elevation_deg: 0.0,
    },
    Case {
        why: "yawed 5° to port it lies ahead again: r = √(4.981² + 0.4358²) = 5.00 → 249",
        target_m: [4.99, 0.4366, 0.0],
        yaw_pitch_roll_deg: [5.0, 0.0, 0.0],
        position_m: [0.0, 0.0, 0.0],
        bin: Some(249),
        azimuth_deg: 0.0,
        elevation_deg: 0.0,
    },
    Case {
        why: "facing north: a target 3.01 m north of (1, 2) lies ahead: 2.99 / 0.02 = 149.5",
        target_m: [1.0, 5.01, 0.0],
        yaw_pitch_roll_deg: [90.0, 0.0, 0.0],
        position_m: [1.0, 2.0, 0.0],
        bin: Some(149),
        azimuth_deg: 0.0,
        elevation_deg: 0.0,
    },
    Case {
        why: "heaved up by 1 m: z = −1, r = √(16 + 1) = 4.1231, (4.1231 − 0.02) / 0.02 = 205.2; \
              φ = −atan(1/4) = −14.04°",
        target_m: [4.0, 0.0, 0.0],
        yaw_pitch_roll_deg: [0.0, 0.0, 0.0],
        position_m: [0.0, 0.0, 1.0],
        bin: Some(205),
        azimuth_deg: 0.0,
        elevation_deg: -14.04,
    },
    Case {
        why: "heaved up by 3 m: φ = −atan(3/4) = −36.87°, outside the fan's ±25°",
        target_m: [4.0, 0.0, 0.0],
        yaw_pitch_roll_deg: [0.0, 0.0, 0.0],
        position_m: [0.0, 0.0, 3.0],
        bin: None,
        azimuth_deg: 0.0,
        elevation_deg: -36.87,
    },
    Case {
        why: "…and pitched down by 36.87° (positive pitch lowers the nose) it lies ahead: \
              r = 5.01, 4.99 / 0.02 = 249.5",
        target_m: [4.008, 0.0, -0.006],
        yaw_pitch_roll_deg: [0.0, 36.87, 0.0],
        position_m: [0.0, 0.0, 3.0],
        bin: Some(249),
        azimuth_deg: 0.0,
        elevation_deg: 0.0,
    },
    Case {
        why: "rolled by 90° port side up: what was above, z = 1, is now to port, y = 1: \
              θ = atan(1/4) = 14.04°, out of the beam",
        target_m: [4.0, 0.0, 1.0],
        yaw_pitch_roll_deg: [0.0, 0.0, 90.0],
        position_m: [0.0, 0.0, 0.0],
        bin: None,
        azimuth_deg: 14.04,
        elevation_deg: 0.0,
    },
    Case {
        why: "rolled by 90°: what was to starboard, y = −1, is now above: φ = 14.04°, \
              r = √17 = 4.1231 → 205",
        target_m: [4.0, -1.0, 0.0],
        yaw_pitch_roll_deg: [0.0, 0.0, 90.0],
        position_m: [0.0, 0.0, 0.0],
        bin: Some(205),
        azimuth_deg: 0.0,
        elevation_deg: 14.04,
    },
    Case {
        why: "rolled by 30°, port side up: the fan's plane holds (x, −sin 30°, cos 30°)·k; with \
              k = 1.2: y = −0.6, z = 1.0392, r = √(16 + 1.44) = 4.1761, 4.1561 / 0.02 = 207.8; \
              φ = atan(1.2 / 4) = 16.70°",
        target_m: [4.0, -0.6, 1.0392],
        yaw_pitch_roll_deg: [0.0, 0.0, 30.0],
        position_m: [0.0, 0.0, 0.0],
        bin: Some(207),
        azimuth_deg: 0.0,
        elevation_deg: 16.70,
    },
    Case {
        why: "rolled by 30° the mirror image at z = −1.0392 is out of the beam: \
              y' = −0.6·cos 30° − 1.0392·sin 30° = −1.0392, z' = 0.3 − 0.9 = −0.6: \
              θ = −atan(1.0392/4) = −14.56°, φ = −atan(0.6/4.1328) = −8.26°",
        target_m: [4.0, -0.6, -1.0392],
        yaw_pitch_roll_deg: [0.0, 0.0, 30.0],
        position_m: [0.0, 0.0, 0.0],
        bin: None,
        azimuth_deg: -14.56,
        elevation_deg: -8.26,
    },
    Case {
        why: "facing west from (2, 1, −1), rolled by −20° (starboard up): a target 6 m ahead and \
              1 m up the fan. Port of a sensor facing west is south; rolled by −20° its up leans \
              to port: up' = z·cos 20° + south·sin 20°, so the target is at \
              (2 − 6, 1 − 0.3420, −1 + 0.9397); r = √37 = 6.0828, 6.0628 / 0.02 = 303.1",
        target_m: [-4.0, 0.6580, -0.0603],
        yaw_pitch_roll_deg: [180.0, 0.0, -20.0],
        position_m: [2.0, 1.0, -1.0],
        bin: Some(303),
        azimuth_deg: 0.0,
        elevation_deg: 9.46,
    },
    Case {
        why: "behind: never",
        target_m: [-5.0, 0.0, 0.0],
        yaw_pitch_roll_deg: [0.0, 0.0, 0.0],
        position_m: [0.0, 0.0, 0.0],
        bin: None,
        azimuth_deg: 180.0,
        elevation_deg: 0.0,
    },
];

#[test]
fn echoes_appear_where_a_hand_calculation_puts_them() {
    for case in &CASES {
        let [yaw, pitch, roll] = case.yaw_pitch_roll_deg.map(f64::to_radians);
        let pose = Pose::from_yaw_pitch_roll(yaw, pitch, roll, DVec3::from(case.position_m));
        let target = DVec3::from(case.target_m);
        let local = pose.inverse() * target;
        let azimuth_deg = local.y.atan2(local.x).to_degrees();
        let elevation_deg = local.z.atan2(local.truncate().length()).to_degrees();
        assert!(
            (azimuth_deg - case.azimuth_deg).abs() < 0.02,
            "{}: θ {azimuth_deg}",
            case.why
        );
        assert!(
            (elevation_deg - case.elevation_deg).abs() < 0.02,
            "{}: φ {elevation_deg}",
            case.why
        );
        let [x, y, z] = case.target_m;
        let scene = parse(&format!(
            "[[sphere]]\ncenter_m = [{x}, {y}, {z}]\nradius_m = 0.02"
        ));
        let power = echoes(&scene, pose, &SETTINGS, 8);
        match case.bin {
            Some(bin) => {
                let peak = peak(&power);
                assert!(peak.abs_diff(bin) <= 1, "{}: peak {peak}", case.why);
                let near = &power[bin - 4..bin + 6];
                assert!(total(near) > 0.99 * total(&power), "{}", case.why);
            }
            None => assert!(total(&power) < 1e-12, "{}", case.why),
        }
    }
}

/// ∫ over a disc of angular radius `half_rad` of the beam's sensitivity across.
fn disc_in_beam(half_rad: f64) -> f64 {
    let steps = 2000;
    let step_rad = 2.0 * half_rad / f64::from(steps);
    let slice = |index: i32| {
        let azimuth_rad = -half_rad + (f64::from(index) + 0.5) * step_rad;
        let height_rad = 2.0 * (half_rad.powi(2) - azimuth_rad.powi(2)).sqrt();
        crate::azimuth_weight(azimuth_rad) * height_rad * step_rad
    };
    (0..steps).map(slice).sum()
}

#[test]
fn a_balls_energy_is_the_solid_angle_it_fills() {
    let energy = |range_m: f64| {
        let ball = format!("[[sphere]]\ncenter_m = [{range_m}, 0, 0]\nradius_m = 0.03");
        total(&echoes(&parse(&ball), Pose::IDENTITY, &SETTINGS, 400))
    };
    for range_m in [2.0, 4.0, 8.0] {
        let ratio = energy(range_m) / disc_in_beam(0.03 / range_m);
        assert!((ratio - 1.0).abs() < 0.05, "at {range_m} m: {ratio}");
    }
    // Where the ball is small against the beam that is energy × r² = constant.
    let ratio = 64.0 * energy(8.0) / (36.0 * energy(6.0));
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
}

#[test]
fn a_floor_gives_no_comb() {
    let floor = parse("[[plane]]\npoint_m = [0, 0, -1.5]");
    let power = echoes(&floor, Pose::IDENTITY, &SETTINGS, 1);
    // Fan edge at 25°: first strong echoes at 1.5 / sin 25° = 3.55 m, bin 177.
    for bin in 200..450 {
        let around = 0.5 * (power[bin - 1] + power[bin + 1]);
        let ripple = power[bin] / around - 1.0;
        assert!(ripple.abs() < 0.02, "bin {bin}: {ripple}");
    }
    // Power per range of a floor at height h: dφ/dr·cos φ ≈ h / r², for φ well inside the fan.
    let ratio = power[300] / power[400] / (400.5f64 / 300.5).powi(2);
    assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
}

#[test]
fn a_wall_seen_head_on_is_one_sharp_edge() {
    let wall = parse("[[box]]\ncenter_m = [4.51, 0, 0]\nsize_m = [1, 8, 0.4]");
    let power = echoes(&wall, Pose::IDENTITY, &SETTINGS, 4);
    // Face at 4.01 m: bin 200; 0.2 m up and down adds 5 mm of range.
    assert_eq!(peak(&power), 200);
    assert!(total(&power[198..203]) > 0.99 * total(&power));
}

#[test]
fn what_stands_before_hides_what_stands_behind() {
    let far = "[[sphere]]\ncenter_m = [6, 0, 0]\nradius_m = 0.2\n";
    let near = "[[sphere]]\ncenter_m = [3, 0, 0]\nradius_m = 0.2\n";
    let off = "[[sphere]]\ncenter_m = [3, 0, 0.8]\nradius_m = 0.2\n";
    let behind = |scene: &str| total(&echoes(&parse(scene), Pose::IDENTITY, &SETTINGS, 4)[250..]);
    assert!(behind(far) > 0.0);
    assert!(behind(&format!("{far}{near}")) < 1e-15);
    let beside = behind(&format!("{far}{off}")) / behind(far);
    assert!((beside - 1.0).abs() < 1e-9);
}

#[test]
fn a_smooth_wall_goes_dark_when_it_turns_away() {
    let lit = |yaw_deg: f64, specular: u32| {
        let solid = format!(
            "[[box]]\ncenter_m = [5, 0, 0]\nsize_m = [0.1, 4, 0.3]\nspecular = {specular}\n\
             yaw_pitch_roll_deg = [{yaw_deg}, 0, 0]"
        );
        total(&echoes(&parse(&solid), Pose::IDENTITY, &SETTINGS, 2))
    };
    assert!((lit(40.0, 0) / lit(0.0, 0) - 1.0).abs() < 0.05);
    let fall = lit(40.0, 12) / lit(0.0, 12);
    let expected = 40f64.to_radians().cos().powi(12);
    assert!((fall / expected - 1.0).abs() < 0.1, "{fall} {expected}");
}

#[test]
fn the_sensor_moves_while_it_listens() {
    // At 120°/s the heading turns by 0.48° in the 4 ms until the echo from 6 m meets the target.
    let target = parse("[[sphere]]\ncenter_m = [6, 0, 0]\nradius_m = 0.02");
    let turning = |sign: f64| {
        let sensor = MovingSensor::new(10.0, |range_m| {
            let turned = sign * 120f64.to_radians() * range_m / 1500.0;
            Pose::from_yaw_pitch_roll(turned, 0.0, 0.0, DVec3::ZERO)
        });
        let fan = Fan::new(SideLobes::Without);
        let power = |index| {
            let mut random = Random::new(2, Purpose::Rays, index);
            total(&power_per_bin(
                &target,
                &sensor,
                &SETTINGS,
                &fan,
                Radiometry::Even,
                &mut random,
            ))
        };
        (0..400).map(power).sum::<f64>()
    };
    let still = turning(0.0);
    let expected = crate::azimuth_weight(0.48f64.to_radians());
    for sign in [-1.0, 1.0] {
        let share = turning(sign) / still;
        assert!((share - expected).abs() < 0.05, "{share} {expected}");
    }
}

fn sonar(scene: &str, noise: NoiseLevel, seed: u64) -> SimulatedSonar {
    let scene = Arc::new(Scene::named(scene).unwrap());
    let options = DiveOptions {
        duration_s: 20.0,
        ..DiveOptions::default()
    };
    let dive = Dive::plan_with(DiveKind::Survey, &scene, noise, seed, &options).unwrap();
    SimulatedSonar::new(scene, Arc::new(dive), noise, seed)
}

#[test]
fn the_background_lies_45_db_below_the_strongest_echo_and_is_exponential() {
    let sonar = sonar("empty", NoiseLevel::Nominal, 1);
    let far: Vec<f64> = (0..20)
        .flat_map(|index| sonar.ping(index).intensity.split_off(100))
        .map(f64::from)
        .collect();
    let mean = far.iter().sum::<f64>() / far.len() as f64;
    let variance = far.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / far.len() as f64;
    assert!((10.0 * mean.log10() + 16.0).abs() < 0.2, "{mean}");
    assert!((variance / (mean * mean) - 1.0).abs() < 0.15);
    let fence = self::sonar("fence", NoiseLevel::None, 1);
    let strongest = (0..fence.dive().pings())
        .map(|index| fence.ping(index).profile.max_pwr_db)
        .fold(f32::NEG_INFINITY, f32::max);
    // By the 192 pings it is measured on; others may be a little stronger.
    assert!((29.0..31.5).contains(&strongest), "{strongest}");
}

#[test]
fn speckle_has_the_variance_of_its_looks() {
    for (noise, looks) in [(NoiseLevel::Nominal, 4.0), (NoiseLevel::Harsh, 1.0)] {
        let device = DeviceSide {
            level: noise,
            seed: 3,
            strongest: 1.0,
        };
        let mut shares = Vec::new();
        for sequence in 0..100 {
            // Bins 100 to 200, at 2 to 4 m, without neighbours: ghosts fall beyond.
            let mut echoes = vec![0.0; 500];
            echoes[100..130].fill(1.0);
            let heard = device.heard(sequence, &SETTINGS, echoes);
            let full = 10f64.powf(2.9);
            // A dropout leaves the floor only.
            if heard[100..130].iter().sum::<f64>() > full {
                shares.extend(heard[100..130].iter().map(|power| power / full));
            }
        }
        let mean = shares.iter().sum::<f64>() / shares.len() as f64;
        let variance = shares.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / shares.len() as f64;
        assert!((mean - 1.0).abs() < 0.06, "{mean}");
        assert!(
            (variance * looks - 1.0).abs() < 0.15,
            "{}",
            variance * looks
        );
    }
}

#[test]
fn ring_down_is_loud_and_gone_by_the_blanking_range() {
    let ping = sonar("empty", NoiseLevel::Nominal, 1).ping(3);
    let level_db = |bin: usize| 10.0 * ping.intensity[bin].log10();
    // 61 − 16 dB at range 0, less 4.34 dB per 3 cm: half a bin of 1.67 cm takes 1.2 dB.
    assert!((level_db(0) - 43.8).abs() < 0.5, "{}", level_db(0));
    let beyond = ping.settings.bin_of_range(0.5).unwrap();
    assert!((beyond..beyond + 100).all(|bin| level_db(bin) < -4.0));
}

#[test]
fn harsh_pings_have_ghosts_dropouts_and_a_walking_gain() {
    let device = DeviceSide {
        level: NoiseLevel::Harsh,
        seed: 3,
        strongest: 1.0,
    };
    let mut ghosts = Vec::new();
    let mut dropouts = 0;
    for sequence in 0..2000 {
        let mut echoes = vec![0.0; 500];
        echoes[200] = 1.0;
        let heard = device.heard(sequence, &SETTINGS, echoes);
        // Bin 200 covers 4.00 to 4.02 m; its ghost 6.00 to 6.03 m: bin 300 and half of 301.
        ghosts.push(heard[300] + heard[301]);
        dropouts += usize::from(heard[200] < 0.5);
    }
    let ghost = ghosts.iter().sum::<f64>() / 2000.0 / 10f64.powf(2.9);
    assert!((ghost / 0.095 - 1.0).abs() < 0.15, "{ghost}");
    // 5 % of 2000, give or take three sigmas of 10; single-look speckle is rarely that dark.
    assert!((70..135).contains(&dropouts), "{dropouts}");
    let sonar = sonar("fence", NoiseLevel::Harsh, 1);
    let gain: Vec<i16> = (0..800)
        .map(|index| sonar.ping(index).settings.gain_index)
        .collect();
    assert_eq!(gain[..5], [0, 4, 5, 6, 7]);
    assert!(gain[5..].windows(2).any(|pair| pair[0] != pair[1]));
    assert!(sonar.ping(799).settings.range_length_m > 11.9);
    assert!(sonar.ping(100).settings.range_length_m < 10.1);
}

#[test]
fn the_first_echoes_of_each_level_stay_what_they_are() {
    // Bins 250 to 253 of ping 40, on the scale of 65535; another processor's logarithms may round
    // differently.
    for (noise, expected) in [
        (NoiseLevel::None, [45445, 45281, 45248, 45091]),
        (NoiseLevel::Nominal, [34409, 34542, 33504, 31611]),
        (NoiseLevel::Harsh, [23688, 34065, 33148, 29913]),
    ] {
        let ping = sonar("pier", noise, 3).ping(40);
        let found = &ping.profile.pwr_results[250..254];
        let is_near = |(found, expected): (&u16, &u16)| found.abs_diff(*expected) <= 2;
        assert!(
            found.iter().zip(&expected).all(is_near),
            "{noise}: {found:?}"
        );
    }
}

#[test]
fn pings_are_pure_functions_of_seed_and_number() {
    let one = sonar("pier", NoiseLevel::Harsh, 5);
    let other = sonar("pier", NoiseLevel::Harsh, 5);
    let backwards: Vec<_> = (0..40).rev().map(|index| other.ping(index)).collect();
    for (index, ping) in backwards.iter().rev().enumerate() {
        assert_eq!(&one.ping(index), ping);
    }
    assert_ne!(sonar("pier", NoiseLevel::Harsh, 6).ping(7), one.ping(7));
}

#[test]
fn sixteen_bit_decibels_lose_less_than_a_thousandth() {
    let power: Vec<f64> = (0..600).map(|i| 1e-2 * 1.02f64.powi(i)).collect();
    let profile = Profile::from_power(&power);
    for (read, &meant) in profile.intensity().iter().zip(&power) {
        assert!((f64::from(*read) / meant - 1.0).abs() < 1e-3);
    }
    for odd in [vec![], vec![0.0; 5], vec![7.0; 5]] {
        let profile = Profile::from_power(&odd);
        assert!(profile.max_pwr_db >= profile.min_pwr_db);
        assert!(profile.intensity().iter().all(|i| i.is_finite()));
    }
}

#[test]
fn other_settings_than_the_dives_are_obeyed_and_bad_ones_harmless() {
    let sonar = sonar("fence", NoiseLevel::None, 1);
    let settings = PingSettings {
        range_start_m: 2.0,
        range_length_m: 6.0,
        bin_count: 200,
        ..sonar.dive().settings()
    };
    let (cut, whole) = (sonar.ping_at(9, 0.225, &settings), sonar.ping(9));
    assert_eq!(cut.intensity.len(), 200);
    let range_of = |ping: &SimulatedPing| {
        let power: Vec<f64> = ping.intensity.iter().map(|&i| f64::from(i)).collect();
        ping.settings.bin_center_m(peak(&power))
    };
    let (a, b) = (range_of(&cut), range_of(&whole));
    assert!((a - b).abs() < 0.05, "{a} {b}");
    let bad = PingSettings {
        range_length_m: f64::NAN,
        ..settings
    };
    assert!(sonar.ping_at(9, 0.225, &bad).intensity.is_empty());
    assert!(sonar.ping(9).to_ping().is_ok());
}

#[test]
fn another_way_and_another_scale_change_what_they_must_and_no_more() {
    let scene = Arc::new(Scene::named("fence").unwrap());
    let plan = |seed| Dive::plan(DiveKind::Survey, &scene, NoiseLevel::None, seed).unwrap();
    let sonar = |seed| {
        SimulatedSonar::new(
            Arc::clone(&scene),
            Arc::new(plan(seed)),
            NoiseLevel::None,
            seed,
        )
    };
    let (own, other) = (sonar(1), sonar(2));
    let (time_s, settings) = (12.0, own.dive().settings());
    let heard = own.ping_at(7, time_s, &settings);
    let along = |sonar: &SimulatedSonar, ahead_s: f64| {
        let dive = Arc::clone(own.dive());
        sonar.ping_along(7, time_s, &settings, |later_s| {
            dive.pose_during(time_s + ahead_s, later_s)
        })
    };
    assert_eq!(along(&own, 0.0).intensity, heard.intensity);
    assert_ne!(along(&own, 1.0).intensity, heard.intensity);
    let rescaled = sonar(1).on_scale_of(&other);
    let loudest = |sonar: &SimulatedSonar| {
        let ping = sonar.ping_at(7, time_s, &settings);
        f64::from(ping.intensity.iter().copied().fold(0.0, f32::max))
    };
    assert!((loudest(&rescaled) / loudest(&own) - 1.0).abs() > 1e-3);
    let back = rescaled.on_scale_of(&own);
    assert_eq!(
        back.ping_at(7, time_s, &settings).intensity,
        heard.intensity
    );
}
