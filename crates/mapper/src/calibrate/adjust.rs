//! Places of landmarks and what is estimated, together, so that the looks at each landmark agree.

use rayon::prelude::*;

use super::landmarks::Landmarks;
use super::linear::{Square, cholesky, inverse_times, solve};
use super::parameters::{Found, PARAMETERS, PRIOR, Values};
use super::point::{FREE, Free};
use super::sums::{Kernel, Reduced};

/// Fewest landmarks and blocks of time that anything is said of.
const LEAST_LANDMARKS: usize = 12;
const LEAST_BLOCKS: usize = 4;
/// Kernels' widths in range, metres, and in azimuth, in sigmas of the beam or of 0.004 rad: first wide enough for
/// 2° of mount at 6 m, then as narrow as echoes are.
const KERNELS: [(f32, f32); 2] = [(0.12, 4.0), (0.06, 2.5)];
const LEAST_BEAM_RAD: f32 = 0.004;
/// Steps with each kernel, and the one after which scatter is looked at for the first time.
const ROUNDS: usize = 15;
const FIRST_LOOK: usize = 3;
/// Longest step over the prior, and of a landmark, metres.
const LONGEST: f64 = 0.5;
const LONGEST_M: f64 = 0.1;

/// Where the estimation stands.
struct State<'a> {
    landmarks: &'a Landmarks,
    values: Values,
    free: Vec<Free>,
    /// How much more blocks of time scatter than their curvature has it.
    dispersion: f64,
}

/// What landmarks say together.
struct Total {
    parts: Vec<Option<Reduced>>,
    gradient: Values,
    curvature: Square<PARAMETERS>,
}

pub(super) fn estimate(landmarks: &Landmarks) -> Option<Found> {
    if landmarks.of.len() < LEAST_LANDMARKS || landmarks.blocks < LEAST_BLOCKS {
        return None;
    }
    let mut state = State {
        landmarks,
        values: [0.0; PARAMETERS],
        free: vec![[0.0; FREE]; landmarks.of.len()],
        dispersion: 1.0,
    };
    let mut covariance = None;
    for (range_m, beams) in KERNELS {
        let kernel = Kernel {
            range_m,
            azimuth_rad: beams * landmarks.beam_sigma_rad.max(LEAST_BEAM_RAD),
        };
        for round in 0..ROUNDS {
            let total = state.total(kernel);
            state.step(&total);
            if round == FIRST_LOOK || round + 1 == ROUNDS {
                covariance = state.covariance(&total, kernel).or(covariance);
            }
        }
    }
    Some(Found {
        values: state.values,
        covariance: covariance?,
        landmarks: landmarks.of.len() as u64,
        looks: landmarks.look_count() as u64,
    })
}

impl State<'_> {
    fn total(&self, kernel: Kernel) -> Total {
        let landmarks = self.landmarks.of.par_iter().zip(&self.free);
        let reduce =
            |(landmark, free)| Reduced::of(landmark, (&self.values, free), kernel, self.dispersion);
        let parts: Vec<Option<Reduced>> = landmarks.map(reduce).collect();
        let (mut gradient, mut curvature) = ([0.0; PARAMETERS], [[0.0; PARAMETERS]; PARAMETERS]);
        for part in parts.iter().flatten() {
            for i in 0..PARAMETERS {
                gradient[i] += part.gradient[i];
                for j in 0..PARAMETERS {
                    curvature[i][j] += part.curvature[i][j];
                }
            }
        }
        Total {
            parts,
            gradient,
            curvature,
        }
    }

    fn prior(&self, of: usize) -> f64 {
        self.dispersion / PRIOR[of].powi(2)
    }

    /// One step of Gauss and Newton with the prior.
    fn step(&mut self, total: &Total) {
        let (mut gradient, mut curvature) = (total.gradient, total.curvature);
        for i in 0..PARAMETERS {
            curvature[i][i] += self.prior(i);
            gradient[i] -= self.prior(i) * self.values[i];
        }
        let Some(factor) = cholesky(&curvature) else {
            return;
        };
        let mut step = solve(&factor, &gradient);
        let sizes = (0..PARAMETERS).map(|i| (step[i] / PRIOR[i]).abs());
        let part = (LONGEST / sizes.fold(0.0, f64::max)).min(1.0);
        for (value, step) in self.values.iter_mut().zip(&mut step) {
            *step *= part;
            *value += *step;
        }
        for (free, part) in self.free.iter_mut().zip(&total.parts) {
            let Some(part) = part else { continue };
            for (free, step) in free.iter_mut().zip(part.own_step(&step)) {
                *free += step.clamp(-LONGEST_M, LONGEST_M);
            }
        }
    }

    /// The covariance by how far blocks of time disagree, `(H + P)⁻¹ (S + P) (H + P)⁻¹`: neighbouring pings are off
    /// together. Sets the dispersion, the mean of what `H⁻¹ S` scales each direction by.
    fn covariance(&mut self, total: &Total, kernel: Kernel) -> Option<Square<PARAMETERS>> {
        let mut scores = vec![[0.0; PARAMETERS]; self.landmarks.blocks];
        let landmarks = self.landmarks.of.iter().zip(&self.free);
        for ((landmark, free), part) in landmarks.zip(&total.parts) {
            if let Some(part) = part {
                part.scores(landmark, (&self.values, free), kernel, &mut scores);
            }
        }
        let mut scatter: Square<PARAMETERS> = std::array::from_fn(|i| {
            std::array::from_fn(|j| scores.iter().map(|score| score[i] * score[j]).sum())
        });
        let mut curvature = total.curvature;
        for (i, row) in curvature.iter_mut().enumerate() {
            row[i] += 1e-6 * row[i].abs() + 1e-9 / PRIOR[i].powi(2);
        }
        if let Some(factor) = cholesky(&curvature) {
            let ratio = inverse_times(&factor, &scatter);
            let trace: f64 = (0..PARAMETERS).map(|i| ratio[i][i]).sum();
            self.dispersion = trace / PARAMETERS as f64;
        }
        let mut curvature = total.curvature;
        for i in 0..PARAMETERS {
            curvature[i][i] += self.prior(i);
            scatter[i][i] += (self.dispersion / PRIOR[i]).powi(2);
        }
        let factor = cholesky(&curvature)?;
        // Twice from the left, since all are symmetric.
        let half = inverse_times(&factor, &scatter);
        let turned = std::array::from_fn(|i| std::array::from_fn(|j| half[j][i]));
        Some(inverse_times(&factor, &turned))
    }
}
