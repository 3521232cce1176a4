//! How many steps a stiff problem takes, and how large a step may be.

use echosplat_mapper::damped_step;
use echosplat_measurement::twin::Twin;
use echosplat_measurement::{Element, PingGeometry, SymmetricMat3};
use glam::{DMat3, DVec3, Mat3, Quat, Vec3};

use super::Row;
use super::row::{Comparison, Figure, Label};
use super::scene::{geometry, plain};
use crate::draw::Draw;
use echosplat_report::Plot;

const POSITION: Label = Label {
    case: "stiffness: position step",
    quantity: "steps until a place is a thousand times nearer (naive: gradient descent with its best \
               stable step)",
    why: "Each step is preconditioned by the Gaussian's own block of the information and damped by how \
          far it is believed.",
};

const BEYOND: Label = Label {
    case: "stiffness: position step",
    quantity: "distance after 50 steps over that before",
    why: "What single precision cannot tell from nothing known is left where it is: a stiff direction \
          never throws a Gaussian away.",
};

const EXPONENT: Label = Label {
    case: "stiffness: multiplicative step",
    quantity: "exponent over the largest that still converges",
    why: "An exponent of ½ never overshoots: it descends on a bound of the likelihood. Beyond the \
          interval strengths swing from step to step.",
};

/// Steps of the program's way, at any condition that single precision can hold.
const STEPS_WITHIN: f64 = 20.0;
/// Sums in single precision tell nothing of a direction this much softer than the stiffest.
const HELD_DECADES: i32 = 6;
const DECADES: i32 = 12;
const MOST_STEPS: usize = 1000;
const NEARER: f64 = 1e-3;
/// Half a voxel of 6 cm: how far a step is believed.
const PRIOR_M: f64 = 0.031_25;
/// Off the truth at the start, metres.
const START_M: DVec3 = DVec3::new(0.012, -0.011, 0.012);
/// Information along the softest direction, per square metre: a hundred times the prior's.
const SOFTEST: f64 = 1e5;
/// Noise over the strongest bin.
const FLOOR: f64 = 1e-3;

/// Observations of one Gaussian from three directions, one of them counting far more.
struct Problem {
    observations: Vec<(PingGeometry, f64)>,
    measured: Vec<Vec<f64>>,
    floor: f64,
    gaussian: Element,
}

/// First derivatives at a place.
struct Slopes {
    gradient: DVec3,
    information: DMat3,
}

/// What steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    Descent,
    Block,
}

fn looking_from(from_m: DVec3, rotation: Quat) -> PingGeometry {
    let mut geometry = geometry();
    // Only where the Gaussians are.
    geometry.range_start_m = 4.0;
    geometry.bin_count = 100;
    geometry.pose.position_m = from_m.as_vec3();
    geometry.pose.axes = Mat3::from_quat(rotation);
    geometry
}

impl Problem {
    fn new(decade: i32) -> Self {
        let askew = Quat::from_xyzw(0.2, 0.5, -0.3, 0.8).normalize();
        let gaussian = plain(Vec3::new(0.3, -0.2, 0.1));
        let turns = [
            Quat::IDENTITY,
            Quat::from_rotation_z(1.6),
            Quat::from_rotation_y(1.5) * Quat::from_rotation_x(0.4),
        ];
        let of_turn = |turn: Quat| {
            let rotation = askew * turn;
            let ahead = rotation * Vec3::new(5.0, 0.01, 0.1);
            looking_from((gaussian.mean_m - ahead).as_dvec3(), rotation)
        };
        let observations = turns.map(|turn| (of_turn(turn), 1.0));
        let mut problem = Self {
            observations: observations.into(),
            measured: Vec::new(),
            floor: 0.0,
            gaussian,
        };
        let truth = gaussian.mean_m.as_dvec3();
        let loudest = problem.rendered(truth).into_iter().flatten();
        problem.floor = FLOOR * loudest.fold(0.0, f64::max);
        problem.measured = problem.rendered(truth);
        let unweighted = problem.slopes(truth).information;
        let unit = SOFTEST / softest(&unweighted);
        for (index, (_, weight)) in problem.observations.iter_mut().enumerate() {
            *weight = unit * if index == 0 { 10_f64.powi(decade) } else { 1.0 };
        }
        problem
    }

    fn truth(&self) -> DVec3 {
        self.gaussian.mean_m.as_dvec3()
    }

