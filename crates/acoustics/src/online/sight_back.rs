//! From the gradients of the loss by the rows of a ping back to the parameters, eight Gaussians at
//! a time.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::rows::{OnlineRow, RowGradient};
use super::sight::{Eight, Sight, View};
use crate::lanes::{self, LANES};
use crate::parameters::{GradientArrays, PARAMETER_COUNT};
use crate::triple::{Triple, cross, dot};

/// [`RowGradient`] of eight rows.
#[derive(Clone, Copy)]
struct RowGradients<S: Simd> {
    log_energy: f32x8<S>,
    range: f32x8<S>,
    variance: f32x8<S>,
    opacity: f32x8<S>,
    moments: [f32x8<S>; 6],
}

impl<S: Simd> RowGradients<S> {
    #[inline(always)]
    fn gather(simd: S, row_gradients: &[RowGradient]) -> Self {
        let mut eight = [RowGradient::default(); LANES];
        eight[..row_gradients.len()].copy_from_slice(row_gradients);
        let mut turned = [[0.0; LANES]; 10];
        for (lane, row_gradient) in eight.iter().enumerate() {
            let [h, h1, h2, h11, h12, h22] = row_gradient.moments;
            let (energy, range, variance) = (
                row_gradient.log_energy,
                row_gradient.range,
                row_gradient.variance,
            );
            let numbers = [
                energy,
                range,
                variance,
                row_gradient.opacity,
                h,
                h1,
                h2,
                h11,
                h12,
                h22,
            ];
            for (lanes, number) in turned.iter_mut().zip(numbers) {
                lanes[lane] = number;
            }
        }
        let [energy, range, variance, opacity, h, h1, h2, h11, h12, h22] = turned;
        Self {
            log_energy: f32x8::simd_from(simd, energy),
            range: f32x8::simd_from(simd, range),
            variance: f32x8::simd_from(simd, variance),
            opacity: f32x8::simd_from(simd, opacity),
            moments: [
                f32x8::simd_from(simd, h),
                f32x8::simd_from(simd, h1),
                f32x8::simd_from(simd, h2),
                f32x8::simd_from(simd, h11),
                f32x8::simd_from(simd, h12),
                f32x8::simd_from(simd, h22),
            ],
        }
    }
}

/// Derivatives by the quantities of a [`Sight`].
struct SightGradient<S: Simd> {
    range_m: f32x8<S>,
    lever_m: f32x8<S>,
    azimuth: f32x8<S>,
    elevation: f32x8<S>,
    rr: f32x8<S>,
    rt: f32x8<S>,
    tt: f32x8<S>,
    tp: f32x8<S>,
    pp: f32x8<S>,
    section2: f32x8<S>,
    side2: f32x8<S>,
}

/// Adds the gradients of `rows` to theirs; returns how many were not finite and left out.
#[inline(always)]
pub(super) fn accumulate<S: Simd>(
    simd: S,
    view: &View,
    fields: &[&[f32]; PARAMETER_COUNT],
    rows: &[OnlineRow],
    row_gradients: &[RowGradient],
    occlusion: bool,
    gradients: &mut GradientArrays,
) -> u64 {
    let mut not_finite = 0;
    let mut fields_back = gradients.fields_mut();
    for (rows, row_gradients) in rows.chunks(LANES).zip(row_gradients.chunks(LANES)) {
        let mut indices = [rows[rows.len() - 1].index; LANES];
        for (index, row) in indices.iter_mut().zip(rows) {
            *index = row.index;
        }
        let eight = Eight::gather(simd, fields, indices);
        let sight = Sight::new(view, &eight);
        let gradient = gradient(
            view,
            &eight,
            &sight,
            &RowGradients::gather(simd, row_gradients),
            occlusion,
        );
        let mut nothing = lanes::nothing(gradient[0]);
        for part in &gradient[1..] {
            nothing += lanes::nothing(*part);
        }
        let finite = nothing.simd_eq(0.0);
        let bits = finite.to_bitmask();
        for (field, part) in fields_back.iter_mut().zip(gradient) {
            add(field, indices, rows.len(), lanes::only(finite, part));
        }
        not_finite += (0..rows.len()).filter(|lane| bits >> lane & 1 == 0).count() as u64;
    }
    not_finite
}

/// Adds the first `count` lanes to the places of `indices`, which ascend.
#[inline(always)]
fn add<S: Simd>(field: &mut [f32], indices: [u32; LANES], count: usize, part: f32x8<S>) {
    let (first, last) = (indices[0] as usize, indices[LANES - 1] as usize);
    if count == LANES && last - first == LANES - 1 {
        if let Some(sums) = field.get_mut(first..=last) {
            (f32x8::from_slice(part.simd, sums) + part).store_slice(sums);
        }
        return;
    }
    for (&index, part) in indices.iter().zip(part.to_array()).take(count) {
        if let Some(sum) = field.get_mut(index as usize) {
            *sum += part;
        }
    }
}

