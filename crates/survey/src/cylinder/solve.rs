//! The five numbers of a cylinder from places near its surface and some that are not of it.

use std::collections::BTreeMap;

use echosplat_model::glam::{DMat3, DVec2, DVec3};

use super::{LEAST_SIGMA_M, NUMBERS, RADII_M};
use crate::grid::{SHARED_M, independent_share};
use crate::linear::{inverse, times};

/// Without a unit; 30 degrees from upright is no pile any more.
const MOST_SLOPE: f64 = 0.58;
/// Without a unit; slope of the axes that fits begin with, all around.
const START_SLOPE: f64 = 0.12;
/// Without a unit; radii to begin with beside that of a rough fit, which strays make too large.
const START_SHARES: [f64; 2] = [0.25, 0.5];
/// Sigmas of what the places scatter, beyond which one counts less (Huber).
const HUBER: f64 = 1.5;
/// Sigmas of what the places scatter, beyond which one counts nothing (Tukey).
const TUKEY: f64 = 4.685;
/// Steps of one fit.
const STEPS: usize = 40;
/// Metres and slopes, for derivatives by differences.
const STEP: f64 = 1e-6;
/// Rounds of drawing a pile like the one found, to see how far such fits are off.
const DRAWS: usize = 24;

/// What a cylinder is fitted to: places about their middle, metres, one sigma of each, and their covariances, square metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct Problem<'p> {
    pub(super) places: &'p [DVec3],
    pub(super) sigmas: &'p [f64],
    pub(super) covariances: &'p [DMat3],
}

/// What was found, and how sure it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// Middle x and y, slopes of the axis along x and y, radius.
    pub(super) numbers: [f64; NUMBERS],
    pub(super) covariance: [[f64; NUMBERS]; NUMBERS],
    /// What places scatter about the surface, metres.
    scatter_m: f64,
}

/// How much a distance counts.
#[derive(Debug, Clone, Copy)]
enum Rule {
    /// Less beyond what is expected: finds the way from far off.
    Huber,
    /// Nothing far beyond it: what is far off is of something else.
    Tukey,
}

impl Rule {
    fn weight(self, off: f64, expected_m: f64) -> f64 {
        let share = match self {
            Self::Huber => (HUBER * expected_m / off.abs().max(f64::MIN_POSITIVE)).min(1.0),
            Self::Tukey => (1.0 - (off / (TUKEY * expected_m)).powi(2))
                .max(0.0)
                .powi(2),
        };
        share / (expected_m * expected_m)
    }

    /// What the weights are the slope of: the sum of it is made least.
    fn loss(self, off: f64, expected_m: f64) -> f64 {
        let share = off.abs() / expected_m;
        match self {
            Self::Huber if share > HUBER => HUBER * (2.0 * share - HUBER),
            Self::Huber => share * share,
            Self::Tukey => {
                let inside = (1.0 - (share / TUKEY).powi(2)).max(0.0);
                TUKEY * TUKEY / 3.0 * (1.0 - inside.powi(3))
            }
        }
    }
}

/// From the axis to a place, metres.
fn from_axis(place: DVec3, [x, y, along_x, along_y, _]: [f64; NUMBERS]) -> DVec3 {
    let axis = DVec3::new(along_x, along_y, 1.0).normalize();
    (place - DVec3::new(x, y, 0.0)).reject_from_normalized(axis)
}

/// How far from the surface a place is, metres; negative inside.
pub(super) fn off_m(place: DVec3, numbers: [f64; NUMBERS]) -> f64 {
    from_axis(place, numbers).length() - numbers[4]
}

/// How a place's distance changes with each number.
fn slopes_of(place: DVec3, numbers: [f64; NUMBERS]) -> [f64; NUMBERS] {
    let off = off_m(place, numbers);
    std::array::from_fn(|i| {
        let mut moved = numbers;
        moved[i] += STEP;
        (off_m(place, moved) - off) / STEP
    })
}

/// The part of a pile that a place belongs to: a quarter around, [`SHARED_M`] high.
fn block_of(place: DVec3, numbers: [f64; NUMBERS]) -> (i64, i64) {
    let side = from_axis(place, numbers).truncate().to_angle() / std::f64::consts::FRAC_PI_2;
    ((place.z / SHARED_M).floor() as i64, side.floor() as i64)
}

/// What a place may be off, metres: what all scatter, or what the map says of it where that is more.
fn expected_m(sigma_m: f64, scatter_m: f64) -> f64 {
    scatter_m.max(0.5 * sigma_m.min(4.0 * scatter_m))
}

type Equations = ([[f64; NUMBERS]; NUMBERS], [f64; NUMBERS]);

