//! How far poses have drifted: a Kalman filter over slices of pings, whose bins it sees by score and Fisher information.
//!
//! Cost of a slice: a few products and factors of 14 × 14 numbers beside the visits that score it.

use echosplat_measurement::heard::{POSE_STATES, PoseScore};
use echosplat_model::glam::DVec2;

use crate::calibrate::linear::{Square, cholesky, inverse_times, solve};

/// States; layout.
/// Shift of the sensor along x, y and z, m; its turn about z, rad; how much nearer than they are echoes are heard, m; velocity of
/// the shift along x and y, m/s; rate of the turn, rad/s; shift along x and y and turn of a finished map; what aspects that the
/// map has too little of draw by along x and y, m.
const STATES: usize = 13;
/// Place of the shift up; layout.
const UP: usize = 2;
/// Place of the turn; layout.
const TURN: usize = 3;
/// Place of the nearness; layout.
const NEARER: usize = 4;
/// Places of the map's own shift; layout.
const MAP: [usize; 2] = [8, 9];
/// Place of the map's own turn; layout.
const MAP_TURN: usize = 10;
/// Places of what aspects draw by; layout.
const DRAWN: [usize; 2] = [11, 12];
/// States with the map's power, of each slice; layout.
const WITH_POWER: usize = STATES + 1;
/// Places of what pings tell of, in a [`PoseScore`]; layout.
const OBSERVED: [usize; POSE_STATES] = [0, 1, UP, TURN, NEARER, STATES];
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
/// Metres, found: 0.2 is worse beside a wall.
/// One sigma of where a finished map lies, against where its first poses put it.
const MAP_SIGMA_M: f64 = 0.05;
/// Metres, measured: 5 to 8 cm.
/// One sigma of what aspects draw by that the map has too little of.
const DRAWN_SIGMA_M: f64 = 0.05;
/// Radians, found with `MAP_SIGMA_M`.
/// One sigma of how a finished map is turned.
const MAP_TURN_SIGMA_RAD: f64 = 0.5 * DEGREE;
/// Seconds, assumed: a structure's side goes by.
/// Time constant of what aspects draw by.
const DRAWN_TIME_S: f64 = 20.0;
/// Metres, measured: 0.08 to 0.24 m along an axis.
/// One sigma of where a map of corrected poses lies as a whole, which its filter does not know.
const SHARED_SIGMA_M: f64 = 0.15;
/// Radians, measured: 0.4 to 1.7 degrees.
/// One sigma of how it is turned.
const SHARED_TURN_SIGMA_RAD: f64 = DEGREE;
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

/// What was found of a slice.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Found {
    pub(crate) correction: Correction,
    /// One sigma of a place so corrected along the map's x, y and z, with the error that all places of the map share.
    pub(crate) sigma_m: [f64; 3],
    /// One sigma of its heading.
    pub(crate) turn_sigma_rad: f64,
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

/// What makes the next state of one.
pub(super) type Transition = Square<STATES>;

/// What pings are compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Against {
    /// The map as it grows: it lies where its first poses put it.
    Growing,
    /// The map of the whole dive, which poses that drifted have moved as a whole.
    Finished,
}

/// What poses have drifted by, as far as is known.
#[derive(Debug, Clone)]
pub(super) struct Filter {
    against: Against,
    state: [f64; STATES],
    covariance: Square<STATES>,
}

