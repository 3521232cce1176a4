use std::sync::Arc;

use glam::DVec3;

use super::*;
use crate::random::Random;
use crate::sonar::echo::{MovingSensor, power_per_bin};
use crate::sonar::radiometry::Radiometry;
use crate::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene, SimulatedSonar};

const SETTINGS: PingSettings = PingSettings {
    range_start_m: 0.0,
    range_length_m: 10.0,
    bin_count: 600,
    speed_of_sound_mps: 1500.0,
    frequency_hz: 451_127.0,
    pulse_duration_s: 4.44e-5,
    gain_index: 7,
};
/// 0.5 m: the ring-down is over.
const BEYOND: usize = 30;

fn at_rest(sequence: u64) -> Moment {
    moved(sequence, DVec3::ZERO, 0.0)
}

fn moved(sequence: u64, place: DVec3, yaw_deg: f64) -> Moment {
    Moment {
        sequence,
        time_s: 0.025 * sequence as f64,
        world_from_sensor: Pose::from_yaw_pitch_roll(yaw_deg.to_radians(), 0.0, 0.0, place),
    }
}

/// Power per bin beyond the ring-down, over the mean noise, of so many pings.
fn pings(echo: f64, moment: impl Fn(u64) -> Moment, count: u64) -> Vec<Vec<f64>> {
    let unit = FieldUnit::new(3).with_echo_over_noise(1.0);
    let echoes = vec![echo; SETTINGS.bin_count];
    let ping = |sequence| {
        let mut received = unit.received(&moment(sequence), &SETTINGS, &echoes);
        received.split_off(BEYOND)
    };
    (0..count).map(ping).collect()
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

/// Pearson's coefficient.
fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let over = |of: &dyn Fn(&(f64, f64)) -> f64| mean(pairs.iter().map(of));
    let (a, b) = (over(&|p| p.0), over(&|p| p.1));
    let covariance = over(&|p| (p.0 - a) * (p.1 - b));
    covariance / (over(&|p| (p.0 - a).powi(2)) * over(&|p| (p.1 - b).powi(2))).sqrt()
}

fn of_bins(pings: &[Vec<f64>], apart: usize) -> f64 {
    let of_ping = |ping: &Vec<f64>| -> Vec<(f64, f64)> {
        let neighbours = ping.iter().zip(&ping[apart..]);
        neighbours.map(|(a, b)| (*a, *b)).collect()
    };
    correlation(&pings.iter().flat_map(of_ping).collect::<Vec<_>>())
}

fn of_pings(pings: &[Vec<f64>], apart: usize) -> f64 {
    let of_pair = |(a, b): (&Vec<f64>, &Vec<f64>)| -> Vec<(f64, f64)> {
        a.iter().zip(b).map(|(a, b)| (*a, *b)).collect()
    };
    let neighbours = pings.iter().zip(&pings[apart..]);
    correlation(&neighbours.flat_map(of_pair).collect::<Vec<_>>())
}

#[test]
fn a_walls_echo_falls_with_its_range() {
    let energy = |radiometry, range_m: f64| -> f64 {
        let x = range_m + 0.5;
        let wall = format!("name = \"t\"\n[[box]]\ncenter_m = [{x}, 0, 0]\nsize_m = [1, 40, 40]");
        let wall = Scene::parse(&wall, None).unwrap();
        let sensor = MovingSensor::new(10.0, |_| Pose::IDENTITY);
        let fan = crate::beam::Fan::new(crate::beam::SideLobes::Without);
        let mut random = Random::new(1, Purpose::Rays, 0);
        let power = power_per_bin(&wall, &sensor, &SETTINGS, &fan, radiometry, &mut random);
        power.into_iter().sum()
    };
    let fall = |radiometry| energy(radiometry, 3.0) / energy(radiometry, 6.0);
    assert!((fall(Radiometry::Even) - 1.0).abs() < 0.01);
    // Four times for spreading; 3 m more there and back take 0.6 dB, a little more off the axis.
    let expected = 4.0 * 10f64.powf(0.1 * 0.6);
    let ratio = fall(Radiometry::Sea) / expected;
    assert!((1.0..1.02).contains(&ratio), "{ratio}");
}

#[test]
fn noise_is_flat_over_range_and_exponential() {
    let pings = pings(0.0, at_rest, 60);
    let level =
        |bins: std::ops::Range<usize>| mean(pings.iter().flat_map(|p| p[bins.clone()].to_vec()));
    let (near, far) = (level(0..190), level(380..570));
    assert!(
        (near - 1.0).abs() < 0.04 && (far - 1.0).abs() < 0.04,
        "{near} {far}"
    );
    let decibels: Vec<f64> = pings
        .iter()
        .flatten()
        .map(|power| 10.0 * power.log10())
        .collect();
    let middle = mean(decibels.iter().copied());
    let square = mean(decibels.iter().map(|db| (db - middle).powi(2)));
    // The logarithm of an exponential power scatters by 10 / ln 10 · π/√6 = 5.57 dB.
    assert!((square.sqrt() - 5.57).abs() < 0.12, "{}", square.sqrt());
}

