//! Who hides whom: from near to far over the raster of directions, eight azimuths at a time. The
//! transmittance is a product that carries what its roundings lost, which holds what the sum of
//! logarithms would and needs none.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};

use super::constants::{LEAST_OVERLAP, LEAST_TRANSMITTANCE, RASTER_REACH_SIGMAS};
use super::raster::{COLUMNS, Raster};
use super::rows::{OnlineRow, RowGradient, Shadow};
use crate::lanes;
use crate::parameters::OPACITY_MAX;

/// Buffers of one ping's occlusion.
#[derive(Debug, Clone, Default)]
pub(super) struct Occlusion {
    pub(super) raster: Raster,
    /// Rows by range: the range's bits above, the row's number below.
    order: Vec<u64>,
    /// T of what lies before, and what its roundings have lost, per row of cells.
    transmittance: Vec<[[f32; COLUMNS]; 2]>,
    /// T before each Gaussian in its cells, one after another in `order`.
    before: Vec<[f32; COLUMNS]>,
    /// Σ over Gaussians behind of dL/d ln T.
    behind: Vec<[f32; COLUMNS]>,
}

/// A Gaussian over the columns of the raster.
struct Cover<S: Simd> {
    rows: Range<usize>,
    y1: f32x8<S>,
    y1_squared: f32x8<S>,
    sheared: f32x8<S>,
    shadow: Shadow,
}

impl<S: Simd> Cover<S> {
    #[inline(always)]
    fn new(simd: S, raster: &Raster, shadow: &Shadow) -> Self {
        let azimuth = f32x8::simd_from(simd, raster.azimuth_rad) - shadow.azimuth_rad;
        let y1 = azimuth * shadow.inverse_width;
        Self {
            rows: rows_of(raster, shadow),
            y1,
            y1_squared: y1 * y1,
            sheared: azimuth * shadow.slope,
            shadow: *shadow,
        }
    }

    /// Covered share of each cell of a row, 0 beyond reach; and y₂.
    #[inline(always)]
    fn of_row(&self, raster: &Raster, row: usize) -> (f32x8<S>, f32x8<S>) {
        let elevation = raster.elevation_rad(row) - self.shadow.elevation_rad;
        let y2 =
            (f32x8::splat(self.y1.simd, elevation) - self.sheared) * self.shadow.inverse_height;
        let distance2 = y2.mul_add(y2, self.y1_squared);
        let reach2 = RASTER_REACH_SIGMAS * RASTER_REACH_SIGMAS;
        let near: mask32x8<S> = distance2.simd_le(reach2);
        // What is cut off is kept from becoming subnormal, which would cost a hundred cycles.
        let covered = lanes::exp(distance2.min(2.0 * reach2) * -0.5) * self.shadow.peak;
        (lanes::only(near, covered), y2)
    }
}

/// Rows of cells within reach.
fn rows_of(raster: &Raster, shadow: &Shadow) -> Range<usize> {
    let reach = RASTER_REACH_SIGMAS * shadow.height_rad;
    let row = |elevation_rad: f32| {
        let position = (elevation_rad - raster.lowest_rad) / raster.row_rad;
        position.clamp(-1.0, raster.row_count() as f32)
    };
    let first = row(shadow.elevation_rad - reach).ceil().max(0.0) as usize;
    let end = (row(shadow.elevation_rad + reach).floor() + 1.0) as usize;
    first..end.min(raster.row_count())
}

impl Occlusion {
    /// Numbers that its buffers hold room for.
    #[cfg(test)]
    pub(super) fn capacity(&self) -> usize {
        self.order.capacity()
            + self.transmittance.capacity()
            + self.before.capacity()
            + self.behind.capacity()
            + self.raster.weights.capacity()
    }

    /// Sets every row's transmittance.
    #[inline(always)]
    pub(super) fn forward<S: Simd>(&mut self, simd: S, rows: &mut [OnlineRow]) {
        self.order.clear();
        // Ranges are positive: their bits are in their order.
        let key = |(number, row): (usize, &OnlineRow)| {
            u64::from(row.range_m.to_bits()) << 32 | number as u64
        };
        self.order.extend(rows.iter().enumerate().map(key));
        self.order.sort_unstable();
        self.before.clear();
        self.transmittance.clear();
        self.transmittance
            .resize(self.raster.row_count(), [[1.0; COLUMNS], [0.0; COLUMNS]]);
        for &key in &self.order {
            let row = &mut rows[key as u32 as usize];
            let cover = Cover::new(simd, &self.raster, &row.shadow);
            let (raster, before) = (&self.raster, &mut self.before);
            let transmittance = &mut self.transmittance;
            pass(raster, &cover, row, transmittance, before);
        }
    }