    fn twins(&self, place: DVec3) -> impl Iterator<Item = (Twin, f64)> + '_ {
        let element = Element {
            mean_m: place.as_vec3(),
            ..self.gaussian
        };
        let observations = self.observations.iter();
        observations.map(move |(geometry, weight)| (Twin::of(geometry, &[element]), *weight))
    }

    /// Over the noise.
    fn rendered(&self, place: DVec3) -> Vec<Vec<f64>> {
        let twins = self.twins(place);
        twins.map(|(twin, _)| twin.predicted(self.floor)).collect()
    }

    /// Of the likelihood of gamma speckle.
    fn slopes(&self, place: DVec3) -> Slopes {
        let mut slopes = Slopes {
            gradient: DVec3::ZERO,
            information: DMat3::ZERO,
        };
        for ((twin, weight), measured) in self.twins(place).zip(&self.measured) {
            let (gradient, information) = twin.scores(measured, &twin.predicted(self.floor))[0];
            slopes.gradient += weight * gradient;
            slopes.information += information * weight;
        }
        slopes
    }

    fn condition(&self) -> f64 {
        let information = self.slopes(self.truth()).information;
        stiffest(&information) / softest(&information)
    }

    /// How many steps it takes, and how far it is off after all over the start.
    fn run(&self, method: Method, most: usize) -> (usize, f64) {
        let start = self.truth() + START_M;
        let mut place = start;
        let at_truth = self.slopes(self.truth()).information;
        let rate = 2.0 / (stiffest(&at_truth) + softest(&at_truth));
        let off = |place: DVec3| (place - self.truth()).length() / START_M.length();
        for step in 0..most {
            if off(place) <= NEARER {
                return (step, off(place));
            }
            let slopes = self.slopes(place);
            place += match method {
                Method::Descent => rate * slopes.gradient,
                Method::Block => stepped(&slopes),
            };
        }
        (most, off(place))
    }
}

/// By the mapper, from sums in single precision.
fn stepped(slopes: &Slopes) -> DVec3 {
    let information = SymmetricMat3::of(slopes.information.as_mat3());
    let step = damped_step(slopes.gradient.as_vec3(), &information, PRIOR_M as f32);
    step.map_or(DVec3::ZERO, Vec3::as_dvec3)
}

/// Largest eigenvalue of a symmetric matrix, by the power method.
fn stiffest(m: &DMat3) -> f64 {
    grown(|v| *m * v)
}

fn softest(m: &DMat3) -> f64 {
    // By cofactors, each from the matrix's own numbers.
    let adjoint = DMat3::from_cols(
        m.y_axis.cross(m.z_axis),
        m.z_axis.cross(m.x_axis),
        m.x_axis.cross(m.y_axis),
    );
    let determinant = m.x_axis.dot(adjoint.x_axis);
    determinant / grown(|v| adjoint.transpose() * v)
}

fn grown(times: impl Fn(DVec3) -> DVec3) -> f64 {
    let mut v = DVec3::new(0.6, 0.5, 0.7);
    let mut size = 0.0;
    for _ in 0..200 {
        let next = times(v);
        size = next.length();
        v = next / size;
    }
    size
}

/// Of strengths, from the right ones off by up to a factor of ten.
struct Strengths {
    /// Energy of each Gaussian per ping and bin, shape `[ping·bin][gaussian]`.
    energies: Vec<Vec<f64>>,
    measured: Vec<f64>,
    truth: Vec<f64>,
    floor: f64,
}

const CROWD: usize = 8;
const EXPONENT_STEPS: usize = 400;
/// Exponent with which the mapper finishes.
const USED_EXPONENT: f64 = 0.5;

impl Strengths {
    fn new(seed: u64) -> Self {
        let mut draw = Draw::new(seed, 900);
        let crowd: Vec<Element> = (0..CROWD).map(|_| plain(0.15 * draw.cube())).collect();
        let mut energies = Vec::new();
        for _ in 0..24 {
            let rotation = draw.rotation();
            let ahead = rotation * Vec3::new(5.0, 0.0, 0.0);
            let geometry = looking_from((-ahead).as_dvec3(), rotation);
            let alone = |one: &Element| Twin::of(&geometry, &[*one]).predicted(0.0);
            let each: Vec<Vec<f64>> = crowd.iter().map(alone).collect();
            for bin in 0..geometry.bin_count as usize {
                let row: Vec<f64> = each.iter().map(|profile| profile[bin]).collect();
                if row.iter().any(|energy| *energy > 0.0) {
                    energies.push(row);
                }
            }
        }
        let truth: Vec<f64> = (0..CROWD)
            .map(|_| f64::from(draw.between(-2.0, 2.0)).exp())
            .collect();
        let mut strengths = Self {
            energies,
            measured: Vec::new(),
            truth,
            floor: 0.0,
        };
        strengths.measured = strengths.predicted(&strengths.truth);
        let loudest = strengths.measured.iter().copied().fold(0.0, f64::max);
        strengths.floor = FLOOR * loudest;
        strengths
    }

