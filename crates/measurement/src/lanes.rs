//! Eight numbers at a time: the functions that `fearless_simd` does not have, in f32.
//!
//! All are branchless, `#[inline(always)]` and carry their token in their argument. Lanes do not
//! touch one another, so a function of a lane is the same bits in whichever lane it stands. What
//! NaN gives is not specified: callers mask such lanes out. No closures and no `array::map` around
//! lanes: their bodies are compiled without the processor's features. Errors below are against f64, measured
//! over the range given, with fused multiplication or without.

pub use fearless_simd::Level;
use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8, mask32x8};

/// AVX2 with fused multiplication, where the processor has it; it may have more.
#[must_use]
pub fn avx2() -> Option<Level> {
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    let found = Level::new().as_avx2().map(Simd::level);
    #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
    let found = None;
    found
}

/// Exponent, derived: results stay normal numbers.
/// Arguments below give e^this, 1.8·10⁻³⁵: results and their products with what is not tiny itself
/// stay normal numbers, since subnormal ones cost a hundred cycles each.
const EXP_MIN: f32 = -80.0;
/// Exponent, derived: the result fits an f32.
/// Arguments above give e^this, 1.7·10³⁸.
const EXP_MAX: f32 = 88.0;

/// Lanes; layout of f32 in AVX2.
pub const LANES: usize = 8;

/// `x · coefficients`, highest power first, by Horner's rule.
#[inline(always)]
fn polynomial<S: Simd, const N: usize>(x: f32x8<S>, coefficients: [f32; N]) -> f32x8<S> {
    let mut sum = f32x8::splat(x.simd, coefficients[0]);
    for &coefficient in &coefficients[1..] {
        sum = sum.mul_add(x, coefficient);
    }
    sum
}

