//! What came, went and moved between two maps of one place.

use echosplat_model::glam::DVec3;

use crate::align::{Alignment, align};
use crate::grid::Grid;
use crate::{Sample, SurveyError};

/// Metres; what is nearer to something of the other map is the same thing.
const LEAST_M: f64 = 0.25;
/// Sigmas of two places, beyond which they are two.
const SIGMAS: f64 = 3.0;
/// Metres; a sigma beyond this tells nothing of a place, and such a Gaussian nothing of a change.
const MOST_SIGMA_M: f64 = 0.3;
/// Metres; of the other map's place a sigma beyond this is taken for this: what is known so badly explains what lies at its
/// middle, not all within its reach.
const MOST_EXPLAINING_SIGMA_M: f64 = 0.1;
/// Share of a thing, without a unit, that must have nothing near in the other map, not even ambiguous.
const LEAST_SHARE_ALONE: f64 = 0.5;
/// Metres; Gaussians of one thing are no farther from each other.
const LINK_M: f64 = 0.3;
/// Gaussians of a thing, at least: fewer are noise of a map.
const FEWEST: usize = 12;
/// Metres; a thing is at least so large.
const LEAST_SIZE_M: f64 = 0.2;
/// Metres; what is flatter is ground that one dive reached and the other did not.
const LEAST_HEIGHT_M: f64 = 0.1;
/// Metres along the ground; beyond, the other dive is taken not to have looked there.
const LOOKED_M: f64 = 1.5;
/// Metres; a thing that went and one that came within this may be one that moved.
const MOVED_M: f64 = 5.0;
/// The most that sizes of one thing differ from map to map, without a unit.
const ALIKE: f64 = 1.6;

/// What became of a thing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// In the second map alone.
    Came,
    /// In the first map alone.
    Went,
    /// In the second map elsewhere.
    Moved,
}

/// One thing that is different.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// What became of it.
    pub kind: Kind,
    /// Its middle, in the world of the first map, metres; of what moved, where it is now.
    pub at_m: DVec3,
    /// How far it moved; zero of what did not.
    pub by_m: DVec3,
    /// Its extent along the axes, metres.
    pub size_m: DVec3,
    /// One sigma of `at_m`, or of `by_m` of what moved, along each axis, metres.
    pub sigma_m: f64,
    /// Its Gaussians.
    pub count: usize,
    /// Their mean probability that there is surface.
    pub probability: f64,
}

/// What became of a Gaussian, by the thing it is part of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Became {
    /// Nothing: it is in both maps, or tells of no change.
    #[default]
    Same,
    /// Of the second map: part of what came.
    Came,
    /// Of the first map: part of what went.
    Went,
    /// Of the first map: part of what moved from there.
    MovedFrom,
    /// Of the second map: part of what moved to there.
    MovedTo,
    /// Of the first map: the second dive seems not to have looked there.
    NotLookedAt,
}

/// Two maps, one on the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Compared {
    /// How the second was laid on the first.
    pub alignment: Alignment,
    /// Largest first.
    pub changes: Vec<Change>,
    /// Share of the first map's Gaussians where the second dive seems not to have looked.
    pub not_looked_at: f64,
    /// What became of each of the first map's places, in their order, shape `[first]`.
    pub first: Vec<Became>,
    /// The same of the second's, shape `[second]`.
    pub second: Vec<Became>,
}

/// Places that hang together.
struct Thing {
    change: Change,
    /// Their numbers.
    members: Vec<usize>,
}

/// Lays the second map on the first and tells what is different. Ambiguous Gaussians and the ground tell of no change; but
/// where most of a thing has ambiguous ones beside it, it is not gone.
///
/// # Errors
/// If the two cannot be laid on each other.
pub fn compare(first: &[Sample], second: &[Sample]) -> Result<Compared, SurveyError> {
    let alignment = align(first, second)?;
    let second = alignment.apply(second);
    let (went, unseen) = missing(first, &second, &alignment);
    let (came, _) = missing(&second, first, &alignment);
    let went = things(first, &went, Kind::Went, &alignment);
    let came = things(&second, &came, Kind::Came, &alignment);
    let mut became = [
        vec![Became::Same; first.len()],
        vec![Became::Same; second.len()],
    ];
    unseen
        .iter()
        .for_each(|index| became[0][*index] = Became::NotLookedAt);
    let mut changes = moved(went, came, &mut became);
    changes.sort_by_key(|change| std::cmp::Reverse(change.count));
    let confident = first.iter().filter(|sample| sample.is_confident).count();
    let [first, second] = became;
    Ok(Compared {
        alignment,
        changes,
        not_looked_at: unseen.len() as f64 / confident.max(1) as f64,
        first,
        second,
    })
}

