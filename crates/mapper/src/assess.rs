//! What the map asserts: a Gaussian is surface only if its surroundings explain most of its
//! echoes and the looks fix its position; else it is ambiguous, or explained away by others.

use echosplat_model::Standing;

use crate::MapperConfig;
use crate::evidence::Evidence;
use crate::expectation::{Scene, Sum, over_pings, pulls};
use crate::gaussians::{Gaussians, Verdict};
use crate::history::Past;
use crate::profile::BinState;
use crate::shape::{Neighbours, eigen};
use crate::tally::Tally;
use crate::visibility::{Row, Sight};

/// Surroundings reach this many voxels: places the sonar cannot tell apart are one explanation.
const SURROUNDINGS_VOXELS: f32 = 5.0;
/// Least number of independent lit looks. At the rim of what a dive saw, a handful agree by chance.
const LEAST_LOOKS: f32 = 16.0;
/// Below this part of what the best place on its arcs explains, a Gaussian is explained away. Where
/// all places explain alike nothing is: they are ambiguous together.
const LEAST_RIVALRY: f32 = 0.15;
/// Below this part of the strongest strength around it, it is the tail of a neighbour.
const LEAST_STRENGTH: f32 = 0.12;

/// What was seen of one Gaussian over all looks that lit it.
#[derive(Debug, Clone, Copy, Default)]
struct Account {
    /// Independent lit looks.
    looks: f32,
    /// Sum over looks of the part of the echo that comes from its surroundings.
    share: f32,
    /// Sum over looks of what its surroundings explain against the best place on the same arc.
    rivalry: f32,
}

impl Account {
    /// As if each look had been made so many times.
    fn times(self, count: f32) -> Self {
        Self {
            looks: self.looks * count,
            share: self.share * count,
            rivalry: self.rivalry * count,
        }
    }
}

impl Sum for Account {
    fn join(&mut self, part: &Self) {
        self.looks += part.looks;
        self.share += part.share;
        self.rivalry += part.rivalry;
    }
}

/// Judges every Gaussian by `pings`, every `stride`-th of those remembered, and sets its verdict and
/// sigma as if by all. Returns pairs done.
pub(crate) fn assess(
    evidence: &Evidence,
    gaussians: &mut Gaussians,
    pings: &[&Past],
    stride: usize,
    floor: f32,
    config: &MapperConfig,
) -> u64 {
    let scene = Scene {
        evidence,
        gaussians,
        floor,
        // What is asserted has to stand however far the poses may be off.
        is_blurred: true,
    };
    let radius_m = SURROUNDINGS_VOXELS * evidence.voxel_m();
    let (accounts, account_pairs) = accounts(scene, pings, radius_m);
    let (pulls, pull_pairs) = pulls(scene, pings);
    let peaks = strongest_around(gaussians, 2.5 * evidence.voxel_m());
    let slots: Vec<usize> = gaussians.slots().collect();
    let stride = stride as f32;
    for slot in slots {
        let (_, information) = eigen(pulls[slot].information.to_mat3());
        let alone = 1.0 / (stride * information.x.max(0.0)).sqrt();
        // What the parts of a split Gaussian know adds up.
        gaussians.sigma_m[slot] = alone * gaussians.part[slot];
        let relative = gaussians.strength[slot].strongest() / peaks[slot];
        gaussians.verdict[slot] = verdict(
            accounts[slot].times(stride),
            relative,
            gaussians.sigma_m[slot],
            config,
        );
    }
    account_pairs + pull_pairs
}

fn verdict(account: Account, relative: f32, sigma_m: f32, config: &MapperConfig) -> Verdict {
    let share = account.share / account.looks;
    let rivalry = account.rivalry / account.looks;
    if !(rivalry > LEAST_RIVALRY && relative > LEAST_STRENGTH) {
        return Verdict::ExplainedAway;
    }
    let sure = account.looks >= LEAST_LOOKS
        && share >= config.confident_share
        && sigma_m <= config.confident_sigma_m;
    Verdict::Published(if sure {
        Standing::Confident
    } else {
        Standing::Ambiguous
    })
}

fn accounts(scene: Scene<'_>, pings: &[&Past], radius_m: f32) -> (Vec<Account>, u64) {
    over_pings(scene, pings, |tally, arcs, past, sight| {
        account_ping(tally, past, sight, arcs, radius_m);
    })
}

