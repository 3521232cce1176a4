//! Where in a ping eight Gaussians are heard, and how strongly: geometry and footprint.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};

use super::pulses::{Pulses, width_steps};
use super::rows::{Detail, Rows};
use super::view::{Numbers, View};
use crate::constants::{BEAM_REACH_SIGMAS, LEAST_FAN, LEAST_VARIANCE_M2};
use crate::lanes::{self, LANES};
use crate::ping_view::Place;
use crate::triple::{Triple, cross, dot, gathered};

/// The beam's frame at the means of eight Gaussians, and how sensitive it is there.
pub(super) struct Beamed<S: Simd> {
    pub(super) place: Place<S>,
    pub(super) range_axis: Triple<S>,
    pub(super) azimuth: f32x8<S>,
    pub(super) elevation: f32x8<S>,
    fan: f32x8<S>,
}

impl<S: Simd> Beamed<S> {
    #[inline(always)]
    fn of(view: &View, mean_m: Triple<S>) -> Self {
        let place = view.ping.place(mean_m);
        let elevation = place.elevation();
        Self {
            range_axis: view.ping.range_axis(&place),
            azimuth: place.azimuth(),
            elevation,
            fan: view.ping.fan(elevation),
            place,
        }
    }
}

/// Strength seen from the sensor, `Σ u_k² s_k` over the three faces turned against `range_axis`.
#[inline(always)]
fn facing<S: Simd>(range_axis: Triple<S>, ahead: Triple<S>, behind: Triple<S>) -> f32x8<S> {
    let [x, y, z] = range_axis;
    let sx = x.simd_le(0.0).select(ahead[0], behind[0]);
    let sy = y.simd_le(0.0).select(ahead[1], behind[1]);
    let sz = z.simd_le(0.0).select(ahead[2], behind[2]);
    (x * x).mul_add(sx, (y * y).mul_add(sy, z * z * sz))
}

/// Covariances times vectors.
#[inline(always)]
fn stretched<S: Simd>(diagonal: Triple<S>, mixed: Triple<S>, v: Triple<S>) -> Triple<S> {
    let [yz, xz, xy] = mixed;
    [
        diagonal[0].mul_add(v[0], xy.mul_add(v[1], xz * v[2])),
        xy.mul_add(v[0], diagonal[1].mul_add(v[1], yz * v[2])),
        xz.mul_add(v[0], yz.mul_add(v[1], diagonal[2] * v[2])),
    ]
}

/// What a shape, or none, makes of an echo.
pub(super) struct Extent<S: Simd> {
    /// Solid angle, steradians.
    solid_angle: f32x8<S>,
    /// Variance of azimuth, all together.
    pub(super) total: f32x8<S>,
    /// Share of the beam's pattern.
    pattern: f32x8<S>,
    /// Squared sigmas off the beam.
    off: f32x8<S>,
    pub(super) mean_range_m: f32x8<S>,
}

impl<S: Simd> Extent<S> {
    #[inline(always)]
    fn of_round(view: &View, beamed: &Beamed<S>, variance_m2: f32) -> Self {
        let (ping, place) = (&view.ping, &beamed.place);
        let (by_lever, by_range) = (place.by_lever, place.by_range);
        let beam = f32x8::splat(by_lever.simd, ping.beam_variance);
        let total = (by_lever * by_lever).mul_add(variance_m2, beam);
        let by_total = f32x8::splat(by_lever.simd, 1.0) / total;
        let off = beamed.azimuth * beamed.azimuth * by_total;
        Self {
            solid_angle: by_range * by_range * (std::f32::consts::TAU * variance_m2),
            total,
            pattern: by_total.sqrt() * ping.sigma_b * lanes::exp(off * -0.5),
            off,
            mean_range_m: place.range_m,
        }
    }

