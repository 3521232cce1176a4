//! Which Gaussians a ping sees and how: [`Look::project`], eight Gaussians at a time.

use std::ops::Range;

use echosplat_acoustics::lanes::{self, LANES};
use echosplat_acoustics::{Look, Splat};
use echosplat_model::glam::Vec3;
use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};

use crate::refine::field::{Field, NUMBERS};

/// The cuts of [`Look::project`].
const BEAM_REACH_SIGMAS: f32 = 3.3;
const NEAREST_M: f32 = 0.05;
const SIDEWAYS: f32 = 0.25;
const LEAST_FAN: f32 = 1e-3;
/// Elevation over the fan's half-width at which its sensitivity has fallen to [`LEAST_FAN`].
const FAN_REACH: f32 = 1.333;
/// Bins this many sigmas from the mean are left out: 2·10⁻⁴ of the energy.
const RANGE_REACH_SIGMAS: f32 = 3.7;

/// One Gaussian in one ping.
#[derive(Debug, Clone)]
pub(crate) struct Row {
    pub(crate) slot: u32,
    pub(crate) splat: Splat,
    /// Strength towards this ping's sensor.
    pub(crate) strength: f32,
    /// Bins it reaches, never empty.
    pub(crate) bins: Range<u32>,
    /// Where its energies begin among those of the ping.
    pub(crate) energies_from: u32,
}

type Triple<S> = [f32x8<S>; 3];

/// A look in single numbers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    /// Along, left and up.
    axes: [[f32; 3]; 3],
    position_m: [f32; 3],
    drift_per_m: [f32; 3],
    reference_range_m: f32,
    sigma_b: f32,
    /// Variance in azimuth of beam and attitude.
    beam_variance: f32,
    inverse_half_width: f32,
    /// Whether sensitivity falls off over elevation.
    is_graded: bool,
    /// Tangent of the fan's reach.
    fan_tangent: f32,
    range_variance_m2: f32,
    range_start_m: f32,
    bins_per_m: f32,
    bin_count: f32,
}

impl View {
    pub(crate) fn of(look: &Look, is_graded: bool) -> Self {
        let sigma_b = look.beam.azimuth_sigma_rad();
        let half_width = look.beam.elevation_half_width_rad();
        Self {
            axes: look.pose.axes.to_cols_array_2d(),
            position_m: look.pose.position_m.to_array(),
            drift_per_m: look.pose.drift_per_m.to_array(),
            reference_range_m: look.pose.reference_range_m,
            sigma_b,
            beam_variance: sigma_b * sigma_b + look.azimuth_variance_rad2,
            inverse_half_width: 1.0 / half_width,
            is_graded,
            fan_tangent: (FAN_REACH * half_width).min(1.5).tan(),
            range_variance_m2: look.range_variance_m2,
            range_start_m: look.range_start_m,
            bins_per_m: 1.0 / look.bin_length_m,
            bin_count: look.bin_count as f32,
        }
    }
}

#[inline(always)]
fn weighted<S: Simd>(v: Triple<S>, [x, y, z]: [f32; 3]) -> f32x8<S> {
    v[0].mul_add(x, v[1].mul_add(y, v[2] * z))
}

#[inline(always)]
fn dot<S: Simd>(a: Triple<S>, b: Triple<S>) -> f32x8<S> {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}

#[inline(always)]
fn cross<S: Simd>(a: Triple<S>, b: Triple<S>) -> Triple<S> {
    [
        a[1].mul_sub(b[2], a[2] * b[1]),
        a[2].mul_sub(b[0], a[0] * b[2]),
        a[0].mul_sub(b[1], a[1] * b[0]),
    ]
}

/// Means in the beam's frame, moved by what the sensor drifts until their echo.
#[inline(always)]
fn in_beam<S: Simd>(view: &View, mean_m: Triple<S>) -> Triple<S> {
    let [px, py, pz] = view.position_m;
    let d = [mean_m[0] - px, mean_m[1] - py, mean_m[2] - pz];
    let [x, y, z] = view.axes.map_axes(d);
    let late_m = dot([x, y, z], [x, y, z]).sqrt() - view.reference_range_m;
    let [left, turn, roll] = view.drift_per_m;
    let rate = x * turn - z * roll + left;
    [x, y - late_m * rate, z]
}

/// Turning by a rotation's columns.
trait Axes {
    fn map_axes<S: Simd>(&self, v: Triple<S>) -> Triple<S>;
    fn back<S: Simd>(&self, v: Triple<S>) -> Triple<S>;
}

impl Axes for [[f32; 3]; 3] {
    /// `Rᵀ v`.
    #[inline(always)]
    fn map_axes<S: Simd>(&self, v: Triple<S>) -> Triple<S> {
        [
            weighted(v, self[0]),
            weighted(v, self[1]),
            weighted(v, self[2]),
        ]
    }

