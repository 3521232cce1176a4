//! What the map asserts: a Gaussian is surface only if its surroundings explain most of its
//! echoes and the looks fix its position; else it is ambiguous, or explained away by others.

use echosplat_model::Standing;

use crate::MapperConfig;
use crate::evidence::Evidence;
use crate::expectation::{Scene, over_pings, pulls};
use crate::gaussians::{Gaussians, Verdict};
use crate::history::Past;
use crate::profile::BinState;
use crate::shape::{Neighbours, eigen};
use crate::visibility::{Row, Sight};

/// Surroundings reach this many voxels: places the sonar cannot tell apart are one explanation.
const SURROUNDINGS_VOXELS: f32 = 5.0;
/// Least number of independent lit looks.
const LEAST_LOOKS: f32 = 3.0;
/// Below this share of its echoes a Gaussian is explained away by others.
const LEAST_SHARE: f32 = 0.1;
/// Below this part of the strongest strength around it, it is the tail of a neighbour.
const LEAST_STRENGTH: f32 = 0.12;

/// What was seen of one Gaussian over all looks that lit it.
#[derive(Debug, Clone, Copy, Default)]
struct Account {
    looks: f32,
    share: f32,
}

/// Judges every Gaussian by `pings` and sets its verdict and sigma. Returns pairs done.
pub(crate) fn assess(
    evidence: &Evidence,
    gaussians: &mut Gaussians,
    pings: &[&Past],
    floor: f32,
    config: &MapperConfig,
) -> u64 {
    let scene = Scene {
        evidence,
        gaussians,
        floor,
    };
    let radius_m = SURROUNDINGS_VOXELS * evidence.voxel_m();
    let (accounts, account_pairs) = accounts(scene, pings, radius_m);
    let (pulls, pull_pairs) = pulls(scene, pings);
    let peaks = strongest_around(gaussians, 2.5 * evidence.voxel_m());
    let slots: Vec<usize> = gaussians.slots().collect();
    for slot in slots {
        let (_, information) = eigen(pulls[slot].information.to_mat3());
        gaussians.sigma_m[slot] = 1.0 / information.x.max(0.0).sqrt();
        let relative = gaussians.strength[slot] / peaks[slot];
        gaussians.verdict[slot] =
            verdict(accounts[slot], relative, gaussians.sigma_m[slot], config);
    }
    account_pairs + pull_pairs
}

fn verdict(account: Account, relative: f32, sigma_m: f32, config: &MapperConfig) -> Verdict {
    let share = account.share / account.looks;
    if !(share > LEAST_SHARE && relative > LEAST_STRENGTH) {
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
    let count = scene.gaussians.slot_count();
    over_pings(
        scene,
        pings,
        || vec![Account::default(); count],
        |accounts, past, sight| account_ping(accounts, past, sight, scene.gaussians, radius_m),
        |total, part| {
            for (total, part) in total.iter_mut().zip(&part) {
                total.looks += part.looks;
                total.share += part.share;
            }
        },
    )
}

/// For every Gaussian near the beam's axis: which part of the echo in its own bin comes from
/// within `radius_m` of it.
fn account_ping(
    accounts: &mut [Account],
    past: &Past,
    sight: &Sight,
    gaussians: &Gaussians,
    radius_m: f32,
) {
    let rows = sight.rows();
    let by_bin = rows_by_bin(rows, sight.predicted.len());
    for row in rows {
        let splat = &row.splat;
        let off = splat.azimuth_rad * splat.azimuth_rad / splat.azimuth_variance_rad2;
        let range_bins = (splat.range_m - past.look.range_start_m) / past.look.bin_length_m;
        let bin = range_bins as usize;
        let lit = past.profile.state.get(bin) == Some(&BinState::Lit);
        if !lit || !(off < 1.5) {
            continue;
        }
        let looks = past.weight * (1.0 - off / 1.5);
        let here = gaussians.mean_m[row.slot as usize];
        let mut near = 0.0;
        for &other in &by_bin[bin] {
            let other = &rows[other as usize];
            if gaussians.mean_m[other.slot as usize].distance(here) < radius_m {
                near += gaussians.strength[other.slot as usize] * energy_in(sight, other, bin);
            }
        }
        let account = &mut accounts[row.slot as usize];
        account.looks += looks;
        account.share += looks * near / sight.predicted[bin];
    }
}

fn rows_by_bin(rows: &[Row], bin_count: usize) -> Vec<Vec<u32>> {
    let mut by_bin = vec![Vec::new(); bin_count];
    for (index, row) in rows.iter().enumerate() {
        for bin in row.bins.clone() {
            by_bin[bin as usize].push(index as u32);
        }
    }
    by_bin
}

fn energy_in(sight: &Sight, row: &Row, bin: usize) -> f32 {
    sight.energies(row)[bin - row.bins.start as usize]
}

/// The strongest strength within `radius_m` of each slot.
fn strongest_around(gaussians: &Gaussians, radius_m: f32) -> Vec<f32> {
    let neighbours = Neighbours::new(gaussians, radius_m, |_| true);
    let mut peaks = vec![f32::MIN_POSITIVE; gaussians.slot_count()];
    for slot in gaussians.slots() {
        neighbours.within_cell(gaussians, gaussians.mean_m[slot], |other| {
            peaks[slot] = peaks[slot].max(gaussians.strength[other]);
        });
    }
    peaks
}