    /// With covariances, diagonal and beside it; also one sigma in range.
    #[inline(always)]
    fn of_shape(
        view: &View,
        beamed: &Beamed<S>,
        diagonal: Triple<S>,
        mixed: Triple<S>,
    ) -> (Self, f32x8<S>) {
        let (ping, place) = (&view.ping, &beamed.place);
        let azimuth_axis = ping.azimuth_axis(place);
        let elevation_axis = cross(beamed.range_axis, azimuth_axis);
        let along = stretched(diagonal, mixed, beamed.range_axis);
        let across = stretched(diagonal, mixed, azimuth_axis);
        let up = stretched(diagonal, mixed, elevation_axis);
        let range_variance = dot(along, beamed.range_axis);
        let width2 = dot(across, azimuth_axis).max(0.0);
        let range_azimuth = dot(along, azimuth_axis) * place.by_lever;
        // √det of the cross-section by Cholesky; its azimuth in metres keeps it well scaled.
        let width_m = width2.sqrt();
        let skew = dot(across, elevation_axis) / width_m.max(1e-9);
        let height_m = (dot(up, elevation_axis) - skew * skew).max(0.0).sqrt();
        let beam = f32x8::splat(width2.simd, ping.beam_variance);
        let total = (width2 * place.by_lever).mul_add(place.by_lever, beam);
        let by_total = f32x8::splat(width2.simd, 1.0) / total;
        let off = beamed.azimuth * beamed.azimuth * by_total;
        let by_range2 = width_m * height_m * place.by_range * place.by_range;
        let extent = Self {
            solid_angle: by_range2 * std::f32::consts::TAU,
            total,
            pattern: by_total.sqrt() * ping.sigma_b * lanes::exp(off * -0.5),
            off,
            mean_range_m: place.range_m - beamed.azimuth * range_azimuth * by_total,
        };
        let own_m2 = range_variance - range_azimuth * range_azimuth * by_total;
        let variance_m2 = own_m2 + ping.range_variance_m2;
        (extent, variance_m2.max(LEAST_VARIANCE_M2).sqrt())
    }

    /// Bins from the ping's start.
    #[inline(always)]
    fn bins(&self, view: &View) -> f32x8<S> {
        (self.mean_range_m - view.ping.range_start_m) * view.bins_per_m
    }
}

/// Where eight are heard.
pub(super) struct Heard<S: Simd> {
    pub(super) at: [u32; LANES],
    pub(super) fraction: f32x8<S>,
    inside: mask32x8<S>,
    pub(super) width: [u32; LANES],
    pub(super) range_sigma_m: f32x8<S>,
}

/// All of eight rows.
pub(super) struct Eight<S: Simd> {
    pub(super) places: [u32; LANES],
    /// How many are meant; the others are the last again.
    pub(super) count: usize,
    pub(super) beamed: Beamed<S>,
    pub(super) extent: Extent<S>,
    pub(super) heard: Heard<S>,
    /// Energy for strength 1, 0 where it is not heard, and times its strength.
    pub(super) energy: f32x8<S>,
    pub(super) echo: f32x8<S>,
}

impl<S: Simd> Eight<S> {
    #[inline(always)]
    fn of(
        view: &View,
        numbers: Numbers<'_>,
        (places, count): ([u32; LANES], usize),
        beamed: Beamed<S>,
        extent: Extent<S>,
        heard: Heard<S>,
    ) -> Self {
        let energy = extent.solid_angle * extent.pattern;
        let energy = match view.is_graded {
            true => energy * beamed.fan,
            false => energy,
        };
        let is_seen = beamed.fan.simd_gt(LEAST_FAN)
            & beamed.place.in_front()
            & energy.simd_ge(0.0)
            & extent.off.simd_le(BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS)
            & heard.inside;
        let energy = lanes::only(is_seen, energy);
        let strength = facing(
            beamed.range_axis,
            triple(energy.simd, numbers.all, 3, places),
            triple(energy.simd, numbers.all, 6, places),
        );
        Self {
            places,
            count,
            echo: lanes::only(is_seen, energy * strength),
            beamed,
            extent,
            heard,
            energy,
        }
    }
}

/// Some places, ascending, eight at a time; the last again where there are fewer.
#[inline(always)]
fn eights(places: &[u32]) -> impl Iterator<Item = ([u32; LANES], usize)> + '_ {
    places.chunks(LANES).map(|chunk| {
        let mut eight = [chunk[chunk.len() - 1]; LANES];
        eight[..chunk.len()].copy_from_slice(chunk);
        (eight, chunk.len())
    })
}