    /// `R v`.
    #[inline(always)]
    fn back<S: Simd>(&self, v: Triple<S>) -> Triple<S> {
        let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = *self;
        [
            weighted(v, [xx, yx, zx]),
            weighted(v, [xy, yy, zy]),
            weighted(v, [xz, yz, zz]),
        ]
    }
}

/// Appends the places among `members` that the ping may see: a first look that spares most the rest.
#[inline(always)]
pub(crate) fn cull<S: Simd>(
    simd: S,
    view: &View,
    numbers: &[Vec<f32>; NUMBERS],
    members: Range<usize>,
    places: &mut Vec<u32>,
) {
    let mut from = members.start;
    while from < members.end {
        let eight = from..from + LANES;
        let mean_m = [
            f32x8::from_slice(simd, &numbers[0][eight.clone()]),
            f32x8::from_slice(simd, &numbers[1][eight.clone()]),
            f32x8::from_slice(simd, &numbers[2][eight.clone()]),
        ];
        let widest_m2 = f32x8::from_slice(simd, &numbers[3][eight.clone()])
            + f32x8::from_slice(simd, &numbers[4][eight.clone()])
            + f32x8::from_slice(simd, &numbers[5][eight]);
        let [x, y, z] = in_beam(view, mean_m);
        let lever2 = x.mul_add(x, y * y);
        let range_m = z.mul_add(z, lever2).sqrt();
        let reach2 = lever2.mul_add(view.beam_variance, widest_m2);
        let tangent2 = view.fan_tangent * view.fan_tangent;
        let seen = range_m.simd_gt(NEAREST_M)
            & x.simd_gt(range_m * SIDEWAYS)
            & (y * y).simd_le(reach2 * (BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS))
            & (z * z).simd_le(lever2 * tangent2);
        let left = members.end - from;
        let mut bits = seen.to_bitmask() & 0xff;
        if left < LANES {
            bits &= (1 << left) - 1;
        }
        while bits != 0 {
            places.push(from as u32 + bits.trailing_zeros());
            bits &= bits - 1;
        }
        from += LANES;
    }
}

#[inline(always)]
fn gathered<S: Simd>(simd: S, numbers: &[f32], places: [u32; LANES]) -> f32x8<S> {
    let (first, last) = (places[0] as usize, places[LANES - 1] as usize);
    // Ascending and each once: eight in a row if the ends say so.
    if last.wrapping_sub(first) == LANES - 1 {
        return f32x8::from_slice(simd, &numbers[first..=last]);
    }
    let mut values = [0.0; LANES];
    for (value, place) in values.iter_mut().zip(places) {
        *value = numbers[place as usize];
    }
    f32x8::simd_from(simd, values)
}

#[inline(always)]
fn gathered_triple<S: Simd>(
    simd: S,
    numbers: &[Vec<f32>; NUMBERS],
    from: usize,
    places: [u32; LANES],
) -> Triple<S> {
    [
        gathered(simd, &numbers[from], places),
        gathered(simd, &numbers[from + 1], places),
        gathered(simd, &numbers[from + 2], places),
    ]
}

/// Covariances times vectors.
#[inline(always)]
fn times<S: Simd>(diagonal: Triple<S>, mixed: Triple<S>, v: Triple<S>) -> Triple<S> {
    let [yz, xz, xy] = mixed;
    [
        diagonal[0].mul_add(v[0], xy.mul_add(v[1], xz * v[2])),
        xy.mul_add(v[0], diagonal[1].mul_add(v[1], yz * v[2])),
        xz.mul_add(v[0], yz.mul_add(v[1], diagonal[2] * v[2])),
    ]
}

/// Appends the Gaussians at `places` in their order, their energies still to come; those that the ping
/// does not see after all are left out.
#[inline(always)]
pub(crate) fn project<S: Simd>(
    simd: S,
    view: &View,
    field: &Field,
    places: &[u32],
    rows: &mut Vec<Row>,
) {
    for chunk in places.chunks(LANES) {
        let mut eight = [chunk[chunk.len() - 1]; LANES];
        eight[..chunk.len()].copy_from_slice(chunk);
        project_eight(simd, view, field, eight, chunk.len(), rows);
    }
}

