//! How far poses have drifted: a Kalman filter over slices of pings, whose bins it sees by score and Fisher information.
//!
//! Cost of a slice: a few products and factors of 9 × 9 numbers beside the visits that score it.

use echosplat_measurement::heard::{POSE_STATES, PoseScore};

use crate::calibrate::linear::{Square, cholesky, inverse_times, solve};

/// States; layout.
/// Shift of the sensor along x, y and z, m; its turn about z, rad; how much nearer than they are echoes are heard, m; velocity of
/// the shift along x and y, m/s; rate of the turn, rad/s.
const STATES: usize = 8;
/// Place of the shift up; layout.
const UP: usize = 2;
/// Place of the turn; layout.
const TURN: usize = 3;
/// Place of the nearness; layout.
const NEARER: usize = 4;
/// States with the map's power, of each slice; layout.
const WITH_POWER: usize = STATES + 1;
/// Place of each state of a [`PoseScore`]; layout.
const OBSERVED: [usize; POSE_STATES] = [0, 1, 2, 3, 4, STATES];
/// Steps of a slice; bounds work.
/// Steps of Gauss and Newton with each slice.
const ROUNDS: usize = 3;

/// Radians; by definition.
const DEGREE: f64 = std::f64::consts::PI / 180.0;
/// Fraction of the speed, assumed: 1 % of the way.
/// One sigma of the velocity that reckoning is off by: over some minutes it adds up to 1 % of the way.
const OF_SPEED: f64 = 0.02;
/// Metres a second, assumed.
/// Speed of a vehicle before anything is known of it.
const FIRST_SPEED_MPS: f64 = 0.3;
/// Seconds, assumed.
/// Time constant of that velocity.
const VELOCITY_TIME_S: f64 = 30.0;
/// Radians a second, assumed: half a degree a minute.
/// One sigma of a gyro's rate.
const TURN_RATE_RADPS: f64 = 0.5 * DEGREE / 60.0;
/// Seconds, assumed.
/// Time constant of that rate.
const TURN_TIME_S: f64 = 240.0;
/// Metres and radians by the root of a second; assumed.
/// What poses wander by beside that, sideways, up, and in turning.
const WANDER: [f64; 4] = [1e-3, 1e-3, 5e-3, 0.003 * DEGREE];
/// Metres, assumed: a pressure sensor's.
/// One sigma of depth, which is measured and does not drift.
const DEPTH_SIGMA_M: f64 = 0.02;
/// Seconds, assumed.
/// Time constant of its error.
const DEPTH_TIME_S: f64 = 20.0;
/// Metres, found: 0.1 takes drift for it.
/// One sigma of how much nearer than the map has them surfaces are heard from where the map has not seen them.
const NEARER_SIGMA_M: f64 = 0.02;
/// Seconds; assumed.
/// Time constant of that.
const NEARER_TIME_S: f64 = 20.0;
/// Logarithm of power; assumed.
/// One sigma of how much louder a slice is than the map has it.
const POWER_SIGMA: f64 = 0.5;
/// Fraction, measured: true errors are ten formal sigmas.
/// What information counts, since the map has errors that its pings share.
const COUNTS: f64 = 0.01;
/// Metres and radians, found.
/// Echoes are blurred by at least so much while a slice is compared with the map.
const LEAST_BLUR_M: f64 = 0.02;
/// Radians, the same; found.
const LEAST_BLUR_RAD: f64 = 0.05 * DEGREE;
/// Ratio; found.
/// In the first round they are blurred by so many sigmas, and no step is longer.
const FIRST_BLUR: f64 = 1.5;
/// Metres a step, at most; found.
/// Most that a step makes surfaces nearer.
const LONGEST_NEARER_M: f64 = 0.05;

/// What is added to a pose, on the map's axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Correction {
    /// Along x, y and z.
    pub(crate) shift_m: [f64; 3],
    /// About the vertical through the sensor's own place.
    pub(crate) turn_rad: f64,
}

/// With what a slice is compared with the map.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trial {
    pub(super) correction: Correction,
    pub(super) nearer_m: f64,
    pub(super) louder_ln: f64,
    /// One sigma that echoes are blurred by, so that places far off still draw.
    pub(super) blur_m: f64,
    pub(super) blur_rad: f64,
}

impl Trial {
    /// As sharp as any.
    pub(super) fn sharp(correction: Correction) -> Self {
        Self {
            correction,
            nearer_m: 0.0,
            louder_ln: 0.0,
            blur_m: LEAST_BLUR_M,
            blur_rad: LEAST_BLUR_RAD,
        }
    }
}

/// What poses have drifted by, as far as is known.
#[derive(Debug)]
pub(super) struct Filter {
    state: [f64; STATES],
    covariance: Square<STATES>,
}

