//! Rows into bins, eight bins at a time, and the moments of a gradient over a row.

use std::ops::Range;

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::rows::{OnlineRow, RowGradient};
use crate::lanes::{self, LANES};
use crate::{PingGeometry, Splat};

/// Numbers beyond the last bin; layout.
/// Eight at a time may touch them.
pub(super) const PADDING: usize = LANES + 1;

/// Sigmas, derived from f32's digits.
/// Bins narrower than this many sigmas take Φ's difference from its series at their middle: that is
/// good to 10⁻⁶ there, while the difference of two f32 is good to 2·10⁻⁷ of 1, which would be 10⁻³
/// of a share as small as 2·10⁻⁴.
const CLOSE_STEP: f32 = 0.125;

/// Edges of a row's bins in sigmas from the mean; edges beyond the row's last stand on it, so that
/// nothing lies between them.
#[derive(Clone, Copy)]
struct Edges<S: Simd> {
    first: f32x8<S>,
    step: f32,
    last: f32,
}

impl<S: Simd> Edges<S> {
    /// Of `bins` about the mean `range_m + offset_m`: apart, so that few digits are lost.
    #[inline(always)]
    fn new(
        simd: S,
        geometry: &PingGeometry,
        bins: Range<usize>,
        [range_m, offset_m]: [f32; 2],
        inverse_sigma: f32,
    ) -> Self {
        let from_m = geometry.range_start_m - range_m;
        let edge_m = geometry.bin_length_m.mul_add(bins.start as f32, from_m) - offset_m;
        Self {
            first: f32x8::splat(simd, edge_m * inverse_sigma),
            // Finite, so that the first edge, 0 times it, is a number.
            step: (geometry.bin_length_m * inverse_sigma).min(f32::MAX),
            last: bins.len() as f32,
        }
    }

    #[inline(always)]
    fn of_row(simd: S, geometry: &PingGeometry, row: &OnlineRow) -> Self {
        let mean_m = [row.range_m, row.offset_m];
        Self::new(simd, geometry, row.bins(), mean_m, row.inverse_sigma)
    }

    /// Whether Φ differs so little from edge to edge that its rounding shows.
    #[inline(always)]
    fn are_close(&self) -> bool {
        self.step < CLOSE_STEP
    }

    /// How often eight bins.
    #[inline(always)]
    fn eights(&self) -> usize {
        (self.last as usize).div_ceil(LANES)
    }

    /// Middles of the bins `from` to `from + 7`, and ϕ there; 0 beyond the row.
    #[inline(always)]
    fn middle(&self, numbers: f32x8<S>, from: usize) -> (f32x8<S>, f32x8<S>) {
        let numbers = numbers + from as f32;
        let z = (numbers + 0.5).mul_add(self.step, self.first);
        let inside = numbers.simd_lt(self.last);
        (z, lanes::only(inside, lanes::normal_density(z)))
    }

    /// Edges `from` to `from + 7`.
    #[inline(always)]
    fn at(&self, numbers: f32x8<S>, from: usize) -> f32x8<S> {
        (numbers + from as f32)
            .min(self.last)
            .mul_add(self.step, self.first)
    }
}

/// Rows, derived: larger sums lose digits.
/// Rows that are summed up before their sum is added to the ping's: many small ones next to a
/// large sum would lose their digits.
const ROWS_AT_A_TIME: usize = 128;

/// Adds every row's intensity, in their order, and counts Gaussian–bin pairs. Both are padded; `partial` is 0 before and after.
#[inline(always)]
pub(super) fn spread<S: Simd>(
    simd: S,
    geometry: &PingGeometry,
    rows: &[OnlineRow],
    partial: &mut [f32],
    intensity: &mut [f32],
) -> u64 {
    let mut pair_count = 0;
    for rows in rows.chunks(ROWS_AT_A_TIME) {
        for row in rows {
            pair_count += u64::from(row.bin_count);
            let strength = row.transmittance * row.energy * row.opacity * row.reflectivity;
            if let Some(bins) = partial.get_mut(row.first_bin as usize..) {
                add_shares(&Edges::of_row(simd, geometry, row), strength, bins);
            }
        }
        for (sum, part) in intensity.iter_mut().zip(partial.iter_mut()) {
            *sum += *part;
            *part = 0.0;
        }
    }
    pair_count
}

