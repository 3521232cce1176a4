//! Adam on the free coordinates of the Gaussians one view touches.

use std::sync::LazyLock;

use crate::parameters::{GaussianArrays, GradientArrays, PARAMETER_COUNT};

use crate::retain::retain;

const FIRST_DECAY: f32 = 0.9;
const SECOND_DECAY: f32 = 0.999;
const EPSILON: f32 = 1e-8;
/// Beyond this many steps both moments have no bias left in f32.
const STEPS_MAX: usize = 20_000;

/// What the moments are short of after each number of steps, `1 − βᵗ`: powers take longer than the
/// rest of a step.
static BIASES: LazyLock<Vec<[f32; 2]>> = LazyLock::new(|| {
    let after = |steps| [FIRST_DECAY, SECOND_DECAY].map(|decay| 1.0 - decay.powi(steps));
    (0..=STEPS_MAX as i32).map(after).collect()
});

/// Step per parameter, in its own unit: mean (m), rotation, log scale, opacity logit, log
/// reflectivity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rates {
    pub(crate) mean_m: f32,
    pub(crate) rotation: f32,
    pub(crate) log_scale: f32,
    pub(crate) opacity_logit: f32,
    pub(crate) reflectivity_log: f32,
}

impl Rates {
    fn per_parameter(&self) -> [f32; PARAMETER_COUNT] {
        let (m, q, s) = (self.mean_m, self.rotation, self.log_scale);
        [
            m,
            m,
            m,
            q,
            q,
            q,
            q,
            s,
            s,
            s,
            self.opacity_logit,
            self.reflectivity_log,
        ]
    }
}

/// Moments of every parameter of every Gaussian, row by row, and how often each was stepped: a
/// Gaussian that no view touches keeps what it has.
#[derive(Debug, Clone, Default)]
pub(crate) struct Adam {
    moments: Vec<[[f32; PARAMETER_COUNT]; 2]>,
    steps: Vec<u32>,
}

impl Adam {
    pub(crate) fn new(count: usize) -> Self {
        Self {
            moments: vec![[[0.0; PARAMETER_COUNT]; 2]; count],
            steps: vec![0; count],
        }
    }

    /// One step of the Gaussians in `subset` along `gradients`, which are cleared there. A gradient
    /// that is not finite is taken as 0; their number is returned.
    pub(crate) fn step(
        &mut self,
        subset: &[u32],
        rates: &Rates,
        gaussians: &mut GaussianArrays,
        gradients: &mut GradientArrays,
    ) -> usize {
        let rates = rates.per_parameter();
        let mut non_finite = 0;
        for &index in subset {
            let index = index as usize;
            let gradient = take(gradients, index);
            let finite = gradient.map(|g| if g.is_finite() { g } else { 0.0 });
            non_finite += usize::from(gradient.iter().any(|g| !g.is_finite()));
            let change = self.change(index, &finite, &rates);
            add(gaussians, index, &change);
        }
        non_finite
    }

    fn change(
        &mut self,
        index: usize,
        gradient: &[f32; PARAMETER_COUNT],
        rates: &[f32; PARAMETER_COUNT],
    ) -> [f32; PARAMETER_COUNT] {
        self.steps[index] += 1;
        let [first_bias, second_bias] = BIASES[(self.steps[index] as usize).min(STEPS_MAX)];
        let [first, second] = &mut self.moments[index];
        std::array::from_fn(|k| {
            first[k] += (1.0 - FIRST_DECAY) * (gradient[k] - first[k]);
            second[k] += (1.0 - SECOND_DECAY) * (gradient[k] * gradient[k] - second[k]);
            -rates[k] * (first[k] / first_bias) / ((second[k] / second_bias).sqrt() + EPSILON)
        })
    }

    pub(crate) fn retain(&mut self, keep: &[bool]) {
        retain(&mut self.moments, keep);
        retain(&mut self.steps, keep);
    }
}

/// The gradient of one Gaussian, which is cleared.
fn take(gradients: &mut GradientArrays, index: usize) -> [f32; PARAMETER_COUNT] {
    gradients
        .fields_mut()
        .map(|field| std::mem::take(&mut field[index]))
}

fn add(gaussians: &mut GaussianArrays, index: usize, change: &[f32; PARAMETER_COUNT]) {
    for (field, change) in gaussians.fields_mut().into_iter().zip(change) {
        field[index] += change;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    const RATES: Rates = Rates {
        mean_m: 0.01,
        rotation: 0.0,
        log_scale: 0.02,
        opacity_logit: 0.05,
        reflectivity_log: 0.0,
    };

    #[test]
    fn a_quadratic_is_descended_to_its_bottom_whatever_its_steepness() {
        let mut gaussians = sample::gaussians(3);
        let mut gradients = GradientArrays::zeros(3);
        let before = gaussians.clone();
        let mut adam = Adam::new(3);
        for _ in 0..2000 {
            // Bottom at mean 0.3 and logit −1; one a million times steeper than the other.
            gradients.mean_m[1][2] = 1e3 * (gaussians.mean_m[1][2] - 0.3);
            gradients.opacity_logit[2] = 1e-3 * (gaussians.opacity_logit[2] + 1.0);
            adam.step(&[2], &RATES, &mut gaussians, &mut gradients);
        }
        assert!((gaussians.mean_m[1][2] - 0.3).abs() < 0.02);
        assert!((gaussians.opacity_logit[2] + 1.0).abs() < 0.1);
        assert_eq!(gaussians.get(0), before.get(0), "untouched");
        assert_eq!(gradients, GradientArrays::zeros(3), "cleared");
    }

    #[test]
    fn the_first_step_is_the_rate_and_nan_is_no_step() {
        let mut gaussians = sample::gaussians(1);
        let mut gradients = GradientArrays::zeros(1);
        let before = gaussians.get(0).to_array();
        gradients.mean_m[0][0] = -1e-4;
        gradients.opacity_logit[0] = f32::NAN;
        let non_finite = Adam::new(1).step(&[0], &RATES, &mut gaussians, &mut gradients);
        let after = gaussians.get(0).to_array();
        assert_eq!(non_finite, 1);
        assert!((after[0] - before[0] - 0.01).abs() < 1e-5);
        assert_eq!(after[10].to_bits(), before[10].to_bits());
    }
}
