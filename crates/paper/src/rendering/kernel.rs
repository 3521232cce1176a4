//! The kernel (25) over strips of eight range bins.

use fearless_simd::prelude::*;
use fearless_simd::{f32x4, i32x8, mask32x8};

use super::REACH_SIGMAS;
use super::projection::{KERNEL_SCALE, Splat, V};
use echosplat_measurement::lanes::{LANES, lane_numbers, only};

/// Where a kernel ends, in its scaled coordinates, squared.
const REACH2: f32 = REACH_SIGMAS * REACH_SIGMAS * KERNEL_SCALE * KERNEL_SCALE;

/// Added to a place, so that it stands in the lowest bits of a float and can be added to as one.
const PLACE: f32 = 8_388_608.0;
const PLACE_BITS: u32 = 0x7f_ffff;

/// Up to eight bins of one beam that a splat covers.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Strip(
    /// Place of its first bin in the band's buffers plus [`PLACE`]; how many of the eight bins are
    /// covered (0 or less: none; more than 8: all); scaled distance of the first bin from the
    /// splat's ridge; scaled distance of the beam from the centre.
    [f32; 4],
);

impl Strip {
    #[inline(always)]
    pub(super) fn at(&self) -> usize {
        (self.0[0].to_bits() & PLACE_BITS) as usize
    }

    #[inline(always)]
    fn count(&self) -> f32 {
        self.0[1]
    }

    #[inline(always)]
    fn z(&self) -> f32 {
        self.0[2]
    }

    #[inline(always)]
    pub(super) fn d(&self) -> f32 {
        self.0[3]
    }
}

/// The beams of a band and its layout.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Layout {
    /// First beam, and one beyond the last.
    pub(super) beams: [u32; 2],
    pub(super) range_bins: u32,
    /// Numbers from beam to beam in a buffer: the bins and at least 8 more.
    pub(super) stride: u32,
}

impl Layout {
    /// Numbers in a buffer.
    pub(super) fn len(&self) -> usize {
        (self.beams[1] - self.beams[0]) as usize * self.stride as usize + LANES
    }

    /// Most strips that a splat can have here, and room to write three too many.
    pub(super) fn strips_max(&self) -> usize {
        let per_beam = self.range_bins as usize / LANES + 2;
        (self.beams[1] - self.beams[0]) as usize * per_beam + 3
    }
}

/// The strips of `splat` in a band go to the start of `strips`; returns how many, and how many
/// pixels they cover.
#[inline(always)]
pub(super) fn cover<S: Simd>(
    simd: S,
    splat: &Splat,
    layout: &Layout,
    strips: &mut [Strip],
) -> (usize, u32) {
    let first = splat.beams[0].max(layout.beams[0]);
    let end = splat.beams[1].min(layout.beams[1]);
    let last_bin = (layout.range_bins - 1) as f32;
    let lanes = lane_numbers(simd);
    let zero = V::splat(simd, 0.0);
    let step = f32x4::simd_from(simd, [8.0, -8.0, 8.0 * splat.bin_scale, 0.0]);
    let mut len = 0;
    let mut covered = zero;
    let mut beam = first;
    while beam < end {
        let dt = lanes + (beam as f32 - splat.beam);
        let d = dt * splat.beam_scale;
        let room = REACH2 - d * d;
        let reach = room.max(zero).sqrt() * splat.bin_sigma;
        let ridge = dt.mul_add(splat.slope, splat.bin);
        let low = (ridge - reach).ceil().max(zero);
        let high = (ridge + reach).floor().min(last_bin);
        let here = room.simd_ge(zero) & lanes.simd_lt((end - beam) as f32);
        let count = only(here, (high - low + 1.0).max(zero));
        covered += count;
        let z = (low - ridge) * splat.bin_scale;
        let row = (beam - layout.beams[0]) * layout.stride;
        let at = lanes.mul_add(layout.stride as f32, low.min(last_bin)) + (row as f32 + PLACE);
        let whole: i32x8<S> = count.to_int();
        let strip_counts = ((whole + 7) >> 3u32).to_array();
        let [at, count, z, d] = [at, count, z, d].map(V::to_array);
        for lane in 0..LANES.min((end - beam) as usize) {
            let row = f32x4::simd_from(simd, [at[lane], count[lane], z[lane], d[lane]]);
            let strip_count = strip_counts[lane] as usize;
            push_row(row, step, strip_count, &mut strips[len..]);
            len += strip_count;
        }
        beam += LANES as u32;
    }
    (len, covered.reduce_sum() as u32)
}

/// Cuts a row into strips.
#[inline(always)]
fn push_row<S: Simd>(row: f32x4<S>, step: f32x4<S>, strip_count: usize, strips: &mut [Strip]) {
    // Nearly all rows need three or fewer: written without asking, where a branch would be missed.
    let [a, b, c, more @ ..] = strips else { return };
    row.store_array(&mut a.0);
    (row + step).store_array(&mut b.0);
    let mut row = row + step + step;
    row.store_array(&mut c.0);
    for strip in more.iter_mut().take(strip_count.saturating_sub(3)) {
        row += step;
        row.store_array(&mut strip.0);
    }
}

/// Scaled coordinates along range and the kernel's value, 0 in lanes outside.
pub(super) struct Lit<S: Simd> {
    pub(super) z: V<S>,
    pub(super) f: V<S>,
    pub(super) inside: mask32x8<S>,
}

/// What is the same for all strips of a splat.
#[derive(Clone, Copy)]
pub(super) struct Pen<S: Simd> {
    lanes: V<S>,
    /// Scaled distance of each lane from the first.
    steps: V<S>,
}

impl<S: Simd> Pen<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, splat: &Splat) -> Self {
        let lanes = lane_numbers(simd);
        Self {
            lanes,
            steps: lanes * splat.bin_scale,
        }
    }

    #[inline(always)]
    pub(super) fn inside(&self, strip: &Strip) -> mask32x8<S> {
        self.lanes.simd_lt(strip.count())
    }

    #[inline(always)]
    pub(super) fn z(&self, strip: &Strip) -> V<S> {
        self.steps + strip.z()
    }

    /// (25) as `2^−(z² + d²)`: relative error below 2·10⁻⁶ inside the reach.
    #[inline(always)]
    pub(super) fn draw(&self, strip: &Strip) -> Lit<S> {
        let z = self.z(strip);
        let inside = self.inside(strip);
        let exponent = z.mul_add(-z, V::splat(z.simd, -strip.d() * strip.d()));
        let f = inside.select(exp2(exponent), V::splat(z.simd, 0.0));
        Lit { z, f, inside }
    }
}

/// 2^x of x ≤ 0, clamped to −126: relative error below 1.5·10⁻⁷. A minimax polynomial on ±½.
#[inline(always)]
fn exp2<S: Simd>(x: V<S>) -> V<S> {
    // Adding this rounds to an integer, which then stands in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    let x = x.max(-126.0);
    let shifted = x + ROUND;
    let r = x - (shifted - ROUND);
    let mantissa = V::splat(x.simd, 1.327_647_2e-3)
        .mul_add(r, 9.675_541e-3)
        .mul_add(r, 5.550_713_3e-2)
        .mul_add(r, 2.402_212e-1)
        .mul_add(r, 6.931_469_7e-1)
        .mul_add(r, 1.000_000_1);
    let power: i32x8<S> = shifted.bitcast();
    let mantissa: i32x8<S> = mantissa.bitcast();
    (mantissa + (power << 23u32)).bitcast()
}