/// Appends the energy of a splat in each of `bins`: [`PingGeometry::spread`].
#[inline(always)]
pub(crate) fn append<S: Simd>(
    simd: S,
    geometry: &PingGeometry,
    splat: &Splat,
    bins: Range<usize>,
    energies: &mut Vec<f32>,
) {
    let (from, count) = (energies.len(), bins.len());
    energies.resize(from + count + PADDING, 0.0);
    let (mean_m, by_sigma) = ([splat.range_m, 0.0], 1.0 / splat.range_sigma_m);
    let edges = Edges::new(simd, geometry, bins, mean_m, by_sigma);
    add_shares(&edges, splat.energy, &mut energies[from..]);
    energies.truncate(from + count);
}

/// Appends the energies of a row's bins for αρ = 1.
#[inline(always)]
pub(super) fn append_row<S: Simd>(
    simd: S,
    geometry: &PingGeometry,
    row: &OnlineRow,
    energies: &mut Vec<f32>,
) {
    let (from, count) = (energies.len(), row.bins().len());
    energies.resize(from + count + PADDING, 0.0);
    let strength = row.transmittance * row.energy;
    add_shares(
        &Edges::of_row(simd, geometry, row),
        strength,
        &mut energies[from..],
    );
    energies.truncate(from + count);
}

/// Adds `strength · [Φ((r_{b+1}−r′)/s) − Φ((r_b−r′)/s)]` to a row's bins, 0 to those beyond.
#[inline(always)]
fn add_shares<S: Simd>(edges: &Edges<S>, strength: f32, bins: &mut [f32]) {
    let numbers = lanes::lane_numbers(edges.first.simd);
    if edges.are_close() {
        return add_close_shares(edges, numbers, strength, bins);
    }
    let mut below = lanes::normal_cdf(edges.at(numbers, 0));
    let count = edges.last as usize;
    let mut eights = bins.chunks_exact_mut(LANES);
    let mut from = LANES;
    for bins in eights.by_ref().take(count / LANES) {
        let above = lanes::normal_cdf(edges.at(numbers, from));
        add(below.slide::<1>(above) - below, strength, bins);
        below = above;
        from += LANES;
    }
    if let (true, Some(bins)) = (!count.is_multiple_of(LANES), eights.next()) {
        // The row's last edge is among these, and repeated in the last lane.
        add(below.slide::<1>(below.reverse()) - below, strength, bins);
    }
}

/// As [`add_shares`], where the differences of Φ would be lost in its rounding.
#[inline(always)]
fn add_close_shares<S: Simd>(edges: &Edges<S>, numbers: f32x8<S>, strength: f32, bins: &mut [f32]) {
    let mut from = 0;
    for bins in bins.chunks_exact_mut(LANES).take(edges.eights()) {
        let (z, density) = edges.middle(numbers, from);
        add(close_share(edges.step, z) * density, strength, bins);
        from += LANES;
    }
}

/// `ΔΦ/ϕ` between two edges a small step t about z: `t (1 + t²/24 (z²−1))`.
#[inline(always)]
fn close_share<S: Simd>(step: f32, z: f32x8<S>) -> f32x8<S> {
    let cubic = step * step * step / 24.0;
    z.mul_add(z, -1.0).mul_add(cubic, step)
}

