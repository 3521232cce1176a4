//! What the bins of a ping say of where its sensor was: score and Fisher information of its pose, all echoes together.

use fearless_simd::prelude::*;
use glam::Vec3;

use super::hearing::Hearing;
use super::told::Bins;
use super::view::View;

/// States of a pose; layout.
/// States that are told of: a shift of the sensor along x, y and z of the world, m; its turn about the world's z, rad; how much
/// nearer than they are all echoes are heard, m; and the logarithm of their power.
pub const POSE_STATES: usize = 6;
/// Place of the turn; layout.
const TURN: usize = 3;
/// Place of the power; layout.
const POWER: usize = 5;
/// Looks, assumed: heavier tails than speckle has.
/// Degrees of freedom of a bin's power against what is predicted: with two, one wild bin counts little.
const LOOKS: f32 = 2.0;
/// Ratio of power; bounds work.
/// Bins with less of echoes than this, over noise, tell nothing.
const LEAST_ECHO: f32 = 1e-3;

/// Gradient and expected curvature of the log likelihood of a ping by its pose, summed over bins.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseScore {
    /// Per state.
    pub gradient: [f64; POSE_STATES],
    /// Per two states, both triangles.
    pub information: [[f64; POSE_STATES]; POSE_STATES],
}

impl PoseScore {
    /// Adds another ping's.
    pub fn add(&mut self, other: &Self) {
        for (sum, other) in self.gradient.iter_mut().zip(other.gradient) {
            *sum += other;
        }
        for (sums, others) in self.information.iter_mut().zip(other.information) {
            for (sum, other) in sums.iter_mut().zip(others) {
                *sum += other;
            }
        }
    }

    /// As if there had been so many alike.
    #[must_use]
    pub fn times(mut self, factor: f64) -> Self {
        let numbers = self.information.as_flattened_mut().iter_mut();
        let numbers = numbers.chain(&mut self.gradient);
        numbers.for_each(|number| *number *= factor);
        self
    }
}

/// Room for what each state changes of each bin. Reused from ping to ping.
#[derive(Debug, Default)]
pub(super) struct Columns {
    echoes: Vec<f32>,
    spread: Vec<f32>,
    of_state: [Vec<f32>; POSE_STATES],
}

impl Hearing {
    /// What the bins say of the pose, of rows told in full detail. `alone` is what is predicted without their echoes.
    #[inline(always)]
    pub fn tell_pose<S: Simd>(
        &mut self,
        simd: S,
        view: &View,
        bins: Bins<'_>,
        alone: &[f32],
    ) -> PoseScore {
        let mut columns = std::mem::take(&mut self.columns);
        let room = bins.predicted.len();
        for column in &mut columns.of_state {
            column.clear();
            column.resize(room, 0.0);
        }
        // A shift brings echoes nearer along it, and moves them across the beam; a turn moves them across it alone.
        for axis in 0..TURN {
            self.spread_as(simd, &mut columns, room, |rows, row| {
                rows.echo[row] * rows.range_axis[axis][row]
            });
            add_slope(
                &columns.spread,
                view.bins_per_m,
                &mut columns.of_state[axis],
            );
        }
        for state in 0..=TURN {
            self.spread_as(simd, &mut columns, room, |rows, row| {
                let variance = rows.azimuth_variance_rad2[row];
                let by_metre =
                    rows.echo[row] * rows.azimuth_rad[row] / (variance * rows.lever_m[row]);
                match state {
                    TURN => {
                        let around = Vec3::Z.cross(rows.range_axis_of(row) * rows.range_m[row]);
                        by_metre * rows.azimuth_axis_of(row).dot(around)
                    }
                    axis => by_metre * rows.azimuth_axis[axis][row],
                }
            });
            let column = columns.of_state[state].iter_mut();
            column
                .zip(&columns.spread)
                .for_each(|(sum, add)| *sum += add);
        }
        let echoes = bins.predicted.iter().zip(alone);
        let power = columns.of_state[POWER].iter_mut();
        power
            .zip(echoes)
            .for_each(|(power, (with, without))| *power = with - without);
        let [.., nearer, power] = &mut columns.of_state;
        add_slope(power, view.bins_per_m, nearer);
        let score = summed(&columns.of_state, bins, alone);
        self.columns = columns;
        score
    }

    #[inline(always)]
    fn spread_as<S: Simd>(
        &mut self,
        simd: S,
        columns: &mut Columns,
        room: usize,
        echo: impl Fn(&super::rows::Rows, usize) -> f32,
    ) {
        let (rows, count) = (&self.rows, self.rows.len());
        columns.echoes.clear();
        let is_heard = |row: usize| rows.energy[row] > 0.0;
        let echoes = (0..count).map(|row| if is_heard(row) { echo(rows, row) } else { 0.0 });
        columns.echoes.extend(echoes);
        columns.spread.clear();
        columns.spread.resize(room, 0.0);
        self.pulses
            .spread(simd, &self.rows, &columns.echoes, &mut columns.spread);
    }
}

/// Adds the slope of `of` over range, per metre, by central differences: a pulse is several bins wide.
#[inline(always)]
fn add_slope(of: &[f32], bins_per_m: f32, sum: &mut [f32]) {
    let beside = of.windows(3);
    for (sum, beside) in sum[1..].iter_mut().zip(beside) {
        *sum += 0.5 * bins_per_m * (beside[2] - beside[0]);
    }
}

#[inline(always)]
fn summed(columns: &[Vec<f32>; POSE_STATES], bins: Bins<'_>, alone: &[f32]) -> PoseScore {
    let mut score = PoseScore::default();
    for bin in 0..bins.predicted.len() {
        let (with, without) = (bins.predicted[bin], alone[bin]);
        let weight = bins.weight[bin];
        if !(weight > 0.0 && with - without > LEAST_ECHO * without) {
            continue;
        }
        let measured = bins.measured[bin];
        let slope = weight * LOOKS * (measured - with) / (LOOKS * with + measured);
        let curvature = weight * LOOKS / (LOOKS + 2.0);
        let by_state: [f64; POSE_STATES] =
            std::array::from_fn(|state| f64::from(columns[state][bin] / with));
        for (i, &of_state) in by_state.iter().enumerate() {
            score.gradient[i] += f64::from(slope) * of_state;
            for (j, &other) in by_state.iter().enumerate() {
                score.information[i][j] += f64::from(curvature) * of_state * other;
            }
        }
    }
    score
}

impl Bins<'_> {
    /// Log likelihood with heavy tails above that of what is predicted without echoes, `alone`, nats.
    #[must_use]
    pub fn gain_nats(&self, alone: &[f32]) -> f64 {
        let bins = (0..self.predicted.len()).map(|bin| self.gain_of(bin, alone[bin]));
        bins.map(f64::from).sum()
    }

    /// Of a bin; 0 where it tells nothing of echoes.
    #[inline(always)]
    fn gain_of(&self, bin: usize, without: f32) -> f32 {
        let (with, weight, measured) = (self.predicted[bin], self.weight[bin], self.measured[bin]);
        match weight > 0.0 && with - without > LEAST_ECHO * without {
            true => weight * (log_likelihood(measured, with) - log_likelihood(measured, without)),
            false => 0.0,
        }
    }
}

/// Of a bin's power with heavy tails, up to what does not depend on what is predicted.
#[inline(always)]
fn log_likelihood(measured: f32, predicted: f32) -> f32 {
    LOOKS * predicted.ln() - (LOOKS + 1.0) * (LOOKS * predicted + measured).ln()
}
