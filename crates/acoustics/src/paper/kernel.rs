//! The kernel (25) over strips of eight range bins.

use fearless_simd::prelude::*;
use fearless_simd::{i32x8, mask32x8};

use super::REACH_SIGMAS;
use super::projection::{KERNEL_SCALE, Splat, V};
use crate::lanes::{LANES, lane_numbers};

/// Where a kernel ends, in its scaled coordinates, squared.
const REACH2: f32 = REACH_SIGMAS * REACH_SIGMAS * KERNEL_SCALE * KERNEL_SCALE;

/// Up to eight bins of one beam that a splat covers.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Strip {
    /// Place of its first bin in the band's buffers.
    pub(super) at: u32,
    /// How many of the eight bins are covered: more than 0, perhaps more than 8.
    count: f32,
    /// Scaled distance of the first bin from the splat's ridge.
    z: f32,
    /// Scaled distance of the beam from the centre.
    pub(super) d: f32,
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
    let zero = V::splat(simd, 0.0);
    let (mut len, mut covered) = (0, 0.0);
    let mut beam = first;
    while beam < end {
        let dt = lane_numbers(simd) + (beam as f32 - splat.beam);
        let d = dt * splat.beam_scale;
        let room = REACH2 - d * d;
        let reach = room.max(zero).sqrt() / splat.bin_scale;
        let ridge = dt * splat.slope + splat.bin;
        let low = (ridge - reach).ceil().max(zero);
        let high = (ridge + reach).floor().min(last_bin);
        let here = room.simd_ge(zero) & lane_numbers(simd).simd_lt((end - beam) as f32);
        let count = here.select((high - low + 1.0).max(zero), zero);
        let z = (low - ridge) * splat.bin_scale;
        covered += count.reduce_sum();
        let [low, count, z, d] = [low, count, z, d].map(V::to_array);
        for lane in 0..LANES.min((end - beam) as usize) {
            let row = (beam - layout.beams[0] + lane as u32) * layout.stride;
            let strip = Strip {
                at: row + low[lane] as u32,
                count: count[lane],
                z: z[lane],
                d: d[lane],
            };
            len += push_row(strip, splat.bin_scale, &mut strips[len..]);
        }
        beam += LANES as u32;
    }
    (len, covered as u32)
}

/// Cuts a row into strips; returns how many.
#[inline(always)]
fn push_row(row: Strip, bin_scale: f32, strips: &mut [Strip]) -> usize {
    let count = (row.count as u32).div_ceil(LANES as u32) as usize;
    let at = |k: usize| Strip {
        at: row.at + (k * LANES) as u32,
        count: row.count - (k * LANES) as f32,
        z: row.z + (k * LANES) as f32 * bin_scale,
        d: row.d,
    };
    // Nearly all rows need three or fewer: written without asking, where a branch would be missed.
    let [a, b, c, ..] = strips else { return 0 };
    (*a, *b, *c) = (at(0), at(1), at(2));
    for (k, strip) in strips.iter_mut().enumerate().take(count).skip(3) {
        *strip = at(k);
    }
    count
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
        self.lanes.simd_lt(strip.count)
    }

    #[inline(always)]
    pub(super) fn z(&self, strip: &Strip) -> V<S> {
        self.steps + strip.z
    }

    /// (25) as `2^−(z² + d²)`: relative error below 2·10⁻⁶ inside the reach.
    #[inline(always)]
    pub(super) fn draw(&self, strip: &Strip) -> Lit<S> {
        let z = self.z(strip);
        let inside = self.inside(strip);
        let exponent = z.mul_add(-z, V::splat(z.simd, -strip.d * strip.d));
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
        .mul_add(r, 5.550_713e-2)
        .mul_add(r, 2.402_212e-1)
        .mul_add(r, 6.931_47e-1)
        .mul_add(r, 1.0);
    let power: i32x8<S> = shifted.bitcast();
    let mantissa: i32x8<S> = mantissa.bitcast();
    (mantissa + (power << 23u32)).bitcast()
}