#[test]
fn speckle_is_of_one_look_and_adds_to_noise_as_amplitudes_do() {
    for echo in [9.0, 1e6] {
        // Far enough apart to be independent.
        let apart = |sequence| moved(sequence, DVec3::X * sequence as f64, 0.0);
        let pings = pings(echo, apart, 60);
        let level = mean(pings.iter().flatten().copied());
        let square = mean(pings.iter().flatten().map(|power| (power - level).powi(2)));
        assert!((level / (echo + 1.0) - 1.0).abs() < 0.05, "{level}");
        assert!(
            (square.sqrt() / level - 1.0).abs() < 0.06,
            "{}",
            square.sqrt() / level
        );
    }
}

#[test]
fn neighbouring_bins_correlate_as_measured() {
    for echo in [0.0, 1e6] {
        let apart = |sequence| moved(sequence, DVec3::X * sequence as f64, 0.0);
        let pings = pings(echo, apart, 60);
        let next = of_bins(&pings, 1);
        assert!((0.4..0.5).contains(&next), "{echo}: {next}");
        assert!(of_bins(&pings, 3).abs() < 0.05);
    }
}

#[test]
fn pings_correlate_at_rest_and_not_when_the_sensor_moves_or_turns() {
    let resting = pings(1e6, at_rest, 80);
    let [next, after] = [1, 40].map(|apart| of_pings(&resting, apart));
    // A real unit's: 0.35 to 0.55 up to 0.1 s, 0.12 to 0.41 after 1 s.
    assert!((0.35..0.55).contains(&next), "{next}");
    assert!((0.12..0.41).contains(&after), "{after}");
    assert!(of_pings(&pings(0.0, at_rest, 40), 1).abs() < 0.05);
    let shifted = |sequence| moved(sequence, DVec3::Y * 0.012 * sequence as f64, 0.0);
    let turned = |sequence| moved(sequence, DVec3::ZERO, 1.0 * sequence as f64);
    let slow = |sequence| moved(sequence, DVec3::Y * 0.001 * sequence as f64, 0.0);
    assert!(of_pings(&pings(1e6, shifted, 40), 1).abs() < 0.08);
    assert!(of_pings(&pings(1e6, turned, 40), 1).abs() < 0.08);
    assert!((0.3..0.5).contains(&of_pings(&pings(1e6, slow, 40), 1)));
}

#[test]
fn gain_scales_echo_and_noise_by_the_measured_steps() {
    let unit = FieldUnit::new(3);
    let mut echoes = vec![0.0; SETTINGS.bin_count];
    echoes[300..320].fill(1e-4);
    let heard = |gain_index| {
        let settings = PingSettings {
            gain_index,
            ..SETTINGS
        };
        unit.heard(&at_rest(1), &settings, &echoes)
    };
    for (index, step_db) in [(4, 4.2), (5, 6.1), (6, 5.2)] {
        let (low, high) = (heard(index), heard(index + 1));
        for (low, high) in low.iter().zip(&high) {
            assert!((10.0 * (high / low).log10() - step_db).abs() < 1e-6);
        }
    }
    let noise = mean(heard(7)[BEYOND..300].iter().copied());
    assert!((10.0 * noise.log10() - 6.4).abs() < 1.0, "{noise}");
}

#[test]
fn ring_down_is_loud_and_gone_by_40_cm() {
    let unit = FieldUnit::new(3);
    let silent = vec![0.0; SETTINGS.bin_count];
    let level_db = |gain_index: i16, bins: std::ops::Range<usize>| {
        let settings = PingSettings {
            gain_index,
            ..SETTINGS
        };
        let heard: Vec<f64> = (0..40)
            .flat_map(|sequence| {
                unit.heard(&at_rest(sequence), &settings, &silent)[bins.clone()].to_vec()
            })
            .collect();
        10.0 * mean(heard.into_iter()).log10()
    };
    assert!((43.0..46.0).contains(&level_db(4, 0..1)));
    assert!((58.0..61.0).contains(&level_db(7, 0..1)));
    // Bin 27 begins at 0.45 m.
    assert!((level_db(7, 27..30) - 6.4).abs() < 1.5);
}

#[test]
fn the_pulse_is_two_bins_long_if_no_longer_is_asked_for() {
    let of = |pulse_duration_s: f64| {
        FieldUnit::pulse_duration_s(&PingSettings {
            pulse_duration_s,
            ..SETTINGS
        })
    };
    // Two bins of 16.7 mm, there and back at 1500 m/s.
    assert!((of(2e-5) - 4.444e-5).abs() < 1e-7);
    assert!((of(1e-4) - 1e-4).abs() < 1e-9);
}

fn sonar(scene: &str, duration_s: f64, seed: u64) -> SimulatedSonar {
    let scene = Arc::new(Scene::named(scene).unwrap());
    let options = DiveOptions {
        duration_s,
        ..DiveOptions::default()
    };
    let level = NoiseLevel::Field;
    let dive = Dive::plan_with(DiveKind::Survey, &scene, level, seed, &options).unwrap();
    SimulatedSonar::new(scene, Arc::new(dive), level, seed)
}

