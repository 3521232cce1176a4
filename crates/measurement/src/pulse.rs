//! What an echo of one width in range puts into the bins around it: the pulse, integrated over bins.
//!
//! Gaussians of one width share one pulse. Their energies are first added up at steps of a fraction of a bin, each shared by the
//! two steps beside it, and one convolution spreads them all; what bins say comes back to them by another. So a Gaussian costs two
//! sums and two look-ups, whatever number of bins it reaches.
//!
//! ```text
//! Î_b = Σ_f Σ_t K_f(t) E_f(b − t)          K_f(t) = Φ((t + 1 − f)/s) − Φ((t − f)/s)
//! ```
//!
//! `E_f(b)` is the energy at the fraction `f` of bin `b`, `s` the width in bins.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8, mask32x8};

use crate::constants::RANGE_REACH_SIGMAS;
use crate::lanes::{self, LANES};

/// Steps a sigma, derived: 2 % off three sigmas away.
/// Between two steps a pulse is off by 2 % three sigmas from its middle, and by a quarter per cent there.
const STEPS_PER_SIGMA: f32 = 7.0;
/// Bits of the steps in a bin, at most; bounds work.
/// A bin is divided into at most 2⁵ steps.
const MOST_PHASE_BITS: u32 = 5;
/// Steps at a time; layout.
/// Kernels go through so many steps at a time, and so through so many bins at most.
pub const GROUP: usize = 4 * LANES;

/// Numbers per step of a bin that a pulse is summed up with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Weighted {
    /// `K`.
    Energy,
    /// `K z`, `z` the middle of the bin in sigmas from the echo.
    Slope,
    /// `K²`.
    Square,
    /// `K² z`.
    SquareTilt,
    /// `K² z²`.
    SquareBend,
}

/// A pulse of one width over bins.
#[derive(Debug, Clone)]
pub struct Pulse {
    sigma_bins: f32,
    phase_bits: u32,
    reach: usize,
    /// Shape `[Weighted][2 reach + 1][phases]`; fewer than [`LANES`] phases are repeated.
    taps: Vec<f32>,
    /// The shares alone, shape `[phases][2 reach + 1]`.
    shares: Vec<f32>,
}

impl Pulse {
    /// Of one sigma in bins, in a ping of so many bins: no echo reaches further than that.
    #[must_use]
    pub fn of(sigma_bins: f32, bin_count: usize) -> Self {
        let wanted = (STEPS_PER_SIGMA / sigma_bins).log2().ceil();
        let phase_bits = (wanted.max(0.0) as u32).min(MOST_PHASE_BITS);
        let reach = ((RANGE_REACH_SIGMAS * sigma_bins).ceil() as usize).clamp(1, bin_count.max(1));
        let mut pulse = Self {
            sigma_bins,
            phase_bits,
            reach,
            taps: Vec::new(),
            shares: Vec::new(),
        };
        let (phases, period) = (pulse.phases(), pulse.period());
        let taps = (0..pulse.width()).flat_map(|t| (0..period).map(move |lane| (lane % phases, t)));
        let taps: Vec<(f64, f64)> = taps.map(|(phase, t)| pulse.tap(phase, t)).collect();
        let weighted: [fn(f64, f64) -> f64; 5] = [
            |share, _| share,
            |share, z| share * z,
            |share, _| share * share,
            |share, z| share * share * z,
            |share, z| share * share * z * z,
        ];
        let all = weighted
            .iter()
            .flat_map(|of| taps.iter().map(|&(share, z)| of(share, z) as f32));
        pulse.taps = all.collect();
        let shares = (0..phases).flat_map(|phase| taps.iter().skip(phase).step_by(period));
        pulse.shares = shares.map(|&(share, _)| share as f32).collect();
        pulse
    }