#[inline(always)]
fn add<S: Simd>(share: f32x8<S>, strength: f32, bins: &mut [f32]) {
    let sum = share.mul_add(strength, f32x8::from_slice(share.simd, bins));
    sum.store_slice(bins);
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

/// The gradient of the loss by every row, from the moments `Σ h Φ`, `Σ h ϕ`, `Σ h z ϕ` over its edges.
#[inline(always)]
pub(super) fn spread_back<S: Simd>(
    simd: S,
    geometry: &PingGeometry,
    rows: &[OnlineRow],
    loss: &Loss,
    row_gradients: &mut Vec<RowGradient>,
) {
    for row in rows {
        let [share, shift, width] = moments(simd, geometry, row, loss);
        let strength = row.transmittance * row.energy * row.opacity * row.reflectivity;
        row_gradients.push(RowGradient {
            log_energy: strength * share,
            range: -strength * row.inverse_sigma * shift,
            variance: -0.5 * strength * row.inverse_sigma * row.inverse_sigma * width,
            ..RowGradient::default()
        });
    }
}

#[inline(always)]
fn moments<S: Simd>(simd: S, geometry: &PingGeometry, row: &OnlineRow, loss: &Loss) -> [f32; 3] {
    let numbers = lanes::lane_numbers(simd);
    let edges = Edges::of_row(simd, geometry, row);
    if edges.are_close() {
        return close_moments(&edges, numbers, &loss.before[row.first_bin as usize + 1..]);
    }
    let zero = f32x8::splat(simd, 0.0);
    let (mut share, mut shift, mut width) = (zero, zero, zero);
    let first_bin = row.first_bin as usize;
    let steps = loss.steps[first_bin..].chunks_exact(LANES);
    // `steps` holds the whole ping's gradient: what belongs to the bins outside the row is taken
    // back at its first edge and at its last, which is repeated up to the last lane.
    let eights = row.bin_count as usize / LANES + 1;
    let (before, beyond) = (
        loss.before[first_bin],
        loss.before[first_bin + eights * LANES],
    );
    let ends = [-before, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let mut ends = f32x8::simd_from(simd, ends);
    for (eight, steps) in steps.take(eights).enumerate() {
        if eight + 1 == eights {
            ends += f32x8::simd_from(simd, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, beyond]);
        }
        let h = f32x8::from_slice(simd, steps) + ends;
        ends = zero;
        let z = edges.at(numbers, eight * LANES);
        let density = lanes::normal_density(z);
        share = lanes::normal_cdf(z).mul_add(h, share);
        shift = density.mul_add(h, shift);
        width = (z * density).mul_add(h, width);
    }
    [share.reduce_sum(), shift.reduce_sum(), width.reduce_sum()]
}

/// As [`moments`], from ΔΦ, Δϕ and Δ(zϕ) by their series about the bins' middles:
/// `Δϕ/ϕ = −t z + t³/24 (3z − z³)`, `Δ(zϕ)/ϕ = t (1−z²) − t³/24 (z⁴ − 6z² + 3)`.
#[inline(always)]
fn close_moments<S: Simd>(edges: &Edges<S>, numbers: f32x8<S>, d_intensity: &[f32]) -> [f32; 3] {
    let zero = numbers * 0.0;
    let (mut share, mut shift, mut width) = (zero, zero, zero);
    let cubic = edges.step * edges.step * edges.step / 24.0;
    let mut from = 0;
    for losses in d_intensity.chunks_exact(LANES).take(edges.eights()) {
        let (z, density) = edges.middle(numbers, from);
        let h = density * f32x8::from_slice(zero.simd, losses);
        let z2 = z * z;
        share = close_share(edges.step, z).mul_add(h, share);
        let turning = (-z2 + 3.0) * cubic - edges.step;
        shift = (turning * z).mul_add(h, shift);
        let bending = ((z2 - 6.0).mul_add(z2, 3.0)) * -cubic;
        width = (-z2 + 1.0).mul_add(edges.step, bending).mul_add(h, width);
        from += LANES;
    }
    [share.reduce_sum(), shift.reduce_sum(), width.reduce_sum()]
}