/// Strongest echo of every eighth ping over the mean noise, dB, and its range.
fn strongest(sonar: &SimulatedSonar) -> Vec<(f64, f64)> {
    let of_ping = |index: usize| {
        let (time_s, settings) = (
            sonar.dive().transmit_s(index),
            sonar.dive().settings_at(index),
        );
        let echoes = sonar.echoes(index as u64, time_s, &settings);
        let loudest = echoes
            .iter()
            .copied()
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let (bin, echo) = loudest.unwrap();
        (
            STERADIAN_OVER_NOISE_DB + 10.0 * echo.log10(),
            settings.bin_center_m(bin),
        )
    };
    (0..sonar.dive().pings()).step_by(8).map(of_ping).collect()
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(share * (values.len() - 1) as f64) as usize]
}

#[test]
fn rods_stand_a_little_above_the_noise_and_walls_far() {
    let fence = strongest(&sonar("fence", 240.0, 1)).into_iter();
    let five_metres_away = fence.filter(|(_, range_m)| (4.7..5.3).contains(range_m));
    let rods: Vec<f64> = five_metres_away.map(|(level_db, _)| level_db).collect();
    let (low, high) = (quantile(rods.clone(), 0.2), quantile(rods, 0.7));
    assert!(low > 5.0 && high < 15.0, "{low} {high}");
    let wall = strongest(&sonar("wall", 240.0, 1)).into_iter();
    let wall: Vec<f64> = wall.map(|(level_db, _)| level_db).collect();
    let (high, most) = (quantile(wall.clone(), 0.7), quantile(wall, 0.999));
    assert!(high > 20.0 && most < 30.0, "{high} {most}");
}

#[test]
fn the_gain_walks_with_the_echoes_one_step_at_a_time() {
    let sonar = sonar("wall", 60.0, 1);
    let gain = |index: usize| sonar.ping(index).settings.gain_index;
    assert_eq!([0, 1, 2, 3, 4].map(gain), [0, 4, 5, 6, 7]);
    let later: Vec<i16> = (20..sonar.dive().pings()).step_by(10).map(gain).collect();
    assert!(later.iter().all(|index| (4..=7).contains(index)));
    assert!(later.windows(2).all(|pair| (pair[0] - pair[1]).abs() <= 1));
    assert!(later.windows(2).any(|pair| pair[0] != pair[1]));
    // The same echoes are reported louder at a higher gain, and so is the noise.
    let noise_db = |index: usize| {
        let heard = sonar.ping(index).intensity;
        let far = heard[540..].iter().map(|power| f64::from(*power));
        10.0 * mean(far).log10() - NOISE_DB - gain_db(gain(index))
    };
    let spread = (20..400).step_by(10).map(noise_db);
    let middle = quantile(spread.collect(), 0.5);
    assert!(middle.abs() < 1.0, "{middle}");
}

#[test]
fn echoes_stand_as_far_above_the_noise_as_is_asked_for() {
    for level in [NoiseLevel::Nominal, NoiseLevel::Field] {
        let scene = Arc::new(Scene::named("fence").unwrap());
        let options = DiveOptions {
            duration_s: 60.0,
            ..DiveOptions::default()
        };
        let plan = Dive::plan_with(DiveKind::Survey, &scene, NoiseLevel::Nominal, 1, &options);
        let sonar = SimulatedSonar::new(scene, Arc::new(plan.unwrap()), level, 1);
        let loud = sonar.with_echoes_over_noise(30.0).unwrap();
        let loudest = |sonar: &SimulatedSonar| {
            // Noise and speckle of one ping; of many, medians of their loudest bins.
            let of_ping = |index| {
                let ping = sonar.ping(index);
                let noise_db = match level {
                    NoiseLevel::Field => NOISE_DB + gain_db(ping.settings.gain_index),
                    _ => -16.0,
                };
                let beyond = ping.intensity[BEYOND..].iter().copied().fold(0.0, f32::max);
                10.0 * f64::from(beyond).log10() - noise_db
            };
            quantile((10..1000).step_by(5).map(of_ping).collect(), 0.5)
        };
        let at_30_db = loudest(&loud);
        // The loudest of the several bins of an echo is lucky in its speckle.
        assert!((29.0..36.0).contains(&at_30_db), "{level}: {at_30_db}");
        let at_50_db = loudest(&loud.with_echoes_over_noise(50.0).unwrap());
        assert!(
            (at_50_db - at_30_db - 20.0).abs() < 0.5,
            "{level}: {at_50_db}"
        );
    }
    assert!(
        sonar("empty", 5.0, 1)
            .with_echoes_over_noise(20.0)
            .is_none()
    );
}

#[test]
fn the_same_seed_gives_the_same_pings_in_any_order_and_another_others() {
    let (one, other) = (sonar("pier", 5.0, 5), sonar("pier", 5.0, 5));
    let backwards: Vec<_> = (0..40).rev().map(|index| other.ping(index)).collect();
    for (index, ping) in backwards.iter().rev().enumerate() {
        assert_eq!(&one.ping(index), ping);
    }
    assert_ne!(sonar("pier", 5.0, 6).ping(7), one.ping(7));
}