/// The lanes 0 to 7 as numbers.
#[inline(always)]
#[must_use]
pub fn lane_numbers<S: Simd>(simd: S) -> f32x8<S> {
    f32x8::simd_from(simd, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
}

/// `a` where `mask`, else 0: also when `a` is not finite there.
#[inline(always)]
#[must_use]
pub fn only<S: Simd>(mask: mask32x8<S>, a: f32x8<S>) -> f32x8<S> {
    mask.select(a, f32x8::splat(a.simd, 0.0))
}

/// eˣ, the argument clamped to −80..88: relative error below 10⁻⁷ (1 ulp).
/// Cephes' polynomial on ±½ ln 2.
#[inline(always)]
#[must_use]
pub fn exp<S: Simd>(x: f32x8<S>) -> f32x8<S> {
    let x = x.max(EXP_MIN).min(EXP_MAX);
    let n = (x * std::f32::consts::LOG2_E).round_ties_even();
    // ln 2 in two parts, the first exact in few digits.
    let r = n.mul_add(-0.693_359_4, x);
    let r = n.mul_add(2.121_944_4e-4, r);
    let tail = polynomial(
        r,
        [
            1.987_569_2e-4,
            1.398_2e-3,
            8.333_452e-3,
            4.166_579_6e-2,
            1.666_666_5e-1,
            0.5,
        ],
    );
    let mantissa = tail.mul_add(r * r, r) + 1.0;
    let n: i32x8<S> = n.to_int();
    let power: f32x8<S> = ((n + 127) << 23u32).bitcast();
    mantissa * power
}

/// ln x of positive normal x: relative error below 10⁻⁷.
/// Cephes' polynomial on √½ to √2.
#[inline(always)]
#[must_use]
pub fn ln<S: Simd>(x: f32x8<S>) -> f32x8<S> {
    let bits: i32x8<S> = x.bitcast();
    // Exponent such that the mantissa lies between √½ and √2.
    let n = (bits - 0x3f35_04f3) >> 23u32;
    let mantissa: f32x8<S> = (bits - (n << 23u32)).bitcast();
    let n: f32x8<S> = n.to_float();
    let f = mantissa - 1.0;
    let tail = polynomial(
        f,
        [
            7.037_683_6e-2,
            -1.151_461e-1,
            1.167_699_9e-1,
            -1.242_014_1e-1,
            1.424_932_3e-1,
            -1.666_805_7e-1,
            2.000_071_5e-1,
            -2.499_999_4e-1,
            3.333_333e-1,
        ],
    );
    let square = f * f;
    let small = n.mul_add(-2.121_944_4e-4, tail * f * square);
    let sum = square.mul_add(-0.5, small) + f;
    n.mul_add(0.693_359_4, sum)
}

/// Arc tangent of `y/x` for x > 0, with one division: relative error below 2·10⁻⁷; ±∞ give ±π/2. Cephes' polynomial below
/// tan π/8.
#[inline(always)]
#[must_use]
pub fn ratio_atan<S: Simd>(y: f32x8<S>, x: f32x8<S>) -> f32x8<S> {
    /// tan(π/8), by definition.
    const TAN_EIGHTH: f32 = 0.414_213_57;
    /// tan(3π/8), by definition.
    const TAN_THREE_EIGHTHS: f32 = 2.414_213_7;
    let simd = x.simd;
    let size = y.abs();
    let steep = size.simd_gt(x * TAN_THREE_EIGHTHS);
    let middle = size.simd_gt(x * TAN_EIGHTH);
    // atan t = π/4 + atan((t−1)/(t+1)) = π/2 − atan(1/t)
    let above = steep.select(-x, middle.select(size - x, size));
    let below = steep.select(size, middle.select(size + x, x));
    let offset = steep.select(
        f32x8::splat(simd, std::f32::consts::FRAC_PI_2),
        middle.select(
            f32x8::splat(simd, std::f32::consts::FRAC_PI_4),
            f32x8::splat(simd, 0.0),
        ),
    );
    let t = above / below;
    let t2 = t * t;
    let tail = polynomial(
        t2,
        [
            8.053_744_5e-2,
            -1.387_768_5e-1,
            1.997_771_1e-1,
            -3.333_295e-1,
        ],
    );
    (offset + (tail * t2).mul_add(t, t)).copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::dispatch;

    /// Every kind of arithmetic that counts: without fused multiplication, and the best.
    fn levels() -> [Level; 2] {
        [Level::baseline(), Level::new()]
    }

    /// Largest of `error(argument, found, expected)` over `arguments`, at every level.
    macro_rules! worst {
        ($function:ident, $arguments:expr, $expected:expr, $error:expr) => {{
            let mut worst = 0f64;
            let arguments: Vec<f32> = $arguments.collect();
            for level in levels() {
                for chunk in arguments.chunks_exact(8) {
                    let mut arguments = [0f32; 8];
                    arguments.copy_from_slice(chunk);
                    let found: [f32; 8] = dispatch!(level, simd =>
                        $function(f32x8::simd_from(simd, arguments)).to_array());
                    for (x, y) in arguments.into_iter().zip(found) {
                        let x = f64::from(x);
                        let error: f64 = $error(x, f64::from(y), $expected(x));
                        assert!(!error.is_nan(), "at {x}: {y}");
                        worst = worst.max(error);
                    }
                }
            }
            print!("{} {worst:e};", stringify!($function));
            worst
        }};
    }

    fn grid(low: f32, high: f32) -> impl Iterator<Item = f32> {
        let steps = 80_000;
        (0..=steps).map(move |i| low + (high - low) * (i as f32 / steps as f32))
    }

    fn relative(_: f64, found: f64, expected: f64) -> f64 {
        if expected == 0.0 {
            return found.abs();
        }
        (found / expected - 1.0).abs()
    }

    #[test]
    fn exp_is_good_to_an_ulp_and_clamped() {
        assert!(worst!(exp, grid(-80.0, 88.0), f64::exp, relative) < 1e-7);
        assert!(worst!(exp, grid(-0.01, 0.01), f64::exp, relative) < 1e-7);
        let beyond = [
            f32::NEG_INFINITY,
            f32::MIN,
            -1e3,
            1e3,
            f32::MAX,
            f32::INFINITY,
            -81.0,
            89.0,
        ];
        let clamped = |x: f64| x.clamp(f64::from(EXP_MIN), f64::from(EXP_MAX)).exp();
        assert!(worst!(exp, beyond.into_iter(), clamped, relative) < 1e-7);
    }

    #[test]
    fn ln_is_good_to_a_few_ulp() {
        let wide = grid(-37.0, 38.0).map(|x| 10f32.powf(x));
        assert!(worst!(ln, wide, f64::ln, relative) < 1e-7);
        assert!(worst!(ln, grid(0.5, 2.0), f64::ln, relative) < 1e-7);
    }

    fn atan<S: Simd>(x: f32x8<S>) -> f32x8<S> {
        ratio_atan(x, f32x8::splat(x.simd, 1.0))
    }

    #[test]
    fn atan_is_good_to_a_few_ulp() {
        assert!(worst!(atan, grid(-4.0, 4.0), f64::atan, relative) < 2e-7);
        let wide = grid(-30.0, 30.0).map(|x| 10f32.powf(x));
        assert!(worst!(atan, wide, f64::atan, relative) < 2e-7);
        let ends = [
            f32::INFINITY,
            f32::NEG_INFINITY,
            0.0,
            -0.0,
            1.0,
            -1.0,
            f32::MAX,
            f32::MIN,
        ];
        assert!(worst!(atan, ends.into_iter(), f64::atan, relative) < 2e-7);
    }
}
