//! Small dives around a small structure, as posed pings, and the whole mapper run on them.
//!
//! Pings are rays cast into the scene, speckled and noisy; each is a function of its own number,
//! so that what a row does to some of them leaves the others as they were.

use std::f64::consts::TAU;
use std::sync::Arc;

use echosplat_mapper::{Mapper, MapperConfig, MapperStatus};
use echosplat_model::{
    Gaussian, Ping, PingSettings, Pose, PosedPing, Snapshot, Standing, Timestamp, Twist,
};
use echosplat_simulator::{Scene, echoes_at_rest};
use glam::DVec3;
use rayon::prelude::*;

use crate::draw::Draw;
use echosplat_metrics::{MapPoints, Truth, distance_between, evaluate_raw};

/// Two rods and a bar between them.
const STRUCTURE: &str = r#"
name = "frame"
description = "Two rods and a bar"

[[cylinder]]
from_m = [-0.5, 0, -0.8]
to_m = [-0.5, 0, 0.8]
radius_m = 0.08

[[cylinder]]
from_m = [0.5, 0, -0.8]
to_m = [0.5, 0, 0.8]
radius_m = 0.08

[[cylinder]]
from_m = [-0.5, 0, 0]
to_m = [0.5, 0, 0]
radius_m = 0.08
"#;

const STANDOFF_M: f64 = 3.5;
const RANGE_M: f64 = 6.0;
const BIN_COUNT: usize = 300;
/// Mean power of the noise, and of the strongest echo: 45 dB above it.
const NOISE: f64 = 0.025;
const STRONGEST: f64 = 800.0;
/// A frontal echo of a rod at the standoff, steradian.
const FRONTAL_SR: f64 = 5e-4;
const PINGS_PER_S: f64 = 40.0;
/// Few, so that a map of few pings is made of many slices.
const SLICE_PINGS: usize = 4;

/// How the sensor goes past the structure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// Around it, with heave and roll, the heading sweeping.
    Around,
    /// The same at one depth and without roll.
    Level,
    /// Turning at one place.
    Pan,
    /// 64 beams of one image.
    OneView,
    /// Hanging still.
    Still,
}

/// The structure all voyages look at.
pub(super) fn scene() -> Option<Arc<Scene>> {
    Scene::parse(STRUCTURE, None).ok().map(Arc::new)
}

pub(super) fn settings() -> PingSettings {
    PingSettings {
        range_start_m: 0.0,
        range_length_m: RANGE_M,
        bin_count: BIN_COUNT,
        speed_of_sound_mps: 1500.0,
        frequency_hz: 451_127.0,
        pulse_duration_s: 2e-5,
        gain_index: 0,
    }
}

/// Where the sensor is, `share` of the way through. Few digits in the place, so that shifts by
/// powers of two are exact.
fn pose(way: Way, share: f64) -> Pose {
    let angle = TAU * share;
    let swing = 0.25 * (41.0 * angle).sin();
    let place = |angle: f64, height_m: f64| {
        let place = DVec3::new(STANDOFF_M * angle.cos(), STANDOFF_M * angle.sin(), height_m);
        (place * 1024.0).round() / 1024.0
    };
    let inwards = angle + 0.5 * TAU;
    match way {
        Way::Around => Pose::from_yaw_pitch_roll(
            inwards + swing,
            0.1 * (5.0 * angle).cos(),
            0.6 * (7.0 * angle).sin(),
            place(angle, 0.8 * (6.0 * angle).sin()),
        ),
        Way::Level => Pose::from_yaw_pitch_roll(inwards + swing, 0.0, 0.0, place(angle, 0.25)),
        Way::Pan => Pose::from_yaw_pitch_roll(0.5 * TAU + swing, 0.0, 0.0, place(0.0, 0.25)),
        Way::OneView => {
            let off = 0.4 * (share - 0.5);
            Pose::from_yaw_pitch_roll(0.5 * TAU + off, 0.0, 0.0, place(0.0, 0.25))
        }
        Way::Still => Pose::from_yaw_pitch_roll(0.5 * TAU, 0.0, 0.0, place(0.0, 0.25)),
    }
}

