//! Rows into bins, eight bins at a time, and the moments of a gradient over a row.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::rows::{OnlineRow, Pull};
use crate::Look;
use crate::lanes::{self, LANES};

/// Numbers beyond the last bin that eight at a time may touch.
pub(super) const PADDING: usize = LANES + 1;

/// Edges of a row's bins in sigmas from the mean; edges beyond the row's last stand on it, so that
/// nothing lies between them.
#[derive(Clone, Copy)]
struct Edges<S: Simd> {
    first: f32x8<S>,
    step: f32,
    last: f32,
}

impl<S: Simd> Edges<S> {
    #[inline(always)]
    fn new(simd: S, look: &Look, row: &OnlineRow) -> Self {
        let edge_m = look
            .bin_length_m
            .mul_add(row.first_bin as f32, look.range_start_m);
        let first = (edge_m - row.range_on_axis_m) * row.inverse_sigma;
        Self {
            first: f32x8::splat(simd, first),
            step: look.bin_length_m * row.inverse_sigma,
            last: row.bin_count as f32,
        }
    }

    /// Edges `from` to `from + 7`.
    #[inline(always)]
    fn at(&self, numbers: f32x8<S>, from: usize) -> f32x8<S> {
        (numbers + from as f32)
            .min(self.last)
            .mul_add(self.step, self.first)
    }
}

/// Calls `put(bin, shares)` for every eight bins of a row: `Φ((r_{b+1}−r′)/s) − Φ((r_b−r′)/s)`,
/// 0 beyond the row.
#[inline(always)]
pub(super) fn shares<S: Simd>(
    simd: S,
    look: &Look,
    row: &OnlineRow,
    mut put: impl FnMut(usize, f32x8<S>),
) {
    let numbers = lanes::lane_numbers(simd);
    let edges = Edges::new(simd, look, row);
    let count = row.bin_count as usize;
    let mut below = lanes::normal_cdf(edges.at(numbers, 0));
    let mut from = 0;
    while from < count {
        let above = lanes::normal_cdf(edges.at(numbers, from + LANES));
        put(
            row.first_bin as usize + from,
            below.slide::<1>(above) - below,
        );
        below = above;
        from += LANES;
    }
}

/// Adds every row's intensity, in their order; `intensity` is padded.
#[inline(always)]
pub(super) fn spread<S: Simd>(simd: S, look: &Look, rows: &[OnlineRow], intensity: &mut [f32]) {
    for row in rows {
        let strength = row.transmittance * row.energy * row.opacity * row.reflectivity;
        shares(simd, look, row, |bin, share| {
            let Some(bins) = intensity.get_mut(bin..bin + LANES) else {
                return;
            };
            let sum = share.mul_add(strength, f32x8::from_slice(simd, bins));
            sum.store_slice(bins);
        });
    }
}

/// dL/dI of a ping, as the backward kernel reads it.
#[derive(Debug, Clone, Default)]
pub(super) struct Loss {
    /// `g_{b−1}` at place b, 0 outside the ping: shape `[bins + padding]`.
    before: Vec<f32>,
    /// `h_e = g_{e−1} − g_e` at edge e.
    steps: Vec<f32>,
}

impl Loss {
    /// Takes `d_intensity`, missing ones as 0, and what is not finite too; returns how many those
    /// were.
    pub(super) fn set(&mut self, d_intensity: &[f32], bin_count: usize) -> u64 {
        let mut not_finite = 0;
        self.before.clear();
        self.before.push(0.0);
        self.before
            .extend(d_intensity.iter().take(bin_count).map(|&g| {
                not_finite += u64::from(!g.is_finite());
                if g.is_finite() { g } else { 0.0 }
            }));
        self.before.resize(bin_count + 1 + PADDING, 0.0);
        self.steps.clear();
        let pairs = self.before.windows(2);
        self.steps.extend(pairs.map(|pair| pair[0] - pair[1]));
        not_finite
    }
}

/// What the loss pulls at in every row, by the moments `Σ h Φ`, `Σ h ϕ`, `Σ h z ϕ` over its edges.
#[inline(always)]
pub(super) fn spread_back<S: Simd>(
    simd: S,
    look: &Look,
    rows: &[OnlineRow],
    loss: &Loss,
    pulls: &mut Vec<Pull>,
) {
    for row in rows {
        let [share, shift, width] = moments(simd, look, row, loss);
        let strength = row.transmittance * row.energy * row.opacity * row.reflectivity;
        pulls.push(Pull {
            log_energy: strength * share,
            range: -strength * row.inverse_sigma * shift,
            variance: -0.5 * strength * row.inverse_sigma * row.inverse_sigma * width,
            ..Pull::default()
        });
    }
}

#[inline(always)]
fn moments<S: Simd>(simd: S, look: &Look, row: &OnlineRow, loss: &Loss) -> [f32; 3] {
    let numbers = lanes::lane_numbers(simd);
    let edges = Edges::new(simd, look, row);
    let zero = f32x8::splat(simd, 0.0);
    let mut sums = [zero; 3];
    let mut last = [zero; 3];
    let first_bin = row.first_bin as usize;
    let (mut from, count) = (0, row.bin_count as usize);
    // `steps` holds the whole ping's gradient: at the row's ends, where its bins end, what belongs
    // to the bins outside is taken back.
    let outside = loss.before[first_bin];
    let mut first = [0.0; 3];
    while from <= count {
        let z = edges.at(numbers, from);
        let density = lanes::normal_density(z);
        last = [lanes::normal_cdf(z), density, z * density];
        if from == 0 {
            first = last.map(|moment| moment[0]);
        }
        let Some(steps) = loss.steps.get(first_bin + from..first_bin + from + LANES) else {
            break;
        };
        let h = f32x8::from_slice(simd, steps);
        for (sum, moment) in sums.iter_mut().zip(last) {
            *sum = moment.mul_add(h, *sum);
        }
        from += LANES;
    }
    let beyond = loss.before.get(first_bin + from).copied().unwrap_or(0.0);
    std::array::from_fn(|k| sums[k].reduce_sum() - outside * first[k] + beyond * last[k][LANES - 1])
}
