//! (16) to (19) and the closed forms of the measurement, eight Gaussians at a time.
//!
//! Determinants are sums of squares of minors, so nothing cancels: with `S` the sigmas and `u, v, w`
//! the directions of range, azimuth and elevation along the Gaussian's own axes,
//! `det Σ_(θφ) = Σ_k (s_i s_j u_k)²` and `Σ_rr Σ_θθ − Σ_rθ² = Σ_k (s_i s_j w_k)²`.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};

use super::constants::{
    BEAM_REACH_SIGMAS, LEAST_AREA2_M4, LEAST_FAN, LEAST_VARIANCE_M2, NEAREST_M, RANGE_REACH_SIGMAS,
    SIDEWAYS, STRONGEST,
};
use super::raster;
use super::rows::{OnlineRow, Shadow};
use crate::Look;
use crate::lanes::{self, LANES};
use crate::parameters::{OPACITY_MAX, PARAMETER_COUNT};

/// Three numbers of eight Gaussians.
pub(super) type Triple<S> = [f32x8<S>; 3];

#[inline(always)]
pub(super) fn dot<S: Simd>(a: Triple<S>, b: Triple<S>) -> f32x8<S> {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

#[inline(always)]
pub(super) fn times<S: Simd>(a: Triple<S>, b: Triple<S>) -> Triple<S> {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

#[inline(always)]
pub(super) fn cross<S: Simd>(a: Triple<S>, b: Triple<S>) -> Triple<S> {
    [
        a[1].mul_sub(b[2], a[2] * b[1]),
        a[2].mul_sub(b[0], a[0] * b[2]),
        a[0].mul_sub(b[1], a[1] * b[0]),
    ]
}

#[inline(always)]
fn weighted<S: Simd>(v: Triple<S>, [x, y, z]: [f32; 3]) -> f32x8<S> {
    v[0].mul_add(x, v[1].mul_add(y, v[2] * z))
}

/// A look in single numbers, worked out once per ping.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    /// Axes of the beam's frame: along, left, up.
    pub(super) axes: [[f32; 3]; 3],
    position_m: [f32; 3],
    pub(super) drift_per_m: [f32; 3],
    pub(super) reference_range_m: f32,
    pub(super) sigma_b: f32,
    /// Variance in azimuth of beam and attitude.
    pub(super) beam_variance: f32,
    pub(super) inverse_half_width: f32,
    pub(super) cell_variance_rad2: [f32; 2],
    range_variance_m2: f32,
    range_start_m: f32,
    bin_length_m: f32,
    bin_count: f32,
}

impl View {
    pub(super) fn new(look: &Look) -> Self {
        let sigma_b = look.beam.azimuth_sigma_rad();
        Self {
            axes: look.pose.axes.to_cols_array_2d(),
            position_m: look.pose.position_m.to_array(),
            drift_per_m: look.pose.drift_per_m.to_array(),
            reference_range_m: look.pose.reference_range_m,
            sigma_b,
            beam_variance: sigma_b * sigma_b + look.azimuth_variance_rad2,
            inverse_half_width: 1.0 / look.beam.elevation_half_width_rad(),
            cell_variance_rad2: raster::cell_rad(look).map(|size| (0.25 * size * size) as f32),
            range_variance_m2: look.range_variance_m2,
            range_start_m: look.range_start_m,
            bin_length_m: look.bin_length_m,
            bin_count: look.bin_count as f32,
        }
    }

    /// `R v`.
    #[inline(always)]
    pub(super) fn in_world_frame<S: Simd>(&self, v: Triple<S>) -> Triple<S> {
        let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = self.axes;
        [
            weighted(v, [xx, yx, zx]),
            weighted(v, [xy, yy, zy]),
            weighted(v, [xz, yz, zz]),
        ]
    }

    /// `Rᵀ v`.
    #[inline(always)]
    fn in_beam_frame<S: Simd>(&self, v: Triple<S>) -> Triple<S> {
        let [along, left, up] = self.axes;
        [weighted(v, along), weighted(v, left), weighted(v, up)]
    }
}

/// The parameters of eight Gaussians.
#[derive(Clone, Copy)]
pub(super) struct Eight<S: Simd> {
    mean_m: Triple<S>,
    rotation: [f32x8<S>; 4],
    log_scale: Triple<S>,
    pub(super) opacity_logit: f32x8<S>,
    reflectivity_log: f32x8<S>,
}

#[inline(always)]
fn gathered<S: Simd>(simd: S, field: &[f32], indices: [u32; LANES]) -> f32x8<S> {
    let (first, last) = (indices[0] as usize, indices[LANES - 1] as usize);
    // Ascending and each once: eight in a row if the ends say so.
    if last - first == LANES - 1 {
        return f32x8::from_slice(simd, &field[first..=last]);
    }
    let mut values = [0.0; LANES];
    for (value, index) in values.iter_mut().zip(indices) {
        *value = field[index as usize];
    }
    f32x8::simd_from(simd, values)
}

impl<S: Simd> Eight<S> {
    /// Those at `indices`, which all must exist and ascend; the last may be repeated.
    #[inline(always)]
    pub(super) fn gather(
        simd: S,
        fields: &[&[f32]; PARAMETER_COUNT],
        indices: [u32; LANES],
    ) -> Self {
        let [mx, my, mz, qx, qy, qz, qw, sx, sy, sz, logit, log] = fields;
        Self {
            mean_m: [
                gathered(simd, mx, indices),
                gathered(simd, my, indices),
                gathered(simd, mz, indices),
            ],
            rotation: [
                gathered(simd, qx, indices),
                gathered(simd, qy, indices),
                gathered(simd, qz, indices),
                gathered(simd, qw, indices),
            ],
            log_scale: [
                gathered(simd, sx, indices),
                gathered(simd, sy, indices),
                gathered(simd, sz, indices),
            ],
            opacity_logit: gathered(simd, logit, indices),
            reflectivity_log: gathered(simd, log, indices),
        }
    }

    /// Where all twelve numbers are finite.
    #[inline(always)]
    fn finite(&self) -> mask32x8<S> {
        let [mx, my, mz] = self.mean_m;
        let [qx, qy, qz, qw] = self.rotation;
        let [sx, sy, sz] = self.log_scale;
        let numbers = [
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
            self.reflectivity_log,
        ];
        let mut nothing = lanes::nothing(self.opacity_logit);
        for number in numbers {
            nothing += lanes::nothing(number);
        }
        nothing.simd_eq(0.0)
    }

    #[inline(always)]
    pub(super) fn opacity(&self) -> f32x8<S> {
        let one = f32x8::splat(self.opacity_logit.simd, 1.0);
        (one / (lanes::exp(-self.opacity_logit) + 1.0)).min(OPACITY_MAX)
    }

    /// dα/d logit; see [`crate::opacity_slope`].
    #[inline(always)]
    pub(super) fn opacity_slope(&self) -> f32x8<S> {
        let falls = lanes::exp(-self.opacity_logit.abs());
        let one_and = falls + 1.0;
        falls / (one_and * one_and)
    }
}

/// Eight Gaussians in the beam's frame.
#[derive(Clone, Copy)]
pub(super) struct Sight<S: Simd> {
    /// Means before what the sensor drifts, and after; distance of the former.
    pub(super) still: Triple<S>,
    pub(super) still_m: f32x8<S>,
    pub(super) mean: Triple<S>,
    pub(super) lever_m: f32x8<S>,
    pub(super) range_m: f32x8<S>,
    pub(super) azimuth: f32x8<S>,
    pub(super) elevation: f32x8<S>,
    /// Unit quaternion, and one over the length of the raw one.
    pub(super) unit: [f32x8<S>; 4],
    pub(super) inverse_length: f32x8<S>,
    pub(super) along: Triple<S>,
    pub(super) across: Triple<S>,
    pub(super) up: Triple<S>,
    pub(super) scale2: Triple<S>,
    pub(super) area2: Triple<S>,
    pub(super) rr: f32x8<S>,
    pub(super) rt: f32x8<S>,
    pub(super) tt: f32x8<S>,
    pub(super) section2: f32x8<S>,
    pub(super) side2: f32x8<S>,
    pub(super) beam2: f32x8<S>,
    pub(super) total2: f32x8<S>,
    /// Sensitivity of the fan.
    fan: f32x8<S>,
    /// Lanes that the ping sees.
    pub(super) seen: mask32x8<S>,
}

/// `v` turned by the inverse of a unit quaternion: `v − 2w(q×v) + 2q×(q×v)`.
#[inline(always)]
fn rotated_back<S: Simd>([x, y, z, w]: [f32x8<S>; 4], v: Triple<S>) -> Triple<S> {
    let axis = [x, y, z];
    let once = cross(axis, v);
    let twice = cross(axis, once);
    [
        (twice[0] - w * once[0]).mul_add(2.0, v[0]),
        (twice[1] - w * once[1]).mul_add(2.0, v[1]),
        (twice[2] - w * once[2]).mul_add(2.0, v[2]),
    ]
}

impl<S: Simd> Sight<S> {
    #[inline(always)]
    pub(super) fn new(view: &View, eight: &Eight<S>) -> Self {
        let simd = eight.opacity_logit.simd;
        let one = f32x8::splat(simd, 1.0);
        let [px, py, pz] = view.position_m;
        let [mx, my, mz] = eight.mean_m;
        let still = view.in_beam_frame([mx - px, my - py, mz - pz]);
        let still_m = dot(still, still).sqrt();
        let [left, turn, roll] = view.drift_per_m;
        let rate = still[0] * turn - still[2] * roll + left;
        let mean = [
            still[0],
            still[1] - (still_m - view.reference_range_m) * rate,
            still[2],
        ];
        let [x, y, z] = mean;
        let lever2 = x.mul_add(x, y * y);
        let lever_m = lever2.sqrt();
        let range_m = z.mul_add(z, lever2).sqrt();
        let (by_lever, by_range) = (one / lever_m, one / range_m);

        let [qx, qy, qz, qw] = eight.rotation;
        let length2 = qx.mul_add(qx, qy * qy) + qz.mul_add(qz, qw * qw);
        let inverse_length = one / length2.sqrt();
        let unit = [
            qx * inverse_length,
            qy * inverse_length,
            qz * inverse_length,
            qw * inverse_length,
        ];
        let zero = f32x8::splat(simd, 0.0);
        let outward = [x * by_range, y * by_range, z * by_range];
        let along = rotated_back(unit, view.in_world_frame(outward));
        let leftward = [-y * by_lever, x * by_lever, zero];
        let across = rotated_back(unit, view.in_world_frame(leftward));
        let up = cross(along, across);

        let [s0, s1, s2] = eight.log_scale;
        let (s0, s1, s2) = (
            lanes::exp(s0 + s0),
            lanes::exp(s1 + s1),
            lanes::exp(s2 + s2),
        );
        let scale2 = [s0, s1, s2];
        let area2 = [s1 * s2, s2 * s0, s0 * s1];
        let (stretched, flattened) = (times(scale2, along), times(scale2, across));
        let tt = dot(flattened, across);
        let beam2 = lever2 * view.beam_variance;
        let elevation = lanes::ratio_atan(z, lever_m);
        let section2 = dot(times(area2, along), along);
        let fan = fan(view, elevation);
        let widest2 = beam2 + (s0 + s1 + s2);
        let seen = eight.finite()
            & range_m.simd_gt(NEAREST_M)
            & x.simd_gt(range_m * SIDEWAYS)
            & length2.simd_gt(0.0)
            & (y * y).simd_le(widest2 * (BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS))
            & fan.simd_gt(LEAST_FAN)
            & section2.simd_gt(LEAST_AREA2_M4);
        Self {
            still,
            still_m,
            mean,
            lever_m,
            range_m,
            azimuth: lanes::ratio_atan(y, x),
            elevation,
            unit,
            inverse_length,
            along,
            across,
            up,
            scale2,
            area2,
            rr: dot(stretched, along),
            rt: dot(stretched, across),
            tt,
            section2,
            side2: dot(times(area2, up), up),
            beam2,
            total2: beam2 + tt,
            fan,
            seen,
        }
    }

    /// Energy over all bins for αρT = 1.
    #[inline(always)]
    fn energy(&self, view: &View) -> f32x8<S> {
        let arc = self.azimuth * self.lever_m;
        let pattern = lanes::exp(arc * arc / self.total2 * -0.5) * self.lever_m;
        let solid_angle = (self.section2 / self.total2).sqrt() / (self.range_m * self.range_m);
        solid_angle * pattern * self.fan * (std::f32::consts::TAU * view.sigma_b)
    }

    /// r′ − r̄.
    #[inline(always)]
    fn offset(&self) -> f32x8<S> {
        -(self.azimuth * self.lever_m * self.rt / self.total2)
    }

    /// What the Gaussian adds to s².
    #[inline(always)]
    pub(super) fn own_variance(&self) -> f32x8<S> {
        self.rr.mul_add(self.beam2, self.side2) / self.total2
    }

    /// s², and where it stands above its floor.
    #[inline(always)]
    pub(super) fn range_variance(&self, view: &View) -> (f32x8<S>, mask32x8<S>) {
        let variance = self.own_variance() + view.range_variance_m2;
        (
            variance.max(LEAST_VARIANCE_M2),
            variance.simd_gt(LEAST_VARIANCE_M2),
        )
    }

    #[inline(always)]
    pub(super) fn shadow(&self, view: &View) -> ShadowLanes<S> {
        let lifted = times(self.scale2, self.up);
        let (by_lever, by_range) = (
            f32x8::splat(self.tt.simd, 1.0) / self.lever_m,
            f32x8::splat(self.tt.simd, 1.0) / self.range_m,
        );
        let tt = self.tt * by_lever * by_lever;
        let tp = dot(lifted, self.across) * by_lever * by_range;
        let pp = dot(lifted, self.up) * by_range * by_range;
        let [ct, cp] = view.cell_variance_rad2;
        let both = by_lever * by_range;
        let determinant = self.section2 * both * both;
        let widened = determinant + pp * ct + tt * cp + ct * cp;
        let width2 = tt + ct;
        ShadowLanes {
            tt,
            tp,
            pp,
            inverse_width: f32x8::splat(tt.simd, 1.0) / width2.sqrt(),
            slope: tp / width2,
            inverse_height: (width2 / widened).sqrt(),
            height: (pp + cp).sqrt(),
            peak: (determinant / widened).sqrt(),
        }
    }
}

/// `g(φ)`.
#[inline(always)]
fn fan<S: Simd>(view: &View, elevation: f32x8<S>) -> f32x8<S> {
    let x = elevation * view.inverse_half_width;
    let x2 = x * x;
    let x4 = x2 * x2;
    lanes::exp(x4 * x4 * -std::f32::consts::LN_2)
}

/// [`Shadow`] of eight Gaussians, with their covariances in radians.
#[derive(Clone, Copy)]
pub(super) struct ShadowLanes<S: Simd> {
    pub(super) tt: f32x8<S>,
    pub(super) tp: f32x8<S>,
    pub(super) pp: f32x8<S>,
    pub(super) inverse_width: f32x8<S>,
    pub(super) slope: f32x8<S>,
    pub(super) inverse_height: f32x8<S>,
    height: f32x8<S>,
    peak: f32x8<S>,
}

/// Appends a row for each of `indices` that the ping sees; all must exist.
#[inline(always)]
pub(super) fn project<S: Simd>(
    simd: S,
    view: &View,
    fields: &[&[f32]; PARAMETER_COUNT],
    indices: &[u32],
    occlusion: bool,
    rows: &mut Vec<OnlineRow>,
) {
    for chunk in indices.chunks(LANES) {
        let mut eight_indices = [chunk[chunk.len() - 1]; LANES];
        eight_indices[..chunk.len()].copy_from_slice(chunk);
        let eight = Eight::gather(simd, fields, eight_indices);
        let sight = Sight::new(view, &eight);
        push_rows(view, &eight, &sight, chunk, occlusion, rows);
    }
}

#[inline(always)]
fn push_rows<S: Simd>(
    view: &View,
    eight: &Eight<S>,
    sight: &Sight<S>,
    chunk: &[u32],
    occlusion: bool,
    rows: &mut Vec<OnlineRow>,
) {
    let simd = eight.opacity_logit.simd;
    let energy = sight.energy(view);
    let offset = sight.offset();
    let on_axis = sight.range_m + offset;
    let sigma = sight.range_variance(view).0.sqrt();
    let reflectivity = lanes::exp(eight.reflectivity_log);
    let inverse_sigma = f32x8::splat(simd, 1.0) / sigma;
    let reach = sigma * RANGE_REACH_SIGMAS;
    let first = bin_edge(view, on_axis - reach).floor();
    let last = bin_edge(view, on_axis + reach).ceil();
    // What is not finite here came of numbers too large to square.
    let nothing = lanes::nothing(energy) + lanes::nothing(on_axis) + lanes::nothing(sigma);
    let bounded = (energy * reflectivity).simd_lt(STRONGEST);
    let seen = sight.seen & nothing.simd_eq(0.0) & bounded;
    let bits = seen.to_bitmask();
    let (energy, opacity) = (energy.to_array(), eight.opacity().to_array());
    let (first, last) = (first.to_array(), last.to_array());
    let (range_m, offset) = (sight.range_m.to_array(), offset.to_array());
    let (reflectivity, inverse_sigma) = (reflectivity.to_array(), inverse_sigma.to_array());
    let from = rows.len();
    for (lane, &index) in chunk.iter().enumerate() {
        if bits >> lane & 1 == 0 {
            continue;
        }
        rows.push(OnlineRow {
            index,
            first_bin: first[lane] as u32,
            bin_count: (last[lane] as u32).saturating_sub(first[lane] as u32),
            transmittance: 1.0,
            energy: energy[lane],
            opacity: opacity[lane],
            reflectivity: reflectivity[lane],
            range_m: range_m[lane],
            offset_m: offset[lane],
            inverse_sigma: inverse_sigma[lane],
            shadow: Shadow::default(),
        });
    }
    if occlusion {
        set_shadows(view, sight, bits, &mut rows[from..]);
    }
}

/// Bins and parts of one from the ping's start, inside the ping.
#[inline(always)]
fn bin_edge<S: Simd>(view: &View, range_m: f32x8<S>) -> f32x8<S> {
    let position = (range_m - view.range_start_m) / view.bin_length_m;
    position.max(0.0).min(view.bin_count)
}

#[inline(always)]
fn set_shadows<S: Simd>(view: &View, sight: &Sight<S>, mut bits: u64, rows: &mut [OnlineRow]) {
    let shadow = sight.shadow(view);
    let (azimuth, elevation) = (sight.azimuth.to_array(), sight.elevation.to_array());
    let (inverse_width, slope) = (shadow.inverse_width.to_array(), shadow.slope.to_array());
    let (inverse_height, height) = (shadow.inverse_height.to_array(), shadow.height.to_array());
    let peak = shadow.peak.to_array();
    for row in rows {
        let lane = bits.trailing_zeros() as usize % LANES;
        bits &= bits.wrapping_sub(1);
        row.shadow = Shadow {
            azimuth_rad: azimuth[lane],
            elevation_rad: elevation[lane],
            inverse_width: inverse_width[lane],
            slope: slope[lane],
            inverse_height: inverse_height[lane],
            height_rad: height[lane],
            peak: peak[lane],
            overlap: 0.0,
        };
    }
}