/// `count` pings along a way.
pub(super) fn pings(scene: &Scene, way: Way, seed: u64, count: usize) -> Vec<PosedPing> {
    let ping = |index: usize| {
        let world_from_sensor = pose(way, index as f64 / count as f64);
        let view = (way == Way::OneView).then_some(0);
        let power = heard(scene, &world_from_sensor, seed, index as u64);
        posed(index as u64, settings(), power, world_from_sensor, view)
    };
    let pings: Vec<Option<PosedPing>> = (0..count).into_par_iter().map(ping).collect();
    pings.into_iter().flatten().collect()
}

/// Echoes with speckle of four looks over exponential noise.
fn heard(scene: &Scene, world_from_sensor: &Pose, seed: u64, number: u64) -> Vec<f32> {
    let mut draw = Draw::new(seed, 0x5ca1e + number);
    let mut exponential = || -f64::from(1.0 - draw.between(0.0, 1.0)).max(1e-7).ln();
    let echoes = echoes_at_rest(scene, world_from_sensor, &settings(), number);
    let power = echoes.into_iter().map(|echo| {
        let speckle = 0.25 * (0..4).map(|_| exponential()).sum::<f64>();
        (STRONGEST / FRONTAL_SR * echo * speckle + NOISE * exponential()) as f32
    });
    power.collect()
}

/// `None` where the numbers are no ping.
pub(super) fn posed(
    number: u64,
    settings: PingSettings,
    power: Vec<f32>,
    world_from_sensor: Pose,
    view: Option<u32>,
) -> Option<PosedPing> {
    let time = Timestamp::from_secs_f64(number as f64 / PINGS_PER_S);
    let ping = Ping::new(number, time, settings, power).ok()?;
    let ping = match view {
        Some(view) => ping.with_beam(0.0, view),
        None => ping,
    };
    Some(PosedPing {
        reference_range_m: settings.range_start_m + 0.5 * settings.range_length_m,
        ping: Arc::new(ping),
        world_from_sensor,
        twist: Twist::default(),
        uncertainty: None,
        jitter: None,
    })
}

/// Each with another pose.
pub(super) fn moved(pings: &[PosedPing], by: impl Fn(Pose) -> Pose) -> Vec<PosedPing> {
    let moved = |ping: &PosedPing| PosedPing {
        world_from_sensor: by(ping.world_from_sensor),
        ..ping.clone()
    };
    pings.iter().map(moved).collect()
}

pub(super) fn config() -> MapperConfig {
    MapperConfig {
        threads: 1,
        slice_pings: SLICE_PINGS,
        workout_passes: 8,
        workout_pairs: 60_000_000,
        resolution_m: 0.0625,
        position_sigma_m: 0.005,
        attitude_sigma_deg: 0.1,
        ..MapperConfig::default()
    }
}

/// A finished map and what it took.
#[derive(Debug, Clone)]
pub(super) struct Made {
    pub(super) snapshot: Snapshot,
    pub(super) status: MapperStatus,
}

/// Inserts, finishes. `None` where no thread can be started.
pub(super) fn map(pings: &[PosedPing], config: &MapperConfig) -> Option<Made> {
    let mut mapper = Mapper::new(config.clone()).ok()?;
    for ping in pings {
        mapper.insert(ping);
    }
    let snapshot = mapper.finish();
    Some(Made {
        status: mapper.status(),
        snapshot,
    })
}

impl Made {
    /// What it asserts.
    pub(super) fn confident(&self) -> Vec<DVec3> {
        MapPoints::from(&self.snapshot).positions()
    }

    pub(super) fn confident_count(&self) -> usize {
        let standing = self.snapshot.gaussians.iter().map(|g| g.standing);
        standing.filter(|s| *s == Standing::Confident).count()
    }

    /// Gaussians with a number that is none.
    pub(super) fn unsound_count(&self) -> usize {
        let gaussians = self.snapshot.gaussians.iter();
        gaussians.filter(|g| !g.is_sound()).count()
    }