impl Filter {
    /// At the first ping nothing has drifted: that is where the map begins.
    pub(super) fn of(against: Against) -> Self {
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
            MAP_SIGMA_M,
            MAP_SIGMA_M,
            MAP_TURN_SIGMA_RAD,
            DRAWN_SIGMA_M,
            DRAWN_SIGMA_M,
        ];
        Self {
            against,
            state: [0.0; STATES],
            covariance: diagonal(sigmas.map(|sigma| sigma * sigma)),
        }
    }

    pub(super) fn correction(&self) -> Correction {
        correction_of(&self.state)
    }

    pub(super) fn level_shift_m(&self) -> f64 {
        self.state[0].hypot(self.state[1])
    }

    /// What is added to poses, and how sure that is.
    pub(super) fn found(&self) -> Found {
        found_in(&self.state, &self.covariance)
    }

    /// Goes on by so many seconds of a vehicle of this speed. Returns what makes the next state of the one before.
    pub(super) fn predict(&mut self, seconds: f64, speed_mps: f64) -> Transition {
        let fades = |time_s: f64| (-seconds / time_s).exp();
        let fresh = |sigma: f64, time_s: f64| sigma * sigma * (1.0 - fades(time_s).powi(2));
        let [of_nearer, of_velocity, of_rate, of_drawn] =
            [NEARER_TIME_S, VELOCITY_TIME_S, TURN_TIME_S, DRAWN_TIME_S].map(fades);
        let mut step = diagonal([
            1.0,
            1.0,
            1.0,
            1.0,
            of_nearer,
            of_velocity,
            of_velocity,
            of_rate,
            1.0,
            1.0,
            1.0,
            of_drawn,
            of_drawn,
        ]);
        (step[0][5], step[1][6], step[TURN][7]) = (seconds, seconds, seconds);
        let [x, y, z, turn] = WANDER.map(|by| by * by * seconds);
        let velocity = fresh(OF_SPEED * speed_mps, VELOCITY_TIME_S);
        let drawn = fresh(DRAWN_SIGMA_M, DRAWN_TIME_S);
        let noise = [
            x,
            y,
            z,
            turn,
            fresh(NEARER_SIGMA_M, NEARER_TIME_S),
            velocity,
            velocity,
            fresh(TURN_RATE_RADPS, TURN_TIME_S),
            0.0,
            0.0,
            0.0,
            drawn,
            drawn,
        ];
        self.state = step.map(|row| row.iter().zip(&self.state).map(|(a, b)| a * b).sum());
        self.covariance = product(&product(&step, &self.covariance), &transposed(&step));
        for (i, noise) in noise.into_iter().enumerate() {
            self.covariance[i][i] += noise;
        }
        step
    }

    /// By how much each state, and the power, changes what pings from around this level place tell of.
    fn seen_from(&self, at_m: DVec2) -> [[f64; WITH_POWER]; POSE_STATES] {
        let mut seen = [[0.0; WITH_POWER]; POSE_STATES];
        for (row, of) in seen.iter_mut().zip(OBSERVED) {
            row[of] = 1.0;
        }
        if self.against == Against::Finished {
            // A map that is moved is seen as a sensor that is moved the other way.
            for (axis, lever_m) in [at_m.y, -at_m.x].into_iter().enumerate() {
                seen[axis][MAP[axis]] = -1.0;
                seen[axis][MAP_TURN] = lever_m;
                seen[axis][DRAWN[axis]] = 1.0;
            }
            seen[TURN][MAP_TURN] = -1.0;
        }
        seen
    }

    /// Takes in a slice of so many seconds around a level place, scored at one trial after the other. What is not finite changes
    /// nothing.
    pub(super) fn update(
        &mut self,
        seconds: f64,
        at_m: DVec2,
        mut score: impl FnMut(Trial) -> PoseScore,
    ) {
        let Some(factor) = cholesky(&self.covariance) else {
            return;
        };
        let prior = inverse_times(&factor, &diagonal([1.0; STATES]));
        let seen = self.seen_from(at_m);
        let sigma_of = |row: usize| self.variance_along(&seen[row]).max(0.0).sqrt();
        let sigma_m = sigma_of(0).max(sigma_of(1));
        let blur_rad = sigma_of(TURN).max(LEAST_BLUR_RAD);
        let mut now = [0.0; WITH_POWER];
        now[..STATES].copy_from_slice(&self.state);
        let mut covariance = None;
        for round in 0..ROUNDS {
            let widened = if round == 0 { FIRST_BLUR } else { 1.0 };
            let blur_m = widened * sigma_m.max(LEAST_BLUR_M);
            let [x, y, z, turn_rad, nearer_m, louder_ln] = seen.map(|row| along(&row, &now));
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
            let (gradient, curvature) = self.system((&prior, seconds), &seen, &now, &told);
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
            covariance = Some(inverse_times(&factor, &diagonal([1.0; WITH_POWER])));
        }
        if let Some(all) = covariance
            && now
                .iter()
                .chain(all.as_flattened())
                .all(|value| value.is_finite())
        {
            self.state = std::array::from_fn(|i| now[i]);
            self.covariance = std::array::from_fn(|i| std::array::from_fn(|j| all[i][j]));
        }
    }

    /// Variance of what is seen of the state, the power not counted.
    fn variance_along(&self, row: &[f64; WITH_POWER]) -> f64 {
        let times = |covariance: &[f64; STATES]| along(row, covariance);
        along(row, &self.covariance.each_ref().map(times))
    }

    /// Gradient and curvature of all states: what the slice tells, what was known before, and the depth sensor.
    fn system(
        &self,
        (prior, seconds): (&Square<STATES>, f64),
        seen: &[[f64; WITH_POWER]; POSE_STATES],
        now: &[f64; WITH_POWER],
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
        gradient[STATES] = -of_power * now[STATES];
        for (of, row) in seen.iter().enumerate() {
            let mut by_state = [0.0; WITH_POWER];
            for (other, information) in seen.iter().zip(told.information[of]) {
                (0..WITH_POWER).for_each(|j| by_state[j] += information * other[j]);
            }
            for i in (0..WITH_POWER).filter(|&i| row[i].abs() > 0.0) {
                gradient[i] += COUNTS * row[i] * told.gradient[of];
                (0..WITH_POWER).for_each(|j| curvature[i][j] += COUNTS * row[i] * by_state[j]);
            }
        }
        let of_depth = DEPTH_SIGMA_M.powi(-2) * seconds / DEPTH_TIME_S;
        curvature[UP][UP] += of_depth;
        gradient[UP] -= of_depth * now[UP];
        (gradient, curvature)
    }
}

