//! The mapper on simulated dives: what it finds, what it must not, and that it does so bit for bit.

#![allow(clippy::unwrap_used)]

use std::collections::HashSet;
use std::sync::{Arc, mpsc};
use std::time::Duration;

use echosplat_mapper::{InsertReport, Mapper, MapperConfig};
use echosplat_model::glam::DVec3;
use echosplat_model::{Ping, PosedPing, Snapshot, Standing};
use echosplat_simulator::{Dive, DiveKind, DiveOptions, NoiseLevel, Scene, SimulatedSonar};

fn dive(scene: &str, kind: DiveKind, duration_s: f64) -> (Arc<Scene>, Vec<PosedPing>) {
    let scene = Arc::new(Scene::named(scene).unwrap());
    let options = DiveOptions {
        duration_s,
        ..DiveOptions::default()
    };
    let noise = NoiseLevel::Nominal;
    let dive = Arc::new(Dive::plan_with(kind, &scene, noise, 7, &options).unwrap());
    let sonar = SimulatedSonar::new(scene.clone(), dive.clone(), noise, 7);
    let trajectory = dive.trajectory(0.5);
    let pings = (0..dive.pings())
        .filter_map(|index| sonar.posed_ping(index, &trajectory))
        .collect();
    (scene, pings)
}

fn config(threads: usize) -> MapperConfig {
    MapperConfig {
        threads,
        workout_passes: 8,
        workout_pairs: 60_000_000,
        ..MapperConfig::default()
    }
}

fn map(pings: &[PosedPing], config: MapperConfig) -> Snapshot {
    map_looking_every(usize::MAX, pings, config)
}

fn map_looking_every(look: usize, pings: &[PosedPing], config: MapperConfig) -> Snapshot {
    let mut mapper = Mapper::new(config).unwrap();
    for (index, ping) in pings.iter().enumerate() {
        mapper.insert(ping);
        if index % look == look - 1 {
            mapper.snapshot();
        }
    }
    mapper.finish()
}

/// How many places are asserted, and how far they are from the scene on average, metres; infinitely if there are none.
fn asserted(scene: &Scene, snapshot: &Snapshot) -> (usize, f64) {
    let confident = snapshot.gaussians.iter();
    let confident = confident.filter(|gaussian| gaussian.standing == Standing::Confident);
    let off = confident.map(|g| scene.distance(g.mean_m.as_dvec3() + snapshot.origin_m));
    let off: Vec<f64> = off.collect();
    match off.is_empty() {
        true => (0, f64::INFINITY),
        false => (off.len(), off.iter().sum::<f64>() / off.len() as f64),
    }
}

#[test]
fn a_fence_is_found_with_the_same_bits_at_any_number_of_threads_and_looks() {
    let (scene, pings) = dive("fence", DiveKind::Survey, 50.0);
    let one = map(&pings, config(1));
    let two = map_looking_every(300, &pings, config(2));
    assert!(one.gaussians == two.gaussians, "not the same bits");
    let (count, mean_m) = asserted(&scene, &one);
    assert!(count > 100, "{count} asserted");
    assert!(mean_m < 0.08, "{mean_m} m off on average");
}

#[test]
fn a_dive_that_goes_on_after_its_end_is_as_if_it_had_not_ended() {
    let (_, pings) = dive("fence", DiveKind::Survey, 20.0);
    let mut mapper = Mapper::new(config(2)).unwrap();
    let (before, after) = pings.split_at(pings.len() / 2);
    before.iter().for_each(|ping| _ = mapper.insert(ping));
    mapper.finish();
    after.iter().for_each(|ping| _ = mapper.insert(ping));
    let ended = mapper.finish().gaussians.len();
    let mut whole = Mapper::new(config(2)).unwrap();
    pings.iter().for_each(|ping| _ = whole.insert(ping));
    let expected = whole.finish().gaussians.len();
    assert!(expected > 100);
    let ratio = ended as f64 / expected as f64;
    assert!((0.9..1.1).contains(&ratio), "{ended} for {expected}");
}

#[test]
fn poses_of_another_moment_do_not_make_this_map() {
    let (scene, pings) = dive("fence", DiveKind::Survey, 50.0);
    let late: Vec<PosedPing> = pings
        .iter()
        .zip(&pings[40..])
        .map(|(ping, pose)| PosedPing {
            ping: ping.ping.clone(),
            ..pose.clone()
        })
        .collect();
    let (_, right_m) = asserted(&scene, &map(&pings, config(0)));
    let (_, wrong_m) = asserted(&scene, &map(&late, config(0)));
    assert!(wrong_m > 3.0 * right_m, "{right_m} m against {wrong_m} m");
}