    fn predicted(&self, strengths: &[f64]) -> Vec<f64> {
        let sum = |row: &Vec<f64>| row.iter().zip(strengths).map(|(a, s)| a * s).sum();
        self.energies.iter().map(sum).collect()
    }

    /// Steps until no echo is off by more than a hundredth; `None` if never.
    fn steps(&self, exponent: f64) -> Option<usize> {
        let mut strengths = vec![1.0; CROWD];
        for step in 0..EXPONENT_STEPS {
            let predicted = self.predicted(&strengths);
            let pairs = || predicted.iter().zip(&self.measured);
            let worst = pairs().map(|(p, m)| ((p + self.floor) / (m + self.floor)).ln().abs());
            if worst.fold(0.0, f64::max) < 0.01 {
                return Some(step);
            }
            let mut sums = vec![(0.0, 0.0); CROWD];
            for ((p, m), row) in pairs().zip(&self.energies) {
                let (p, m) = (p + self.floor, m + self.floor);
                for ((numerator, weight), energy) in sums.iter_mut().zip(row) {
                    *numerator += energy * m / (p * p);
                    *weight += energy / p;
                }
            }
            for (strength, (numerator, weight)) in strengths.iter_mut().zip(sums) {
                *strength *= (numerator / weight).powf(exponent).clamp(0.05, 20.0);
            }
        }
        None
    }

    /// The largest exponent up to which all converge.
    fn largest_stable(&self) -> f64 {
        let exponents = (1..=25).map(|tenth| 0.1 * f64::from(tenth));
        let stable = exponents.skip_while(|e| self.steps(*e).is_none());
        stable
            .take_while(|e| self.steps(*e).is_some())
            .fold(f64::NAN, f64::max)
    }
}

pub(super) fn rows(seed: u64, quick: bool) -> Vec<Row> {
    let every = if quick { 3 } else { 1 };
    let mut rows = Vec::new();
    for decade in (0..=DECADES).step_by(every) {
        let problem = Problem::new(decade);
        let input = format!("condition {}", Figure(problem.condition()));
        if decade > HELD_DECADES {
            let (_, off) = problem.run(Method::Block, 50);
            rows.push(Comparison::of(0.0, off, 1.0).row(BEYOND, input, 1.0));
            continue;
        }
        let (steps, _) = problem.run(Method::Block, MOST_STEPS);
        let (descent, _) = problem.run(Method::Descent, MOST_STEPS);
        let comparison = Comparison::of(0.0, steps as f64, 1.0).with_naive(descent as f64, 1.0);
        rows.push(comparison.row(POSITION, input, STEPS_WITHIN));
    }
    let largest = Strengths::new(seed).largest_stable();
    let comparison = Comparison::of(0.0, USED_EXPONENT / largest, 1.0);
    let input = format!(
        "exponent ½, {CROWD} that overlap, stable to {}",
        Figure(largest)
    );
    rows.push(comparison.row(EXPONENT, input, 0.5));
    rows
}

/// Steps over condition by each method, and over the exponent.
#[must_use]
pub(crate) fn plots(seed: u64) -> Vec<Plot> {
    let methods = [
        ("gradient descent, best stable step", Method::Descent),
        ("block of the information, the mapper's", Method::Block),
    ];
    let problems: Vec<(f64, Problem)> = (0..=DECADES)
        .map(Problem::new)
        .map(|problem| (problem.condition(), problem))
        .collect();
    let line = |method| {
        let steps = |problem: &Problem| problem.run(method, MOST_STEPS).0 as f64;
        problems.iter().map(|(c, p)| (*c, steps(p))).collect()
    };
    let strengths = Strengths::new(seed);
    let exponents = (1..=25).map(|tenth| 0.1 * f64::from(tenth));
    let converging = exponents.filter_map(|e| Some((e, strengths.steps(e)? as f64)));
    vec![
        Plot {
            x_label: "condition of the information".to_owned(),
            y_label: format!("steps until a thousand times nearer, {MOST_STEPS} at most"),
            lines: methods.map(|(name, m)| (name.to_owned(), line(m))).into(),
            ..Plot::default()
        },
        Plot {
            x_label: "exponent of the multiplicative step".to_owned(),
            y_label: "steps until every echo is within 1 %".to_owned(),
            lines: vec![("where it converges".to_owned(), converging.collect())],
            ..Plot::default()
        },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvalues_are_those_of_a_diagonal() {
        let m = DMat3::from_diagonal(DVec3::new(3.0, 1e12, 1.0));
        assert!((stiffest(&m) / 1e12 - 1.0).abs() < 1e-9);
        assert!((softest(&m) - 1.0).abs() < 1e-9);
    }
}
