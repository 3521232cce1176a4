//! [`PingGeometry::project`], eight Gaussians at a time: what a ping sees of Gaussians that are kept as
//! packed covariances with a directional reflectivity: a strength towards each of the six faces of a
//! cube.
//!
//! [`cull`] and [`project`] belong inside `dispatch!`. Nothing here is known of where the Gaussians
//! come from: they are arrays of numbers.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};
use glam::Vec3;

use crate::lanes::{self, LANES};
use crate::online::constants::{
    BEAM_REACH_SIGMAS, FAN_REACH, LEAST_FAN, LEAST_VARIANCE_M2, NEAREST_M, RANGE_REACH_SIGMAS,
};
use crate::ping_view::PingView;
use crate::triple::{Triple, cross, dot, gathered};
use crate::{PingGeometry, Splat};

/// Numbers a Gaussian; layout.
/// Numbers per Gaussian, world axes: mean (m), covariance (xx, yy, zz, yz, xz, xy, m²), strength
/// towards +x, +y, +z and towards −x, −y, −z.
pub const NUMBERS: usize = 15;

/// A row of the system matrix: one Gaussian in one ping.
#[derive(Debug, Clone, PartialEq)]
pub struct MatrixRow {
    /// Which Gaussian: what `slots` names it.
    pub slot: u32,
    /// How the ping sees it.
    pub splat: Splat,
    /// Strength towards this ping's sensor: what [`Splat::energy`] is to be multiplied by.
    pub strength: f32,
    /// Bins it reaches, never empty.
    pub bins: Range<u32>,
    /// Where its energies begin among those of the ping; 0 until whoever spreads them says.
    pub energies_from: u32,
}

/// A ping's geometry as single numbers, worked out once per ping.
#[derive(Debug, Clone, Copy)]
pub struct View {
    ping: PingView,
    /// Whether sensitivity falls off over elevation.
    is_graded: bool,
    /// Tangent of the fan's reach.
    fan_tangent: f32,
    bins_per_m: f32,
}

impl View {
    /// Of `geometry`; unless `is_graded`, the fan is equally sensitive over all elevations that it sees.
    #[must_use]
    pub fn of(geometry: &PingGeometry, is_graded: bool) -> Self {
        let half_width = geometry.beam.elevation_half_width_rad();
        Self {
            ping: PingView::new(geometry),
            is_graded,
            fan_tangent: (FAN_REACH * half_width).min(1.5).tan(),
            bins_per_m: 1.0 / geometry.bin_length_m,
        }
    }

    /// Bins and fractions of one from the ping's start, inside the ping.
    #[inline(always)]
    fn bin_edge<S: Simd>(&self, range_m: f32x8<S>) -> f32x8<S> {
        let position = (range_m - self.ping.range_start_m) * self.bins_per_m;
        position.max(0.0).min(self.ping.bin_count)
    }
}