#[inline(always)]
fn gradient<S: Simd>(
    view: &View,
    eight: &Eight<S>,
    sight: &Sight<S>,
    row_gradients: &RowGradients<S>,
    occlusion: bool,
) -> [f32x8<S>; PARAMETER_COUNT] {
    let mut by = measurement_back(view, sight, row_gradients);
    if occlusion {
        shadow_back(view, sight, row_gradients, &mut by);
    }
    let [gu, gv, gw] = axes_back(sight, &by);
    let [mx, my, mz] = mean_back(view, sight, &by, gu, gv, gw);
    let [qx, qy, qz, qw] = rotation_back(sight, gu, gv, gw);
    let [sx, sy, sz] = scale_back(sight, &by);
    let by_opacity = row_gradients.log_energy / eight.opacity() + row_gradients.opacity;
    let logit = by_opacity * eight.opacity_slope();
    [
        mx,
        my,
        mz,
        qx,
        qy,
        qz,
        qw,
        sx,
        sy,
        sz,
        logit,
        row_gradients.log_energy,
    ]
}

/// Through energy, r′ and s².
#[inline(always)]
fn measurement_back<S: Simd>(
    view: &View,
    sight: &Sight<S>,
    row_gradients: &RowGradients<S>,
) -> SightGradient<S> {
    let simd = sight.rr.simd;
    let one = f32x8::splat(simd, 1.0);
    let zero = f32x8::splat(simd, 0.0);
    let (e, lever) = (row_gradients.log_energy, sight.lever_m);
    let by_total = one / sight.total2;
    let above_floor = sight.range_variance(view).1;
    let variance = lanes::only(above_floor, row_gradients.variance);
    let arc = sight.azimuth * lever;
    let by_total2 = (e * (arc * arc * by_total - one) * 0.5
        + row_gradients.range * arc * sight.rt * by_total
        - variance * sight.own_variance())
        * by_total;
    let by_beam2 = by_total2 + variance * sight.rr * by_total;
    let by_arc = -(e * arc + row_gradients.range * sight.rt) * by_total;
    SightGradient {
        range_m: row_gradients.range - e * 2.0 / sight.range_m,
        lever_m: e / lever
            + by_arc * sight.azimuth
            + lever * by_beam2 * (2.0 * view.ping.beam_variance),
        azimuth: by_arc * lever,
        elevation: e * fan_slope(view, sight.elevation),
        rr: variance * sight.beam2 * by_total,
        rt: -row_gradients.range * arc * by_total,
        tt: by_total2,
        tp: zero,
        pp: zero,
        section2: e * 0.5 / sight.section2,
        side2: variance * by_total,
    }
}

/// `d ln g(φ)/dφ`.
#[inline(always)]
fn fan_slope<S: Simd>(view: &View, elevation: f32x8<S>) -> f32x8<S> {
    let x = elevation * view.ping.inverse_half_width;
    let x2 = x * x;
    let slope = -8.0 * std::f32::consts::LN_2 * view.ping.inverse_half_width;
    x2 * x2 * x2 * x * slope
}

/// Through what is covered on the raster.
#[inline(always)]
fn shadow_back<S: Simd>(
    view: &View,
    sight: &Sight<S>,
    row_gradients: &RowGradients<S>,
    by: &mut SightGradient<S>,
) {
    let shadow = sight.shadow(view);
    let (a, b, slope) = (shadow.inverse_width, shadow.inverse_height, shadow.slope);
    let [h, h1, h2, h11, h12, h22] = row_gradients.moments;
    let by_elevation = h2 * b;
    by.elevation += by_elevation;
    by.azimuth += h1 * a - slope * by_elevation;
    // ½ S⁻¹(d dᵀ − S)S⁻¹ in the whitened frame.
    let (k11, k22) = (h11 - h, h22 - h);
    let pp = b * b * k22;
    let tp = b * (a * h12 - slope * b * k22);
    let tt = a * a * k11 - a * slope * b * h12 * 2.0 + slope * slope * pp;
    let one = f32x8::splat(h.simd, 1.0);
    let (by_lever, by_range) = (one / sight.lever_m, one / sight.range_m);
    by.tt += tt * by_lever * by_lever * 0.5;
    by.tp += tp * by_lever * by_range;
    by.pp += pp * by_range * by_range * 0.5;
    by.section2 += h * 0.5 / sight.section2;
    by.lever_m -= (h + tt * shadow.tt + tp * shadow.tp) * by_lever;
    by.range_m -= (h + pp * shadow.pp + tp * shadow.tp) * by_range;
}