impl Problem<'_> {
    /// The best of fits from several beginnings.
    pub(super) fn best(&self) -> Option<Fit> {
        let found = self
            .starts()
            .into_iter()
            .filter_map(|start| self.fit(start));
        let found: Vec<Fit> = found.collect();
        let least_m = found
            .iter()
            .map(|fit| fit.scatter_m)
            .fold(f64::INFINITY, f64::min);
        let cost = |fit: &Fit| self.cost(fit.numbers, least_m, Rule::Tukey);
        found.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))
    }

    /// Upright, along what the places are long, and leaning all around.
    fn starts(&self) -> Vec<[f64; NUMBERS]> {
        let scatter = self.places.iter().fold(DMat3::ZERO, |sum, p| {
            sum + DMat3::from_cols(*p * p.x, *p * p.y, *p * p.z)
        });
        // Towards the longest axis, by the power of the matrix; upright to begin with.
        let mut long = DVec3::Z;
        for _ in 0..100 {
            long = (scatter * long).normalize_or(DVec3::Z);
        }
        let long = long.truncate() / long.z.abs().max(0.1) * long.z.signum();
        let around = (0..8)
            .map(|i| START_SLOPE * DVec2::from_angle(f64::from(i) * 0.25 * std::f64::consts::PI));
        let slopes = [DVec2::ZERO, long].into_iter().chain(around);
        let sensible = slopes.filter(|slope| slope.length() < MOST_SLOPE);
        let start = |slope: DVec2| {
            let flat: Vec<DVec2> = self
                .places
                .iter()
                .map(|p| p.truncate() - slope * p.z)
                .collect();
            let (middle, radius) = circle(&flat)?;
            let mean = flat.iter().sum::<DVec2>() / flat.len() as f64;
            // Also rounder ones, through the middle of what is seen.
            let out = (mean - middle).normalize_or(DVec2::X);
            let rounder = START_SHARES.map(|share| (mean - share * radius * out, share * radius));
            let all = [(middle, radius)].into_iter().chain(rounder);
            Some(all.map(move |(m, radius)| [m.x, m.y, slope.x, slope.y, radius]))
        };
        sensible.filter_map(start).flatten().collect()
    }

    fn fit(&self, start: [f64; NUMBERS]) -> Option<Fit> {
        let mut numbers = start;
        for _ in 0..3 {
            numbers = self.descend(numbers, self.spread_m(numbers), Rule::Huber)?;
        }
        for _ in 0..3 {
            numbers = self.descend(numbers, self.spread_m(numbers), Rule::Tukey)?;
        }
        let scatter_m = self.spread_m(numbers);
        let is_sensible = numbers[2].hypot(numbers[3]) < MOST_SLOPE
            && (RADII_M.0..=RADII_M.1).contains(&numbers[4].abs());
        let covariance = self.covariance(numbers, scatter_m)?;
        is_sensible.then_some(Fit {
            numbers,
            covariance,
            scatter_m,
        })
    }

    /// Gauss and Newton with a brake (Levenberg and Marquardt).
    fn descend(&self, start: [f64; NUMBERS], scatter_m: f64, rule: Rule) -> Option<[f64; NUMBERS]> {
        let mut numbers = start;
        let mut brake = 1e-3;
        let mut cost = self.cost(numbers, scatter_m, rule);
        for _ in 0..STEPS {
            let (mut normal, right) = self.equations(numbers, scatter_m, rule);
            for (i, row) in normal.iter_mut().enumerate() {
                row[i] *= 1.0 + brake;
            }
            let step = times(&inverse(&normal)?, &right);
            let tried: [f64; NUMBERS] = std::array::from_fn(|i| numbers[i] - step[i]);
            let tried_cost = self.cost(tried, scatter_m, rule);
            if tried_cost < cost {
                numbers = tried;
                cost = tried_cost;
                brake = (0.1 * brake).max(1e-9);
            } else {
                brake *= 10.0;
            }
            if brake > 1e9 || step.iter().all(|x| x.abs() < 1e-7) {
                break;
            }
        }
        Some(numbers)
    }

    /// What places scatter about the surface, metres: 1.48 times the median of their distances, as of normal noise.
    fn spread_m(&self, numbers: [f64; NUMBERS]) -> f64 {
        let off = self.places.iter().map(|p| off_m(*p, numbers).abs());
        (1.4826 * median(off)).max(LEAST_SIGMA_M)
    }

    fn cost(&self, numbers: [f64; NUMBERS], scatter_m: f64, rule: Rule) -> f64 {
        let one = |(place, sigma): (&DVec3, &f64)| {
            rule.loss(off_m(*place, numbers), expected_m(*sigma, scatter_m))
        };
        self.places.iter().zip(self.sigmas).map(one).sum()
    }

    fn equations(&self, numbers: [f64; NUMBERS], scatter_m: f64, rule: Rule) -> Equations {
        let mut normal = [[0.0; NUMBERS]; NUMBERS];
        let mut right = [0.0; NUMBERS];
        for (place, sigma) in self.places.iter().zip(self.sigmas) {
            let off = off_m(*place, numbers);
            let row = slopes_of(*place, numbers);
            let weight = rule.weight(off, expected_m(*sigma, scatter_m));
            for i in 0..NUMBERS {
                right[i] += weight * row[i] * off;
                for j in 0..NUMBERS {
                    normal[i][j] += weight * row[i] * row[j];
                }
            }
        }
        (normal, right)
    }

    /// Of the numbers: forces over slopes of the forces, the sandwich of robust fits. Forces are what places really scatter
    /// about the surface, each place for itself, and what the map says of their error, alike for all of a block.
    fn covariance(
        &self,
        numbers: [f64; NUMBERS],
        scatter_m: f64,
    ) -> Option<[[f64; NUMBERS]; NUMBERS]> {
        let mut slopes = [[0.0; NUMBERS]; NUMBERS];
        let mut forces = [[0.0; NUMBERS]; NUMBERS];
        let mut blocks: BTreeMap<(i64, i64), [f64; NUMBERS]> = BTreeMap::new();
        let count = self.places.len() as f64;
        let freedom = count / (count - NUMBERS as f64).max(1.0) / independent_share(self.places);
        let known = self.sigmas.iter().zip(self.covariances);
        for (place, (sigma, covariance)) in self.places.iter().zip(known) {
            let expected_m = expected_m(*sigma, scatter_m);
            let (off, row) = (off_m(*place, numbers), slopes_of(*place, numbers));
            let pull = Rule::Tukey.weight(off, expected_m);
            let share = (off / (TUKEY * expected_m)).powi(2);
            let slope = (1.0 - share).max(0.0) * (1.0 - 5.0 * share) / (expected_m * expected_m);
            let out = from_axis(*place, numbers).normalize_or(DVec3::X);
            let told_m = out.dot(*covariance * out).max(0.0).sqrt();
            let shared = blocks.entry(block_of(*place, numbers)).or_default();
            for i in 0..NUMBERS {
                shared[i] += pull * told_m * row[i];
                for j in 0..NUMBERS {
                    slopes[i][j] += slope * row[i] * row[j];
                    forces[i][j] += freedom * (pull * off).powi(2) * row[i] * row[j];
                }
            }
        }
        for shared in blocks.values() {
            for i in 0..NUMBERS {
                for j in 0..NUMBERS {
                    forces[i][j] += shared[i] * shared[j];
                }
            }
        }
        let bread = inverse(&slopes)?;
        let half: [[f64; NUMBERS]; NUMBERS] = std::array::from_fn(|i| times(&forces, &bread[i]));
        Some(std::array::from_fn(|i| times(&bread, &half[i])))
    }

    /// Without what fits of such arcs are off on average, found by fitting piles drawn from this one: noise across a
    /// short arc makes it look rounder than it is.
    pub(super) fn unbiased(&self, found: Fit) -> Fit {
        let foot = |place: &DVec3| {
            let out = from_axis(*place, found.numbers);
            *place + out.normalize_or(DVec3::X) * (found.numbers[4] - out.length())
        };
        let feet: Vec<DVec3> = self.places.iter().map(foot).collect();
        let mut noise = Noise(1);
        let shift = |_| {
            let drawn = feet
                .iter()
                .map(|foot| *foot + found.scatter_m * noise.vector());
            let places: Vec<DVec3> = drawn.collect();
            let again = Problem {
                places: &places,
                ..*self
            };
            let again = again.fit(found.numbers)?;
            Some(std::array::from_fn(|i| again.numbers[i] - found.numbers[i]))
        };
        let shifts: Vec<[f64; NUMBERS]> = (0..DRAWS).filter_map(shift).collect();
        let count = shifts.len() as f64;
        let independent = independent_share(self.places);
        let mut better = found;
        if shifts.len() < DRAWS / 2 {
            return found;
        }
        for i in 0..NUMBERS {
            // The middle one: a draw may have found another cylinder.
            let all = shifts.iter().map(|shift| shift[i]);
            let shift = median(all.clone());
            let spread = 1.4826 * median(all.map(|other| (other - shift).abs()));
            better.numbers[i] -= shift;
            // What the draws scatter, if that is more, and what their middle is uncertain by.
            let variance = found.covariance[i][i].max(spread * spread / independent);
            better.covariance[i][i] = variance * (1.0 + 1.57 / count);
        }
        better.numbers[4] = better.numbers[4].clamp(RADII_M.0, RADII_M.1);
        better
    }
}

/// Of at least one number.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// By the least squares of x² + y² (Kåsa): a start only, too small for short arcs.
fn circle(points: &[DVec2]) -> Option<(DVec2, f64)> {
    let mut normal = [[0.0; 3]; 3];
    let mut right = [0.0; 3];
    for p in points {
        let row = [p.x, p.y, 1.0];
        for i in 0..3 {
            right[i] += row[i] * p.length_squared();
            for j in 0..3 {
                normal[i][j] += row[i] * row[j];
            }
        }
    }
    let [a, b, c] = times(&inverse(&normal)?, &right);
    let middle = DVec2::new(0.5 * a, 0.5 * b);
    let square = c + middle.length_squared();
    (square > 0.0).then(|| (middle, square.sqrt()))
}

/// The same numbers each time: `SplitMix64`, two of its numbers for a normal one (Box and Muller).
pub(super) struct Noise(pub(super) u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub(super) fn share(&mut self) -> f64 {
        ((self.next() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let (length, turn) = (self.share(), self.share());
        (-2.0 * length.ln()).sqrt() * (std::f64::consts::TAU * turn).cos()
    }

    pub(super) fn vector(&mut self) -> DVec3 {
        DVec3::new(self.normal(), self.normal(), self.normal())
    }
}
