//! Parameters far outside: brought back to where slopes exist, and shown to recover.

use echosplat_acoustics::{GaussianArrays, PARAMETER_COUNT, Parameters, opacity_slope};
use glam::{Quat, Vec3};

use super::Row;
use super::naive;
use super::row::{Comparison, Figure, Label};
use super::scene::{Scene, plain};

const SLOPE: Label = Label {
    case: "opacity logit beyond ±16.6",
    quantity: "dα/d logit, relative",
    why: "Logits are clamped to ±12 and the slope is computed from e^(−|x|), not from 1 − α.",
};

const LOGIT: Label = Label {
    case: "opacity logit beyond ±16.6",
    quantity: "logit after the steps",
    why: "Clamped to ±12, where the slope has not vanished: gradient steps bring it back.",
};

const SCALE: Label = Label {
    case: "log scale beyond 88",
    quantity: "log scale of a sphere after the steps",
    why: "Clamped to 10 µm … 100 m, where slopes are still above rounding: gradient steps bring it \
          back.",
};

const ROTATION: Label = Label {
    case: "zero quaternion",
    quantity: "loss after the steps over the loss before",
    why: "Reset to the identity; quaternions are renormalised, so that their gradient exists.",
};

/// Adam's step (Kingma and Ba 2015), one per parameter and step.
const STEP: f32 = 0.1;
const STEPS: usize = 600;
/// Log scales among the parameters.
const SCALES: std::ops::Range<usize> = 7..10;

pub(super) fn rows(_seed: u64, _quick: bool) -> Vec<Row> {
    let mut rows: Vec<Row> = [12.0, 16.0, 20.0, 40.0].into_iter().map(slope).collect();
    for start in [20.0, 40.0, 1e6, -20.0, -40.0, -1e6] {
        rows.push(logit(start));
    }
    for start in [90.0, 1e6, -90.0, -1e6] {
        rows.push(scale(start));
    }
    for tiny in [0.0, 1e-30] {
        rows.push(rotation(tiny));
    }
    rows
}

/// The slope where the clamp puts the logit, against f64 at the same place.
fn slope(logit: f32) -> Row {
    let mut arrays = of(Parameters {
        opacity_logit: logit,
        ..plain(Vec3::X)
    });
    arrays.clamp();
    let clamped = arrays.opacity_logit[0];
    let falls = (-f64::from(clamped).abs()).exp();
    let truth = falls / (1.0 + falls).powi(2);
    let naive = f64::from(naive::logistic_and_slope(logit).1);
    let program = f64::from(opacity_slope(clamped));
    let comparison = Comparison::of(truth, program, truth).with_naive(naive, truth);
    comparison.row(SLOPE, format!("logit {logit}, clamped to {clamped}"), 1e-6)
}

fn of(gaussian: Parameters) -> GaussianArrays {
    let mut arrays = GaussianArrays::new();
    arrays.push(gaussian);
    arrays
}

/// What is to be found again: an ellipsoid seen askew.
fn goal() -> Parameters {
    Parameters {
        rotation: Quat::from_rotation_z(0.6),
        log_scale: Vec3::new(-1.5, -3.0, -3.5),
        ..plain(Vec3::new(5.0, 0.02, 0.3))
    }
}

fn logit(start: f32) -> Row {
    let truth = f64::from(goal().opacity_logit);
    let begin = Parameters {
        opacity_logit: start,
        ..goal()
    };
    let (end, _) = descend(begin, 10..11);
    let naive = f64::from(naive_logit(start));
    let program = f64::from(end.opacity_logit);
    let comparison = Comparison::of(truth, program, 1.0).with_naive(naive, 1.0);
    comparison.row(
        LOGIT,
        format!("from {}, {STEPS} steps of {STEP}", Figure(start.into())),
        0.05,
    )
}

/// Plain descent on the same loss with σ(1 − σ): from far outside every slope is 0.
fn naive_logit(start: f32) -> f32 {
    let target = naive::logistic_and_slope(goal().opacity_logit).0;
    (0..STEPS).fold(start, |logit, _| {
        let (opacity, slope) = naive::logistic_and_slope(logit);
        logit - STEP * (opacity - target) * slope
    })
}