/// (18), (19) and the closed forms of the measurement: beam folded in, `Ω`, `r′`, `s²`.
#[inline(always)]
fn project_eight<S: Simd>(
    simd: S,
    view: &View,
    field: &Field,
    places: [u32; LANES],
    count: usize,
    rows: &mut Vec<Row>,
) {
    let numbers = field.numbers();
    let triple = |from: usize| gathered_triple(simd, numbers, from, places);
    let (mean_m, diagonal, mixed) = (triple(0), triple(3), triple(6));
    let (ahead, behind) = (triple(9), triple(12));
    let one = f32x8::splat(simd, 1.0);
    let zero = f32x8::splat(simd, 0.0);
    let [x, y, z] = in_beam(view, mean_m);
    let lever2 = x.mul_add(x, y * y);
    let lever_m = lever2.sqrt();
    let range_m = z.mul_add(z, lever2).sqrt();
    let (by_lever, by_range) = (one / lever_m, one / range_m);
    let range_axis = view.axes.back([x * by_range, y * by_range, z * by_range]);
    let azimuth_axis = view.axes.back([-y * by_lever, x * by_lever, zero]);
    let elevation_axis = cross(range_axis, azimuth_axis);
    let azimuth_rad = lanes::ratio_atan(y, x);
    let elevation_rad = lanes::ratio_atan(z, lever_m);

    let along = times(diagonal, mixed, range_axis);
    let across = times(diagonal, mixed, azimuth_axis);
    let up = times(diagonal, mixed, elevation_axis);
    let range_variance = dot(along, range_axis);
    let width2 = dot(across, azimuth_axis).max(0.0);
    let range_azimuth = dot(along, azimuth_axis) * by_lever;
    // √det of the cross-section by Cholesky; its azimuth in metres keeps it well scaled.
    let width_m = width2.sqrt();
    let skew = dot(across, elevation_axis) / width_m.max(1e-9);
    let height_m = (dot(up, elevation_axis) - skew * skew).max(0.0).sqrt();
    let solid_angle = width_m * height_m * by_range * by_range * std::f32::consts::TAU;
    let total = width2 * by_lever * by_lever + view.beam_variance;
    let by_total = one / total;
    let off = azimuth_rad * azimuth_rad * by_total;
    let pattern = by_total.sqrt() * view.sigma_b * lanes::exp(off * -0.5);
    let range_sigma_m = (range_variance + view.range_variance_m2
        - range_azimuth * range_azimuth * by_total)
        .max(1e-8)
        .sqrt();
    let mean_range_m = range_m - azimuth_rad * range_azimuth * by_total;
    let steep = elevation_rad * view.inverse_half_width;
    let steep2 = steep * steep;
    let steep4 = steep2 * steep2;
    let fan = lanes::exp(steep4 * steep4 * -std::f32::consts::LN_2);
    let energy = match view.is_graded {
        true => solid_angle * fan * pattern,
        false => solid_angle * pattern,
    };
    let strength = facing(range_axis, ahead, behind);

    let reach_m = range_sigma_m * RANGE_REACH_SIGMAS;
    let near = (mean_range_m - reach_m - view.range_start_m) * view.bins_per_m;
    let far = (mean_range_m + reach_m - view.range_start_m) * view.bins_per_m;
    let first: i32x8<S> = near.max(0.0).min(view.bin_count).floor().to_int();
    let end: i32x8<S> = far.max(0.0).min(view.bin_count).ceil().to_int();
    let (first, end) = (first.to_array(), end.to_array());

    let is_seen = fan.simd_gt(LEAST_FAN) & range_m.simd_gt(NEAREST_M) & energy.simd_ge(0.0);
    let bits = is_seen.to_bitmask();
    let single = [
        mean_range_m,
        range_sigma_m,
        azimuth_rad,
        elevation_rad,
        total,
        energy,
        lever_m,
        strength,
    ];
    let [
        range,
        sigma,
        azimuth,
        elevation,
        variance,
        energy,
        lever,
        strength,
    ] = arrays(single);
    let [rx, ry, rz] = arrays(range_axis);
    let [ax, ay, az] = arrays(azimuth_axis);
    for lane in 0..count {
        let bins = first[lane] as u32..end[lane] as u32;
        if bits >> lane & 1 == 0 || bins.is_empty() {
            continue;
        }
        rows.push(Row {
            slot: field.slot(places[lane]),
            splat: Splat {
                range_m: range[lane],
                range_sigma_m: sigma[lane],
                azimuth_rad: azimuth[lane],
                elevation_rad: elevation[lane],
                azimuth_variance_rad2: variance[lane],
                energy: energy[lane],
                range_axis: Vec3::new(rx[lane], ry[lane], rz[lane]),
                azimuth_axis: Vec3::new(ax[lane], ay[lane], az[lane]),
                lever_m: lever[lane],
            },
            strength: strength[lane],
            bins,
            energies_from: 0,
        });
    }
}

#[inline(always)]
fn arrays<S: Simd, const N: usize>(vectors: [f32x8<S>; N]) -> [[f32; LANES]; N] {
    let mut arrays = [[0.0; LANES]; N];
    for (array, vector) in arrays.iter_mut().zip(vectors) {
        *array = vector.to_array();
    }
    arrays
}

