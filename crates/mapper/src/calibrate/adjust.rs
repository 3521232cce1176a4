//! Places of landmarks and what is estimated, together, so that the observations of each landmark agree.

use rayon::prelude::*;

use super::landmarks::Landmarks;
use super::linear::{Square, cholesky, inverse_times, solve};
use super::parameters::{Compass, Found, PARAMETERS, PRIOR, Values};
use super::point::{FREE, Free};
use super::sums::{Kernel, Reduced};

/// Landmarks, at least; found.
/// Fewest landmarks and blocks of time that anything is said of.
const LEAST_LANDMARKS: usize = 12;
/// Blocks of time, at least; found.
const LEAST_BLOCKS: usize = 4;
/// Metres and sigmas, derived: 2° at 6 m.
/// Kernels' widths in range, metres, and in azimuth, in sigmas of the beam or of 0.004 rad: first wide enough for
/// 2° of mount at 6 m, then as narrow as echoes are.
const KERNELS: [(f32, f32); 2] = [(0.12, 4.0), (0.06, 2.5)];
/// Radians of sigma, at least; found.
const LEAST_BEAM_RAD: f32 = 0.004;
/// Steps with each kernel; bounds work.
/// Steps with each kernel, and the one after which scatter is looked at for the first time.
const ROUNDS: usize = 15;
/// Steps before scatter is looked at; found.
const FIRST_SCATTER: usize = 3;
/// Prior sigmas of a step, derived.
/// A kernel is done with once a step is this short: a sixth of the sigma that half a fence's survey tells the clock with,
/// and less of all others.
const CONVERGED: f64 = 1e-3;
/// Prior sigmas of a step, at most; found.
/// Longest step over the prior, and of a landmark, metres.
const LONGEST: f64 = 0.5;
/// Metres a landmark steps, at most; found.
const LONGEST_M: f64 = 0.1;

/// Where the estimation stands.
struct State<'a> {
    landmarks: &'a Landmarks,
    prior: Values,
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

impl Landmarks {
    /// `None` if they are too few.
    pub(crate) fn estimate(&self, compass: Compass) -> Option<Found> {
        if self.of.len() < LEAST_LANDMARKS || self.blocks < LEAST_BLOCKS {
            return None;
        }
        let mut state = State {
            landmarks: self,
            prior: compass.prior(),
            values: [0.0; PARAMETERS],
            free: vec![[0.0; FREE]; self.of.len()],
            dispersion: 1.0,
        };
        let mut covariance = None;
        for (range_m, beams) in KERNELS {
            let kernel = Kernel {
                range_m,
                azimuth_rad: beams * self.beam_sigma_rad.max(LEAST_BEAM_RAD),
            };
            for round in 0..ROUNDS {
                let total = state.total(kernel);
                let is_done = state.step(&total) < CONVERGED && round > FIRST_SCATTER;
                let is_last = is_done || round + 1 == ROUNDS;
                if round == FIRST_SCATTER || is_last {
                    covariance = state.covariance(&total, kernel).or(covariance);
                }
                if is_last {
                    break;
                }
            }
        }
        Some(Found {
            values: state.values,
            covariance: covariance?,
            landmarks: self.of.len() as u64,
            observations: self.observation_count() as u64,
        })
    }
}