/// Appends the places among `members` that the ping may see: a cheap test that rules most of them out.
/// `numbers` has shape `[NUMBERS][places]`, with [`LANES`] places or more from each member on.
#[inline(always)]
pub fn cull<S: Simd>(
    simd: S,
    view: &View,
    numbers: &[Vec<f32>; NUMBERS],
    members: Range<usize>,
    places: &mut Vec<u32>,
) {
    let mut found = places.len();
    // Room for all, and for eight from the last on.
    places.resize(found + members.len() + LANES, 0);
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
        let place = view.ping.place(mean_m);
        let [_, y, z] = place.mean;
        let reach2 = place.lever2.mul_add(view.ping.beam_variance, widest_m2);
        let tangent2 = view.fan_tangent * view.fan_tangent;
        let seen = place.in_front()
            & (y * y).simd_le(reach2 * (BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS))
            & (z * z).simd_le(place.lever2 * tangent2);
        let left = (members.end - from).min(LANES);
        let bits = seen.to_bitmask() & ((1 << left) - 1);
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
fn stretched<S: Simd>(diagonal: Triple<S>, mixed: Triple<S>, v: Triple<S>) -> Triple<S> {
    let [yz, xz, xy] = mixed;
    [
        diagonal[0].mul_add(v[0], xy.mul_add(v[1], xz * v[2])),
        xy.mul_add(v[0], diagonal[1].mul_add(v[1], yz * v[2])),
        xz.mul_add(v[0], yz.mul_add(v[1], diagonal[2] * v[2])),
    ]
}

/// Appends a row for each of `places`, as [`cull`] found them: ascending; those that the ping does
/// not see after all are left out. `numbers` has shape `[NUMBERS][places]`, `slots` names the
/// Gaussian at each place.
#[inline(always)]
pub fn project<S: Simd>(
    simd: S,
    view: &View,
    numbers: &[Vec<f32>; NUMBERS],
    slots: &[u32],
    places: &[u32],
    rows: &mut Vec<MatrixRow>,
) {
    for chunk in places.chunks(LANES) {
        let mut eight = [chunk[chunk.len() - 1]; LANES];
        eight[..chunk.len()].copy_from_slice(chunk);
        project_eight(simd, view, numbers, slots, (eight, chunk.len()), rows);
    }
}

/// (18), (19) and the closed forms of the measurement: beam folded in, `Ω`, `r′`, `s²`.
#[inline(always)]
fn project_eight<S: Simd>(
    simd: S,
    view: &View,
    numbers: &[Vec<f32>; NUMBERS],
    slots: &[u32],
    (places, count): ([u32; LANES], usize),
    rows: &mut Vec<MatrixRow>,
) {
    let triple = |from: usize| gathered_triple(simd, numbers, from, places);
    let (mean_m, diagonal, mixed) = (triple(0), triple(3), triple(6));
    let (ahead, behind) = (triple(9), triple(12));
    let ping = &view.ping;
    let one = f32x8::splat(simd, 1.0);
    let place = ping.place(mean_m);
    let (lever_m, range_m) = (place.lever_m, place.range_m);
    let (by_lever, by_range) = (place.by_lever, place.by_range);
    let range_axis = ping.range_axis(&place);
    let azimuth_axis = ping.azimuth_axis(&place);
    let elevation_axis = cross(range_axis, azimuth_axis);
    let azimuth_rad = place.azimuth();
    let elevation_rad = place.elevation();

    let along = stretched(diagonal, mixed, range_axis);
    let across = stretched(diagonal, mixed, azimuth_axis);
    let up = stretched(diagonal, mixed, elevation_axis);
    let range_variance = dot(along, range_axis);
    let width2 = dot(across, azimuth_axis).max(0.0);
    let range_azimuth = dot(along, azimuth_axis) * by_lever;
    // √det of the cross-section by Cholesky; its azimuth in metres keeps it well scaled.
    let width_m = width2.sqrt();
    let skew = dot(across, elevation_axis) / width_m.max(1e-9);
    let height_m = (dot(up, elevation_axis) - skew * skew).max(0.0).sqrt();
    let solid_angle = width_m * height_m * by_range * by_range * std::f32::consts::TAU;
    let total = width2 * by_lever * by_lever + ping.beam_variance;
    let by_total = one / total;
    let off = azimuth_rad * azimuth_rad * by_total;
    let pattern = by_total.sqrt() * ping.sigma_b * lanes::exp(off * -0.5);
    let range_sigma_m = (range_variance + ping.range_variance_m2
        - range_azimuth * range_azimuth * by_total)
        .max(LEAST_VARIANCE_M2)
        .sqrt();
    let mean_range_m = range_m - azimuth_rad * range_azimuth * by_total;
    let fan = ping.fan(elevation_rad);
    let energy = match view.is_graded {
        true => solid_angle * fan * pattern,
        false => solid_angle * pattern,
    };
    let strength = facing(range_axis, ahead, behind);

    let reach_m = range_sigma_m * RANGE_REACH_SIGMAS;
    let first: i32x8<S> = view.bin_edge(mean_range_m - reach_m).floor().to_int();
    let end: i32x8<S> = view.bin_edge(mean_range_m + reach_m).ceil().to_int();
    let (first, end) = (first.to_array(), end.to_array());

    let is_seen = fan.simd_gt(LEAST_FAN)
        & range_m.simd_gt(NEAREST_M)
        & energy.simd_ge(0.0)
        & off.simd_le(BEAM_REACH_SIGMAS * BEAM_REACH_SIGMAS);
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
        rows.push(MatrixRow {
            slot: slots[places[lane] as usize],
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

/// Strength seen from the sensor, `Σ u_k² s_k` over the three faces turned against `range_axis`.
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
    use crate::{Beam, PingPose, SymmetricMat3};
    use fearless_simd::{Level, dispatch};
    use glam::{EulerRot, Mat3, Quat};

    fn geometry() -> PingGeometry {
        let turn = Quat::from_euler(EulerRot::ZYX, 0.4, -0.2, 0.3);
        PingGeometry {
            pose: PingPose {
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

    struct Gaussian {
        mean_m: Vec3,
        covariance_m2: SymmetricMat3,
        ahead: Vec3,
        behind: Vec3,
    }

    impl Gaussian {
        fn strength_seen(&self, towards: Vec3) -> f32 {
            let faces = Vec3::select(towards.cmpge(Vec3::ZERO), self.ahead, self.behind);
            faces.dot(towards * towards)
        }
    }

    /// Gaussians of all shapes in and beside the fan, and behind the sensor.
    fn gaussians(geometry: &PingGeometry) -> Vec<Gaussian> {
        let gaussian = |i| {
            let t = i as f32;
            let in_beam = Vec3::new(
                5.0 + 6.0 * (t * 0.7).sin(),
                0.3 * (t * 1.3).sin(),
                4.0 * (t * 0.9).cos(),
            );
            let rotation = Quat::from_euler(EulerRot::ZYX, t * 0.37, t * 0.11, t * 0.23);
            let scale_m = Vec3::new(0.05, 0.03, 0.01);
            let axes = Mat3::from_quat(rotation) * Mat3::from_diagonal(scale_m);
            Gaussian {
                mean_m: geometry.pose.position_m + geometry.pose.axes * in_beam,
                covariance_m2: SymmetricMat3::of(axes * axes.transpose()),
                ahead: Vec3::new(1.0, 2.0, 3.0) + t,
                behind: Vec3::new(5.0, 7.0, 9.0) + t,
            }
        };
        (0..2003).map(gaussian).collect()
    }

    fn numbers_of(gaussians: &[Gaussian]) -> [Vec<f32>; NUMBERS] {
        let mut numbers: [Vec<f32>; NUMBERS] = Default::default();
        for gaussian in gaussians {
            let triples = [
                gaussian.mean_m,
                gaussian.covariance_m2.diagonal,
                gaussian.covariance_m2.mixed,
                gaussian.ahead,
                gaussian.behind,
            ];
            let each = triples.iter().flat_map(Vec3::to_array);
            for (numbers, number) in numbers.iter_mut().zip(each) {
                numbers.push(number);
            }
        }
        for numbers in &mut numbers {
            numbers.resize(gaussians.len() + LANES, 0.0);
        }
        numbers
    }

    #[test]
    fn eight_at_a_time_see_what_one_at_a_time_sees() {
        let geometry = geometry();
        let gaussians = gaussians(&geometry);
        let (numbers, view) = (numbers_of(&gaussians), View::of(&geometry, true));
        // Named otherwise than placed.
        let slots: Vec<u32> = (0..gaussians.len() as u32).map(|place| place + 7).collect();
        let (mut places, mut rows) = (Vec::new(), Vec::new());
        dispatch!(Level::new(), simd => {
            cull(simd, &view, &numbers, 0..gaussians.len(), &mut places);
            project(simd, &view, &numbers, &slots, &places, &mut rows);
        });
        let mut rows = rows.into_iter().peekable();
        let mut count = 0;
        for (gaussian, &slot) in gaussians.iter().zip(&slots) {
            let splat = geometry.project(gaussian.mean_m, &gaussian.covariance_m2);
            let Some(splat) = splat.filter(|splat| !geometry.bins_of(splat).is_empty()) else {
                continue;
            };
            // One at the very edge of a cut may fall to either side.
            let Some(found) = rows.next_if(|row| row.slot == slot) else {
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
            let strength = gaussian.strength_seen(-splat.range_axis);
            assert!(near(found.strength, strength, strength), "{slot}");
            let bins = geometry.bins_of(&splat);
            assert!(bins.start.abs_diff(found.bins.start as usize) <= 1);
            assert!(bins.end.abs_diff(found.bins.end as usize) <= 1);
        }
        assert!(count > 100 && rows.next().is_none(), "{count}");
    }

    #[test]
    fn few_whose_ends_lie_eight_apart_are_each_read() {
        let geometry = geometry();
        let mut gaussians: Vec<Gaussian> = gaussians(&geometry).into_iter().take(8).collect();
        for (i, g) in gaussians.iter_mut().enumerate() {
            let r = 3.0 + i as f32;
            g.mean_m = geometry.pose.position_m + geometry.pose.axes * Vec3::new(r, 0.0, 0.0);
        }
        let (numbers, view) = (numbers_of(&gaussians), View::of(&geometry, true));
        let slots: Vec<u32> = (0..8).collect();
        let mut rows = Vec::new();
        dispatch!(Level::new(), simd => project(simd, &view, &numbers, &slots, &[0, 7], &mut rows));
        let ranges: Vec<_> = rows.iter().map(|r| (r.slot, r.splat.range_m)).collect();
        assert!((ranges[1].1 - 10.0).abs() < 0.1, "{ranges:?}");
    }
}