/// [`crate::spawn::lobes::Lobes::seen`] from the sensor, against `range_axis`.
#[inline(always)]
fn facing<S: Simd>(range_axis: Triple<S>, ahead: Triple<S>, behind: Triple<S>) -> f32x8<S> {
    let [x, y, z] = range_axis;
    let sx = x.simd_le(0.0).select(ahead[0], behind[0]);
    let sy = y.simd_le(0.0).select(ahead[1], behind[1]);
    let sz = z.simd_le(0.0).select(ahead[2], behind[2]);
    (x * x).mul_add(sx, (y * y).mul_add(sy, z * z * sz))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spawn::gaussians::Gaussians;
    use crate::spawn::lobes::Lobes;
    use echosplat_acoustics::{Beam, LookPose};
    use echosplat_model::glam::{EulerRot, Mat3, Quat};
    use fearless_simd::{Level, dispatch};

    fn look() -> Look {
        let turn = Quat::from_euler(EulerRot::ZYX, 0.4, -0.2, 0.3);
        Look {
            pose: LookPose {
                position_m: Vec3::new(1.0, -2.0, 0.5),
                axes: Mat3::from_quat(turn),
                drift_per_m: Vec3::new(1e-4, 2e-4, -1e-4),
                reference_range_m: 5.0,
            },
            range_start_m: 0.3,
            bin_length_m: 0.02,
            bin_count: 500,
            range_variance_m2: 1e-4,
            azimuth_variance_rad2: 1e-5,
            beam: Beam::default(),
        }
    }

    /// Gaussians of all shapes in and beside the fan, and behind the sensor.
    fn gaussians(look: &Look) -> Gaussians {
        let mut gaussians = Gaussians::default();
        for i in 0..2003 {
            let t = i as f32;
            let in_beam = Vec3::new(
                5.0 + 6.0 * (t * 0.7).sin(),
                0.3 * (t * 1.3).sin(),
                4.0 * (t * 0.9).cos(),
            );
            let mean_m = look.pose.position_m + look.pose.axes * in_beam;
            let slot = gaussians.spawn(mean_m, (0, 0), 0.02, 0.0) as usize;
            let rotation = Quat::from_euler(EulerRot::ZYX, t * 0.37, t * 0.11, t * 0.23);
            gaussians.set_shape(slot, rotation, Vec3::new(0.05, 0.03, 0.01));
            gaussians.strength[slot] = Lobes {
                ahead: Vec3::new(1.0, 2.0, 3.0) + t,
                behind: Vec3::new(5.0, 7.0, 9.0) + t,
            };
        }
        gaussians
    }

    #[test]
    fn eight_at_a_time_see_what_one_at_a_time_sees() {
        let look = look();
        let gaussians = gaussians(&look);
        let (field, view) = (Field::of_all(&gaussians), View::of(&look, true));
        let (mut places, mut rows) = (Vec::new(), Vec::new());
        dispatch!(Level::new(), simd => {
            cull(simd, &view, field.numbers(), 0..gaussians.slot_count(), &mut places);
            project(simd, &view, &field, &places, &mut rows);
        });
        let mut rows = rows.into_iter().peekable();
        let mut count = 0;
        for slot in gaussians.slots() {
            let splat = look.project(gaussians.mean_m[slot], &gaussians.covariance_m2[slot]);
            let Some(splat) = splat.filter(|splat| !look.bins_of(splat).is_empty()) else {
                continue;
            };
            // One at the very edge of a cut may fall to either side.
            let Some(found) = rows.next_if(|row| row.slot as usize == slot) else {
                assert!(splat.energy < 1e-4, "{slot} {splat:?}");
                continue;
            };
            count += 1;
            let near = |a: f32, b: f32, size: f32| (a - b).abs() <= 2e-3 * size;
            let other = &found.splat;
            assert!(near(other.range_m, splat.range_m, 1e-2), "{slot}");
            assert!(near(
                other.range_sigma_m,
                splat.range_sigma_m,
                splat.range_sigma_m
            ));
            assert!(near(other.energy, splat.energy, splat.energy), "{slot}");
            assert!(near(other.elevation_rad, splat.elevation_rad, 1.0));
            assert!(near(other.azimuth_rad, splat.azimuth_rad, 1e-2));
            assert!((other.range_axis - splat.range_axis).length() < 1e-5);
            assert!((other.azimuth_axis - splat.azimuth_axis).length() < 1e-5);
            let strength = gaussians.strength[slot].seen(-splat.range_axis);
            assert!(near(found.strength, strength, strength), "{slot}");
            let bins = look.bins_of(&splat);
            assert!(bins.start.abs_diff(found.bins.start as usize) <= 1);
            assert!(bins.end.abs_diff(found.bins.end as usize) <= 1);
        }
        assert!(count > 100 && rows.next().is_none(), "{count}");
    }
}