impl Default for Filter {
    /// At the first ping nothing has drifted: that is where the map begins.
    fn default() -> Self {
        let velocity = OF_SPEED * FIRST_SPEED_MPS;
        let [x, y, ..] = WANDER;
        let sigmas = [
            x,
            y,
            DEPTH_SIGMA_M,
            LEAST_BLUR_RAD,
            NEARER_SIGMA_M,
            velocity,
            velocity,
            TURN_RATE_RADPS,
        ];
        Self {
            state: [0.0; STATES],
            covariance: diagonal(sigmas.map(|sigma| sigma * sigma)),
        }
    }
}

impl Filter {
    pub(super) fn correction(&self) -> Correction {
        let [x, y, z, turn_rad, ..] = self.state;
        Correction {
            shift_m: [x, y, z],
            turn_rad,
        }
    }

    pub(super) fn level_shift_m(&self) -> f64 {
        self.state[0].hypot(self.state[1])
    }

    /// One sigma of a state.
    fn sigma(&self, of: usize) -> f64 {
        self.covariance[of][of].max(0.0).sqrt()
    }

    /// One sigma of the shift, the larger of x and y, and of the turn.
    pub(super) fn sigmas(&self) -> (f64, f64) {
        (self.sigma(0).max(self.sigma(1)), self.sigma(TURN))
    }

    /// Goes on by so many seconds of a vehicle of this speed.
    pub(super) fn predict(&mut self, seconds: f64, speed_mps: f64) {
        let fades = |time_s: f64| (-seconds / time_s).exp();
        let fresh = |sigma: f64, time_s: f64| sigma * sigma * (1.0 - fades(time_s).powi(2));
        let [of_nearer, of_velocity, of_rate] =
            [NEARER_TIME_S, VELOCITY_TIME_S, TURN_TIME_S].map(fades);
        let mut step = diagonal([
            1.0,
            1.0,
            1.0,
            1.0,
            of_nearer,
            of_velocity,
            of_velocity,
            of_rate,
        ]);
        (step[0][5], step[1][6], step[TURN][7]) = (seconds, seconds, seconds);
        let [x, y, z, turn] = WANDER.map(|by| by * by * seconds);
        let velocity = fresh(OF_SPEED * speed_mps, VELOCITY_TIME_S);
        let noise = [
            x,
            y,
            z,
            turn,
            fresh(NEARER_SIGMA_M, NEARER_TIME_S),
            velocity,
            velocity,
            fresh(TURN_RATE_RADPS, TURN_TIME_S),
        ];
        self.state = step.map(|row| row.iter().zip(&self.state).map(|(a, b)| a * b).sum());
        self.covariance = product(&product(&step, &self.covariance), &transposed(&step));
        for (i, noise) in noise.into_iter().enumerate() {
            self.covariance[i][i] += noise;
        }
    }

    /// Takes in a slice of so many seconds, scored at one trial after the other. What is not finite changes nothing.
    pub(super) fn update(&mut self, seconds: f64, mut score: impl FnMut(Trial) -> PoseScore) {
        let Some(factor) = cholesky(&self.covariance) else {
            return;
        };
        let prior = inverse_times(&factor, &diagonal([1.0; STATES]));
        let (sigma_m, sigma_rad) = self.sigmas();
        let blur_rad = sigma_rad.max(LEAST_BLUR_RAD);
        let (mut now, mut louder_ln) = (self.state, 0.0);
        let mut covariance = None;
        for round in 0..ROUNDS {
            let widened = if round == 0 { FIRST_BLUR } else { 1.0 };
            let blur_m = widened * sigma_m.max(LEAST_BLUR_M);
            let [x, y, z, turn_rad, nearer_m, ..] = now;
            let told = score(Trial {
                correction: Correction {
                    shift_m: [x, y, z],
                    turn_rad,
                },
                nearer_m,
                louder_ln,
                blur_m,
                blur_rad,
            });
            let (gradient, curvature) = self.system((&prior, seconds), (&now, louder_ln), &told);
            let Some(factor) = cholesky(&curvature) else {
                return;
            };
            let step = solve(&factor, &gradient);
            let longest_m = FIRST_BLUR * blur_m;
            let mut longest = [1.0; WITH_POWER];
            longest[..=UP].fill(longest_m);
            (longest[TURN], longest[NEARER]) = (FIRST_BLUR * blur_rad, LONGEST_NEARER_M);
            let over = step
                .iter()
                .zip(longest)
                .map(|(step, most)| (step / most).abs());
            let share = over.fold(1.0, f64::max).recip();
            for (now, step) in now.iter_mut().zip(step) {
                *now += share * step;
            }
            louder_ln += share * step[STATES];
            covariance = Some(inverse_times(&factor, &diagonal([1.0; WITH_POWER])));
        }
        if let Some(all) = covariance
            && now
                .iter()
                .chain(all.as_flattened())
                .all(|value| value.is_finite())
        {
            self.state = now;
            self.covariance = std::array::from_fn(|i| std::array::from_fn(|j| all[i][j]));
        }
    }