    /// Share of an echo that falls into a bin, and the bin's middle in sigmas from the echo.
    fn tap(&self, phase: usize, t: usize) -> (f64, f64) {
        let fraction = (phase as f64 + 0.5) / self.phases() as f64;
        let edge = t as f64 - self.reach as f64 - fraction;
        let by_sigma = f64::from(self.sigma_bins).recip();
        let cdf = |x: f64| 0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2);
        let (from, to) = (edge * by_sigma, (edge + 1.0) * by_sigma);
        // From the tail that is small, so that none of it is lost.
        let share = match from > 0.0 {
            true => cdf(-from) - cdf(-to),
            false => cdf(to) - cdf(from),
        };
        (share, (edge + 0.5) * by_sigma)
    }

    /// One sigma, bins.
    #[must_use]
    pub fn sigma_bins(&self) -> f32 {
        self.sigma_bins
    }

    /// Bins on either side of its own that it reaches.
    #[must_use]
    pub fn reach(&self) -> usize {
        self.reach
    }

    /// Bins that it reaches.
    #[must_use]
    pub fn width(&self) -> usize {
        2 * self.reach + 1
    }

    fn phases(&self) -> usize {
        1 << self.phase_bits
    }

    /// Numbers after which taps are those of the next bin.
    fn period(&self) -> usize {
        self.phases().max(LANES)
    }

    /// Shape `[2 reach + 1][period]`.
    fn taps(&self, weighted: Weighted) -> &[f32] {
        let count = self.width() * self.period();
        &self.taps[weighted as usize * count..][..count]
    }
}

/// Energies of one pulse's width over steps of bins, in a row of many such.
#[derive(Debug, Clone, Copy)]
pub struct Steps {
    /// Which pulse.
    pub pulse: u32,
    /// Where they begin.
    from: u32,
    /// Steps of the ping's bins and of those on either side that the pulse reaches, and room for one more.
    count: u32,
    phase_bits: u32,
    reach: u32,
    bin_count: u32,
    /// Bins of a group in which echoes are looked for, as a power of two: there are 64 at most.
    group_bits: u32,
}

/// Where eight echoes are among the steps.
#[derive(Clone, Copy)]
pub struct Placed<S: Simd> {
    /// The step before each; the first of all where it does not reach into the ping.
    pub at: [u32; LANES],
    /// How far on it is towards the next, 0 to 1.
    pub fraction: f32x8<S>,
    /// Which reach into the ping at all.
    pub inside: mask32x8<S>,
    /// Groups of bins that they lie in, a bit each.
    pub touched: u64,
}

impl Steps {
    /// Of `pulse`, which has this number, in a ping of so many bins, from `from` on.
    #[must_use]
    pub fn of(pulse: &Pulse, number: usize, bin_count: usize, from: usize) -> Self {
        let bins = bin_count + 2 * pulse.reach + 1;
        let group_bits = bins.div_ceil(64).next_power_of_two().ilog2();
        Self {
            pulse: number as u32,
            from: from as u32,
            count: (bins << pulse.phase_bits).next_multiple_of(GROUP) as u32,
            phase_bits: pulse.phase_bits,
            reach: pulse.reach as u32,
            bin_count: bin_count as u32,
            group_bits,
        }
    }

    /// Where they end: room for so many numbers is needed.
    #[must_use]
    pub fn end(&self) -> usize {
        (self.from + self.count) as usize
    }

    /// Places echoes that are so many bins from the ping's start.
    #[inline(always)]
    pub fn place<S: Simd>(&self, bins: f32x8<S>, bin_count: f32) -> Placed<S> {
        let reach = self.reach as f32;
        let inside = bins.simd_ge(-reach) & bins.simd_lt(bin_count + reach);
        // From the middle of the first step: what lies before it is nearer to it than to any other.
        let position = (bins + reach) * (1 << self.phase_bits) as f32 - 0.5;
        let position = lanes::only(inside, position.max(0.0));
        let before = position.floor();
        let step: i32x8<S> = before.to_int();
        let (mut at, mut touched) = ([0; LANES], 0);
        for (at, step) in at.iter_mut().zip((step + self.from as i32).to_array()) {
            *at = step as u32;
        }
        // The next step may lie in the next group.
        for steps in [step, step + 1] {
            for group in (steps >> (self.phase_bits + self.group_bits)).to_array() {
                touched |= 1 << (group as u32 & (u64::BITS - 1));
            }
        }
        Placed {
            at,
            fraction: position - before,
            inside,
            touched,
        }
    }

