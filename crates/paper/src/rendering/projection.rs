//! (14) to (24) for eight Gaussians at a time.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, mask32x8};

use super::{
    COVARIANCE_MAX, LEAST_AXIS_RATIO, LEAST_RANGE_M, PaperView, QUATERNION_LENGTHS, REACH_SIGMAS,
    REFLECTIVITY_MAX,
};
use crate::parameters::{GaussianArrays, OPACITY_MAX, PARAMETER_COUNT};
use echosplat_measurement::lanes::{LANES, exp, ratio_atan};

/// `√(½ log₂ e)`: with coordinates scaled by it, (25) is `2^−(z² + d²)`.
pub(super) const KERNEL_SCALE: f32 = 0.849_321_84;

/// A Gaussian in pixels, ready to be drawn.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Splat {
    /// (21): range bin and beam of the centre.
    pub(super) bin: f32,
    pub(super) beam: f32,
    /// Bins per beam along the splat's ridge: `Σ_rθ/Σ_θθ`.
    pub(super) slope: f32,
    /// [`KERNEL_SCALE`] over one sigma in range at a fixed azimuth: `√(Σ_θθ/det Σ)`.
    pub(super) bin_scale: f32,
    /// Its inverse.
    pub(super) bin_sigma: f32,
    /// [`KERNEL_SCALE`] over one sigma in azimuth.
    pub(super) beam_scale: f32,
    pub(super) opacity: f32,
    pub(super) reflectivity: f32,
    pub(super) range_m: f32,
    /// Beams it may cover, inside the image: first, and one beyond the last.
    pub(super) beams: [u32; 2],
    /// Which Gaussian it is.
    pub(super) index: u32,
    /// Its place before sorting.
    pub(super) origin: u32,
}

/// What projection needs of a view, divided out.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    position_m: [f32; 3],
    /// Forward, left, up in world coordinates.
    pub(super) axes: [[f32; 3]; 3],
    range_min_m: f32,
    pub(super) bins_per_m: f32,
    pub(super) beams_per_rad: f32,
    middle_beam: f32,
    last_bin: f32,
    last_beam: f32,
    pub(super) least_variance: f32,
}

impl Frame {
    /// Of a sound view.
    pub(super) fn of(view: &PaperView) -> Self {
        let axes = view.axes.to_cols_array_2d();
        let last_beam = (view.beams - 1) as f32;
        Self {
            position_m: view.position_m.to_array(),
            axes,
            range_min_m: view.range_min_m,
            bins_per_m: view.range_step_m.recip(),
            beams_per_rad: view.azimuth_step_rad().recip(),
            middle_beam: 0.5 * last_beam,
            last_bin: (view.range_bins - 1) as f32,
            last_beam,
            least_variance: view.least_pixel_variance,
        }
    }
}

pub(super) type V<S> = f32x8<S>;

/// `[f(0), f(1), f(2)]`, inlined for certain.
#[inline(always)]
pub(super) fn each3<T>(mut f: impl FnMut(usize) -> T) -> [T; 3] {
    [f(0), f(1), f(2)]
}

/// One parameter of eight Gaussians.
#[inline(always)]
pub(super) fn lanes_of<S: Simd>(simd: S, eight: &Eight, parameter: usize) -> V<S> {
    V::load_array_ref(simd, &eight[parameter])
}

/// `v · axis`.
#[inline(always)]
pub(super) fn on_axis<S: Simd>(v: [V<S>; 3], axis: [f32; 3]) -> V<S> {
    v[2].mul_add(axis[2], v[1].mul_add(axis[1], v[0] * axis[0]))
}

