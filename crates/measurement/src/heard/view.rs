//! A ping as kernels see it, Gaussians as they read them, and which of them a ping may hear at all.

use std::ops::Range;

use fearless_simd::f32x8;
use fearless_simd::prelude::*;
use glam::Vec3;

use crate::PingGeometry;
use crate::constants::LEAST_VARIANCE_M2;
use crate::lanes::LANES;
use crate::ping_view::PingView;

/// Numbers a Gaussian; layout.
/// Numbers per Gaussian, world axes: mean (m), strength towards +x, +y, +z and towards −x, −y, −z.
pub const NUMBERS: usize = 9;
/// Numbers of a shape; layout.
/// Those that a Gaussian with a shape has beside them: covariance xx, yy, zz, yz, xz, xy, m².
pub const SHAPE_NUMBERS: usize = 6;

/// A ping's geometry as single numbers, worked out once per ping.
#[derive(Debug, Clone, Copy)]
pub struct View {
    pub(super) ping: PingView,
    /// Whether sensitivity falls off over elevation.
    pub(super) is_graded: bool,
    pub(super) bins_per_m: f32,
}

impl View {
    /// Of `geometry`; unless `is_graded`, the fan is equally sensitive over all elevations that it sees.
    #[must_use]
    pub fn of(geometry: &PingGeometry, is_graded: bool) -> Self {
        Self {
            ping: PingView::new(geometry),
            is_graded,
            bins_per_m: 1.0 / geometry.bin_length_m,
        }
    }

    /// Whether any of `members` may be within the beam's reach and the ping's range.
    #[must_use]
    pub(crate) fn may_hear(&self, members: &Members) -> bool {
        self.ping
            .may_hear(members.center_m, members.radius_m, members.sigma_m)
    }

    pub(super) fn bin_count(&self) -> usize {
        self.ping.bin_count as usize
    }

    /// Width in bins of an echo with this variance in range beside the ping's.
    pub(super) fn sigma_bins(&self, variance_m2: f32) -> f32 {
        let variance_m2 = variance_m2 + self.ping.range_variance_m2;
        variance_m2.max(LEAST_VARIANCE_M2).sqrt() * self.bins_per_m
    }
}

/// Numbers of Gaussians side by side, with [`LANES`] more places from the last on.
#[derive(Debug, Clone, Copy)]
pub struct Numbers<'a> {
    /// Shape `[NUMBERS][places]`.
    pub all: &'a [Vec<f32>; NUMBERS],
    /// Shape `[SHAPE_NUMBERS][places]`, for those that have one.
    pub shapes: &'a [Vec<f32>; SHAPE_NUMBERS],
    /// One sigma of round Gaussians of each size; what has no size of these has a shape.
    pub sizes_m: &'a [f32],
}

/// Gaussians side by side that lie in a ball.
#[derive(Debug, Clone)]
pub struct Members {
    /// Their places.
    pub places: Range<usize>,
    /// Middle and radius of the ball that holds their means.
    pub center_m: Vec3,
    /// See `center_m`.
    pub radius_m: f32,
    /// The widest of their sigmas.
    pub sigma_m: f32,
}

/// Appends the places among `members` that the ping may see: a cheap test that rules most of them out.
#[inline(always)]
pub(super) fn cull<S: Simd>(
    simd: S,
    view: &View,
    numbers: Numbers<'_>,
    members: &Members,
    places: &mut Vec<u32>,
) {
    let range = members.places.clone();
    let slab = view
        .ping
        .slab(members.center_m, members.radius_m, members.sigma_m);
    let mut found = places.len();
    // Room for all, and for eight from the last on.
    places.resize(found + range.len() + LANES, 0);
    let [x_m, y_m, z_m, ..] = numbers.all;
    let mut from = range.start;
    while from < range.end {
        let mean_m = [
            f32x8::from_slice(simd, &x_m[from..from + LANES]),
            f32x8::from_slice(simd, &y_m[from..from + LANES]),
            f32x8::from_slice(simd, &z_m[from..from + LANES]),
        ];
        let left = (range.end - from).min(LANES);
        let bits = slab.holds(mean_m).to_bitmask() & ((1 << left) - 1);
        if bits != 0 {
            // Each is written, and the next over those that are not seen: no branch that would be guessed wrong.
            let eight = &mut places[found..found + LANES];
            let mut count = 0;
            for lane in 0..LANES {
                eight[count & (LANES - 1)] = (from + lane) as u32;
                count += (bits >> lane & 1) as usize;
            }
            found += count;
        }
        from += LANES;
    }
    places.truncate(found);
}
