//! Places of the map that many pings observed, and what those heard around them.

use std::collections::BTreeMap;

use echosplat_measurement::heard::Detail;
use echosplat_model::Standing;
use echosplat_model::glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::moving::Moving;
use crate::accumulate::evidence::BlockIndex;
use crate::features::AtWork;
use crate::refine::field::Field;
use crate::refine::terms::PassTerms;
use crate::refine::visibility::Sight;
use crate::spawn::gaussians::{Gaussians, Stage, Verdict};

/// Landmarks; bounds work.
/// Most landmarks, and most observations of one.
const MOST_LANDMARKS: usize = 160;
/// Observations of one; bounds work.
const MOST_OBSERVATIONS: usize = 160;
/// Confident ones; found.
/// Confident ones that are enough to do without others.
const ENOUGH_SURE: usize = MOST_LANDMARKS / 4;
/// Observations that make a landmark; found.
const LEAST_OBSERVATIONS: usize = 24;
/// Radians beyond the beam, derived: the mount's prior.
/// An observation reaches this far beyond the beam, radians, and in range, metres.
const REACH_RAD: f32 = 0.06;
/// Metres, derived: priors of lever and clock.
const REACH_M: f32 = 0.4;
/// Metres a second, physics: nominal.
/// Nominal speed of sound: the motion within a ping is a matter of milliseconds.
const SOUND_MPS: f32 = 1500.0;
/// Noise powers; found.
/// Log odds of an echo in a bin of power `x` over its noise: `x` less this.
const EVEN_POWER: f32 = 6.4;

/// One ping's observation of a landmark.
#[derive(Debug, Clone)]
pub(super) struct Observation {
    /// Landmark in the sensor's frame, as the pose was told, metres.
    pub(super) place_m: Vec3,
    /// Sensor from map.
    pub(super) turn: Mat3,
    /// Motion in the sensor's frame, m/s and rad/s.
    pub(super) linear_mps: Vec3,
    pub(super) angular_radps: Vec3,
    /// When the echo met the landmark, after the time of the pose, seconds.
    pub(super) after_s: f32,
    /// Middle of the first bin kept, metres, and from one to the next.
    pub(super) first_m: f32,
    pub(super) step_m: f32,
    /// What was heard in the bins kept, 0 to 1.
    pub(super) heard: Vec<f32>,
    pub(super) weight: f32,
    /// Block of time.
    pub(super) block: u32,
}

/// A place and its observations.
#[derive(Debug, Clone)]
pub(super) struct Landmark {
    pub(super) observations: Vec<Observation>,
}

/// All landmarks of a map.
#[derive(Debug, Clone, Default)]
pub(crate) struct Landmarks {
    pub(super) of: Vec<Landmark>,
    /// Blocks of time.
    pub(super) blocks: usize,
    pub(super) beam_sigma_rad: f32,
}

impl Landmarks {
    /// At these places, with what `moving` heard around them, or with what it would have heard were the map of that field true.
    pub(crate) fn find(
        moving: &[Moving],
        places_m: &[Vec3],
        map: Option<(&Field, AtWork)>,
    ) -> Self {
        let Some(first) = moving.first() else {
            return Self::default();
        };
        let predicted = map.map_or_else(Vec::new, |(field, at_work)| {
            predictions(moving, field, at_work)
        });
        let of: Vec<Landmark> = places_m
            .par_iter()
            .map(|&at_m| landmark(at_m, moving, &predicted))
            .filter(|landmark| landmark.observations.len() >= LEAST_OBSERVATIONS)
            .collect();
        Self {
            of,
            blocks: moving
                .iter()
                .map(|p| p.block as usize + 1)
                .max()
                .unwrap_or(0),
            beam_sigma_rad: first.keyframe.geometry.beam.azimuth_width_deg.to_radians() / 2.354_82,
        }
    }

    pub(super) fn observation_count(&self) -> usize {
        self.of.iter().map(|l| l.observations.len()).sum()
    }
}

/// Of each block the strongest Gaussian, confident ones only where there are enough, evenly over the map.
pub(crate) fn places(gaussians: &Gaussians) -> Vec<Vec3> {
    let mut best: BTreeMap<BlockIndex, (bool, f32, usize)> = BTreeMap::new();
    for slot in gaussians.slots() {
        let Verdict::Published(standing) = gaussians.verdict[slot] else {
            continue;
        };
        if gaussians.stage[slot] != Stage::Worked {
            continue;
        }
        let strength = gaussians.strongest(slot);
        let is_sure = standing == Standing::Confident;
        let entry = best.entry(gaussians.home[slot].0);
        let entry = entry.or_insert((is_sure, strength, slot));
        if (is_sure, strength) > (entry.0, entry.1) {
            *entry = (is_sure, strength, slot);
        }
    }
    let sure = best.values().filter(|(is_sure, ..)| *is_sure).count();
    let chosen = best
        .values()
        .filter(|(is_sure, ..)| *is_sure || sure < ENOUGH_SURE);
    let slots: Vec<usize> = chosen.map(|&(.., slot)| slot).collect();
    let places = evenly(&slots, MOST_LANDMARKS).map(|&slot| gaussians.mean_m[slot]);
    places.collect()
}