/// What was known of a slice.
#[derive(Debug)]
pub(super) struct Known {
    /// What made its state of the one before.
    pub(super) step: Transition,
    /// Before it was heard.
    pub(super) before: Filter,
    /// After.
    pub(super) after: Filter,
}

/// What is known of each slice when those after it are heard too (Rauch, Tung and Striebel).
pub(super) fn smoothed(known: &[Known]) -> Vec<Found> {
    let mut found: Vec<Found> = Vec::with_capacity(known.len());
    let mut later: Option<([f64; STATES], Square<STATES>, &Known)> = None;
    for now in known.iter().rev() {
        let Filter {
            mut state,
            mut covariance,
            ..
        } = now.after.clone();
        if let Some((of_next, covariance_of_next, next)) = later
            && let Some(factor) = cholesky(&next.before.covariance)
        {
            // Transposed.
            let gain = inverse_times(&factor, &product(&next.step, &now.after.covariance));
            for (of, gain) in of_next.iter().zip(&next.before.state).zip(gain) {
                let off = of.0 - of.1;
                (0..STATES).for_each(|i| state[i] += gain[i] * off);
            }
            let mut less = covariance_of_next;
            let before = next.before.covariance.as_flattened();
            (less.as_flattened_mut().iter_mut().zip(before))
                .for_each(|(less, before)| *less -= before);
            let less = product(&product(&transposed(&gain), &less), &gain);
            let all = covariance.as_flattened_mut().iter_mut();
            (all.zip(less.as_flattened())).for_each(|(of, less)| *of += less);
        }
        found.push(found_in(&state, &covariance));
        later = Some((state, covariance, now));
    }
    found.reverse();
    found
}

/// A state and its covariance as others see them.
fn found_in(state: &[f64; STATES], covariance: &Square<STATES>) -> Found {
    let sigma = |of: usize, shared: f64| covariance[of][of].max(0.0).sqrt().hypot(shared);
    Found {
        correction: correction_of(state),
        sigma_m: [
            sigma(0, SHARED_SIGMA_M),
            sigma(1, SHARED_SIGMA_M),
            sigma(UP, DEPTH_SIGMA_M),
        ],
        turn_sigma_rad: sigma(TURN, SHARED_TURN_SIGMA_RAD),
    }
}

fn correction_of(state: &[f64; STATES]) -> Correction {
    let [x, y, z, turn_rad, ..] = *state;
    Correction {
        shift_m: [x, y, z],
        turn_rad,
    }
}

