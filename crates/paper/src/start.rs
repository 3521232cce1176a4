//! (13): the first Gaussians.

use crate::parameters::{GaussianArrays, OPACITY_MAX, Parameters};
use glam::{Quat, Vec3};

use crate::Choices;
use crate::candidates::Candidates;

/// Opacities are kept above this, where the logit still moves.
const OPACITY_MIN: f32 = 1e-5;

/// One Gaussian per candidate: reflectivity as its pixels' value, `α = √ρ`, a sphere.
pub(crate) fn gaussians(
    found: &Candidates,
    beam_width_m: f32,
    choices: &Choices,
) -> GaussianArrays {
    let mut arrays = GaussianArrays::with_capacity(found.value.len());
    let log_scale = Vec3::splat((choices.scale_beams * beam_width_m).ln());
    for (position_m, value) in found.position_m.iter().zip(&found.value) {
        let reflectivity = (choices.reflectivity_share * value).clamp(1e-6, 1.0);
        arrays.push(Parameters {
            mean_m: *position_m,
            rotation: Quat::IDENTITY,
            log_scale,
            opacity_logit: logit(reflectivity.sqrt()),
            reflectivity_log: reflectivity.ln(),
        });
    }
    arrays
}

/// Of an opacity, brought into the open interval that has one.
pub(crate) fn logit(opacity: f32) -> f32 {
    let opacity = opacity.clamp(OPACITY_MIN, OPACITY_MAX);
    (opacity / (1.0 - opacity)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tags::ViewTags;

    #[test]
    fn opacity_is_the_root_of_reflectivity() {
        let found = Candidates {
            position_m: vec![Vec3::X, Vec3::Y],
            value: vec![0.5, 1.0],
            tags: ViewTags::new(1),
        };
        let arrays = gaussians(&found, 0.1, &Choices::default());
        for (index, value) in found.value.iter().enumerate() {
            let one = arrays.get(index);
            let expected = Choices::default().reflectivity_share * value;
            assert!((one.reflectivity() - expected).abs() < 1e-5);
            assert!((one.opacity().powi(2) - expected).abs() < 1e-5);
        }
    }
}
