//! The two plain terms of (42): `λ_α ‖α‖²` and `λ_s ‖S‖²`.

use crate::parameters::{GaussianArrays, GradientArrays, opacity_of, opacity_slope};

use crate::Choices;

/// Both terms over the Gaussians of `subset`, with scales in beam widths; adds their gradients.
pub(crate) fn add(
    gaussians: &GaussianArrays,
    subset: &[u32],
    beam_width_m: f32,
    choices: &Choices,
    gradients: &mut GradientArrays,
) -> f64 {
    let mut loss = 0.0;
    for &index in subset {
        let index = index as usize;
        let logit = gaussians.opacity_logit[index];
        let opacity = opacity_of(logit);
        loss += f64::from(choices.opacity_weight * opacity * opacity);
        gradients.opacity_logit[index] +=
            choices.opacity_weight * 2.0 * opacity * opacity_slope(logit);
        for axis in 0..3 {
            let scale = gaussians.log_scale[axis][index].exp() / beam_width_m;
            loss += f64::from(choices.scale_weight * scale * scale);
            gradients.log_scale[axis][index] += choices.scale_weight * 2.0 * scale * scale;
        }
    }
    loss
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    #[test]
    fn gradients_agree_with_central_differences() {
        let gaussians = sample::gaussians(6);
        let choices = Choices {
            opacity_weight: 0.3,
            scale_weight: 0.7,
            ..Choices::default()
        };
        let loss = |gaussians: &GaussianArrays| {
            let mut unused = GradientArrays::zeros(6);
            add(gaussians, &[0, 2, 5], 0.1, &choices, &mut unused)
        };
        let mut gradients = GradientArrays::zeros(6);
        add(&gaussians, &[0, 2, 5], 0.1, &choices, &mut gradients);
        for index in 0..6 {
            for field in 7..11 {
                let at = |step: f32| {
                    let mut moved = gaussians.clone();
                    moved.fields_mut()[field][index] += step;
                    loss(&moved)
                };
                let expected = (at(1e-2) - at(-1e-2)) / 2e-2;
                let found = f64::from(gradients.get(index)[field]);
                assert!(
                    (found - expected).abs() < 1e-3 * (1e-2 + expected.abs()),
                    "{index} {field}: {found} {expected}"
                );
            }
        }
    }
}
