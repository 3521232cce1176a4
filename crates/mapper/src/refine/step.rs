//! One damped step of Fisher scoring for a place.

use echosplat_measurement::SymmetricMat3;
use echosplat_model::glam::{DMat3, DVec3, Vec3};

/// Fraction, derived: single precision.
/// What sums in single precision leave open of the information, over its trace.
const ROUNDING: f64 = 1.0 / (1 << 21) as f64;
/// Prior sigmas of a step, at most; found.
/// Longest step over `prior_m`.
const LONGEST: f32 = 0.5;

/// `(H + 1/prior²)⁻¹ g` of a gradient and an information matrix `H`, at most half of `prior_m` long:
/// how far a step is believed. `None` if anything is not finite. Factored, never inverted by its
/// determinant; what rounding may have left of `H` counts as nothing known.
#[must_use]
pub fn damped_step(gradient: Vec3, information: &SymmetricMat3, prior_m: f32) -> Option<Vec3> {
    let information = information.to_mat3().as_dmat3();
    let trace = information.x_axis.x + information.y_axis.y + information.z_axis.z;
    let damping = 1.0 / f64::from(prior_m).powi(2) + ROUNDING * trace;
    let hessian = information + DMat3::from_diagonal(DVec3::splat(damping));
    let step = solve(&hessian, gradient.as_dvec3())?.as_vec3();
    step.is_finite()
        .then(|| step.clamp_length_max(LONGEST * prior_m))
}

/// `M⁻¹ v` by Cholesky's factors; `None` unless `M` is positive definite.
fn solve(m: &DMat3, v: DVec3) -> Option<DVec3> {
    let root = |pivot: f64| (pivot > 0.0 && pivot.is_finite()).then(|| pivot.sqrt());
    let l00 = root(m.x_axis.x)?;
    let (l10, l20) = (m.x_axis.y / l00, m.x_axis.z / l00);
    let l11 = root(m.y_axis.y - l10 * l10)?;
    let l21 = (m.y_axis.z - l20 * l10) / l11;
    let l22 = root(m.z_axis.z - l20 * l20 - l21 * l21)?;
    let x = v.x / l00;
    let y = (v.y - l10 * x) / l11;
    let z = (v.z - l20 * x - l21 * y) / l22 / l22;
    let y = (y - l21 * z) / l11;
    Some(DVec3::new((x - l10 * y - l20 * z) / l00, y, z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::{Mat3, Quat};

    /// Information of this size along three askew axes.
    fn askew(sizes: Vec3) -> (Mat3, SymmetricMat3) {
        let axes = Mat3::from_quat(Quat::from_xyzw(0.1, 0.5, -0.3, 0.8).normalize());
        let information = axes * Mat3::from_diagonal(sizes) * axes.transpose();
        (axes, SymmetricMat3::of(information))
    }

    #[test]
    fn a_step_is_what_information_and_prior_make_of_the_gradient() {
        let (axes, information) = askew(Vec3::new(3e4, 1e3, 10.0));
        let gradient = axes * Vec3::new(30.0, 2.0, 1.0);
        let step = damped_step(gradient, &information, 0.1).unwrap();
        let expected = Vec3::new(30.0 / 30_100.0, 2.0 / 1100.0, 1.0 / 110.0);
        assert!((axes.transpose() * step - expected).length() < 1e-4);
    }

    #[test]
    fn no_information_is_too_stiff_and_none_is_no_step() {
        let (axes, information) = askew(Vec3::new(1e17, 1e5, 1e5));
        let gradient = axes * Vec3::new(1e15, 1e3, 1e3);
        let step = damped_step(gradient, &information, 0.03).unwrap();
        assert!((axes.x_axis.dot(step) - 0.01).abs() < 1e-4, "{step}");
        assert!(damped_step(Vec3::NAN, &information, 0.03).is_none());
        let unknown = SymmetricMat3::of(Mat3::from_diagonal(Vec3::splat(f32::NAN)));
        assert!(damped_step(Vec3::X, &unknown, 0.03).is_none());
    }
}
