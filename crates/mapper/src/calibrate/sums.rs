//! What the observations of one landmark say of it and of what is estimated.

use super::landmarks::{Landmark, Observation};
use super::linear::{Square, cholesky, solve};
use super::parameters::{PARAMETERS, Values};
use super::point::{ALL, FREE, Free, Point};

/// Metres, one sigma; found.
/// One sigma of what a landmark is free in, metres.
const FREE_PRIOR_M: Free = [0.3, 0.3, 0.3, 1.0];
/// Widths, derived: nothing beyond.
/// A kernel is nothing beyond so many widths in range, and in azimuth.
const RANGE_REACH: f32 = 3.0;
/// Widths, derived: nothing beyond.
const AZIMUTH_REACH: f32 = 4.0;

/// Widths within which an echo belongs to a landmark.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kernel {
    pub(super) range_m: f32,
    pub(super) azimuth_rad: f32,
}

/// Gradient and curvature, the landmark's own and those it shares.
#[derive(Debug, Clone, Copy)]
struct Sums {
    gradient: [f64; ALL],
    curvature: Square<ALL>,
}

/// Goes through the observations and gives each one's gradient. Near the maximum the curvature is at least the true
/// one, so that steps do not overshoot.
fn each_observation(
    landmark: &Landmark,
    (values, free): (&Values, &Free),
    kernel: Kernel,
    mut each: impl FnMut(&Observation, [f64; ALL], &Point, [f64; 2]),
) {
    let by_range = f64::from(kernel.range_m).powi(-2);
    let by_azimuth = f64::from(kernel.azimuth_rad).powi(-2);
    for observation in &landmark.observations {
        let point = Point::of(observation, values, free);
        let z = point.azimuth_rad / kernel.azimuth_rad;
        let (heard, off_m) = near(observation, point.range_m, kernel.range_m);
        let weight = f64::from(heard * observation.weight * (-0.5 * z * z).exp());
        if z.abs() > AZIMUTH_REACH || !(weight > 0.0) {
            continue;
        }
        let curvature = [weight * by_range, weight * by_azimuth];
        let (along, across) = (
            curvature[0] * f64::from(off_m),
            -curvature[1] * f64::from(point.azimuth_rad),
        );
        let gradient =
            std::array::from_fn(|i| along * point.by_range[i] + across * point.by_azimuth[i]);
        each(observation, gradient, &point, curvature);
    }
}

/// How much was heard around a range, and how far its mean is from there, metres.
fn near(observation: &Observation, range_m: f32, width_m: f32) -> (f32, f32) {
    let bin = |at_m: f32| (at_m - observation.first_m) / observation.step_m;
    let from = bin(range_m - RANGE_REACH * width_m).ceil().max(0.0) as usize;
    let end = bin(range_m + RANGE_REACH * width_m).floor() + 1.0;
    let end = (end.max(0.0) as usize).min(observation.heard.len());
    let (mut sum, mut first) = (0.0, 0.0);
    for index in from..end {
        let heard = observation.heard[index];
        if heard > 0.0 {
            let off_m = observation.first_m + observation.step_m * index as f32 - range_m;
            let z = off_m / width_m;
            let part = heard * (-0.5 * z * z).exp();
            sum += part;
            first += part * off_m;
        }
    }
    match sum > 0.0 {
        true => (sum, first / sum),
        false => (0.0, 0.0),
    }
}

fn sums(landmark: &Landmark, at: (&Values, &Free), kernel: Kernel) -> Sums {
    let mut sums = Sums {
        gradient: [0.0; ALL],
        curvature: [[0.0; ALL]; ALL],
    };
    each_observation(
        landmark,
        at,
        kernel,
        |_, gradient, point, [along, across]| {
            for (i, add) in gradient.into_iter().enumerate() {
                sums.gradient[i] += add;
                let (r, a) = (along * point.by_range[i], across * point.by_azimuth[i]);
                for j in 0..=i {
                    sums.curvature[i][j] += r * point.by_range[j] + a * point.by_azimuth[j];
                }
            }
        },
    );
    for i in 0..ALL {
        for j in 0..i {
            sums.curvature[j][i] = sums.curvature[i][j];
        }
    }
    sums
}

/// What a landmark says of the parameters once it is free to be where its observations put it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reduced {
    pub(super) gradient: Values,
    pub(super) curvature: Square<PARAMETERS>,
    /// How the landmark follows each parameter.
    follow: [Free; PARAMETERS],
    own_step: Free,
}

impl Reduced {
    /// The Schur complement of the landmark's freedom; `None` if its observations leave that open.
    pub(super) fn of(
        landmark: &Landmark,
        at: (&Values, &Free),
        kernel: Kernel,
        dispersion: f64,
    ) -> Option<Self> {
        let sums = sums(landmark, at, kernel);
        let mut own: Square<FREE> = std::array::from_fn(|i| {
            std::array::from_fn(|j| sums.curvature[PARAMETERS + i][PARAMETERS + j])
        });
        let mut own_gradient: Free = std::array::from_fn(|i| sums.gradient[PARAMETERS + i]);
        for i in 0..FREE {
            let prior = dispersion / FREE_PRIOR_M[i].powi(2);
            own[i][i] += prior;
            own_gradient[i] -= prior * at.1[i];
        }
        let factor = cholesky(&own)?;
        let mixed: [Free; PARAMETERS] =
            std::array::from_fn(|i| std::array::from_fn(|k| sums.curvature[i][PARAMETERS + k]));
        let follow = mixed.map(|row| solve(&factor, &row));
        let dot = |a: &Free, b: &Free| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        Some(Self {
            gradient: std::array::from_fn(|i| sums.gradient[i] - dot(&follow[i], &own_gradient)),
            curvature: std::array::from_fn(|i| {
                std::array::from_fn(|j| sums.curvature[i][j] - dot(&follow[i], &mixed[j]))
            }),
            own_step: solve(&factor, &own_gradient),
            follow,
        })
    }

    /// The landmark's own step after one of the parameters.
    pub(super) fn own_step(&self, step: &Values) -> Free {
        std::array::from_fn(|k| {
            let follow: f64 = (0..PARAMETERS).map(|i| self.follow[i][k] * step[i]).sum();
            self.own_step[k] - follow
        })
    }

    /// Adds each observation's gradient, less what the landmark's freedom takes of it, to that of its block of time.
    pub(super) fn scores(
        &self,
        landmark: &Landmark,
        at: (&Values, &Free),
        kernel: Kernel,
        blocks: &mut [Values],
    ) {
        each_observation(landmark, at, kernel, |observation, gradient, _, _| {
            let Some(block) = blocks.get_mut(observation.block as usize) else {
                return;
            };
            for (i, score) in block.iter_mut().enumerate() {
                let taken: f64 = (0..FREE)
                    .map(|k| self.follow[i][k] * gradient[PARAMETERS + k])
                    .sum();
                *score += gradient[i] - taken;
            }
        });
    }
}