fn scale(start: f32) -> Row {
    let goal = Parameters {
        log_scale: Vec3::splat(-3.0),
        ..goal()
    };
    let begin = Parameters {
        log_scale: Vec3::splat(start),
        ..goal
    };
    let (end, _) = descend_to(goal, begin, SCALES);
    let spread = (end.log_scale + 3.0).abs().max_element();
    let naive = f64::from(naive::descended_log_scale(start, STEP, STEPS));
    let comparison = Comparison {
        truth: -3.0,
        program: f64::from(end.log_scale.max_element()),
        error: f64::from(spread),
        naive: Some((naive, (naive + 3.0).abs())),
    };
    comparison.row(
        SCALE,
        format!("from {}, {STEPS} steps of {STEP}", Figure(start.into())),
        0.5,
    )
}

fn rotation(tiny: f32) -> Row {
    let begin = Parameters {
        rotation: Quat::from_xyzw(tiny, tiny, tiny, tiny),
        ..goal()
    };
    let (_, losses) = descend(begin, 3..7);
    let program = losses.1 / losses.0;
    let naive = f64::from(
        naive::profile(&super::scene::geometry(), &begin)
            .iter()
            .sum::<f32>(),
    );
    let comparison = Comparison::of(0.0, program, 1.0).with_naive(naive, 1.0);
    comparison.row(
        ROTATION,
        format!("each part {}, {STEPS} steps", Figure(tiny.into())),
        0.01,
    )
}

fn descend(begin: Parameters, free: std::ops::Range<usize>) -> (Parameters, (f64, f64)) {
    descend_to(goal(), begin, free)
}

/// Clamps, then descends on half the sum of squared differences of intensity, in the `free`
/// parameters; also that sum at the first and at the last step.
fn descend_to(
    goal: Parameters,
    begin: Parameters,
    free: std::ops::Range<usize>,
) -> (Parameters, (f64, f64)) {
    let measured = Scene::new(false).with(goal).program();
    let mut scene = Scene::new(false).with(begin);
    scene.gaussians.clamp();
    let mut adam = Adam::default();
    let mut losses = (f64::NAN, f64::NAN);
    for step in 0..STEPS {
        let difference = difference(&scene, &measured);
        let loss = difference
            .iter()
            .map(|d| f64::from(*d).powi(2))
            .sum::<f64>();
        losses = (if step == 0 { loss } else { losses.0 }, loss);
        let mut gradient = scene.program_gradient(&difference)[0];
        if free == SCALES {
            // A sphere stays one.
            let sum = gradient[free.clone()].iter().sum();
            gradient[free.clone()].fill(sum);
        }
        let fading = 1.0 - step as f32 / STEPS as f32;
        let parameters = adam.step(
            scene.gaussians.get(0),
            &gradient,
            free.clone(),
            STEP * fading,
        );
        scene.gaussians.set(0, parameters);
        scene.gaussians.clamp();
    }
    (scene.gaussians.get(0), losses)
}

fn difference(scene: &Scene, measured: &[f32]) -> Vec<f32> {
    let pairs = scene.program().into_iter().zip(measured);
    pairs.map(|(now, measured)| now - measured).collect()
}

#[derive(Debug, Clone, Default)]
struct Adam {
    mean: [f32; PARAMETER_COUNT],
    square: [f32; PARAMETER_COUNT],
    count: i32,
}

impl Adam {
    fn step(
        &mut self,
        parameters: Parameters,
        gradient: &[f32; PARAMETER_COUNT],
        free: std::ops::Range<usize>,
        step: f32,
    ) -> Parameters {
        let mut values = parameters.to_array();
        self.count += 1;
        for index in free {
            let slope = gradient[index];
            self.mean[index] = 0.9 * self.mean[index] + 0.1 * slope;
            self.square[index] = 0.99 * self.square[index] + 0.01 * slope * slope;
            let mean = self.mean[index] / (1.0 - 0.9_f32.powi(self.count));
            let square = self.square[index] / (1.0 - 0.99_f32.powi(self.count));
            values[index] -= step * mean / square.sqrt().max(f32::MIN_POSITIVE);
        }
        Parameters::from_array(values)
    }
}
