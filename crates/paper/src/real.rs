//! The numbers that the plain twins calculate with: one text for f32 and f64.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// f32 or f64 with the functions of the measurement, exact to the last place or two.
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
    /// Angle of (`x`, `self`), −π to π.
    #[must_use]
    fn atan2(self, x: Self) -> Self;
    /// The largest integer not above.
    #[must_use]
    fn floor(self) -> Self;
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
}

macro_rules! real {
    ($float:ty) => {
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
            fn atan2(self, x: Self) -> Self {
                self.atan2(x)
            }
            #[inline]
            fn floor(self) -> Self {
                self.floor()
            }
            #[inline]
            fn is_finite(self) -> bool {
                self.is_finite()
            }
        }
    };
}

real!(f32);
real!(f64);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_loses_against_numbers() {
        assert!(Real::min(f64::NAN, 2.0) < 3.0);
        assert!(Real::max(f64::NAN, 2.0) > 1.0);
    }
}