/// At most so many of them.
pub(crate) fn evenly<T>(all: &[T], most: usize) -> impl Iterator<Item = &T> {
    let stride = (all.len() as f64 / most as f64).max(1.0);
    (0..all.len().min(most)).map(move |index| &all[(index as f64 * stride) as usize])
}

/// What each ping would hear if the map were true, speckle included.
fn predictions(moving: &[Moving], field: &Field, at_work: AtWork) -> Vec<Vec<f32>> {
    let terms = PassTerms {
        is_blurred: false,
        at_work,
    };
    let of_ping = |sight: &mut Sight, moving: &Moving| {
        let keyframe = &moving.keyframe;
        sight.observe(keyframe, terms, field, Detail::Strength);
        let bins = sight
            .predicted
            .iter()
            .take(keyframe.geometry.bin_count as usize);
        let speckled = bins
            .enumerate()
            .map(|(bin, mean)| mean * speckle(keyframe.sequence, bin as u64));
        speckled.collect()
    };
    moving
        .par_iter()
        .map_init(Sight::default, of_ping)
        .collect()
}

/// A draw of the exponential distribution of mean 1, the same for the same ping and bin (splitmix64).
fn speckle(sequence: u64, bin: u64) -> f32 {
    let mut z = (sequence.wrapping_shl(20) ^ bin).wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^= z >> 31;
    let unit = ((z >> 40) as f32 + 0.5) / (1u64 << 24) as f32;
    -unit.ln()
}

fn landmark(at_m: Vec3, moving: &[Moving], predicted: &[Vec<f32>]) -> Landmark {
    let seen: Vec<usize> = (0..moving.len())
        .filter(|&index| sees(&moving[index], at_m))
        .collect();
    let observations = evenly(&seen, MOST_OBSERVATIONS);
    let observations = observations.filter_map(|&index| {
        let predicted = predicted.get(index).map(Vec::as_slice);
        observation_at(at_m, &moving[index], predicted)
    });
    let mut observations: Vec<Observation> = observations.collect();
    level(&mut observations);
    Landmark { observations }
}

/// Whether the whole of a landmark's surroundings is within a ping.
fn sees(moving: &Moving, at_m: Vec3) -> bool {
    let geometry = &moving.keyframe.geometry;
    let s = geometry.pose.axes.transpose() * (at_m - geometry.pose.position_m);
    let range_m = s.length();
    let end_m = geometry.range_start_m + geometry.bin_length_m * geometry.bin_count as f32;
    s.x > 0.0
        && s.y.abs() < s.x * (REACH_RAD + 0.5 * geometry.beam.azimuth_width_deg.to_radians())
        && s.z.abs() < s.x.hypot(s.y) * geometry.beam.elevation_half_width_rad().tan()
        && range_m > geometry.range_start_m + REACH_M
        && range_m + REACH_M < end_m
}

fn observation_at(at_m: Vec3, moving: &Moving, predicted: Option<&[f32]>) -> Option<Observation> {
    let keyframe = &moving.keyframe;
    let geometry = &keyframe.geometry;
    let turn = geometry.pose.axes.transpose();
    let place_m = turn * (at_m - geometry.pose.position_m);
    let range_m = place_m.length();
    let bin = |r: f32| (r - geometry.range_start_m) / geometry.bin_length_m;
    let first = bin(range_m - REACH_M).max(keyframe.profile.first_bin() as f32) as usize;
    let end = (bin(range_m + REACH_M) as usize + 1).min(geometry.bin_count as usize);
    if first >= end {
        return None;
    }
    let profile = &keyframe.profile;
    let heard: Vec<f32> = match predicted {
        Some(predicted) => predicted.get(first..end)?.to_vec(),
        None => profile
            .intensity
            .iter()
            .skip(first)
            .take(end - first)
            .collect(),
    };
    let mut ground = profile.ground.iter().skip(first);
    let heard = heard.into_iter().map(|power| {
        let noise = profile.noise + ground.next().unwrap_or(0.0);
        let over = power / noise.max(f32::MIN_POSITIVE);
        if over > EVEN_POWER { power } else { 0.0 }
    });
    Some(Observation {
        place_m,
        turn,
        linear_mps: moving.linear_mps,
        angular_radps: moving.angular_radps,
        after_s: (range_m - geometry.pose.reference_range_m) / SOUND_MPS,
        first_m: geometry.range_start_m + (first as f32 + 0.5) * geometry.bin_length_m,
        step_m: geometry.bin_length_m,
        heard: heard.collect(),
        weight: keyframe.weight,
        block: moving.block,
    })
}

/// Powers to fractions of the loudest that is usual.
fn level(observations: &mut [Observation]) {
    let mut peaks: Vec<f32> = observations
        .iter()
        .map(|observation| observation.heard.iter().copied().fold(0.0, f32::max))
        .collect();
    peaks.sort_unstable_by(f32::total_cmp);
    let usual = peaks.get(peaks.len() * 9 / 10).copied().unwrap_or(0.0);
    for power in observations
        .iter_mut()
        .flat_map(|observation| &mut observation.heard)
    {
        *power = if usual > 0.0 {
            *power / (*power + usual)
        } else {
            0.0
        };
    }
}