#[inline(always)]
fn triple<S: Simd, const N: usize>(
    simd: S,
    numbers: &[Vec<f32>; N],
    from: usize,
    places: [u32; LANES],
) -> Triple<S> {
    [
        gathered(simd, &numbers[from], places),
        gathered(simd, &numbers[from + 1], places),
        gathered(simd, &numbers[from + 2], places),
    ]
}

/// Appends a row for each of `places`, ascending, which are round and have this sigma.
#[inline(always)]
pub(super) fn project_round<S: Simd>(
    simd: S,
    view: &View,
    numbers: Numbers<'_>,
    (sigma_m, places): (f32, &[u32]),
    detail: Detail,
    (rows, pulses): (&mut Rows, &mut Pulses),
) {
    if places.is_empty() {
        return;
    }
    let variance_m2 = sigma_m * sigma_m;
    let sigma_bins = view.sigma_bins(variance_m2);
    let width = pulses.width(sigma_bins);
    pulses.count(width, places.len());
    let steps = pulses.steps(width);
    let range_sigma_m = f32x8::splat(simd, sigma_bins / view.bins_per_m);
    for eight in eights(places) {
        let beamed = Beamed::of(view, triple(simd, numbers.all, 0, eight.0));
        let extent = Extent::of_round(view, &beamed, variance_m2);
        let placed = steps.place(extent.bins(view), view.ping.bin_count);
        pulses.touch(width, placed.touched);
        let heard = Heard {
            at: placed.at,
            fraction: placed.fraction,
            inside: placed.inside,
            width: [width as u32; LANES],
            range_sigma_m,
        };
        let eight = Eight::of(view, numbers, eight, beamed, extent, heard);
        rows.append(view, &eight, detail);
    }
}

/// Appends a row for each of `places`, ascending, which have shapes.
#[inline(always)]
pub(super) fn project_shaped<S: Simd>(
    simd: S,
    view: &View,
    numbers: Numbers<'_>,
    places: &[u32],
    detail: Detail,
    (rows, pulses): (&mut Rows, &mut Pulses),
) {
    for eight in eights(places) {
        let beamed = Beamed::of(view, triple(simd, numbers.all, 0, eight.0));
        let diagonal = triple(simd, numbers.shapes, 0, eight.0);
        let mixed = triple(simd, numbers.shapes, 3, eight.0);
        let (extent, range_sigma_m) = Extent::of_shape(view, &beamed, diagonal, mixed);
        let heard = place_each(view, &extent, range_sigma_m, eight.1, pulses);
        let eight = Eight::of(view, numbers, eight, beamed, extent, heard);
        rows.append(view, &eight, detail);
    }
}

/// Places the first `count` of eight echoes, each among those of about its width.
#[inline(always)]
fn place_each<S: Simd>(
    view: &View,
    extent: &Extent<S>,
    range_sigma_m: f32x8<S>,
    count: usize,
    pulses: &mut Pulses,
) -> Heard<S> {
    let (simd, bins) = (range_sigma_m.simd, extent.bins(view));
    let one = f32x8::splat(simd, 1.0);
    let (mut at, mut width) = ([0; LANES], [0; LANES]);
    let (mut inside, mut fraction) = ([0.0; LANES], [0.0; LANES]);
    let widths = range_sigma_m * view.bins_per_m;
    let (steps, widths) = (width_steps(widths).to_array(), widths.to_array());
    for lane in 0..count {
        if !widths[lane].is_finite() {
            continue;
        }
        let of_lane = pulses.rounded_width(steps[lane]);
        let placed = pulses.steps(of_lane).place(bins, view.ping.bin_count);
        pulses.touch(of_lane, placed.touched);
        at[lane] = placed.at[lane];
        fraction[lane] = placed.fraction.to_array()[lane];
        inside[lane] = lanes::only(placed.inside, one).to_array()[lane];
        width[lane] = of_lane as u32;
        pulses.count(of_lane, 1);
    }
    Heard {
        at,
        fraction: f32x8::simd_from(simd, fraction),
        inside: f32x8::simd_from(simd, inside).simd_gt(0.0),
        width,
        range_sigma_m,
    }
}
