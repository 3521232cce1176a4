//! What the map asserts, in the project's own vocabulary.

use crate::parameters::{GaussianArrays, opacity_of};
use echosplat_model::glam::{Quat, Vec3};
use echosplat_model::{Gaussian, GaussianId, Standing};

/// The Gaussians more opaque than `least_opacity`, in order of id. Nothing is known of their sigma.
/// Opacity and reflectivity are as rendered: of the images' values, not of power.
pub(crate) fn asserted(
    arrays: &GaussianArrays,
    ids: &[GaussianId],
    least_opacity: f32,
) -> Vec<Gaussian> {
    let gaussian = |(index, id): (usize, &GaussianId)| {
        let one = arrays.get(index);
        let gaussian = Gaussian {
            id: *id,
            mean_m: one.mean_m,
            rotation: Quat::normalize(one.rotation),
            scale_m: Vec3::map(one.log_scale, f32::exp),
            opacity: one.opacity(),
            reflectivity: one.reflectivity().min(1.0),
            sigma_m: f32::INFINITY,
            position_covariance_m2: Gaussian::known_alike_m2(f32::INFINITY),
            probability: 1.0,
            standing: Standing::Confident,
            why: echosplat_model::Why::default(),
        };
        (gaussian.opacity > least_opacity && gaussian.is_sound()).then_some(gaussian)
    };
    ids.iter().enumerate().filter_map(gaussian).collect()
}

/// How many [`asserted`] gives, of finite Gaussians.
pub(crate) fn count(arrays: &GaussianArrays, least_opacity: f32) -> usize {
    let logits = arrays.opacity_logit.iter();
    logits
        .filter(|logit| opacity_of(**logit) > least_opacity)
        .count()
}