/// A Gaussian that the other map asserts nothing beside.
#[derive(Debug, Clone, Copy)]
struct Missing {
    number: usize,
    /// Nor has it something ambiguous there.
    is_alone: bool,
}

/// The one's confident Gaussians that have nothing confident near them in the other, which looked there; and numbers of those
/// where it did not look.
fn missing(of: &[Sample], other: &[Sample], alignment: &Alignment) -> (Vec<Missing>, Vec<usize>) {
    // No direction has more than the root of all three axes' variances.
    let most_m = (3.0_f64.sqrt() * MOST_SIGMA_M).hypot(MOST_EXPLAINING_SIGMA_M);
    let reach_m = LEAST_M + SIGMAS * most_m.hypot(alignment.sigma_m);
    let grid = Grid::new(other.iter().map(|sample| sample.at_m), reach_m);
    let flat = |at: DVec3| DVec3::new(at.x, at.y, 0.0);
    let ground = Grid::new(other.iter().map(|sample| flat(sample.at_m)), LOOKED_M);
    let (mut found, mut unseen) = (Vec::new(), Vec::new());
    let telling = of.iter().enumerate();
    let telling = telling.filter(|(_, sample)| sample.is_confident && !sample.is_ground);
    for (number, sample) in telling {
        if ground.near(flat(sample.at_m)).next().is_none() {
            unseen.push(number);
            continue;
        }
        let is_known = [DVec3::X, DVec3::Y, DVec3::Z]
            .iter()
            .all(|axis| sample.sigma_along_m(*axis) <= MOST_SIGMA_M);
        if !is_known {
            continue;
        }
        let explains = |(index, apart_m): (usize, f64)| {
            let other = &other[index];
            let direction = (other.at_m - sample.at_m).normalize_or(DVec3::Z);
            let other_m = match other.is_ground {
                true => 0.0,
                false => other.sigma_along_m(direction).min(MOST_EXPLAINING_SIGMA_M),
            };
            let sigma_m = sample.sigma_along_m(direction).hypot(other_m);
            other.is_confident && apart_m <= LEAST_M + SIGMAS * sigma_m.hypot(alignment.sigma_m)
        };
        if !grid.near(sample.at_m).any(explains) {
            let is_beside = |(_, apart_m): (usize, f64)| apart_m <= LEAST_M;
            let is_alone = !grid.near(sample.at_m).any(is_beside);
            found.push(Missing { number, is_alone });
        }
    }
    (found, unseen)
}

/// Those of these that hang together, where they are enough and most of them alone.
fn things(all: &[Sample], missing: &[Missing], kind: Kind, alignment: &Alignment) -> Vec<Thing> {
    let samples: Vec<Sample> = missing.iter().map(|missing| all[missing.number]).collect();
    let grid = Grid::new(samples.iter().map(|sample| sample.at_m), LINK_M);
    let mut is_taken = vec![false; samples.len()];
    let mut found = Vec::new();
    for start in 0..samples.len() {
        if std::mem::replace(&mut is_taken[start], true) {
            continue;
        }
        let mut members = vec![start];
        let mut next = 0;
        while let Some(&index) = members.get(next) {
            next += 1;
            for (near, _) in grid.near(samples[index].at_m) {
                if !std::mem::replace(&mut is_taken[near], true) {
                    members.push(near);
                }
            }
        }
        let alone = members.iter().filter(|index| missing[**index].is_alone);
        if (alone.count() as f64) < LEAST_SHARE_ALONE * members.len() as f64 {
            continue;
        }
        let thing: Vec<Sample> = members.iter().map(|index| samples[*index]).collect();
        found.extend(change(&thing, kind, alignment).map(|change| Thing {
            change,
            members: members.iter().map(|index| missing[*index].number).collect(),
        }));
    }
    found
}