impl State<'_> {
    fn total(&self, kernel: Kernel) -> Total {
        let landmarks = self.landmarks.of.par_iter().zip(&self.free);
        let reduce =
            |(landmark, free)| Reduced::of(landmark, (&self.values, free), kernel, self.dispersion);
        let parts: Vec<Option<Reduced>> = landmarks.map(reduce).collect();
        let (mut gradient, mut curvature) = ([0.0; PARAMETERS], [[0.0; PARAMETERS]; PARAMETERS]);
        for part in parts.iter().flatten() {
            for (i, row) in curvature.iter_mut().enumerate() {
                gradient[i] += part.gradient[i];
                for (sum, add) in row.iter_mut().zip(part.curvature[i]) {
                    *sum += add;
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
        self.dispersion / self.prior[of].powi(2)
    }

    /// One step of Gauss and Newton with the prior. Returns how long it was, in prior sigmas.
    fn step(&mut self, total: &Total) -> f64 {
        let (mut gradient, mut curvature) = (total.gradient, total.curvature);
        for i in 0..PARAMETERS {
            curvature[i][i] += self.prior(i);
            gradient[i] -= self.prior(i) * self.values[i];
        }
        let Some(factor) = cholesky(&curvature) else {
            return 0.0;
        };
        let mut step = solve(&factor, &gradient);
        let sizes = (0..PARAMETERS).map(|i| (step[i] / self.prior[i]).abs());
        let longest = sizes.fold(0.0, f64::max);
        let fraction = (LONGEST / longest).min(1.0);
        for (value, step) in self.values.iter_mut().zip(&mut step) {
            *step *= fraction;
            *value += *step;
        }
        for (free, part) in self.free.iter_mut().zip(&total.parts) {
            let Some(part) = part else { continue };
            for (free, step) in free.iter_mut().zip(part.own_step(&step)) {
                *free += step.clamp(-LONGEST_M, LONGEST_M);
            }
        }
        longest
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
            scatter[i][i] += (self.dispersion / self.prior[i]).powi(2);
        }
        let factor = cholesky(&curvature)?;
        // Twice from the left, since all are symmetric.
        let half = inverse_times(&factor, &scatter);
        let turned = std::array::from_fn(|i| std::array::from_fn(|j| half[j][i]));
        Some(inverse_times(&factor, &turned))
    }
}

#[cfg(test)]
mod tests {
    use echosplat_model::glam::{EulerRot, Mat3, Quat, Vec3};

    use super::*;
    use crate::calibrate::landmarks::{Landmark, Observation};
    use crate::calibrate::parameters::{COMPASS, RANGE, TIME, TURN};
    use crate::calibrate::point::Point;

    const BEAM_SIGMA_RAD: f32 = 0.006;
    const STEP_M: f32 = 0.02;

    /// Of a vehicle that goes by, sweeps, rolls and heaves.
    fn pose(time_s: f32) -> (Vec3, Quat) {
        let yaw = 0.6 * (0.7 * time_s).sin();
        let roll = 0.4 * (0.43 * time_s).sin();
        let place_m = Vec3::new(
            0.8 * (0.11 * time_s).sin(),
            0.05 * time_s - 3.0,
            0.5 * (0.3 * time_s).cos(),
        );
        (place_m, Quat::from_euler(EulerRot::ZYX, yaw, 0.0, roll))
    }

    /// An observation of a landmark believed 3 cm from where it is, which sounds as `values` have it.
    fn observation(at_m: Vec3, number: u32, values: &Values) -> Option<Observation> {
        const DT_S: f32 = 0.01;
        let time_s = 0.05 * number as f32;
        let (place_m, turn) = pose(time_s);
        let ((before_m, before), (after_m, after)) = (pose(time_s - DT_S), pose(time_s + DT_S));
        let into = turn.conjugate();
        let angular_radps = (before.conjugate() * after).to_scaled_axis() / (2.0 * DT_S);
        let believed_m = at_m + Vec3::new(0.0, 0.02, 0.02);
        let mut observation = Observation {
            place_m: into * (believed_m - place_m),
            turn: Mat3::from_quat(into),
            linear_mps: into * (after_m - before_m) / (2.0 * DT_S),
            angular_radps,
            after_s: 0.0,
            first_m: 0.0,
            step_m: STEP_M,
            heard: Vec::new(),
            weight: 1.0,
            block: number / 200,
        };
        if observation.place_m.y.abs() > 0.07 * observation.place_m.x {
            return None;
        }
        let point = Point::of(&observation, values, &[0.0, -0.02, -0.02, 0.0]);
        observation.first_m = observation.place_m.length() - 0.4;
        let loud = (-0.5 * (point.azimuth_rad / BEAM_SIGMA_RAD).powi(2)).exp();
        let echo = |bin: u32| {
            let off_m = observation.first_m + STEP_M * bin as f32 - point.range_m;
            loud * (-0.5 * (off_m / 0.02).powi(2)).exp()
        };
        observation.heard = (0..41).map(echo).collect();
        Some(observation)
    }

    fn landmarks(values: &Values) -> Landmarks {
        let places = (0..24_u32).map(|i| {
            let i = i as f32;
            Vec3::new(5.0 + (1.7 * i).sin(), 0.3 * i - 3.5, 1.2 * (2.3 * i).cos())
        });
        let of = places.map(|at_m| Landmark {
            observations: (0..2400)
                .filter_map(|number| observation(at_m, number, values))
                .collect(),
        });
        Landmarks {
            of: of.collect(),
            blocks: 12,
            beam_sigma_rad: BEAM_SIGMA_RAD,
        }
    }

    #[test]
    fn what_is_off_is_found_although_landmarks_are_free() {
        let degree = 1f64.to_radians();
        for (which, value, tolerance) in [
            (TIME, 0.03, 0.003),
            (TURN, 2.0 * degree, 0.2 * degree),
            (TURN + 2, 2.0 * degree, 0.2 * degree),
            (RANGE, 0.015, 0.002),
        ] {
            let mut values = [0.0; PARAMETERS];
            values[which] = value;
            let found = landmarks(&values).estimate(Compass::True).unwrap();
            let off = found.values[which] - value;
            assert!(
                off.abs() < tolerance,
                "{which}: {} for {value}",
                found.values[which]
            );
        }
    }

    #[test]
    fn a_compass_that_deviates_is_found_where_it_is_asked_for() {
        let mut values = [0.0; PARAMETERS];
        values[COMPASS] = 3f64.to_radians();
        let landmarks = landmarks(&values);
        let found = landmarks.estimate(Compass::Deviates).unwrap();
        let off_deg = (found.values[COMPASS] - values[COMPASS]).to_degrees();
        assert!(off_deg.abs() < 0.3, "{off_deg}");
        // All headings are within 35°: their cosine is as good as constant, as a turn of the mount is.
        let sigma = |i: usize| found.covariance[i][i].sqrt();
        let (sine, cosine) = (sigma(COMPASS), sigma(COMPASS + 1));
        assert!(cosine > 2.0 * sine, "{sine} {cosine}");
        let known = landmarks.estimate(Compass::True).unwrap();
        assert!(
            known.values[COMPASS..]
                .iter()
                .all(|value| value.abs() < 1e-4)
        );
    }

    #[test]
    fn nothing_is_found_where_nothing_is_off_and_little_said_of_what_is_not_seen() {
        let found = landmarks(&[0.0; PARAMETERS])
            .estimate(Compass::True)
            .unwrap();
        assert!(found.values[TIME].abs() < 1e-3, "{:?}", found.values);
        assert!(found.values[TURN + 2].abs() < 2e-3, "{:?}", found.values);
        assert!(found.values[RANGE].abs() < 2e-3, "{:?}", found.values);
        // A turn within the fan's own plane changes nothing that is heard.
        let sigma = found.covariance[TURN + 1][TURN + 1].sqrt();
        assert!(sigma > 0.5 * PRIOR[TURN + 1], "{sigma}");
    }

    #[test]
    fn too_few_landmarks_say_nothing() {
        let mut few = landmarks(&[0.0; PARAMETERS]);
        few.of.truncate(LEAST_LANDMARKS - 1);
        assert!(few.estimate(Compass::True).is_none());
        assert!(Landmarks::default().estimate(Compass::True).is_none());
    }
}
