//! From the pixels' moments back to the twelve parameters, for eight Gaussians at a time.

use fearless_simd::prelude::*;

use super::projection::{
    Eight, Frame, KERNEL_SCALE, Projected, Splat, V, are_in_a_row, cross, dot, each3, gather,
    lanes_of, on_axis, project,
};
use super::stroke::{MOMENTS, Moments};
use crate::parameters::{GaussianArrays, GradientArrays, PARAMETER_COUNT};
use echosplat_measurement::lanes::{LANES, exp};

/// What the pixels say of eight Gaussians: slopes to (21), (24) and to ln α, ln ρ.
struct PixelGradient<S: Simd> {
    centre: [V<S>; 2],
    /// To (24) as `zz a aᵀ + dz (a bᵀ + b aᵀ) + dd b bᵀ` with a = (1, −m) across the ridge and
    /// b = (0, 1): zz, dz, dd.
    covariance: [V<S>; 3],
    opacity_log: V<S>,
    reflectivity_log: V<S>,
}

/// Moments of `e = dL/d ln f` over the pixels, in the scaled coordinates of the kernel.
#[inline(always)]
fn from_moments<S: Simd>(one: &Projected<S>, sums: [V<S>; MOMENTS]) -> PixelGradient<S> {
    let [e, ez, ezz, ed, edz, edd, reflectivity_log] = sums;
    let simd = e.simd;
    let [_, rt, tt] = one.covariance;
    let slope = rt / tt;
    let per_bin = (tt / one.determinant).sqrt();
    let per_beam = V::splat(simd, 1.0) / tt.sqrt();
    let by_bin = per_bin * ez * KERNEL_SCALE.recip();
    let square = 0.5 / (KERNEL_SCALE * KERNEL_SCALE);
    let zz = per_bin * per_bin * ezz * square;
    let dz = per_bin * per_beam * edz * square;
    let dd = per_beam * per_beam * edd * square;
    PixelGradient {
        centre: [
            by_bin,
            per_beam * ed * KERNEL_SCALE.recip() - slope * by_bin,
        ],
        // ½ Σ e s sᵀ, s = Σ⁻¹ (p − u)
        covariance: [zz, dz, dd],
        opacity_log: e,
        reflectivity_log,
    }
}

#[inline(always)]
fn twice<S: Simd>(a: V<S>) -> V<S> {
    a + a
}

/// Through (20) and (24) to the twelve parameters.
#[inline(always)]
fn chain<S: Simd>(
    frame: &Frame,
    one: &Projected<S>,
    pixels: &PixelGradient<S>,
    eight: &Eight,
) -> [V<S>; PARAMETER_COUNT] {
    let simd = one.opacity.simd;
    let [zz, dz, dd] = pixels.covariance;
    let [h_r, h_t] = one.half;
    let [_, rt, tt] = one.covariance;
    let slope = rt / tt;
    // What H's row of range has across the ridge: h_r − m h_θ, as (h_θ × (h_r × h_θ) + λ h_r)/Σ_θθ,
    // in which a needle's length does not cancel.
    let normal = cross(h_r, h_t);
    let upright = cross(h_t, normal);
    let across = each3(
        #[inline(always)]
        |k| (upright[k] + h_r[k] * frame.least_variance) / tt,
    );
    // Σ = H Hᵀ: dL/dH = 2 (dL/dΣ) H, along a and along b.
    let d_half = [
        each3(
            #[inline(always)]
            |k| twice(zz.mul_add(across[k], dz * h_t[k])),
        ),
        each3(
            #[inline(always)]
            |k| twice(dz.mul_add(across[k], dd * h_t[k])),
        ),
    ];
    // H = P R S; columns of dL/dR = Pᵀ dL/dH S.
    let [p_r, p_t] = one.pixels_per_m;
    let p_across = each3(
        #[inline(always)]
        |i| p_r[i] - slope * p_t[i],
    );
    let columns = each3(
        #[inline(always)]
        |k| {
            let (a, b) = (d_half[0][k] * one.scale_m[k], d_half[1][k] * one.scale_m[k]);
            each3(
                #[inline(always)]
                |i| p_across[i].mul_add(a, p_t[i] * b),
            )
        },
    );
    let d_scale = each3(
        #[inline(always)]
        |k| d_half[0][k].mul_add(across[k], d_half[1][k] * h_t[k]),
    );
    let rotation = rotation_gradient(one, &columns);
    let d_half_t = each3(
        #[inline(always)]
        |k| d_half[1][k] - slope * d_half[0][k],
    );
    let mean = mean_gradient(frame, one, pixels, [d_half[0], d_half_t]);
    let falls = exp(-lanes_of(simd, eight, 10).abs());
    let one_and = falls + 1.0;
    let opacity_slope = falls / (one_and * one_and);
    [
        mean[0],
        mean[1],
        mean[2],
        rotation[0],
        rotation[1],
        rotation[2],
        rotation[3],
        d_scale[0],
        d_scale[1],
        d_scale[2],
        pixels.opacity_log / one.opacity * opacity_slope,
        pixels.reflectivity_log,
    ]
}

/// A row of dL/dP = dL/dH (R S)ᵀ, world axes.
#[inline(always)]
fn row_gradient<S: Simd>(one: &Projected<S>, d_half: [V<S>; 3]) -> [V<S>; 3] {
    let scaled = each3(
        #[inline(always)]
        |k| d_half[k] * one.scale_m[k],
    );
    each3(
        #[inline(always)]
        |i| {
            let r = &one.rotation;
            dot(scaled, [r[0][i], r[1][i], r[2][i]])
        },
    )
}

