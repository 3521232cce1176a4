//! Whether poses can be what they are read as: told from the pings, without a truth.
//!
//! Each of a short list of readings is scored by how well pings and poses then [agree](crate::agreement), and
//! the one in use is wrong if another does far better on the same pings.
//!
//! Pure: no threads, no clock, no randomness. Cost: 13 readings × 128 pings × about 1,800 samples of their arcs, and 512
//! pings for each reading that is not less likely by those than the one in use.

mod reading;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use echosplat_mapper::MapperConfig;
use echosplat_model::{Ping, Pose, PosedPing};
use serde::Serialize;

use crate::agreement::{Agreement, ByBlock, error_of_sum};
pub use reading::FrameReading;

/// Cells of range, found.
/// Cells of range. Finer ones tell nothing more of errors that are as large as the scene, nor these of a tilt.
const CELLS: usize = 64;
/// Cells of range for tilts; found.
const TILT_CELLS: usize = 32;

/// Pings of a window looked at; bounds work.
/// Most pings of a window that are looked at; of more, some are passed over.
const MOST_PINGS: usize = 512;
/// Pings that say which readings are worth more; bounds work.
/// What explains these less than the reading in use does by more than its error cannot refute that one by all of them.
const FEW_PINGS: usize = MOST_PINGS / 4;
/// Pings that hear anything, at least; found.
const LEAST_LIT_PINGS: usize = 60;
/// Degrees, found: with less readings are alike.
/// Less than this and every reading is much the same, degrees.
const LEAST_TURN_DEG: f64 = 45.0;
/// Standard errors over none; assumed.
/// The best reading has to have a likelihood gain of so many standard errors over none.
const TELLING_ERRORS: f64 = 4.0;

/// What refutes poses as given.
#[derive(Debug, Clone, Copy)]
struct Refutation {
    /// Likelihood gain of the best over them, standard errors.
    least_errors: f64,
    /// They explain less than this share of what the best does.
    least_share: f64,
}

/// Standard errors and share that refute; found.
const OTHER: Refutation = Refutation {
    least_errors: 4.0,
    least_share: 0.5,
};
/// The same for a tilt; found.
/// With a tilt half of each fan is still where it was: it explains more, and what it does not, more unevenly.
const TILT: Refutation = Refutation {
    least_errors: 2.5,
    least_share: 0.7,
};
/// Attitudes compared for the turn; bounds work.
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
    /// Whether the reading in use cannot be: the best has a likelihood gain of four standard errors (of a tilt, 2.5)
    /// over it and of four over ranges alone, and as given explains less than half (0.7) of what the best does.
    pub is_telling: bool,
}

/// Compares all readings on a window of pings in order of time; `mount` is `vehicle_from_sensor` as
/// configured. `None` if too few pings hear anything, or the vehicle has hardly turned.
#[must_use]
pub fn judge(pings: &[VehiclePing], mount: &Pose, config: &MapperConfig) -> Option<FrameVerdict> {
    compare(pings, mount, (config, CELLS), (&FrameReading::ALL, OTHER))
}

/// Compares tilts of the mount on pings of a whole dive, minutes of it: in less, a tilt by some tens of degrees explains
/// nearly as much as none. Otherwise as [`judge`]. Cost: 7 readings × 512 pings × about 450 samples of their arcs.
#[must_use]
pub fn judge_tilt(
    pings: &[VehiclePing],
    mount: &Pose,
    config: &MapperConfig,
) -> Option<FrameVerdict> {
    compare(
        pings,
        mount,
        (config, TILT_CELLS),
        (&FrameReading::TILTS, TILT),
    )
}

fn compare(
    pings: &[VehiclePing],
    mount: &Pose,
    (config, cells): (&MapperConfig, usize),
    (readings, refutation): (&[FrameReading], Refutation),
) -> Option<FrameVerdict> {
    let pings = thinned(pings, MOST_PINGS);
    let turned_deg = turned_deg(&pings);
    if !(turned_deg >= LEAST_TURN_DEG) {
        return None;
    }
    let agreement = agreement(&pings, config, cells)?;
    if agreement.lit_pings() < LEAST_LIT_PINGS {
        return None;
    }
    let readings = worth_asking(
        &thinned(&pings, FEW_PINGS),
        mount,
        (config, cells),
        readings,
    );
    let scores = scores(&pings, &agreement, mount, &readings);
    Some(verdict(&scores, refutation, pings.len() as u64, turned_deg))
}

fn agreement(pings: &[VehiclePing], config: &MapperConfig, cells: usize) -> Option<Agreement> {
    let heard = pings.iter().map(|ping| Arc::clone(&ping.ping)).collect();
    Agreement::new(heard, config, cells)
}

/// The reading in use, which comes first, and those that these pings do not make less likely by more than chance does.
fn worth_asking(
    pings: &[VehiclePing],
    mount: &Pose,
    (config, cells): (&MapperConfig, usize),
    readings: &[FrameReading],
) -> Vec<FrameReading> {
    let Some(agreement) = agreement(pings, config, cells) else {
        return readings.to_vec();
    };
    let scores = scores(pings, &agreement, mount, readings);
    let is_worth = |scored: &&Scored| {
        let beyond = scored.beyond(&scores[0]);
        beyond.iter().sum::<f64>() >= -error_of_sum(&beyond)
    };
    let worth = scores.iter().filter(is_worth);
    worth.map(|scored| scored.reading).collect()
}

/// Log likelihood of a reading above that by range alone, nats per cell, by block.
struct Scored {
    reading: FrameReading,
    by_block: ByBlock,
}

impl Scored {
    fn gain(&self) -> f64 {
        self.by_block.iter().sum()
    }

    /// Its gain over another.
    fn beyond(&self, other: &Self) -> ByBlock {
        std::array::from_fn(|i| self.by_block[i] - other.by_block[i])
    }
}

fn scores(
    pings: &[VehiclePing],
    agreement: &Agreement,
    mount: &Pose,
    readings: &[FrameReading],
) -> Vec<Scored> {
    let score = |&reading: &FrameReading| {
        let pose = |ping: &VehiclePing| Some(reading.apply(&ping.world_from_vehicle, mount));
        let poses: Vec<Option<Pose>> = pings.iter().map(pose).collect();
        let gain = agreement.gain(&poses);
        Scored {
            reading,
            by_block: gain.map(|gain| gain / agreement.known_cells()),
        }
    };
    readings.iter().map(score).collect()
}

fn verdict(scores: &[Scored], refutation: Refutation, pings: u64, turned_deg: f64) -> FrameVerdict {
    // As given comes first and wins a draw.
    let given = &scores[0];
    let more_likely = |a: &Scored, b: &Scored| b.gain() > a.gain();
    let best = scores
        .iter()
        .fold(given, |a, b| if more_likely(a, b) { b } else { a });
    let beyond = best.beyond(given);
    let error = error_of_sum(&beyond);
    // Against the ranges alone too: a reading that explains nothing refutes nothing.
    let is_far = beyond.iter().sum::<f64>() > refutation.least_errors * error
        && best.gain() > TELLING_ERRORS * error_of_sum(&best.by_block)
        && given.gain() < refutation.least_share * best.gain();
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

/// At most so many, evenly spread over the window.
fn thinned(pings: &[VehiclePing], most: usize) -> Vec<VehiclePing> {
    let is_finite = |ping: &&VehiclePing| ping.world_from_vehicle.is_finite();
    let pings: Vec<&VehiclePing> = pings.iter().filter(is_finite).collect();
    let count = pings.len().min(most);
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
