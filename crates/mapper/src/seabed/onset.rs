//! The first bottom return of a ping: how far below the sensor the ground lies where the lower edge
//! of the fan meets it.
//!
//! Flat ground `h` below the sensor lights every bin from `r₀ = h / sin(edge)` on, ever more faintly, until something
//! occludes it: by the fan's sensitivity over the elevations in a bin, times a power of range for spreading and
//! grazing. For each `r₀` the gain in log likelihood over no ground at all is summed up to the best end; bins that
//! hold something else count as little for one depth as for another.
//!
//! Cost: about 100 depths × 150 runs of bins × 5 brightnesses for every fourth ping, 0.5 ms; four times that for a
//! dive's first onsets, which tell the power of range.

use std::ops::Range;

use echosplat_measurement::lanes::{self, LANES};
use echosplat_measurement::simd_level;
use echosplat_model::glam::Vec3;
use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x8};
use rayon::prelude::*;

use crate::detect::profile::mean_of_noise;

use super::fan_plane::{FanEnergy, FanPlane};

/// Runs of bins in a profile; bounds work.
/// A profile is looked at in about so many runs of bins.
const RUNS: usize = 150;
/// Divisor; found.
/// The nearest third of a ping tells its noise, if it is quieter than all: one over that fraction.
const NOISE_DIVISOR: usize = 3;
/// Looks; found.
/// Number of looks that a run averages, as the likelihood has it: few, since neighbouring bins share them.
const LOOKS: f32 = 4.0;
/// Nats, physics: gamma density.
/// `L ln L − ln Γ(L)`: the density of log power is `exp` of this plus `L (x − eˣ)`.
const LOG_DENSITY: f32 = 3.753_4;
/// Nats, derived: 5 % of bins over 11 nats.
/// Log density of an echo of something else: 5 % of bins, spread over 11 nats of power.
const LOG_OUTLIER: f32 = -5.4;
/// Nats above the mean; found.
/// Power this far above the mean is an outlier for sure, nats.
const FAR_ABOVE: f32 = 3.0;
/// Ratio of range, physics: a wall ends at 1.2.
/// The ground has to be lit out to this many times the range of its onset: a wall's echo ends at
/// 1.2, where the fan does.
const LEAST_EXTENT: f32 = 1.35;
/// Depths tried of ground that begins beyond a ping; grid.
const BEYOND: usize = 16;
/// Nats over no ground at all; found.
/// Gain in log likelihood over no ground at all.
const LEAST_GAIN: f32 = 40.0;
/// Slope at the fan's lower edge; found.
/// Metres down per metre of range at the fan's lower edge, below which depth cannot be told.
const LEAST_DESCENT: f32 = 0.15;
/// Runs that tell ground; found.
const LEAST_RUNS: usize = 8;
/// Metres, physics: nearer is no far field.
const LEAST_RANGE_M: f32 = 0.1;
/// Depths one thread takes; layout.
/// Depths that one thread takes at least.
const LEAST_ONSETS: usize = 16;
/// Ratio of brightness; grid.
/// Brightnesses tried: so many in steps of this about the one of late.
const KNOWN_STEP: f32 = std::f32::consts::SQRT_2;
/// Steps of them; grid.
const KNOWN_STEPS: usize = 5;
/// Ratio of brightness; grid.
/// As long as none is known: steps of this from the noise on to the loudest run.
const STEP: f32 = 1.6;
/// Steps of them; bounds work.
const MOST_STEPS: usize = 48;
/// Exponents, physics.
/// Powers of range that the ground's brightness may fall by: 0 is a receiver that made up for all of it, 2 is
/// spreading of what spreads by solid angle, 3 that at grazing incidence, 4 a rough seabed's by Lambert's law.
pub(crate) const FALLS: [f32; 4] = [0.0, 2.0, 3.0, 4.0];

/// What a ping says of the ground.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Onset {
    /// Where the lower edge of the fan meets it.
    pub(crate) point_m: Vec3,
    /// Power per radian of elevation at 1 m.
    pub(crate) brightness: f32,
    /// Gain in log likelihood over no ground.
    pub(crate) gain: f32,
    /// Whether the ping ends before a wall's echo would.
    pub(crate) is_open: bool,
}

/// Runs of bins of one ping. Reused from ping to ping.
#[derive(Debug, Default)]
pub(crate) struct Runs {
    bins_per_run: f32,
    noise: f32,
    /// Range of the edges of runs, one more than there are runs.
    edges_m: Vec<f32>,
    /// Mean power of a run, and its logarithm.
    power: Vec<f32>,
    log_power: Vec<f32>,
    /// Log likelihood of nothing but noise.
    empty: Vec<f32>,
}

/// A depth and brightness, and how well they explain a ping.
#[derive(Debug, Clone, Copy)]
struct Explanation {
    gain: f32,
    /// Where the lower edge of the fan meets the ground.
    range_m: f32,
    brightness: f32,
}