/// For every Gaussian near the beam's axis: which part of the echo in its own bin comes from
/// within `radius_m` of it. In one bin of a narrow beam a place is its position along the arc, so
/// the surroundings are the steps of the arc next to it.
fn account_ping(
    tally: &mut Tally<Account>,
    past: &Past,
    sight: &Sight,
    arcs: &mut Arcs,
    radius_m: f32,
) {
    arcs.fill(sight, past, 0.5 * radius_m);
    for row in sight.rows() {
        let splat = &row.splat;
        let off = splat.azimuth_rad * splat.azimuth_rad / splat.azimuth_variance_rad2;
        let range_bins = (splat.range_m - past.look.range_start_m) / past.look.bin_length_m;
        let bin = range_bins as usize;
        let lit = past.profile.state.at(bin) == BinState::Lit;
        if !lit || !(off < 1.5) {
            continue;
        }
        let looks = past.weight * (1.0 - off / 1.5);
        let near = arcs.around(bin, arcs.step_of(row));
        let account = tally.of(row.slot);
        account.looks += looks;
        account.share += looks * near / sight.predicted[bin];
        account.rivalry += looks * near / arcs.best(bin).max(f32::MIN_POSITIVE);
    }
}

/// Predicted energy per bin and step along its arc. Reused from ping to ping.
#[derive(Debug, Default)]
struct Arcs {
    energy: Vec<f32>,
    /// The most energy around any step of a bin, worked out when asked for; negative until then.
    best: Vec<f32>,
    steps: usize,
    steps_per_m: f32,
}

impl Arcs {
    /// Steps of `step_m` over the whole half-circle of the farthest bin.
    fn fill(&mut self, sight: &Sight, past: &Past, step_m: f32) {
        let look = &past.look;
        let end_m = look.range_start_m + look.bin_length_m * look.bin_count as f32;
        self.steps_per_m = step_m.recip();
        self.steps = (3.2 * end_m * self.steps_per_m) as usize + 5;
        self.energy.clear();
        self.energy
            .resize(self.steps * look.bin_count as usize, 0.0);
        self.best.clear();
        self.best.resize(look.bin_count as usize, -1.0);
        for row in sight.rows() {
            let step = self.step_of(row);
            for (bin, energy) in row.bins.clone().zip(sight.energies(row)) {
                self.energy[bin as usize * self.steps + step] += row.strength * energy;
            }
        }
    }

    fn step_of(&self, row: &Row) -> usize {
        let along_m = row.splat.elevation_rad * row.splat.range_m;
        let step = along_m * self.steps_per_m + 0.5 * self.steps as f32;
        (step.max(0.0) as usize).min(self.steps - 1)
    }

    fn best(&mut self, bin: usize) -> f32 {
        if self.best[bin] < 0.0 {
            let sums = (0..self.steps).map(|step| self.around(bin, step));
            self.best[bin] = sums.fold(0.0, f32::max);
        }
        self.best[bin]
    }

    /// Energy in a bin within two steps of `step`.
    fn around(&self, bin: usize, step: usize) -> f32 {
        let first = step.saturating_sub(2);
        let last = (step + 3).min(self.steps);
        let from = bin * self.steps;
        self.energy[from + first..from + last].iter().sum()
    }
}

/// Slots that are nothing but the tail of a stronger neighbour: below `part` of it.
pub(crate) fn tails(gaussians: &Gaussians, voxel_m: f32, part: f32) -> Vec<usize> {
    let peaks = strongest_around(gaussians, 2.5 * voxel_m);
    let weak = |&slot: &usize| !(gaussians.strength[slot].strongest() > part * peaks[slot]);
    gaussians.slots().filter(weak).collect()
}

/// The strongest strength within `radius_m` of each slot.
fn strongest_around(gaussians: &Gaussians, radius_m: f32) -> Vec<f32> {
    let neighbours = Neighbours::new(gaussians, radius_m, |_| true);
    let mut peaks = vec![f32::MIN_POSITIVE; gaussians.slot_count()];
    for slot in gaussians.slots() {
        neighbours.within_cell(gaussians, gaussians.mean_m[slot], |other| {
            peaks[slot] = peaks[slot].max(gaussians.strength[other].strongest());
        });
    }
    peaks
}
