//! Power over range without noise: the paper's (5) to (8), one ray per cell of the beam.

use echosplat_model::{PingSettings, Pose};
use glam::DMat3;
use glam::DVec3;

use super::radiometry::Radiometry;
use crate::beam::{Cell, Fan, pulse_sigma_m};
use crate::random::Random;
use crate::scene::{Hit, Scene};

/// Echoes are gathered finer than bins, so that the pulse and the bins integrate exactly enough.
const PARTS_PER_BIN: usize = 4;
const PULSE_REACH_SIGMAS: f64 = 4.0;
const POSE_STEPS: usize = 16;

/// Where the sensor is when the echo from a range meets the surface: at transmit + range / c.
pub(crate) struct MovingSensor {
    step_m: f64,
    poses: Vec<(DMat3, DVec3)>,
}

impl MovingSensor {
    /// `world_from_sensor_at(range_m)` for ranges up to `end_m`, kept at 16 steps: at 30°/s and
    /// 10 m a step turns by 0.01°.
    pub(crate) fn new(end_m: f64, world_from_sensor_at: impl Fn(f64) -> Pose) -> Self {
        let step_m = end_m / POSE_STEPS as f64;
        let matrix = |pose: Pose| (DMat3::from_quat(pose.rotation), pose.translation_m);
        let poses = (0..POSE_STEPS)
            .map(|step| matrix(world_from_sensor_at((step as f64 + 0.5) * step_m)))
            .collect();
        Self { step_m, poses }
    }

    fn step_of(&self, range_m: f64) -> usize {
        ((range_m / self.step_m) as usize).min(POSE_STEPS - 1)
    }
}

/// Power per bin, shape `[bin_count]`: solid angle in steradian × sensitivity × what `radiometry` lets
/// come back.
pub(crate) fn power_per_bin(
    scene: &Scene,
    sensor: &MovingSensor,
    settings: &PingSettings,
    fan: &Fan,
    radiometry: Radiometry,
    random: &mut Random,
) -> Vec<f64> {
    let mut gathered = Gathered::new(settings);
    let reach_m = settings.range_end_m() + gathered.margin_m;
    let mut guess_m = 0.5 * settings.range_end_m();
    fan.for_each(random, |cell| {
        let Some((hit, step)) = first_hit(scene, sensor, cell.ray, guess_m, reach_m) else {
            return;
        };
        guess_m = hit.distance_m;
        let (rotation, _) = sensor.poses[step];
        let normal = rotation.transpose() * hit.normal;
        let facing = normal.dot(cell.ray).abs();
        let sent_back = radiometry.sent_back(&hit, facing);
        let (middle_m, half_m) = footprint(&hit, normal, cell);
        gathered.add(middle_m, half_m, cell.weight * sent_back);
    });
    gathered.into_bins(settings)
}

/// The hit from where the sensor is when that very echo meets the surface. A second cast is
/// needed only where the range differs from the neighbouring ray's.
fn first_hit(
    scene: &Scene,
    sensor: &MovingSensor,
    ray: DVec3,
    guess_m: f64,
    reach_m: f64,
) -> Option<(Hit, usize)> {
    let cast = |step: usize| {
        let (rotation, origin) = sensor.poses[step];
        scene.cast(origin, rotation * ray, reach_m)
    };
    let guessed = sensor.step_of(guess_m);
    let hit = cast(guessed)?;
    let step = sensor.step_of(hit.distance_m);
    if step == guessed {
        return Some((hit, step));
    }
    cast(step).map(|hit| (hit, step))
}

/// Middle and half width of the ranges a cell covers on the tangent plane of its hit, so that
/// neighbouring cells of a floor join without gap or overlap. `normal` in the sensor's frame.
fn footprint(hit: &Hit, normal: DVec3, cell: &Cell) -> (f64, f64) {
    let range_m = hit.distance_m;
    let off_plane_m = range_m * normal.dot(cell.ray);
    let reach_m = hit.flat_reach_m.min(0.5 * range_m);
    let edge = |direction: DVec3| {
        let met_m = off_plane_m / normal.dot(direction);
        // Seen edge-on the plane recedes without end, and past that it is met behind.
        let met_m = if met_m > 0.0 { met_m } else { f64::INFINITY };
        met_m.clamp(range_m - reach_m, range_m + reach_m)
    };
    let [low, high, right, left] = cell.edges.map(edge);
    let (along_m, across_m) = (0.5 * (high - low), 0.5 * (left - right));
    (0.5 * (low + high), along_m.hypot(across_m))
}

/// Power gathered in parts of bins, with a margin at both ends for the pulse to reach in.
struct Gathered {
    part_m: f64,
    margin_m: f64,
    near_m: f64,
    power: Vec<f64>,
    pulse: Vec<f64>,
}

impl Gathered {
    fn new(settings: &PingSettings) -> Self {
        let part_m = settings.bin_length_m() / PARTS_PER_BIN as f64;
        let pulse = pulse_weights(pulse_sigma_m(settings) / part_m);
        let margin_parts = pulse.len() / 2;
        let margin_m = margin_parts as f64 * part_m;
        Self {
            part_m,
            margin_m,
            near_m: settings.range_start_m - margin_m,
            power: vec![0.0; settings.bin_count * PARTS_PER_BIN + 2 * margin_parts],
            pulse,
        }
    }

    /// Spreads `power` evenly over `middle_m ± half_m`; what falls outside is lost.
    fn add(&mut self, middle_m: f64, half_m: f64, power: f64) {
        let half = (half_m / self.part_m).max(0.5);
        let middle = (middle_m - self.near_m) / self.part_m;
        let (from, to) = (middle - half, middle + half);
        let density = power / (2.0 * half);
        let first = from.max(0.0) as usize;
        let end = (to.ceil().max(0.0) as usize).min(self.power.len());
        for part in first..end {
            let overlap = to.min((part + 1) as f64) - from.max(part as f64);
            self.power[part] += density * overlap;
        }
    }

    fn into_bins(self, settings: &PingSettings) -> Vec<f64> {
        let mut bins = vec![0.0; settings.bin_count];
        if self.power.iter().all(|&power| power <= 0.0) {
            return bins;
        }
        for (bin, total) in bins.iter_mut().enumerate() {
            for part in bin * PARTS_PER_BIN..(bin + 1) * PARTS_PER_BIN {
                let window = &self.power[part..part + self.pulse.len()];
                *total += window
                    .iter()
                    .zip(&self.pulse)
                    .map(|(p, w)| p * w)
                    .sum::<f64>();
            }
        }
        bins
    }
}

/// A Gaussian cut at four sigmas and summing to one, an odd number of weights.
fn pulse_weights(sigma_parts: f64) -> Vec<f64> {
    let reach = (PULSE_REACH_SIGMAS * sigma_parts).ceil().min(4096.0) as i32;
    let weight = |offset: i32| {
        let sigmas = f64::from(offset) / sigma_parts.max(1e-9);
        (-0.5 * sigmas * sigmas).exp()
    };
    let weights: Vec<f64> = (-reach..=reach).map(weight).collect();
    let total: f64 = weights.iter().sum();
    weights.iter().map(|weight| weight / total).collect()
}
