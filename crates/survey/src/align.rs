//! One map laid on another: turned about up, and moved.

use echosplat_model::glam::{DMat3, DVec3};

use crate::grid::{Grid, SHARED_M, cells};
use crate::linear::{inverse, times};
use crate::plane::axes_of;
use crate::{Sample, SurveyError};

/// Metres; how far places of the two are looked for, round by round.
const REACHES_M: [f64; 4] = [2.0, 1.0, 0.5, 0.3];
/// Rounds with one reach.
const ROUNDS: usize = 15;
/// Metres; around a place of the first map, what it is part of: ground, a wall, a rod.
const AROUND_M: f64 = 0.4;
/// Metres; places scatter so much across what they are part of.
const SCATTER_M: f64 = 0.03;
/// Share of a reach, without a unit, beyond which a pair counts less and less: it may be what changed.
const SOFT: f64 = 0.25;
/// Of the pairs, without a unit, that count for the sigma: neighbours err alike.
const INDEPENDENT: f64 = 0.1;
/// Turn about up, and move.
const NUMBERS: usize = 4;
/// Most places of the second map that are laid on the first.
const MOST_PLACES: usize = 8_000;
/// Most places of the first map that others are asked whether they lie on a wall by.
const MOST_NEIGHBOURS: usize = 20_000;
/// Share of the second map, without a unit, that must lie near the first.
const LEAST_SHARE: f64 = 0.3;
/// Pairs; fewer tell nothing.
const FEWEST: usize = 20;

/// How the second map lies on the first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alignment {
    /// Turn about up that the second was given, degrees anticlockwise, about `pivot_m`.
    pub turn_deg: f64,
    /// Move that it was given after that, metres.
    pub move_m: DVec3,
    /// What it was turned about, metres.
    pub pivot_m: DVec3,
    /// Root mean square of the distances that the pairs kept, across what they are part of, metres.
    pub residual_m: f64,
    /// One sigma of the move, along its least known axis, metres: of the pairs, and of what poses' errors do to both maps.
    pub sigma_m: f64,
    /// Places of the second map that have one of the first near.
    pub pairs: usize,
}

impl Alignment {
    /// A place of the second map on the first, metres.
    #[must_use]
    pub fn place(&self, at_m: DVec3) -> DVec3 {
        self.turn() * (at_m - self.pivot_m) + self.pivot_m + self.move_m
    }

    /// The second map on the first.
    #[must_use]
    pub fn apply(&self, samples: &[Sample]) -> Vec<Sample> {
        let turn = self.turn();
        let moved = |sample: &Sample| Sample {
            at_m: self.place(sample.at_m),
            covariance_m2: turned(turn, sample.covariance_m2),
            ..*sample
        };
        samples.iter().map(moved).collect()
    }

    fn turn(&self) -> DMat3 {
        DMat3::from_rotation_z(self.turn_deg.to_radians())
    }
}

/// What is infinite stays so: infinity times zero is no number.
fn turned(turn: DMat3, covariance: DMat3) -> DMat3 {
    match covariance.is_finite() {
        true => turn * covariance * turn.transpose(),
        false => covariance,
    }
}

/// Finds how the second map lies on the first, from where it lies now, within some two metres.
///
/// # Errors
/// If they share too little.
pub fn align(first: &[Sample], second: &[Sample]) -> Result<Alignment, SurveyError> {
    let confident = |samples: &[Sample]| -> Vec<DVec3> {
        let kept = samples.iter().filter(|sample| sample.is_confident);
        kept.map(|sample| sample.at_m).collect()
    };
    let (fixed, all) = (confident(first), confident(second));
    let step = all.len().div_ceil(MOST_PLACES).max(1);
    let moving: Vec<DVec3> = all.into_iter().step_by(step).collect();
    let pivot_m = moving.iter().sum::<DVec3>() / moving.len().max(1) as f64;
    let mut found = Alignment {
        turn_deg: 0.0,
        move_m: DVec3::ZERO,
        pivot_m,
        residual_m: 0.0,
        sigma_m: 0.0,
        pairs: 0,
    };
    let walls = weights_of(&fixed);
    for reach_m in REACHES_M {
        let grid = Grid::new(fixed.iter().copied(), reach_m);
        for _ in 0..ROUNDS {
            let pairs = pairs(&grid, &fixed, &walls, &moving, &found);
            let share = pairs.len() as f64 / moving.len().max(1) as f64;
            let apart = SurveyError::Apart {
                share: 100.0 * share,
                reach_m,
            };
            if pairs.len() < FEWEST || share < LEAST_SHARE {
                return Err(apart);
            }
            let better = step_of(&pairs, found, SOFT * reach_m).ok_or(apart)?;
            let change_m = (better.move_m - found.move_m).length();
            let is_done = change_m < 1e-5 && (better.turn_deg - found.turn_deg).abs() < 1e-4;
            found = better;
            if is_done {
                break;
            }
        }
    }
    let both_m2 = shared_m2(first, &fixed) + shared_m2(second, &moving);
    found.sigma_m = found.sigma_m.hypot(both_m2.sqrt());
    Ok(found)
}

