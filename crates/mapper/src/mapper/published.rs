//! The map as others see it.

use echosplat_measurement::SymmetricMat3;
use echosplat_model::{Gaussian, Standing};
use rayon::prelude::*;

use crate::spawn::gaussians::{Gaussians, Verdict};

/// Intensity per steradian that αρ = 1 stands for: above what a typical strongest echo needs, and a
/// power of two, so that the unit does not creep and every Gaussian with it. 1 before any echo.
pub(super) fn intensity_unit(unit_strength: f32) -> f32 {
    if !(unit_strength > 0.0) {
        return 1.0;
    }
    // Between the powers of two that are normal numbers.
    (4.0 * unit_strength)
        .log2()
        .ceil()
        .clamp(-126.0, 127.0)
        .exp2()
}

/// In the order of [`Gaussian::position_covariance_m2`].
fn upper_triangle(matrix: &SymmetricMat3) -> [f32; 6] {
    let (d, m) = (matrix.diagonal, matrix.mixed);
    [d.x, m.z, m.y, d.y, m.x, d.z]
}

/// Published Gaussians in order of id, each as `placed` makes it; what is not likely is ambiguous. The gauge is that of (13):
/// `α = √ρ`, so `αρ = ρ^{3/2}`.
pub(super) fn published(
    gaussians: &Gaussians,
    unit: f32,
    placed: impl Fn(Gaussian) -> Gaussian + Sync,
) -> Vec<Gaussian> {
    let numbered = |slot: usize| match gaussians.verdict[slot] {
        Verdict::Published(standing) => Some((gaussians.id[slot], slot as u32, standing)),
        Verdict::ExplainedAway => None,
    };
    let mut order: Vec<_> = gaussians.slots().filter_map(numbered).collect();
    order.par_sort_unstable_by_key(|&(id, ..)| id);
    let gaussian = |&(id, slot, standing): &(_, u32, _)| {
        let slot = slot as usize;
        let product = (gaussians.strongest(slot) / unit).clamp(1e-12, 1.0);
        let gaussian = Gaussian {
            id,
            mean_m: gaussians.mean_m[slot],
            rotation: gaussians.rotation[slot],
            scale_m: gaussians.scale_m[slot],
            opacity: product.cbrt(),
            reflectivity: product.cbrt() * product.cbrt(),
            sigma_m: gaussians.sigma_m[slot],
            position_covariance_m2: upper_triangle(&gaussians.position_covariance_m2[slot]),
            probability: gaussians.probability[slot],
            standing: match gaussians.is_likely[slot] {
                true => standing,
                false => Standing::Ambiguous,
            },
            why: gaussians.why[slot],
        };
        match gaussian.is_sound() {
            true => placed(gaussian),
            false => gaussian,
        }
    };
    // As many as there are in order, so that each thread writes its share in place.
    let mut published: Vec<Gaussian> = order.par_iter().map(gaussian).collect();
    if !published.par_iter().all(Gaussian::is_sound) {
        published.retain(Gaussian::is_sound);
    }
    published
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::Vec3;

    #[test]
    fn what_is_not_likely_enough_is_shown_and_not_asserted_and_what_is_unsound_is_neither() {
        let mut gaussians = Gaussians::default();
        let unsound = gaussians.spawn(Vec3::NAN, (0, 0), 0.1, 1.0) as usize;
        gaussians.verdict[unsound] = Verdict::Published(Standing::Confident);
        for (verdict, is_likely) in [
            (Verdict::Published(Standing::Confident), true),
            (Verdict::Published(Standing::Confident), false),
            (Verdict::Published(Standing::Ambiguous), true),
            (Verdict::ExplainedAway, true),
        ] {
            let slot = gaussians.spawn(Vec3::ZERO, (0, 0), 0.1, 1.0) as usize;
            gaussians.sigma_m[slot] = 0.1;
            gaussians.position_covariance_m2[slot] = SymmetricMat3::isotropic(0.1);
            gaussians.verdict[slot] = verdict;
            gaussians.is_likely[slot] = is_likely;
        }
        let published = published(&gaussians, 1.0, |gaussian| gaussian);
        let standings: Vec<Standing> = published.iter().map(|g| g.standing).collect();
        let (confident, ambiguous) = (Standing::Confident, Standing::Ambiguous);
        assert_eq!(standings, [confident, ambiguous, ambiguous]);
    }
}