/// Through the centre (20) and the Jacobian (19), which is taken where the mean is.
#[inline(always)]
fn mean_gradient<S: Simd>(
    frame: &Frame,
    one: &Projected<S>,
    pixels: &PixelGradient<S>,
    d_half: [[V<S>; 3]; 2],
) -> [V<S>; 3] {
    let (d_r, d_t) = (row_gradient(one, d_half[0]), row_gradient(one, d_half[1]));
    let (bins, beams) = (frame.bins_per_m, frame.beams_per_rad);
    let along = each3(
        #[inline(always)]
        |i| one.offset_m[i] * one.inverse_range,
    );
    let radial = pixels.centre[0] - dot(along, d_r) * one.inverse_range;
    // The azimuth's row depends on x and y of the sensor's frame.
    let [forward, left, _] = frame.axes;
    let (d_x, d_y) = (on_axis(d_t, forward), on_axis(d_t, left));
    let [x, y] = one.level_m;
    let skew = (x * y) + (x * y);
    let spread = y * y - x * x;
    let quartic = one.inverse_axis2 * one.inverse_axis2;
    let turn = pixels.centre[1] * one.inverse_axis2;
    let by_x = ((d_x * skew + d_y * spread) * quartic - turn * y) * beams;
    let by_y = ((d_x * spread - d_y * skew) * quartic + turn * x) * beams;
    each3(
        #[inline(always)]
        |i| {
            let by_range = (radial * along[i] + d_r[i] * one.inverse_range) * bins;
            by_range + by_x * forward[i] + by_y * left[i]
        },
    )
}

/// Through the rotation matrix and the length of the raw quaternion; `c` are columns of dL/dR.
#[inline(always)]
fn rotation_gradient<S: Simd>(one: &Projected<S>, c: &[[V<S>; 3]; 3]) -> [V<S>; 4] {
    let [x, y, z, w] = one.unit;
    let (xy, xz, yz) = (c[0][1] + c[1][0], c[0][2] + c[2][0], c[1][2] + c[2][1]);
    let (wx, wy, wz) = (c[1][2] - c[2][1], c[2][0] - c[0][2], c[0][1] - c[1][0]);
    let d = [
        twice(y * xy + z * xz + w * wx - twice(x * (c[1][1] + c[2][2]))),
        twice(x * xy + z * yz + w * wy - twice(y * (c[0][0] + c[2][2]))),
        twice(x * xz + y * yz + w * wz - twice(z * (c[0][0] + c[1][1]))),
        twice(x * wx + y * wy + z * wz),
    ];
    let along = d[3].mul_add(w, dot([d[0], d[1], d[2]], [x, y, z]));
    let held = |i: usize| (d[i] - along * one.unit[i]) * one.inverse_length;
    [held(0), held(1), held(2), held(3)]
}

/// Adds rows to the Gaussians `indices`, where `finite` has the lane's bit.
#[inline(always)]
fn scatter<S: Simd>(
    rows: &[V<S>; PARAMETER_COUNT],
    indices: &[u32],
    finite: u64,
    gradients: &mut [&mut [f32]; PARAMETER_COUNT],
) {
    let first = indices[0] as usize;
    let all = first..first + LANES;
    let in_a_row = finite == 0xff && are_in_a_row(indices);
    for (gradient, row) in gradients.iter_mut().zip(rows) {
        match gradient.get_mut(all.clone()) {
            Some(gradient) if in_a_row => {
                (*row + V::from_slice(row.simd, gradient)).store_slice(gradient);
            }
            _ => {
                for (lane, (&index, value)) in indices.iter().zip(row.to_array()).enumerate() {
                    if let Some(gradient) = gradient.get_mut(index as usize)
                        && finite >> lane & 1 == 1
                    {
                        *gradient += value;
                    }
                }
            }
        }
    }
}

/// Adds the gradients of all splats, whose moments are in the same order; returns how many were
/// left out because they were not finite.
#[inline(always)]
pub(super) fn add_gradients<S: Simd>(
    simd: S,
    frame: &Frame,
    gaussians: &GaussianArrays,
    splats: &[Splat],
    moments: &[Moments],
    gradients: &mut GradientArrays,
) -> u64 {
    let fields = gaussians.fields();
    let mut gradients = gradients.fields_mut();
    let mut eight = [[0.0; LANES]; PARAMETER_COUNT];
    let mut dropped = 0;
    for (splats, moments) in splats.chunks(LANES).zip(moments.chunks(LANES)) {
        let mut indices = [0; LANES];
        let mut sums = [[0.0; LANES]; MOMENTS];
        for (lane, (splat, moments)) in splats.iter().zip(moments).enumerate() {
            indices[lane] = splat.index;
            for (sum, moment) in sums.iter_mut().zip(moments) {
                sum[lane] = *moment;
            }
        }
        let indices = &indices[..splats.len()];
        gather(&fields, indices, &mut eight);
        let one = project(simd, frame, &eight);
        let sums = sums.map(
            #[inline(always)]
            |sum| V::simd_from(simd, sum),
        );
        let rows = chain(frame, &one, &from_moments(&one, sums), &eight);
        let size = rows.iter().fold(
            V::splat(simd, 0.0),
            #[inline(always)]
            |sum, row| sum + row.abs(),
        );
        let finite = size.simd_le(f32::MAX).to_bitmask();
        dropped += u64::from((!finite & ((1 << indices.len()) - 1)).count_ones());
        scatter(&rows, indices, finite, &mut gradients);
    }
    dropped
}
