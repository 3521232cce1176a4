//! The numbers that the plain twins calculate with: one text for f32 and f64.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// f32 or f64 with the functions of the measurement, exact to the last place or two.
///
/// ```
/// use echosplat_acoustics::Real;
/// fn gauss<R: Real>(x: R) -> R {
///     (-x * x * R::of(0.5)).exp()
/// }
/// assert!((gauss(1f32) - gauss(1f64) as f32).abs() < 1e-7);
/// ```
pub trait Real:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + SubAssign
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;

    /// The nearest number to `value`: for constants.
    fn of(value: f64) -> Self;
    /// A parameter or a measured value.
    #[must_use]
    fn of_f32(value: f32) -> Self {
        Self::of(f64::from(value))
    }
    /// As f64.
    fn to_f64(self) -> f64;
    /// eˣ.
    #[must_use]
    fn exp(self) -> Self;
    /// ln x.
    #[must_use]
    fn ln(self) -> Self;
    /// ln(1 + x), good for tiny x.
    #[must_use]
    fn ln_1p(self) -> Self;
    /// √x.
    #[must_use]
    fn sqrt(self) -> Self;
    /// Arc tangent, −π/2 to π/2.
    #[must_use]
    fn atan(self) -> Self;
    /// Angle of (`x`, `self`), −π to π.
    #[must_use]
    fn atan2(self, x: Self) -> Self;
    /// The largest integer not above.
    #[must_use]
    fn floor(self) -> Self;
    /// Complementary error function, 0 to 2.
    #[must_use]
    fn erfc(self) -> Self;
    /// Whether neither infinite nor NaN.
    fn is_finite(self) -> bool;

    /// |x|.
    #[must_use]
    fn abs(self) -> Self {
        if self < Self::ZERO { -self } else { self }
    }
    /// The smaller; `other` if `self` is NaN.
    #[must_use]
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    /// The larger; `other` if `self` is NaN.
    #[must_use]
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    /// Φ(x), the standard normal distribution function, relatively exact in the lower tail.
    #[must_use]
    fn normal_cdf(self) -> Self {
        Self::of(0.5) * (-self * Self::of(std::f64::consts::FRAC_1_SQRT_2)).erfc()
    }
    /// ϕ(x), the standard normal density.
    #[must_use]
    fn normal_density(self) -> Self {
        Self::of(INVERSE_SQRT_TAU) * (Self::of(-0.5) * self * self).exp()
    }
}

/// 1/√(2π), by definition.
const INVERSE_SQRT_TAU: f64 = 0.398_942_280_401_432_7;

macro_rules! real {
    ($float:ty, $erfc:path) => {
        impl Real for $float {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            #[inline]
            fn of(value: f64) -> Self {
                value as Self
            }
            #[inline]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline]
            fn exp(self) -> Self {
                self.exp()
            }
            #[inline]
            fn ln(self) -> Self {
                self.ln()
            }
            #[inline]
            fn ln_1p(self) -> Self {
                self.ln_1p()
            }
            #[inline]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            #[inline]
            fn atan(self) -> Self {
                self.atan()
            }
            #[inline]
            fn atan2(self, x: Self) -> Self {
                self.atan2(x)
            }
            #[inline]
            fn floor(self) -> Self {
                self.floor()
            }
            #[inline]
            fn erfc(self) -> Self {
                $erfc(self)
            }
            #[inline]
            fn is_finite(self) -> bool {
                self.is_finite()
            }
        }
    };
}

real!(f32, libm::erfcf);
real!(f64, libm::erfc);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;

    #[test]
    fn the_distribution_function_agrees_with_its_series() {
        for i in -800..=800 {
            let x = f64::from(i) * 0.01;
            let expected = reference::normal_cdf(x);
            assert!((Real::normal_cdf(x) - expected).abs() < 1e-14, "{x}");
            let single = f64::from(Real::normal_cdf(x as f32));
            assert!((single - expected).abs() < 2e-7, "{x}");
        }
    }

    #[test]
    fn the_density_is_the_slope_of_the_distribution() {
        for i in -60..=60 {
            let x = f64::from(i) * 0.1;
            let h = 1e-5;
            let slope = ((x + h).normal_cdf() - (x - h).normal_cdf()) / (2.0 * h);
            assert!((slope - x.normal_density()).abs() < 1e-10, "{x}");
        }
    }

    #[test]
    fn nan_loses_against_numbers() {
        assert!(Real::min(f64::NAN, 2.0) < 3.0);
        assert!(Real::max(f64::NAN, 2.0) > 1.0);
    }
}