impl Explanation {
    /// The better of two, the first if they are as good.
    fn or(self, other: Self) -> Self {
        match other.gain > self.gain {
            true => other,
            false => self,
        }
    }
}

impl Runs {
    /// Takes in a ping from bin `from` on, which begins at `near_m`; bins of `bin_length_m`.
    pub(crate) fn fill(
        &mut self,
        intensity: &[f32],
        from: usize,
        noise: f32,
        near_m: f32,
        bin_length_m: f32,
    ) {
        let per_run = (intensity.len() / RUNS).max(1);
        self.bins_per_run = per_run as f32;
        self.noise = noise;
        self.edges_m.clear();
        self.power.clear();
        self.log_power.clear();
        self.empty.clear();
        let open = intensity.get(from..).unwrap_or_default();
        // Ground that fills most of a ping leaves its nearest part to the noise.
        let nearest = &open[..open.len() / NOISE_DIVISOR];
        if !nearest.is_empty() {
            self.noise = mean_of_noise(&mut nearest.to_vec())
                .min(noise)
                .max(f32::MIN_POSITIVE);
        }
        self.edges_m.push(near_m);
        for (run, bins) in open.chunks_exact(per_run).enumerate() {
            let mean = bins.iter().sum::<f32>() / per_run as f32;
            let power = mean.max(f32::MIN_POSITIVE);
            self.power.push(power);
            self.log_power.push(power.ln());
            self.empty.push(log_likelihood(power, self.noise));
            let end = (run + 1) * per_run;
            self.edges_m.push(near_m + end as f32 * bin_length_m);
        }
    }

    /// Whether the lower edge of the fan meets the ground steeply enough to tell its depth.
    pub(crate) fn can_tell(&self, plane: &FanPlane, fan: &FanEnergy) -> bool {
        let descent = plane.descent(-fan.half_width_rad());
        descent > LEAST_DESCENT && self.log_power.len() >= LEAST_RUNS
    }

    /// Ranges at which ground has to begin to be told from a wall.
    pub(crate) fn reach_m(&self) -> Range<f32> {
        let (near_m, far_m) = (self.edges_m.first(), self.edges_m.last());
        let both = near_m.copied().zip(far_m.copied());
        both.map_or(0.0..0.0, |(near_m, far_m)| near_m..far_m / LEAST_EXTENT)
    }

    /// The ground in this ping, if it shows, its brightness falling by the power `fall` of range. `brightness` is what
    /// it was of late, if it is known.
    pub(crate) fn onset(
        &self,
        plane: &FanPlane,
        fan: &FanEnergy,
        fall: f32,
        brightness: Option<f32>,
    ) -> Option<Onset> {
        let edge_rad = -fan.half_width_rad();
        let descent = plane.descent(edge_rad);
        let middles = self
            .edges_m
            .windows(2)
            .map(|edges| 0.5 * (edges[0] + edges[1]));
        let factors: Vec<f32> = middles.map(|range_m| falling(range_m, fall)).collect();
        let at = |(energy, gains): &mut (Vec<f32>, Vec<f32>), range_m: f32| {
            self.spread_ground(plane, fan, range_m * descent, energy);
            for (energy, factor) in energy.iter_mut().zip(&factors) {
                *energy *= factor;
            }
            self.explain(range_m, energy, brightness, gains)
        };
        let end_m = *self.edges_m.last()?;
        let within = &self.edges_m[1..self.log_power.len()];
        // Depths of which a ping shows but the fan's faint edge are tried too: left out, shallower ones would take their
        // place.
        let beyond = (0..BEYOND)
            .map(|step| end_m * (1.0 + (LEAST_EXTENT - 1.0) * step as f32 / BEYOND as f32));
        let begins_m: Vec<f32> = within.iter().copied().chain(beyond).collect();
        let tried: Vec<Explanation> = begins_m
            .into_par_iter()
            .with_min_len(LEAST_ONSETS)
            .map_init(Default::default, at)
            .collect();
        let best = tried.into_iter().reduce(Explanation::or)?;
        if !(best.gain > LEAST_GAIN && best.range_m < end_m) {
            return None;
        }
        Some(Onset {
            is_open: best.range_m >= self.reach_m().end,
            point_m: plane.position_m + plane.direction(edge_rad) * best.range_m,
            brightness: best.brightness,
            gain: best.gain,
        })
    }