    /// Gradient and curvature of all states: what the slice tells, what was known before, and the depth sensor.
    fn system(
        &self,
        (prior, seconds): (&Square<STATES>, f64),
        (now, louder_ln): (&[f64; STATES], f64),
        told: &PoseScore,
    ) -> ([f64; WITH_POWER], Square<WITH_POWER>) {
        let (mut gradient, mut curvature) = ([0.0; WITH_POWER], [[0.0; WITH_POWER]; WITH_POWER]);
        for (i, row) in prior.iter().enumerate() {
            curvature[i][..STATES].copy_from_slice(row);
            let off = row.iter().zip(now.iter().zip(&self.state));
            gradient[i] = -off
                .map(|(known, (now, before))| known * (now - before))
                .sum::<f64>();
        }
        let of_power = POWER_SIGMA.powi(-2);
        curvature[STATES][STATES] = of_power;
        gradient[STATES] = -of_power * louder_ln;
        for (of, &i) in OBSERVED.iter().enumerate() {
            gradient[i] += COUNTS * told.gradient[of];
            for (other, &j) in OBSERVED.iter().enumerate() {
                curvature[i][j] += COUNTS * told.information[of][other];
            }
        }
        let of_depth = DEPTH_SIGMA_M.powi(-2) * seconds / DEPTH_TIME_S;
        curvature[UP][UP] += of_depth;
        gradient[UP] -= of_depth * now[UP];
        (gradient, curvature)
    }
}

fn diagonal<const N: usize>(of: [f64; N]) -> Square<N> {
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { of[i] } else { 0.0 }))
}

fn product<const N: usize>(a: &Square<N>, b: &Square<N>) -> Square<N> {
    let sum = |i: usize, j: usize| (0..N).map(|k| a[i][k] * b[k][j]).sum();
    std::array::from_fn(|i| std::array::from_fn(|j| sum(i, j)))
}

fn transposed<const N: usize>(a: &Square<N>) -> Square<N> {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a slice that tells shift along x and y, and turn, each by itself, as they truly are; of the others nothing.
    fn told(truth: [f64; 4], information: f64, trial: Trial) -> PoseScore {
        let [x, y, z] = trial.correction.shift_m;
        let now = [x, y, z, trial.correction.turn_rad];
        let mut score = PoseScore::default();
        for of in [0, 1, TURN] {
            score.gradient[of] = information * (truth[of] - now[of]);
            score.information[of][of] = information;
        }
        score
    }

    #[test]
    fn a_steady_drift_is_followed_and_its_sigma_is_that_of_what_pings_tell() {
        let mut filter = Filter::default();
        let truth = |slice: u32| {
            let seconds = 0.5 * f64::from(slice);
            [6e-3 * seconds, -3e-3 * seconds, 0.0, 1e-4 * seconds]
        };
        for slice in 1..=240 {
            filter.predict(0.5, 0.4);
            filter.update(0.5, |trial| told(truth(slice), 1e5, trial));
        }
        let (found, truth) = (filter.correction(), truth(240));
        for (found, truth) in found.shift_m.iter().zip(truth) {
            assert!((found - truth).abs() < 0.02, "{found} {truth}");
        }
        assert!(
            (found.turn_rad - truth[TURN]).abs() < 0.2 * DEGREE,
            "{found:?}"
        );
        let (sigma_m, sigma_rad) = filter.sigmas();
        assert!((0.005..0.03).contains(&sigma_m), "{sigma_m}");
        assert!(sigma_rad < 0.5 * DEGREE, "{sigma_rad}");
    }

    #[test]
    fn where_nothing_is_heard_the_shift_grows_unsure_with_the_way_and_stays_where_it_was() {
        let sigma_after = |speed_mps: f64| {
            let mut filter = Filter::default();
            for _ in 0..400 {
                filter.predict(0.5, speed_mps);
                filter.update(0.5, |_| PoseScore::default());
            }
            assert_eq!(filter.correction(), Correction::default());
            filter.sigmas().0
        };
        let (still, slow, fast) = (sigma_after(0.0), sigma_after(0.5), sigma_after(1.0));
        assert!(still < slow && slow < 0.6 * fast, "{still} {slow} {fast}");
        // Of a way of 200 m.
        assert!((0.5..3.0).contains(&fast), "{fast}");
    }

    #[test]
    fn what_is_no_number_changes_nothing() {
        let mut filter = Filter::default();
        filter.predict(0.5, 0.4);
        let before = filter.sigmas();
        filter.update(0.5, |_| PoseScore {
            gradient: [f64::NAN; POSE_STATES],
            ..PoseScore::default()
        });
        assert_eq!(filter.correction(), Correction::default());
        assert_eq!(filter.sigmas(), before);
    }
}