fn change(thing: &[Sample], kind: Kind, alignment: &Alignment) -> Option<Change> {
    let count = thing.len() as f64;
    let first = thing.first()?.at_m;
    let least = thing
        .iter()
        .fold(first, |least, sample| least.min(sample.at_m));
    let most = thing
        .iter()
        .fold(first, |most, sample| most.max(sample.at_m));
    let size_m = most - least;
    let mean_m = thing.iter().map(|sample| sample.at_m).sum::<DVec3>() / count;
    let spread = thing
        .iter()
        .map(|sample| sample.at_m.distance_squared(mean_m))
        .sum::<f64>();
    // What is seen of a thing differs from map to map: its middle is no better known than its places scatter, over
    // the root of a tenth of their number.
    let middle_m = (spread / count / 3.0).sqrt() / (0.1 * count).max(1.0).sqrt();
    // Its places err alike as well, by what the map tells of each.
    let told_m2 = thing.iter().map(|sample| {
        let of = sample.covariance_m2;
        of.x_axis.x.max(of.y_axis.y).max(of.z_axis.z)
    });
    let shared_m = (told_m2.sum::<f64>() / count).sqrt();
    let laid_m = match kind {
        Kind::Went => 0.0,
        Kind::Came | Kind::Moved => alignment.sigma_m,
    };
    let is_thing =
        thing.len() >= FEWEST && size_m.max_element() >= LEAST_SIZE_M && size_m.z >= LEAST_HEIGHT_M;
    is_thing.then(|| Change {
        kind,
        at_m: mean_m,
        by_m: DVec3::ZERO,
        size_m,
        sigma_m: middle_m.hypot(shared_m).hypot(laid_m),
        count: thing.len(),
        probability: thing.iter().map(|sample| sample.probability).sum::<f64>() / count,
    })
}

/// What went and what came, where they are alike and near, as one that moved; `became` of both maps is told of it.
fn moved(went: Vec<Thing>, mut came: Vec<Thing>, became: &mut [Vec<Became>; 2]) -> Vec<Change> {
    let mut mark = |map: usize, thing: &Thing, what: Became| {
        thing
            .members
            .iter()
            .for_each(|index| became[map][*index] = what);
    };
    let mut found = Vec::new();
    for gone in went {
        let apart_m = |new: &Thing| new.change.at_m.distance(gone.change.at_m);
        let nearest = came
            .iter()
            .enumerate()
            .filter(|(_, new)| are_alike(&gone.change, &new.change) && apart_m(new) <= MOVED_M)
            .min_by(|a, b| apart_m(a.1).total_cmp(&apart_m(b.1)))
            .map(|(index, _)| index);
        let Some(index) = nearest else {
            mark(0, &gone, Became::Went);
            found.push(gone.change);
            continue;
        };
        let new = came.remove(index);
        mark(0, &gone, Became::MovedFrom);
        mark(1, &new, Became::MovedTo);
        let (gone, new) = (gone.change, new.change);
        found.push(Change {
            kind: Kind::Moved,
            by_m: new.at_m - gone.at_m,
            sigma_m: gone.sigma_m.hypot(new.sigma_m),
            ..new
        });
    }
    came.iter().for_each(|new| mark(1, new, Became::Came));
    found.extend(came.into_iter().map(|new| new.change));
    found
}

fn are_alike(gone: &Change, new: &Change) -> bool {
    let ratios = [
        (gone.size_m.length(), new.size_m.length()),
        (gone.size_m.z + LEAST_SIZE_M, new.size_m.z + LEAST_SIZE_M),
        ((gone.count as f64).sqrt(), (new.count as f64).sqrt()),
    ];
    let is_near = |(a, b): &(f64, f64)| (1.0 / ALIKE..=ALIKE).contains(&(a / b));
    ratios.iter().all(is_near)
}

#[cfg(test)]
mod tests;