/// Their product as far as both go.
fn along(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
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
        let mut filter = Filter::of(Against::Growing);
        let truth = |slice: u32| {
            let seconds = 0.5 * f64::from(slice);
            [6e-3 * seconds, -3e-3 * seconds, 0.0, 1e-4 * seconds]
        };
        for slice in 1..=240 {
            filter.predict(0.5, 0.4);
            filter.update(0.5, DVec2::ZERO, |trial| told(truth(slice), 1e5, trial));
        }
        let (found, truth) = (filter.correction(), truth(240));
        for (found, truth) in found.shift_m.iter().zip(truth) {
            assert!((found - truth).abs() < 0.02, "{found} {truth}");
        }
        assert!(
            (found.turn_rad - truth[TURN]).abs() < 0.2 * DEGREE,
            "{found:?}"
        );
        let Found {
            sigma_m: [x_m, ..],
            turn_sigma_rad,
            ..
        } = filter.found();
        let of_pings_m = (x_m.powi(2) - SHARED_SIGMA_M.powi(2)).sqrt();
        assert!((0.005..0.03).contains(&of_pings_m), "{of_pings_m}");
        let of_pings_rad = (turn_sigma_rad.powi(2) - SHARED_TURN_SIGMA_RAD.powi(2)).sqrt();
        assert!(of_pings_rad < 0.5 * DEGREE, "{of_pings_rad}");
    }

    #[test]
    fn where_nothing_is_heard_the_shift_grows_unsure_with_the_way_and_stays_where_it_was() {
        let sigma_after = |speed_mps: f64| {
            let mut filter = Filter::of(Against::Growing);
            for _ in 0..400 {
                filter.predict(0.5, speed_mps);
                filter.update(0.5, DVec2::ZERO, |_| PoseScore::default());
            }
            assert_eq!(filter.correction(), Correction::default());
            filter.found().sigma_m[0]
        };
        let (still, slow, fast) = (sigma_after(0.0), sigma_after(0.5), sigma_after(1.0));
        assert!(still < slow && slow < 0.6 * fast, "{still} {slow} {fast}");
        // Of a way of 200 m.
        assert!((0.5..3.0).contains(&fast), "{fast}");
    }

    /// Of a slice heard around a place by a map that is moved and turned by so much.
    fn told_of_map((moved_m, turned_rad): (DVec2, f64), at_m: DVec2, trial: Trial) -> PoseScore {
        let lever_m = turned_rad * DVec2::new(at_m.y, -at_m.x);
        let seen_m = lever_m - moved_m;
        told([seen_m.x, seen_m.y, 0.0, -turned_rad], 1e5, trial)
    }

    #[test]
    fn a_map_that_lies_elsewhere_as_a_whole_does_not_move_poses_with_it() {
        let map = (DVec2::new(0.05, -0.04), 0.3 * DEGREE);
        let longest_m = |against: Against| {
            let mut filter = Filter::of(against);
            let mut known = Vec::new();
            for slice in 0..240 {
                let at_m = 3.0 * DVec2::from_angle(0.05 * f64::from(slice));
                let step = filter.predict(0.5, 0.1);
                let before = filter.clone();
                filter.update(0.5, at_m, |trial| told_of_map(map, at_m, trial));
                let after = filter.clone();
                known.push(Known {
                    step,
                    before,
                    after,
                });
            }
            let track = smoothed(&known);
            let lengths = track.iter().map(|found| {
                let [x, y, _] = found.correction.shift_m;
                x.hypot(y)
            });
            lengths.fold(0.0, f64::max)
        };
        let (growing_m, finished_m) = (longest_m(Against::Growing), longest_m(Against::Finished));
        assert!(growing_m > 0.05, "{growing_m}");
        assert!(finished_m < 0.5 * growing_m, "{finished_m} {growing_m}");
    }

    #[test]
    fn what_comes_later_tells_of_slices_in_which_nothing_was_heard() {
        let mut filter = Filter::of(Against::Growing);
        let mut known = Vec::new();
        for slice in 1..=200 {
            let step = filter.predict(0.5, 0.4);
            let before = filter.clone();
            let truth_m = 2e-3 * f64::from(slice);
            let is_deaf = (60..140).contains(&slice);
            filter.update(0.5, DVec2::ZERO, |trial| match is_deaf {
                true => PoseScore::default(),
                false => told([truth_m, 0.0, 0.0, 0.0], 1e5, trial),
            });
            known.push(Known {
                step,
                before,
                after: filter.clone(),
            });
        }
        let track = smoothed(&known);
        let off_m = |found: &Correction| (found.shift_m[0] - 2e-3 * 139.0).abs();
        let smoothed_m = off_m(&track[138].correction);
        let filtered_m = off_m(&known[138].after.correction());
        assert_eq!(track.len(), known.len());
        let last = known[199].after.found();
        assert_eq!(track[199].correction, last.correction);
        // Where nothing was heard the end of it is as sure as the pings after it, and the middle the least.
        let sigma_m = |of: &Found| of.sigma_m[0];
        let sigmas_m = [30, 100, 138].map(|slice| sigma_m(&track[slice]));
        assert!(
            sigmas_m[0] < sigmas_m[2] && sigmas_m[2] < sigmas_m[1],
            "{sigmas_m:?}"
        );
        assert!(
            sigmas_m[1] < sigma_m(&known[138].after.found()),
            "{sigmas_m:?}"
        );
        assert!(smoothed_m < 0.02, "{smoothed_m}");
        assert!(filtered_m > 3.0 * smoothed_m, "{filtered_m} {smoothed_m}");
    }

    #[test]
    fn what_is_no_number_changes_nothing() {
        let mut filter = Filter::of(Against::Growing);
        filter.predict(0.5, 0.4);
        let before = filter.found();
        filter.update(0.5, DVec2::ZERO, |_| PoseScore {
            gradient: [f64::NAN; POSE_STATES],
            ..PoseScore::default()
        });
        assert_eq!(filter.correction(), Correction::default());
        assert_eq!(filter.found(), before);
    }
}