#[inline(always)]
pub(super) fn dot<S: Simd>(a: [V<S>; 3], b: [V<S>; 3]) -> V<S> {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

/// `a × b`, whose differences lose what cancels.
#[inline(always)]
pub(super) fn cross<S: Simd>(a: [V<S>; 3], b: [V<S>; 3]) -> [V<S>; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Columns of the rotation matrix of a unit quaternion.
#[inline(always)]
fn rotation_columns<S: Simd>([x, y, z, w]: [V<S>; 4]) -> [[V<S>; 3]; 3] {
    let (x2, y2, z2) = (x + x, y + y, z + z);
    let (xx, yy, zz) = (x * x2, y * y2, z * z2);
    let (xy, xz, yz) = (x * y2, x * z2, y * z2);
    let (wx, wy, wz) = (w * x2, w * y2, w * z2);
    let one = V::splat(x.simd, 1.0);
    [
        [one - (yy + zz), xy + wz, xz - wy],
        [xy - wz, one - (xx + zz), yz + wx],
        [xz + wy, yz - wx, one - (xx + yy)],
    ]
}

/// Eight Gaussians on their way from world to pixels, with all that the way back needs.
#[derive(Clone, Copy)]
pub(super) struct Projected<S: Simd> {
    /// Mean relative to the sensor, world axes.
    pub(super) offset_m: [V<S>; 3],
    /// Mean in the sensor's frame: x, y.
    pub(super) level_m: [V<S>; 2],
    pub(super) inverse_range: V<S>,
    /// 1/(x² + y²).
    pub(super) inverse_axis2: V<S>,
    pub(super) unit: [V<S>; 4],
    pub(super) inverse_length: V<S>,
    /// Columns of R and of `R S`.
    pub(super) rotation: [[V<S>; 3]; 3],
    pub(super) scale_m: [V<S>; 3],
    /// Rows of `D J` in world axes.
    pub(super) pixels_per_m: [[V<S>; 3]; 2],
    /// Rows of `D J R S`.
    pub(super) half: [[V<S>; 3]; 2],
    /// (24): rr, rθ, θθ, and the determinant.
    pub(super) covariance: [V<S>; 3],
    pub(super) determinant: V<S>,
    pub(super) opacity: V<S>,
    pub(super) reflectivity: V<S>,
    range_m: V<S>,
    bin: V<S>,
    beam: V<S>,
    sound: mask32x8<S>,
}

/// Parameters of eight Gaussians, one array per parameter; NaN where there is none.
pub(super) type Eight = [[f32; LANES]; PARAMETER_COUNT];

/// Whether there are eight, each one more than the one before.
#[inline(always)]
pub(super) fn are_in_a_row(indices: &[u32]) -> bool {
    let follows = |(k, &index): (usize, &u32)| index as usize == indices[0] as usize + k;
    indices.len() == LANES && indices.iter().enumerate().all(follows)
}

/// The Gaussians `indices` (at most eight); indices beyond the arrays give NaN.
#[inline(always)]
pub(super) fn gather(fields: &[&[f32]; PARAMETER_COUNT], indices: &[u32], eight: &mut Eight) {
    let first = indices.first().map_or(0, |&index| index as usize);
    let in_a_row = are_in_a_row(indices);
    for (lanes, field) in eight.iter_mut().zip(fields) {
        match field.get(first..first + LANES) {
            Some(eight) if in_a_row => lanes.copy_from_slice(eight),
            _ => {
                *lanes = [f32::NAN; LANES];
                for (lane, &index) in lanes.iter_mut().zip(indices) {
                    *lane = field.get(index as usize).copied().unwrap_or(f32::NAN);
                }
            }
        }
    }
}

/// (14) to (24).
#[inline(always)]
pub(super) fn project<S: Simd>(simd: S, frame: &Frame, eight: &Eight) -> Projected<S> {
    let one = V::splat(simd, 1.0);
    let offset_m = each3(
        #[inline(always)]
        |i| lanes_of(simd, eight, i) - frame.position_m[i],
    );
    let x = on_axis(offset_m, frame.axes[0]);
    let y = on_axis(offset_m, frame.axes[1]);
    let axis2 = y.mul_add(y, x * x);
    let range_m = dot(offset_m, offset_m).sqrt();
    let inverse_range = one / range_m;
    let inverse_axis2 = one / axis2;
    let least_axis_m = range_m * LEAST_AXIS_RATIO;
    let apart = range_m.simd_gt(LEAST_RANGE_M) & axis2.simd_gt(least_axis_m * least_axis_m);

    let raw = [
        lanes_of(simd, eight, 3),
        lanes_of(simd, eight, 4),
        lanes_of(simd, eight, 5),
        lanes_of(simd, eight, 6),
    ];
    let length2 = raw[3].mul_add(
        raw[3],
        dot([raw[0], raw[1], raw[2]], [raw[0], raw[1], raw[2]]),
    );
    let [short, long] = QUATERNION_LENGTHS.map(|length| length * length);
    let turned = length2.simd_gt(short) & length2.simd_lt(long);
    let inverse_length = one / length2.sqrt();
    let unit = [
        raw[0] * inverse_length,
        raw[1] * inverse_length,
        raw[2] * inverse_length,
        raw[3] * inverse_length,
    ];
    let rotation = rotation_columns(unit);
    let scale_m = [
        exp(lanes_of(simd, eight, 7)),
        exp(lanes_of(simd, eight, 8)),
        exp(lanes_of(simd, eight, 9)),
    ];

    // Rows of (19), each over its pixel.
    let along = inverse_range * frame.bins_per_m;
    let across = inverse_axis2 * frame.beams_per_rad;
    let [forward, left, _] = frame.axes;
    let pixels_per_m = [
        each3(
            #[inline(always)]
            |i| offset_m[i] * along,
        ),
        each3(
            #[inline(always)]
            |i| (x * left[i] - y * forward[i]) * across,
        ),
    ];
    let half = [
        each3(
            #[inline(always)]
            |k| dot(pixels_per_m[0], rotation[k]) * scale_m[k],
        ),
        each3(
            #[inline(always)]
            |k| dot(pixels_per_m[1], rotation[k]) * scale_m[k],
        ),
    ];
    let least = frame.least_variance;
    let (rr, tt) = (dot(half[0], half[0]), dot(half[1], half[1]));
    let normal = cross(half[0], half[1]);
    // det (H Hᵀ + λ) = |h_r × h_θ|² + λ (|h_r|² + |h_θ|²) + λ²: no difference of large numbers.
    let determinant = (rr + tt + least).mul_add(least, dot(normal, normal));
    let covariance = [rr + least, dot(half[0], half[1]), tt + least];

    let ahead = ratio_atan(y, x.abs());
    let behind = V::splat(simd, std::f32::consts::PI).copysign(y) - ahead;
    let azimuth = x.simd_lt(0.0).select(behind, ahead);
    let opacity = (one / (exp(-lanes_of(simd, eight, 10)) + 1.0)).min(OPACITY_MAX);
    let reflectivity = exp(lanes_of(simd, eight, 11));
    // Comparisons with NaN are false; the lanes' eˣ of NaN is a number.
    let finite = |part: usize| lanes_of(simd, eight, part).abs().simd_le(f32::MAX);
    let drawn = finite(7)
        & finite(8)
        & finite(9)
        & finite(11)
        & covariance[0].simd_le(COVARIANCE_MAX)
        & covariance[2].simd_le(COVARIANCE_MAX)
        & determinant.simd_gt(f32::MIN_POSITIVE)
        & lanes_of(simd, eight, 10).abs().simd_le(f32::MAX)
        & lanes_of(simd, eight, 11).simd_le(REFLECTIVITY_MAX.ln());
    Projected {
        offset_m,
        level_m: [x, y],
        inverse_range,
        inverse_axis2,
        unit,
        inverse_length,
        rotation,
        scale_m,
        pixels_per_m,
        half,
        covariance,
        determinant,
        opacity,
        reflectivity,
        range_m,
        bin: (range_m - frame.range_min_m) * frame.bins_per_m,
        beam: azimuth.mul_add(frame.beams_per_rad, frame.middle_beam),
        sound: apart & turned & drawn,
    }
}

/// Appends those of eight Gaussians that touch the image.
#[inline(always)]
pub(super) fn push_splats<S: Simd>(
    one: &Projected<S>,
    frame: &Frame,
    indices: &[u32],
    splats: &mut Vec<Splat>,
) {
    let simd = one.bin.simd;
    let [rr, rt, tt] = one.covariance;
    let bin_reach = rr.sqrt() * REACH_SIGMAS;
    let deviation = tt.sqrt();
    let beam_reach = deviation * REACH_SIGMAS;
    let first = (one.beam - beam_reach).ceil().max(0.0);
    let last = (one.beam + beam_reach).floor().min(frame.last_beam);
    let inside = one.sound
        & first.simd_le(last)
        & (one.bin + bin_reach).simd_ge(0.0)
        & (one.bin - bin_reach).simd_le(frame.last_bin);
    let bin_scale = (tt / one.determinant).sqrt() * KERNEL_SCALE;
    let bin_sigma = V::splat(simd, 1.0) / bin_scale;
    let beam_scale = V::splat(simd, KERNEL_SCALE) / deviation;
    let [bin, beam, slope] = [one.bin, one.beam, rt / tt].map(V::to_array);
    let [bin_scale, bin_sigma, beam_scale] = [bin_scale, bin_sigma, beam_scale].map(V::to_array);
    let range_m = one.range_m.to_array();
    let [opacity, reflectivity] = [one.opacity, one.reflectivity].map(V::to_array);
    let [first, last] = [first, last].map(V::to_array);
    let inside = inside.to_bitmask();
    for (lane, &index) in indices.iter().enumerate().take(LANES) {
        if inside >> lane & 1 == 1 {
            splats.push(Splat {
                bin: bin[lane],
                beam: beam[lane],
                slope: slope[lane],
                bin_scale: bin_scale[lane],
                bin_sigma: bin_sigma[lane],
                beam_scale: beam_scale[lane],
                opacity: opacity[lane],
                reflectivity: reflectivity[lane],
                range_m: range_m[lane],
                beams: [first[lane] as u32, last[lane] as u32 + 1],
                index,
                origin: splats.len() as u32,
            });
        }
    }
}

/// All of `subset` that touch the image, in its order.
#[inline(always)]
pub(super) fn project_all<S: Simd>(
    simd: S,
    frame: &Frame,
    gaussians: &GaussianArrays,
    subset: &[u32],
    splats: &mut Vec<Splat>,
) {
    let fields = gaussians.fields();
    let mut eight = [[0.0; LANES]; PARAMETER_COUNT];
    for indices in subset.chunks(LANES) {
        gather(&fields, indices, &mut eight);
        let projected = project(simd, frame, &eight);
        push_splats(&projected, frame, indices, splats);
    }
}