/// The ping as a receiver gives it that amplifies by a power of range and walks through three gains.
fn amplified(ping: &Ping, exponent: f32) -> Ping {
    let index = ping.sequence() / 100 % 3;
    let mut settings = *ping.settings();
    settings.gain_index = index as i16;
    let (gain, of) = ([1.0, 4.0, 12.0][index as usize], settings);
    let range_m = |bin: usize| of.bin_center_m(bin) as f32;
    let scaled = ping.scaled(|bin| gain * range_m(bin).powf(exponent));
    let intensity = scaled.intensity().to_vec();
    Ping::new(ping.sequence(), ping.transmit_time(), settings, intensity).unwrap()
}

#[test]
fn amplification_over_range_and_a_walking_gain_do_not_change_what_is_found() {
    let (scene, pings) = dive("fence", DiveKind::Survey, 50.0);
    let (count, error_m) = asserted(&scene, &map(&pings, config(0)));
    for exponent in [0.0, 2.0, 4.0] {
        let told = pings.iter().map(|posed| PosedPing {
            ping: Arc::new(amplified(&posed.ping, exponent)),
            ..posed.clone()
        });
        let told: Vec<PosedPing> = told.collect();
        let (told_count, told_m) = asserted(&scene, &map(&told, config(0)));
        let ratio = told_count as f64 / count as f64;
        assert!(
            (0.9..1.1).contains(&ratio),
            "{told_count} for {count}, r^{exponent}"
        );
        assert!(
            told_m < 1.1 * error_m,
            "{told_m} m for {error_m} m, r^{exponent}"
        );
    }
}

#[test]
fn open_water_is_an_empty_map() {
    let (_, pings) = dive("empty", DiveKind::Survey, 20.0);
    assert_eq!(map(&pings, config(0)).gaussians, []);
}

#[test]
fn silence_after_a_structure_does_not_keep_the_mapper() {
    let (_, mut pings) = dive("fence", DiveKind::Survey, 40.0);
    for posed in &mut pings[1200..] {
        let ping = &posed.ping;
        let settings = *ping.settings();
        let noise = (0..settings.bin_count).map(|bin| 1e-9 * (1 + bin * 37 % 97) as f32);
        let (sequence, time) = (ping.sequence(), ping.transmit_time());
        let silent = Ping::new(sequence, time, settings, noise.collect()).unwrap();
        posed.ping = Arc::new(silent);
        posed.world_from_sensor.translation_m.x += 100.0;
    }
    let (done, is_done) = mpsc::channel();
    std::thread::spawn(move || {
        let ample = MapperConfig {
            work_pairs_per_ping: 5_000_000,
            ..config(1)
        };
        let mut mapper = Mapper::new(ample).unwrap();
        let pairs: Vec<u64> = pings.iter().map(|ping| mapper.insert(ping).pairs).collect();
        let _ = done.send((mapper.status().candidates, pairs));
    });
    let (held, pairs) = is_done.recv_timeout(Duration::from_secs(60)).unwrap();
    assert!(held > 0);
    assert!(pairs[..1200].iter().any(|&pairs| pairs > 0));
    // What was seen is worked out, and nothing new is.
    assert_eq!(pairs[pairs.len() - 100..].iter().sum::<u64>(), 0);
}

#[test]
fn work_is_done_with_the_first_ping_of_a_slice_and_a_slice_is_taken_in_without() {
    let (_, pings) = dive("fence", DiveKind::Survey, 20.0);
    let reports = |slice_pings: usize| {
        let config = MapperConfig {
            slice_pings,
            ..config(2)
        };
        let mut mapper = Mapper::new(config).unwrap();
        let reports = pings.iter().map(|ping| mapper.insert(ping));
        reports.collect::<Vec<InsertReport>>()
    };
    let does_both = |report: &InsertReport| report.slice_taken_in && report.pairs > 0;
    let of_four = reports(4);
    assert!(of_four.iter().any(|report| report.pairs > 0));
    assert!(!of_four.iter().any(does_both));
    let of_second = of_four.windows(2).filter(|two| two[0].pairs > 0);
    assert!(of_second.map(|two| two[1].pairs).sum::<u64>() == 0);
    // The only ping of a slice is its first.
    assert!(reports(1).iter().any(does_both));
}