    /// The same elsewhere, its origin kept; Gaussians are not turned, only their places.
    pub(super) fn moved(mut self, to_there: &Pose) -> Self {
        let origin_m = self.snapshot.origin_m;
        for gaussian in &mut self.snapshot.gaussians {
            let place = *to_there * (origin_m + gaussian.mean_m.as_dvec3());
            gaussian.mean_m = (place - origin_m).as_vec3();
        }
        self
    }

    /// Pairs and voxel observations.
    pub(super) fn work(&self) -> u64 {
        self.status.pairs + self.status.voxel_observations
    }

    /// Chamfer distance of what is asserted from the structure, metres.
    pub(super) fn error_m(&self, truth: &Truth) -> f64 {
        evaluate_raw(&MapPoints::from(&self.snapshot), truth).cd_m
    }
}

/// Chamfer distance of what two maps assert, the second one's points brought back by `back`;
/// not a number if either was not made, infinite if either asserts nothing.
pub(super) fn apart_m(
    here: Option<&Made>,
    there: Option<&Made>,
    back: impl Fn(DVec3) -> DVec3,
) -> f64 {
    let (Some(here), Some(there)) = (here, there) else {
        return f64::NAN;
    };
    let there: Vec<DVec3> = there.confident().into_iter().map(back).collect();
    distance_between(&here.confident(), &there)
}

/// Numbers of two maps that differ in any bit, the second made `shift_m` away, which must be exact
/// in f64; not a number if they cannot be compared. Places are compared bit by bit too if both maps
/// are relative to the same point of the dive; else one is rounded where it is large and the other
/// where it is small, and they differ if they are further apart than these roundings.
pub(in crate::stability) fn differing_bits(
    here: Option<&Snapshot>,
    there: Option<&Snapshot>,
    shift_m: DVec3,
) -> f64 {
    let (Some(here), Some(there)) = (here, there) else {
        return f64::NAN;
    };
    let pairs = here.gaussians.iter().zip(&there.gaussians);
    if here.gaussians.len() != there.gaussians.len() || here.gaussians.is_empty() {
        return f64::NAN;
    }
    let apart_m = there.origin_m - shift_m - here.origin_m;
    let differing = pairs.map(|(a, b)| {
        let numbers = other_numbers(a).into_iter().zip(other_numbers(b));
        numbers.filter(|(a, b)| a != b).count() + differing_places(a, b, apart_m)
    });
    differing.sum::<usize>() as f64
}

/// All of a Gaussian that does not depend on where it is.
fn other_numbers(gaussian: &Gaussian) -> [u32; 10] {
    let [x, y, z, w] = gaussian.rotation.to_array();
    let [a, b, c] = gaussian.scale_m.to_array();
    let rest = (gaussian.opacity, gaussian.reflectivity, gaussian.sigma_m);
    [x, y, z, w, a, b, c, rest.0, rest.1, rest.2].map(f32::to_bits)
}

/// Coordinates of `there` that are not those of `here` once its origin, `apart_m` from here's, is
/// added.
fn differing_places(here: &Gaussian, there: &Gaussian, apart_m: DVec3) -> usize {
    let differs = |axis: usize| {
        let (a, b) = (here.mean_m[axis], there.mean_m[axis]);
        if apart_m == DVec3::ZERO {
            return a.to_bits() != b.to_bits();
        }
        let (a, b) = (f64::from(a), f64::from(b));
        let rounding = 0.5 * f64::from(f32::EPSILON) * (a.abs() + b.abs());
        !((a - b - apart_m[axis]).abs() <= rounding)
    };
    (0..3).filter(|axis| differs(*axis)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_frame_is_found_from_all_sides() {
        let scene = scene().unwrap();
        let pings = pings(&scene, Way::Around, 1, 800);
        assert_eq!(pings.len(), 800);
        let map = map(&pings, &config()).unwrap();
        assert!(map.confident_count() > 500);
        let error_m = map.error_m(&Truth::from_scene(&scene, None));
        assert!(error_m < 0.04, "{error_m}");
    }
}