    /// Whether any of `count` bins from `from` on has an echo, counted from the pulse's reach before the ping.
    #[inline(always)]
    fn is_touched(&self, touched: u64, from: usize, count: usize) -> bool {
        let (first, last) = (
            from >> self.group_bits,
            (from + count - 1) >> self.group_bits,
        );
        let (first, last) = (first.min(63), last.min(63));
        touched >> first & (u64::MAX >> (63 - (last - first))) != 0
    }

    /// First bin that an echo at this step reaches, and its shares of the bins from there on.
    #[must_use]
    pub fn echo<'a>(&self, pulse: &'a Pulse, at: u32) -> (isize, &'a [f32]) {
        let step = at - self.from;
        let first = (step >> self.phase_bits) as isize - 2 * self.reach as isize;
        let phase = step as usize & (pulse.phases() - 1);
        (
            first,
            &pulse.shares[phase * pulse.width()..][..pulse.width()],
        )
    }

    /// Adds what the energies send into the bins of `sums`, which has room for whole groups of [`GROUP`].
    #[inline(always)]
    pub fn spread<S: Simd>(
        &self,
        simd: S,
        pulse: &Pulse,
        touched: u64,
        energies: &[f32],
        sums: &mut [f32],
    ) {
        let (phases, taps) = (pulse.phases(), pulse.taps(Weighted::Energy));
        let bins = GROUP >> self.phase_bits;
        let sums = &mut sums[..(self.bin_count as usize).next_multiple_of(bins)];
        for (group, sums) in sums.chunks_exact_mut(bins).enumerate() {
            if !self.is_touched(touched, group * bins, bins + pulse.width() - 1) {
                continue;
            }
            let energies = &energies[self.from as usize + group * GROUP..];
            // Of an echo that many bins further on, what falls that many bins nearer.
            let spread = correlate::<_, true>(simd, pulse, taps, energies);
            for (sum, of_bin) in sums.iter_mut().zip(spread.chunks_exact(phases)) {
                let mut all = 0.0;
                for of_step in of_bin {
                    all += of_step;
                }
                *sum += all;
            }
        }
    }

    /// For every step `Σ_t K(t) x(b + t)`, written where the energies stand. `x` has every bin once for each step of it, and
    /// begins twice the reach before the ping.
    #[inline(always)]
    pub fn gather<S: Simd>(
        &self,
        simd: S,
        pulse: &Pulse,
        (weighted, touched): (Weighted, u64),
        x: &[f32],
        gathered: &mut [f32],
    ) {
        let (taps, bins) = (pulse.taps(weighted), GROUP >> self.phase_bits);
        let gathered = &mut gathered[self.from as usize..self.end()];
        for (group, gathered) in gathered.chunks_exact_mut(GROUP).enumerate() {
            if self.is_touched(touched, group * bins, bins) {
                let found = correlate::<_, false>(simd, pulse, taps, &x[group * GROUP..]);
                gathered.copy_from_slice(&found);
            }
        }
    }

    /// Steps of a bin.
    #[must_use]
    pub fn phases(&self) -> usize {
        1 << self.phase_bits
    }
}