/// Variance of a whole map's place, square metres: that which it tells of a Gaussian, alike within a block.
fn shared_m2(samples: &[Sample], places: &[DVec3]) -> f64 {
    let told = samples.iter().filter(|sample| sample.is_confident);
    let told = told.map(|sample| sample.covariance_m2);
    let told = told.map(|of| (of.x_axis.x + of.y_axis.y + of.z_axis.z) / 3.0);
    let known: Vec<f64> = told.filter(|variance| variance.is_finite()).collect();
    let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
    mean / cells(places, SHARED_M).max(1) as f64
}

/// A place of the second map where it lies now, the nearest of the first, and how much each direction counts there.
struct Pair {
    at: DVec3,
    to: DVec3,
    weight: DMat3,
}

/// How much each direction counts at each place: across a wall all, along it nearly nothing, since there the nearest
/// place is one as good as its neighbour.
fn weights_of(places: &[DVec3]) -> Vec<DMat3> {
    let step = places.len().div_ceil(MOST_NEIGHBOURS).max(1);
    let thinned: Vec<DVec3> = places.iter().copied().step_by(step).collect();
    let grid = Grid::new(thinned.iter().copied(), AROUND_M);
    let floor = SCATTER_M * SCATTER_M;
    let weight = |at: &DVec3| {
        let near = grid.near(*at).map(|(index, _)| thinned[index]);
        let near: Vec<DVec3> = near.chain([*at]).collect();
        let (_, axes) = axes_of(&near, &vec![1.0; near.len()]);
        let least = axes[0].0 + floor;
        axes.iter().fold(DMat3::ZERO, |sum, (variance, axis)| {
            let share = (least / (variance + floor)).powi(2);
            sum + DMat3::from_cols(*axis * axis.x, *axis * axis.y, *axis * axis.z) * share
        })
    };
    places.iter().map(weight).collect()
}

fn pairs(
    grid: &Grid,
    fixed: &[DVec3],
    walls: &[DMat3],
    moving: &[DVec3],
    now: &Alignment,
) -> Vec<Pair> {
    let pair = |at: &DVec3| {
        let at = now.place(*at);
        let (index, _) = grid.nearest(at)?;
        Some(Pair {
            at,
            to: fixed[index],
            weight: walls[index],
        })
    };
    moving.iter().filter_map(pair).collect()
}

/// The turn about up and the move that bring the pairs nearest, on top of what was found. Pairs count half where they
/// are `soft_m` apart (Geman and Mc Clure).
fn step_of(pairs: &[Pair], before: Alignment, soft_m: f64) -> Option<Alignment> {
    let middle = before.pivot_m + before.move_m;
    let mut normal = [[0.0; NUMBERS]; NUMBERS];
    let mut right = [0.0; NUMBERS];
    let (mut square, mut total) = (0.0, 0.0);
    for pair in pairs {
        let apart = pair.to - pair.at;
        let off_2 = apart.dot(pair.weight * apart).max(0.0);
        let share = 1.0 / (1.0 + off_2 / (soft_m * soft_m));
        let trust = share * share;
        let around = DVec3::Z.cross(pair.at - middle);
        let columns = [around, DVec3::X, DVec3::Y, DVec3::Z];
        for i in 0..NUMBERS {
            let pulled = pair.weight * columns[i] * trust;
            right[i] += pulled.dot(apart);
            for j in 0..NUMBERS {
                normal[i][j] += pulled.dot(columns[j]);
            }
        }
        square += trust * off_2;
        total += trust;
    }
    let inverted = inverse(&normal)?;
    let [turn, x, y, z] = times(&inverted, &right);
    let residual_2 = square / total;
    // Turned about the middle and moved: the pivot goes with the move alone.
    let sigma_2 =
        (1..NUMBERS).map(|i| inverted[i][i]).fold(0.0, f64::max) * residual_2 / INDEPENDENT;
    Some(Alignment {
        turn_deg: before.turn_deg + turn.to_degrees(),
        move_m: before.move_m + DVec3::new(x, y, z),
        pivot_m: before.pivot_m,
        residual_m: residual_2.sqrt(),
        sigma_m: sigma_2.sqrt(),
        pairs: pairs.len(),
    })
}