/// By the directions of range, azimuth and elevation along the Gaussian's own axes.
#[inline(always)]
fn axes_back<S: Simd>(sight: &Sight<S>, by: &SightGradient<S>) -> [Triple<S>; 3] {
    let (u, v, w) = (sight.along, sight.across, sight.up);
    let (rr, tt, pp) = (by.rr * 2.0, by.tt * 2.0, by.pp * 2.0);
    let (section2, side2) = (by.section2 * 2.0, by.side2 * 2.0);
    let mut back = [u; 3];
    for k in 0..3 {
        let (scale2, area2) = (sight.scale2[k], sight.area2[k]);
        back[0][k] = scale2 * (rr * u[k] + by.rt * v[k]) + section2 * area2 * u[k];
        back[1][k] = scale2 * (tt * v[k] + by.rt * u[k] + by.tp * w[k]);
        back[2][k] = scale2 * (pp * w[k] + by.tp * v[k]) + side2 * area2 * w[k];
    }
    back
}

#[inline(always)]
fn scale_back<S: Simd>(sight: &Sight<S>, by: &SightGradient<S>) -> Triple<S> {
    let (u, v, w) = (sight.along, sight.across, sight.up);
    let (mut scales, mut areas) = (u, u);
    for k in 0..3 {
        let spread = (by.rr * u[k] + by.rt * v[k]) * u[k]
            + (by.tt * v[k] + by.tp * w[k]) * v[k]
            + by.pp * w[k] * w[k];
        scales[k] = sight.scale2[k] * spread;
        areas[k] = sight.area2[k] * (by.section2 * u[k] * u[k] + by.side2 * w[k] * w[k]);
    }
    // Area k is the product of the two scales other than k.
    [
        (scales[0] + areas[1] + areas[2]) * 2.0,
        (scales[1] + areas[2] + areas[0]) * 2.0,
        (scales[2] + areas[0] + areas[1]) * 2.0,
    ]
}

/// By the mean: along range, azimuth and elevation, back through the drift, into the world.
#[inline(always)]
fn mean_back<S: Simd>(
    view: &View,
    sight: &Sight<S>,
    by: &SightGradient<S>,
    gu: Triple<S>,
    gv: Triple<S>,
    gw: Triple<S>,
) -> Triple<S> {
    let (u, v, w) = (sight.along, sight.across, sight.up);
    let one = f32x8::splat(u[0].simd, 1.0);
    let (by_range, by_lever) = (one / sight.range_m, one / sight.lever_m);
    let [x, y, z] = sight.mean;
    let (cos, sin) = (sight.lever_m * by_range, z * by_range);
    let azimuth = by.azimuth + cos * (dot(gu, v) - dot(gv, u)) + sin * (dot(gv, w) - dot(gw, v));
    let elevation = by.elevation + dot(gu, w) - dot(gw, u) - z * by.lever_m;
    let range = (by.range_m + cos * by.lever_m) * by_range;
    let sideways = azimuth * by_lever * by_lever;
    let upward = elevation * by_range * by_range;
    let sunk = range - upward * z * by_lever;
    let moved = [
        x * sunk - y * sideways,
        y * sunk + x * sideways,
        z * range + sight.lever_m * upward,
    ];
    view.ping.in_world_frame(drift_back(view, sight, moved))
}

/// `Dᵀg` with D the derivative of the drifted mean by the still one.
#[inline(always)]
fn drift_back<S: Simd>(view: &View, sight: &Sight<S>, g: Triple<S>) -> Triple<S> {
    let [left, turn, roll] = view.ping.drift_per_m;
    let [x, y, z] = sight.still;
    let late = sight.still_m - view.ping.reference_range_m;
    let rate = (x * turn - z * roll + left) / sight.still_m;
    [
        g[0] - g[1] * (rate * x + late * turn),
        g[1] - g[1] * rate * y,
        g[2] - g[1] * (rate * z - late * roll),
    ]
}

/// By the raw quaternion: the torque about the own axes, doubled, through the normalisation.
#[inline(always)]
fn rotation_back<S: Simd>(
    sight: &Sight<S>,
    gu: Triple<S>,
    gv: Triple<S>,
    gw: Triple<S>,
) -> [f32x8<S>; 4] {
    let (a, b, c) = (
        cross(gu, sight.along),
        cross(gv, sight.across),
        cross(gw, sight.up),
    );
    let torque = [a[0] + b[0] + c[0], a[1] + b[1] + c[1], a[2] + b[2] + c[2]];
    let [x, y, z, w] = sight.unit;
    let turned = cross([x, y, z], torque);
    let factor = sight.inverse_length * 2.0;
    [
        factor * (w * torque[0] + turned[0]),
        factor * (w * torque[1] + turned[1]),
        factor * (w * torque[2] + turned[2]),
        -factor * dot([x, y, z], torque),
    ]
}
