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

    /// World from sensor when an echo from `range_m` meets the surface: rotation and place.
    pub(crate) fn at(&self, range_m: f64) -> (DMat3, DVec3) {
        self.poses[self.step_of(range_m)]
    }

    fn end_m(&self) -> f64 {
        self.step_m * POSE_STEPS as f64
    }

    fn step_of(&self, range_m: f64) -> usize {
        ((range_m / self.step_m) as usize).min(POSE_STEPS - 1)
    }
}

/// What a ping is heard with, and of what.
pub(crate) struct Listener<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) sensor: &'a MovingSensor,
    pub(crate) fan: &'a Fan,
    pub(crate) radiometry: Radiometry,
}

impl Listener<'_> {
    /// Calls `visit` for every cell of the fan that meets a surface within `reach_m`.
    pub(crate) fn for_each_echo(
        &self,
        reach_m: f64,
        random: &mut Random,
        mut visit: impl FnMut(&Echo<'_>),
    ) {
        let mut guess_m = 0.5 * self.sensor.end_m();
        self.fan.for_each(random, |cell| {
            let Some((hit, step)) = first_hit(self.scene, self.sensor, cell.ray, guess_m, reach_m)
            else {
                return;
            };
            guess_m = hit.distance_m;
            let (rotation, origin) = self.sensor.poses[step];
            visit(&Echo {
                normal: rotation.transpose() * hit.normal,
                hit,
                cell,
                rotation,
                origin,
            });
        });
    }
}

/// Where a cell of the fan meets a surface.
pub(crate) struct Echo<'a> {
    pub(crate) hit: Hit,
    /// Of the surface, in the sensor's frame.
    pub(crate) normal: DVec3,
    pub(crate) cell: &'a Cell,
    /// World from sensor, when the echo meets the surface.
    pub(crate) rotation: DMat3,
    pub(crate) origin: DVec3,
}

impl Echo<'_> {
    /// Cosine of the angle between ray and normal.
    pub(crate) fn facing(&self) -> f64 {
        self.normal.dot(self.cell.ray).abs()
    }

    pub(crate) fn power(&self, radiometry: Radiometry) -> f64 {
        self.cell.weight * radiometry.sent_back(&self.hit, self.facing())
    }

    /// Ranges at which the middles of the cell's lower, upper, right and left edges meet the tangent
    /// plane of its hit.
    pub(crate) fn edges_m(&self) -> [f64; 4] {
        let range_m = self.hit.distance_m;
        let off_plane_m = range_m * self.normal.dot(self.cell.ray);
        let reach_m = self.hit.flat_reach_m.min(0.5 * range_m);
        let edge = |direction: DVec3| {
            let met_m = off_plane_m / self.normal.dot(direction);
            // Seen edge-on the plane recedes without end, and past that it is met behind.
            let met_m = if met_m > 0.0 { met_m } else { f64::INFINITY };
            met_m.clamp(range_m - reach_m, range_m + reach_m)
        };
        self.cell.edges.map(edge)
    }

    /// Middle and half width of the ranges between such edges, so that neighbouring cells of a floor join
    /// without gap or overlap.
    pub(crate) fn spread([low, high, right, left]: [f64; 4]) -> (f64, f64) {
        let (along_m, across_m) = (0.5 * (high - low), 0.5 * (left - right));
        (0.5 * (low + high), along_m.hypot(across_m))
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
    let listener = Listener {
        scene,
        sensor,
        fan,
        radiometry,
    };
    let mut gathered = Gathered::new(settings);
    listener.for_each_echo(gathered.reach_m(settings), random, |echo| {
        gathered.add_echo(echo, radiometry);
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

/// Power gathered in parts of bins, with a margin at both ends for the pulse to reach in.
pub(crate) struct Gathered {
    part_m: f64,
    margin_m: f64,
    near_m: f64,
    power: Vec<f64>,
    pulse: Vec<f64>,
}

impl Gathered {
    pub(crate) fn new(settings: &PingSettings) -> Self {
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

    /// The furthest that is heard.
    pub(crate) fn reach_m(&self, settings: &PingSettings) -> f64 {
        settings.range_end_m() + self.margin_m
    }

    pub(crate) fn add_echo(&mut self, echo: &Echo<'_>, radiometry: Radiometry) {
        let (middle_m, half_m) = Echo::spread(echo.edges_m());
        self.add(middle_m, half_m, echo.power(radiometry));
    }

    /// Spreads `power` evenly over `middle_m ± half_m`; what falls outside is lost.
    pub(crate) fn add(&mut self, middle_m: f64, half_m: f64, power: f64) {
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

    pub(crate) fn into_bins(self, settings: &PingSettings) -> Vec<f64> {
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