    /// From far to near: adds the gradients that come from each row's hiding of others and from its
    /// being hidden.
    #[inline(always)]
    pub(super) fn backward<S: Simd>(
        &mut self,
        simd: S,
        rows: &[OnlineRow],
        row_gradients: &mut [RowGradient],
    ) {
        self.behind.clear();
        self.behind.resize(self.raster.row_count(), [0.0; COLUMNS]);
        let mut end = self.before.len();
        for &key in self.order.iter().rev() {
            let number = key as u32 as usize;
            let (row, row_gradient) = (&rows[number], &mut row_gradients[number]);
            let cover = Cover::new(simd, &self.raster, &row.shadow);
            let start = end - cover.rows.len();
            let before = &self.before[start..end];
            pass_back(
                &self.raster,
                &cover,
                row,
                before,
                &mut self.behind,
                row_gradient,
            );
            end = start;
        }
    }
}

/// `Σ w f T / Σ w f` over a Gaussian's cells, which it then darkens for those behind.
#[inline(always)]
fn pass<S: Simd>(
    raster: &Raster,
    cover: &Cover<S>,
    row: &mut OnlineRow,
    transmittance: &mut [[[f32; COLUMNS]; 2]],
    before: &mut Vec<[f32; COLUMNS]>,
) {
    let simd = cover.y1.simd;
    let (mut lit, mut overlap) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 0.0));
    for number in cover.rows.clone() {
        let (covered, _) = cover.of_row(raster, number);
        let [product, lost] = &mut transmittance[number];
        let through = f32x8::simd_from(simd, *product);
        let rest = f32x8::simd_from(simd, *lost);
        before.push(through.to_array());
        let weighted = covered * f32x8::simd_from(simd, raster.weights[number]);
        lit = weighted.mul_add(through, lit);
        overlap += weighted;
        let stopped = (covered * row.opacity).min(OPACITY_MAX);
        // 1 − stopped in two parts, so that a share of 10⁻⁸ still counts.
        let one = f32x8::splat(simd, 1.0);
        let passed = one - stopped;
        let passed_rest = (one - passed) - stopped;
        let next = through * passed;
        let rounding = through.mul_add(passed, -next);
        let next_rest = rest.mul_add(passed, through.mul_add(passed_rest, rounding));
        let sum = next + next_rest;
        // It only ever falls: what is dark stays so.
        let is_lit = sum.simd_ge(LEAST_TRANSMITTANCE);
        *lost = lanes::only(is_lit, next_rest - (sum - next)).to_array();
        *product = lanes::only(is_lit, sum).to_array();
    }
    let overlap = overlap.reduce_sum();
    if overlap > LEAST_OVERLAP {
        row.transmittance = lit.reduce_sum() / overlap;
        row.shadow.overlap = overlap;
    }
}

#[inline(always)]
fn pass_back<S: Simd>(
    raster: &Raster,
    cover: &Cover<S>,
    row: &OnlineRow,
    before: &[[f32; COLUMNS]],
    behind: &mut [[f32; COLUMNS]],
    row_gradient: &mut RowGradient,
) {
    let simd = cover.y1.simd;
    let zero = f32x8::splat(simd, 0.0);
    // What lies beside the raster or in the dark has no cell to be lit through.
    let lit = row.shadow.overlap > LEAST_OVERLAP && row.transmittance > 0.0;
    let by_mean = if lit {
        row_gradient.log_energy / row.transmittance / row.shadow.overlap
    } else {
        0.0
    };
    let (mut opacity, mut h, mut h2, mut h22) = (zero, zero, zero, zero);
    for (number, before) in cover.rows.clone().zip(before) {
        let (covered, y2) = cover.of_row(raster, number);
        let through = f32x8::simd_from(simd, *before);
        let weight = f32x8::simd_from(simd, raster.weights[number]) * by_mean;
        let stopped = (covered * row.opacity).min(OPACITY_MAX);
        let later = f32x8::simd_from(simd, behind[number]);
        let by_stopped = -later / (f32x8::splat(simd, 1.0) - stopped);
        let by_covered = weight * (through - row.transmittance) + by_stopped * row.opacity;
        opacity = by_stopped.mul_add(covered, opacity);
        behind[number] = (weight * covered).mul_add(through, later).to_array();
        let part = by_covered * covered;
        let part_y2 = part * y2;
        h += part;
        h2 += part_y2;
        h22 = part_y2.mul_add(y2, h22);
    }
    row_gradient.opacity = opacity.reduce_sum();
    row_gradient.moments = [
        h.reduce_sum(),
        (h * cover.y1).reduce_sum(),
        h2.reduce_sum(),
        (h * cover.y1_squared).reduce_sum(),
        (h2 * cover.y1).reduce_sum(),
        h22.reduce_sum(),
    ];
}
