//! The normal distribution function, for integrating a Gaussian over range bins exactly.

/// Φ(x), the standard normal distribution function. Absolute error below 1.2·10⁻⁷ in exact
/// arithmetic, from the rational fit 7.1.26 of Abramowitz and Stegun with |error| ≤ 1.5·10⁻⁷
/// on erf; rounding in f32 adds about as much.
#[must_use]
pub fn normal_cdf(x: f32) -> f32 {
    const A: [f32; 5] = [
        0.254_829_6,
        -0.284_496_72,
        1.421_413_8,
        -1.453_152_1,
        1.061_405_4,
    ];
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let poly = t * (A[0] + t * (A[1] + t * (A[2] + t * (A[3] + t * A[4]))));
    let tail = 0.5 * poly * (-z * z).exp();
    if x >= 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;

    #[test]
    fn it_agrees_with_the_f64_twin() {
        for i in -800..=800 {
            let x = f64::from(i) * 0.01;
            let error = f64::from(normal_cdf(x as f32)) - reference::normal_cdf(x);
            assert!(error.abs() < 3e-7, "at {x}: {error:e}");
        }
    }
}