fn confident(snapshot: &Snapshot) -> Vec<DVec3> {
    let gaussians = snapshot.gaussians.iter();
    let confident = gaussians.filter(|gaussian| gaussian.standing == Standing::Confident);
    confident
        .map(|gaussian| gaussian.mean_m.as_dvec3() + snapshot.origin_m)
        .collect()
}

#[test]
fn the_map_is_worked_out_while_the_dive_goes_on() {
    let (scene, pings) = dive("fence", DiveKind::Survey, 50.0);
    let ample = MapperConfig {
        work_pairs_per_ping: 1_000_000,
        ..config(0)
    };
    let mut mapper = Mapper::new(ample).unwrap();
    pings.iter().for_each(|ping| _ = mapper.insert(ping));
    let live = confident(&mapper.snapshot());
    let ended = confident(&mapper.finish());
    assert!(
        live.len() as f64 > 0.6 * ended.len() as f64,
        "{} of {}",
        live.len(),
        ended.len()
    );
    let mean_m = live.iter().map(|&at_m| scene.distance(at_m)).sum::<f64>() / live.len() as f64;
    assert!(mean_m < 0.08, "{mean_m} m off on average");
}

#[test]
fn looking_at_a_part_again_keeps_the_ids_of_what_stays() {
    let (_, pings) = dive("fence", DiveKind::Survey, 50.0);
    let ids = |snapshot: &Snapshot| -> HashSet<u32> {
        let gaussians = snapshot.gaussians.iter();
        let confident = gaussians.filter(|gaussian| gaussian.standing == Standing::Confident);
        confident.map(|gaussian| gaussian.id).collect()
    };
    let mut mapper = Mapper::new(config(0)).unwrap();
    let (first, rest) = pings.split_at(pings.len() * 4 / 5);
    first.iter().for_each(|ping| _ = mapper.insert(ping));
    let before = ids(&mapper.finish());
    rest.iter().for_each(|ping| _ = mapper.insert(ping));
    let after = ids(&mapper.finish());
    let kept = before.intersection(&after).count();
    assert!(2 * kept > before.len(), "{kept} of {}", before.len());
}

#[test]
fn what_forgotten_pings_told_stays_in_the_map() {
    let (_, near) = dive("fence", DiveKind::Survey, 30.0);
    let away = near.iter().map(|posed| {
        let mut away = posed.clone();
        away.world_from_sensor.translation_m.x += 200.0;
        let settings = *posed.ping.settings();
        let (sequence, time) = (posed.ping.sequence(), posed.ping.transmit_time());
        let intensity = posed.ping.intensity().to_vec();
        let (sequence, time) = (sequence + 10_000, time.offset_by(100.0));
        away.ping = Arc::new(Ping::new(sequence, time, settings, intensity).unwrap());
        away
    });
    let small = MapperConfig {
        history_pings: near.len() / 2,
        ..config(0)
    };
    let mut mapper = Mapper::new(small).unwrap();
    near.iter().for_each(|ping| _ = mapper.insert(ping));
    let here = |snapshot: &Snapshot| -> usize {
        confident(snapshot)
            .iter()
            .filter(|at_m| at_m.x < 100.0)
            .count()
    };
    let before = here(&mapper.finish());
    away.for_each(|ping| _ = mapper.insert(&ping));
    let after = mapper.finish();
    assert!(before > 50, "{before} asserted");
    assert_eq!(here(&after), before);
    assert!(mapper.status().pings_forgotten > 0);
}

#[test]
fn turning_on_the_spot_asserts_nothing() {
    let (_, pings) = dive("fence", DiveKind::Pan, 40.0);
    let snapshot = map(&pings, config(0));
    let asserted = snapshot
        .gaussians
        .iter()
        .filter(|gaussian| gaussian.standing == Standing::Confident);
    assert_eq!(asserted.count(), 0);
    assert!(!snapshot.gaussians.is_empty());
}

#[test]
fn a_ping_without_a_finite_pose_is_counted_and_left_out() {
    let (_, pings) = dive("fence", DiveKind::Survey, 2.0);
    let mut mapper = Mapper::new(config(1)).unwrap();
    let mut odd = pings[0].clone();
    odd.world_from_sensor.translation_m.x = f64::NAN;
    assert!(mapper.insert(&odd).rejected);
    odd = pings[0].clone();
    odd.twist.angular_radps.z = f64::INFINITY;
    assert!(mapper.insert(&odd).rejected);
    assert_eq!(mapper.status().pings_rejected, 2);
    assert_eq!(mapper.finish().gaussians, []);
}
