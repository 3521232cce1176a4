//! (16) to (19) and the closed forms of the measurement, eight Gaussians at a time.
//!
//! Determinants are sums of squares of minors, so nothing cancels: with `S` the sigmas and `u, v, w`
//! the directions of range, azimuth and elevation along the Gaussian's own axes,
//! `det Σ_(θφ) = Σ_k (s_i s_j u_k)²` and `Σ_rr Σ_θθ − Σ_rθ² = Σ_k (s_i s_j w_k)²`.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};

use super::constants::{
    BEAM_REACH_SIGMAS, LEAST_AREA2_M4, LEAST_FAN, LEAST_VARIANCE_M2, RANGE_REACH_SIGMAS, STRONGEST,
};
use super::raster;
use super::rows::{OnlineRow, Shadow};
use crate::PingGeometry;
use crate::lanes::{self, LANES};
use crate::parameters::{OPACITY_MAX, PARAMETER_COUNT};
use crate::ping_view::PingView;
use crate::triple::{Triple, cross, dot, gathered, times};

/// A ping's geometry as single numbers, worked out once per ping.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    pub(super) ping: PingView,
    cell_variance_rad2: [f32; 2],
}

impl View {
    pub(super) fn new(geometry: &PingGeometry) -> Self {
        Self {
            ping: PingView::new(geometry),
            cell_variance_rad2: raster::cell_rad(geometry).map(|size| (0.25 * size * size) as f32),
        }
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
        let ping = &view.ping;
        let place = ping.place(eight.mean_m);
        let y = place.mean[1];

        let [qx, qy, qz, qw] = eight.rotation;
        let length2 = qx.mul_add(qx, qy * qy) + qz.mul_add(qz, qw * qw);
        let inverse_length = one / length2.sqrt();
        let unit = [
            qx * inverse_length,
            qy * inverse_length,
            qz * inverse_length,
            qw * inverse_length,
        ];
        let along = rotated_back(unit, ping.range_axis(&place));
        let across = rotated_back(unit, ping.azimuth_axis(&place));
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
        let beam2 = place.lever2 * ping.beam_variance;
        let elevation = place.elevation();
        let section2 = dot(times(area2, along), along);
        let fan = ping.fan(elevation);
        let widest2 = beam2 + (s0 + s1 + s2);
        let seen = eight.finite()
            & place.in_front()
            & length2.simd_gt(0.0)
            & (y * y).simd_le(widest2 * (BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS))
            & fan.simd_gt(LEAST_FAN)
            & section2.simd_gt(LEAST_AREA2_M4);
        Self {
            still: place.still,
            still_m: place.still_m,
            mean: place.mean,
            lever_m: place.lever_m,
            range_m: place.range_m,
            azimuth: place.azimuth(),
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
        solid_angle * pattern * self.fan * (std::f32::consts::TAU * view.ping.sigma_b)
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
        let variance = self.own_variance() + view.ping.range_variance_m2;
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

/// Bins and fractions of one from the ping's start, inside the ping.
#[inline(always)]
fn bin_edge<S: Simd>(view: &View, range_m: f32x8<S>) -> f32x8<S> {
    let ping = &view.ping;
    let position = (range_m - ping.range_start_m) / ping.bin_length_m;
    position.max(0.0).min(ping.bin_count)
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
