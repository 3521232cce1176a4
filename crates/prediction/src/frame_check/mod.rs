//! Whether poses can be what they are read as: told from the pings, without a truth.
//!
//! Under the right reading a place that one ping found lit is found lit by others that observe it from
//! elsewhere; under a wrong one it is not. So each of a short list of readings is scored by how well a
//! window's other pings predict which ranges of a ping are lit, and the one in use is wrong if another
//! does far better on the same pings. Where nothing is seen twice, no reading says anything.
//!
//! Pure: no threads, no clock, no randomness. Cost: 13 readings × 512 pings × about 1,800 samples of
//! their arcs.

mod evidence;
mod lit;
mod reading;
mod score;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use echosplat_mapper::MapperConfig;
use echosplat_model::{Ping, Pose, PosedPing};
use serde::Serialize;

use evidence::{Arcs, BLOCKS, Evidence};
use lit::LitPings;
pub use reading::FrameReading;
use score::Baseline;

/// Most pings of a window that are looked at; of more, some are passed over.
const MOST_PINGS: usize = 512;
/// Fewest pings that hear anything.
const LEAST_LIT_PINGS: usize = 60;
/// Less than this and every reading is much the same, degrees.
const LEAST_TURN_DEG: f64 = 45.0;
/// Likelihood gain that another reading has to have, standard errors.
const TELLING_ERRORS: f64 = 4.0;
/// As given explains less than this share of what the best does, if it cannot be.
const LEAST_SHARE: f64 = 0.5;
/// Attitudes compared for the turn.
const TURN_PINGS: usize = 64;

/// A ping and where its vehicle was, as its poses were read.
#[derive(Debug, Clone)]
pub struct VehiclePing {
    /// The ping.
    pub ping: Arc<Ping>,
    /// As read, right or wrong, at the middle of what was listened to.
    pub world_from_vehicle: Pose,
}

impl VehiclePing {
    /// Takes the mount, `vehicle_from_sensor` as configured, off the pose of a sensor.
    #[must_use]
    pub fn of(posed: &PosedPing, mount: &Pose) -> Self {
        Self {
            ping: Arc::clone(&posed.ping),
            world_from_vehicle: posed.world_from_sensor * mount.inverse(),
        }
    }
}

/// What a window of pings says of how its poses are read.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FrameVerdict {
    /// The most likely reading.
    pub best: FrameReading,
    /// Likelihood gain of the reading in use over ranges alone, in telling lit cells from dark ones,
    /// natural logarithm per cell of range.
    pub gain_nats_per_bin_as_given: f64,
    /// The same of the best.
    pub gain_best: f64,
    /// Standard error of the difference of the two, over blocks of time.
    pub error_nats_per_bin: f64,
    /// Pings looked at.
    pub pings: u64,
    /// The widest angle between two attitudes of the vehicle.
    pub turned_deg: f64,
    /// Whether the reading in use cannot be: the best has a likelihood gain of four standard errors
    /// over it and over ranges alone, and as given explains less than half of what the best does.
    pub is_telling: bool,
}

/// Compares all readings on a window of pings in order of time; `mount` is `vehicle_from_sensor` as
/// configured. `None` if too few pings hear anything, or the vehicle has hardly turned.
#[must_use]
pub fn judge(pings: &[VehiclePing], mount: &Pose, config: &MapperConfig) -> Option<FrameVerdict> {
    let pings = thinned(pings);
    let turned_deg = turned_deg(&pings);
    if !(turned_deg >= LEAST_TURN_DEG) {
        return None;
    }
    let lit = LitPings::of(&pings, config)?;
    if lit.lit_pings() < LEAST_LIT_PINGS {
        return None;
    }
    let scores = scores(&pings, &lit, mount, config);
    Some(verdict(&scores, pings.len() as u64, turned_deg))
}

/// Log likelihood of a reading above that by range alone, nats per cell, by block.
struct Scored {
    reading: FrameReading,
    by_block: [f64; BLOCKS],
}

impl Scored {
    fn gain(&self) -> f64 {
        self.by_block.iter().sum()
    }
}

/// Standard error of a sum over blocks.
fn error_of_sum(by_block: &[f64; BLOCKS]) -> f64 {
    let count = BLOCKS as f64;
    let mean = by_block.iter().sum::<f64>() / count;
    let square = by_block.iter().map(|value| (value - mean).powi(2));
    (square.sum::<f64>() * count / (count - 1.0)).sqrt()
}

fn scores(
    pings: &[VehiclePing],
    lit: &LitPings,
    mount: &Pose,
    config: &MapperConfig,
) -> Vec<Scored> {
    let baseline = Baseline::of(lit);
    let arcs = Arcs::new(lit.cell_m, &config.beam);
    let score = |reading: FrameReading| {
        let pose = |ping: &VehiclePing| reading.apply(&ping.world_from_vehicle, mount);
        let poses: Vec<Pose> = pings.iter().map(pose).collect();
        let evidence = Evidence::new(pings, &poses, lit, &arcs);
        let likelihood = baseline.with(lit, &evidence);
        let gain = |block: usize| likelihood[block] - baseline.by_block[block];
        Scored {
            reading,
            by_block: std::array::from_fn(|block| gain(block) / baseline.cell_count),
        }
    };
    FrameReading::ALL.into_iter().map(score).collect()
}

fn verdict(scores: &[Scored], pings: u64, turned_deg: f64) -> FrameVerdict {
    // As given comes first and wins a draw.
    let given = &scores[0];
    let more_likely = |a: &Scored, b: &Scored| b.gain() > a.gain();
    let best = scores
        .iter()
        .fold(given, |a, b| if more_likely(a, b) { b } else { a });
    let beyond: [f64; BLOCKS] = std::array::from_fn(|i| best.by_block[i] - given.by_block[i]);
    let error = error_of_sum(&beyond);
    // Against the ranges alone too: a reading that explains nothing refutes nothing.
    let is_far = beyond.iter().sum::<f64>() > TELLING_ERRORS * error
        && best.gain() > TELLING_ERRORS * error_of_sum(&best.by_block)
        && given.gain() < LEAST_SHARE * best.gain();
    FrameVerdict {
        best: best.reading,
        gain_nats_per_bin_as_given: given.gain(),
        gain_best: best.gain(),
        error_nats_per_bin: error,
        pings,
        turned_deg,
        is_telling: best.reading != FrameReading::AsGiven && is_far,
    }
}

/// Evenly spread over the window.
fn thinned(pings: &[VehiclePing]) -> Vec<VehiclePing> {
    let is_finite = |ping: &&VehiclePing| ping.world_from_vehicle.is_finite();
    let pings: Vec<&VehiclePing> = pings.iter().filter(is_finite).collect();
    let count = pings.len().min(MOST_PINGS);
    let nth = |index: usize| pings[index * pings.len() / count].clone();
    (0..count).map(nth).collect()
}

fn turned_deg(pings: &[VehiclePing]) -> f64 {
    let every = pings.len().div_ceil(TURN_PINGS).max(1);
    let attitudes = pings
        .iter()
        .step_by(every)
        .map(|p| p.world_from_vehicle.rotation);
    let attitudes: Vec<glam::DQuat> = attitudes.collect();
    let pairs = attitudes
        .iter()
        .flat_map(|a| attitudes.iter().map(move |b| (a, b)));
    let angles = pairs.map(|(a, b)| a.angle_between(*b));
    angles.fold(0.0, f64::max).to_degrees()
}