    /// The best brightness of ground of some energy per run; `of_runs` is room for what each run gains.
    fn explain(
        &self,
        range_m: f32,
        energy: &[f32],
        brightness: Option<f32>,
        of_runs: &mut Vec<f32>,
    ) -> Explanation {
        let enough_m = LEAST_EXTENT * range_m;
        let lit = self.edges_m.partition_point(|&edge_m| edge_m < enough_m);
        let enough = lit.min(self.log_power.len() - 1);
        let (first, step, count) = match brightness {
            Some(known) => (
                known * KNOWN_STEP.powf(-0.5 * (KNOWN_STEPS - 1) as f32),
                KNOWN_STEP,
                KNOWN_STEPS,
            ),
            None => {
                let peak = energy.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
                let loudest = self.log_power.iter().copied().fold(f32::MIN, f32::max);
                let steps = ((loudest - self.noise.ln()) / STEP.ln()).ceil() as usize;
                (STEP * self.noise / peak, STEP, steps.min(MOST_STEPS))
            }
        };
        let brightness = |index: usize| first * step.powf(index as f32);
        let gains: Vec<f32> = (0..count)
            .map(|index| self.gain(energy, brightness(index), enough, of_runs))
            .collect();
        let best = (0..count).reduce(|best, other| {
            if gains[other] > gains[best] {
                other
            } else {
                best
            }
        });
        match best {
            Some(best) => Explanation {
                gain: gains[best],
                range_m,
                brightness: brightness(best) * step.powf(vertex(&gains, best)),
            },
            None => Explanation {
                gain: f32::MIN,
                range_m,
                brightness: 0.0,
            },
        }
    }

    /// Energy per bin of each run of flat ground `depth_m` below the sensor, for a brightness of 1.
    fn spread_ground(
        &self,
        plane: &FanPlane,
        fan: &FanEnergy,
        depth_m: f32,
        energy: &mut Vec<f32>,
    ) {
        let ends_m = &self.edges_m[1..];
        energy.resize(ends_m.len(), 0.0);
        plane.elevations_of_ground(depth_m, ends_m, energy);
        let mut before = 0.0;
        for energy in energy {
            let upto = fan.below(*energy);
            *energy = (upto - before) / self.bins_per_run;
            before = upto;
        }
    }

    /// Gain of ground lit from its onset to wherever the sum is best, from run `enough` on.
    fn gain(&self, energy: &[f32], brightness: f32, enough: usize, of_runs: &mut Vec<f32>) -> f32 {
        of_runs.resize(energy.len(), 0.0);
        dispatch!(simd_level::level(), simd => self.gains(simd, energy, brightness, of_runs));
        let (mut sum, mut most) = (0.0, f32::MIN);
        for (run, gain) in of_runs.iter().enumerate() {
            sum += gain;
            if run >= enough {
                most = most.max(sum);
            }
        }
        most
    }

    /// Gain of each run over no ground, 0 where no ground is lit.
    #[inline(always)]
    fn gains<S: Simd>(&self, simd: S, energy: &[f32], brightness: f32, gains: &mut [f32]) {
        let at = |run: usize| run..run + LANES;
        let (outlier, none) = (f32x8::splat(simd, LOG_OUTLIER), f32x8::splat(simd, 0.0));
        let whole = energy.len() - energy.len() % LANES;
        let mut run = 0;
        while run < whole {
            let energy = f32x8::from_slice(simd, &energy[at(run)]);
            let power = f32x8::from_slice(simd, &self.power[at(run)]);
            let log_power = f32x8::from_slice(simd, &self.log_power[at(run)]);
            let empty = f32x8::from_slice(simd, &self.empty[at(run)]);
            let mean = energy * brightness + self.noise;
            let x = log_power - lanes::ln(mean);
            let density = (x - power / mean) * LOOKS + LOG_DENSITY;
            let likelihood = x.simd_lt(FAR_ABOVE).select(density.max(outlier), outlier);
            let gain = energy.simd_gt(none).select(likelihood - empty, none);
            gain.store_slice(&mut gains[at(run)]);
            run += LANES;
        }
        for run in whole..energy.len() {
            gains[run] = match energy[run] > 0.0 {
                true => {
                    let mean = self.noise + brightness * energy[run];
                    log_likelihood(self.power[run], mean) - self.empty[run]
                }
                false => 0.0,
            };
        }
    }
}

/// What is left at a range of a brightness told at 1 m.
pub(crate) fn falling(range_m: f32, fall: f32) -> f32 {
    match fall > 0.0 {
        true => range_m.max(LEAST_RANGE_M).powf(-fall),
        false => 1.0,
    }
}

/// Where the parabola through the best of evenly spaced values and those beside it is highest, in steps from the best.
fn vertex(values: &[f32], best: usize) -> f32 {
    let beside = best
        .checked_sub(1)
        .and_then(|before| Some((*values.get(before)?, *values.get(best + 1)?)));
    let Some((before, after)) = beside else {
        return 0.0;
    };
    let bend = before - 2.0 * values[best] + after;
    match bend < 0.0 {
        true => (0.5 * (before - after) / bend).clamp(-0.5, 0.5),
        false => 0.0,
    }
}

/// Log likelihood of the mean power of a run, looks of speckle about a mean or an echo of something else.
fn log_likelihood(power: f32, mean: f32) -> f32 {
    let ratio = power / mean;
    let x = ratio.ln();
    if !(x < FAR_ABOVE) {
        return LOG_OUTLIER;
    }
    (LOG_DENSITY + LOOKS * (x - ratio)).max(LOG_OUTLIER)
}