/// `Σ_t taps(t) x(b + t)` for a group of steps, each with the taps of its phase, from the last or from the first on.
#[inline(always)]
fn correlate<S: Simd, const IS_BACKWARDS: bool>(
    simd: S,
    pulse: &Pulse,
    taps: &[f32],
    x: &[f32],
) -> [f32; GROUP] {
    let (phases, period, width) = (pulse.phases(), pulse.period(), pulse.width());
    let zero = f32x8::splat(simd, 0.0);
    let (mut a, mut b, mut c, mut d) = (zero, zero, zero, zero);
    let x = &x[..GROUP + (width - 1) * phases];
    if period == LANES {
        // All eights have the same taps.
        for j in 0..width {
            let t = if IS_BACKWARDS { width - 1 - j } else { j };
            let tap = f32x8::from_slice(simd, &taps[t * LANES..(t + 1) * LANES]);
            let x = &x[j * phases..j * phases + GROUP];
            a = f32x8::from_slice(simd, &x[..LANES]).mul_add(tap, a);
            b = f32x8::from_slice(simd, &x[LANES..2 * LANES]).mul_add(tap, b);
            c = f32x8::from_slice(simd, &x[2 * LANES..3 * LANES]).mul_add(tap, c);
            d = f32x8::from_slice(simd, &x[3 * LANES..]).mul_add(tap, d);
        }
    } else {
        let [second, third, fourth] = [1, 2, 3].map(|eight| (eight * LANES) & (period - 1));
        for j in 0..width {
            let t = if IS_BACKWARDS { width - 1 - j } else { j };
            let taps = &taps[t * period..(t + 1) * period];
            let x = &x[j * phases..j * phases + GROUP];
            let tap = f32x8::from_slice(simd, &taps[..LANES]);
            a = f32x8::from_slice(simd, &x[..LANES]).mul_add(tap, a);
            let tap = f32x8::from_slice(simd, &taps[second..second + LANES]);
            b = f32x8::from_slice(simd, &x[LANES..2 * LANES]).mul_add(tap, b);
            let tap = f32x8::from_slice(simd, &taps[third..third + LANES]);
            c = f32x8::from_slice(simd, &x[2 * LANES..3 * LANES]).mul_add(tap, c);
            let tap = f32x8::from_slice(simd, &taps[fourth..fourth + LANES]);
            d = f32x8::from_slice(simd, &x[3 * LANES..]).mul_add(tap, d);
        }
    }
    let mut sums = [0.0; GROUP];
    a.store_slice(&mut sums[..LANES]);
    b.store_slice(&mut sums[LANES..2 * LANES]);
    c.store_slice(&mut sums[2 * LANES..3 * LANES]);
    d.store_slice(&mut sums[3 * LANES..]);
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_of_any_width_holds_its_energy() {
        for sigma_bins in [1e-4, 0.03, 0.2, 0.7, 1.8, 5.0, 40.0] {
            let pulse = Pulse::of(sigma_bins, 600);
            for phase in 0..pulse.phases() {
                let of = |weighted| {
                    pulse
                        .taps(weighted)
                        .iter()
                        .skip(phase)
                        .step_by(pulse.period())
                };
                let sum: f32 = of(Weighted::Energy).sum();
                assert!((0.997..=1.000_001).contains(&sum), "{sigma_bins}: {sum}");
                assert!(of(Weighted::Energy).all(|tap| *tap >= 0.0));
                let square: f32 = of(Weighted::Energy).map(|tap| tap * tap).sum();
                assert!((of(Weighted::Square).sum::<f32>() - square).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn no_pulse_is_wider_than_the_ping() {
        for (sigma_bins, bin_count) in [(1e9, 600), (1e9, 1), (1e-9, 1), (3.0, 1)] {
            let pulse = Pulse::of(sigma_bins, bin_count);
            assert!(pulse.reach() <= bin_count.max(1) && pulse.phases() <= 32);
            let steps = Steps::of(&pulse, 0, bin_count, 0);
            assert!(steps.end() <= 32 * (3 * bin_count + 1) + GROUP);
        }
    }

    #[test]
    fn groups_without_echoes_are_passed_over_and_no_other() {
        let (pulse, bins) = (Pulse::of(2.0, 5000), 5000);
        let steps = Steps::of(&pulse, 0, bins, 0);
        for bin in [0_u32, 31, 32, 777, 4999] {
            let touched = 1_u64 << (bin >> steps.group_bits);
            assert!(steps.is_touched(touched, bin as usize, 1));
            assert!(steps.is_touched(touched, bin as usize & !31, GROUP));
            let others = (0..bins).filter(|&other| steps.is_touched(touched, other, 1));
            assert!(others.count() <= 1 << steps.group_bits);
        }
    }
}
