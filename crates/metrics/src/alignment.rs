//! Alignment of a map with the truth (ICP, point to point), for figures that are never the headline.

use echosplat_model::Pose;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use crate::neighbors::KdTree;

const MAX_ITERATIONS: usize = 60;
/// Improvement of the mean distance below which it has settled.
const SETTLED_M: f64 = 1e-7;
/// Points of the map that take part, evenly chosen; more change nothing but the time.
const MAX_POINTS: usize = 20_000;

/// What moves the map onto the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Alignment {
    pub(crate) truth_from_map: Pose,
    pub(crate) iterations: usize,
}

/// Pairs of places, the first to be moved onto the second.
type Pairs = [(DVec3, DVec3)];

/// Iterated closest points: pairs each map point with the nearest truth sample, moves the map by
/// the best transform of its kind, until the mean distance settles. The identity for an empty set.
pub(crate) fn align(map: &[DVec3], truth: &KdTree, best: fn(&Pairs) -> Option<Pose>) -> Alignment {
    let stride = map.len().div_ceil(MAX_POINTS).max(1);
    let chosen: Vec<DVec3> = map.iter().step_by(stride).copied().collect();
    let mut alignment = Alignment {
        truth_from_map: Pose::IDENTITY,
        iterations: 0,
    };
    let mut last_mean_m = f64::INFINITY;
    while alignment.iterations < MAX_ITERATIONS {
        let pairs = pairs(&chosen, alignment.truth_from_map, truth);
        let mean_m = pairs.iter().map(|(a, b)| a.distance(*b)).sum::<f64>() / pairs.len() as f64;
        let better = last_mean_m - mean_m > SETTLED_M;
        let Some(step) = best(&pairs).filter(|_| better) else {
            break;
        };
        alignment.truth_from_map = step * alignment.truth_from_map;
        alignment.iterations += 1;
        last_mean_m = mean_m;
    }
    alignment
}

fn pairs(map: &[DVec3], truth_from_map: Pose, truth: &KdTree) -> Vec<(DVec3, DVec3)> {
    let pair = |point: &DVec3| {
        let moved = truth_from_map * *point;
        truth.nearest(moved).map(|nearest| (moved, nearest.point))
    };
    map.par_iter().filter_map(pair).collect()
}

/// The rigid transform that brings the first of each pair closest to the second, in least squares
/// (Horn 1987: the rotation is the eigenvector of a 4 × 4 matrix). `None` without pairs.
pub(crate) fn best_rigid(pairs: &Pairs) -> Option<Pose> {
    let count = pairs.len() as f64;
    let from = pairs.iter().map(|pair| pair.0).sum::<DVec3>() / count;
    let to = pairs.iter().map(|pair| pair.1).sum::<DVec3>() / count;
    let mut s = DMat3::ZERO;
    for (a, b) in pairs {
        let (a, b) = (*a - from, *b - to);
        // Rows by the first's component, columns by the second's.
        s += DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    }
    let [xx, yx, zx, xy, yy, zy, xz, yz, zz] = s.to_cols_array();
    let [w, x, y, z] = largest_eigenvector([
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]);
    let pose = Pose::checked(DQuat::from_xyzw(x, y, z, w), DVec3::ZERO)?;
    let translation_m = to - pose.rotation * from;
    Pose::checked(pose.rotation, translation_m)
}

/// The shift and the turn about the vertical that do the same. `None` without pairs.
pub(crate) fn best_level(pairs: &Pairs) -> Option<Pose> {
    let count = pairs.len() as f64;
    let from = pairs.iter().map(|pair| pair.0).sum::<DVec3>() / count;
    let to = pairs.iter().map(|pair| pair.1).sum::<DVec3>() / count;
    let (mut across, mut along) = (0.0, 0.0);
    for (a, b) in pairs {
        let (a, b) = (*a - from, *b - to);
        across += a.x * b.y - a.y * b.x;
        along += a.x * b.x + a.y * b.y;
    }
    let rotation = DQuat::from_rotation_z(across.atan2(along));
    Pose::checked(rotation, to - rotation * from)
}

/// Of a symmetric matrix, by cyclic Jacobi rotations.
fn largest_eigenvector(mut m: [[f64; 4]; 4]) -> [f64; 4] {
    let mut vectors = [[0.0; 4]; 4];
    for (i, row) in vectors.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for _sweep in 0..16 {
        for p in 0..3 {
            for q in p + 1..4 {
                rotate_away(&mut m, &mut vectors, p, q);
            }
        }
    }
    let largest = (0..4).max_by(|&a, &b| m[a][a].total_cmp(&m[b][b]));
    let column = largest.unwrap_or(0);
    vectors.map(|row| row[column])
}

/// One Jacobi rotation: makes `m[p][q]` zero.
fn rotate_away(m: &mut [[f64; 4]; 4], vectors: &mut [[f64; 4]; 4], p: usize, q: usize) {
    if m[p][q].abs() <= f64::MIN_POSITIVE {
        return;
    }
    let ratio = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
    let tangent = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
    let cosine = 1.0 / tangent.hypot(1.0);
    let sine = tangent * cosine;
    for row in m.iter_mut().chain(vectors.iter_mut()) {
        (row[p], row[q]) = (
            cosine * row[p] - sine * row[q],
            sine * row[p] + cosine * row[q],
        );
    }
    let (row_p, row_q) = (m[p], m[q]);
    m[p] = std::array::from_fn(|k| cosine * row_p[k] - sine * row_q[k]);
    m[q] = std::array::from_fn(|k| sine * row_p[k] + cosine * row_q[k]);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two walls and a floor, so that every motion shows.
    fn corner() -> Vec<DVec3> {
        let grid = || (0..15).flat_map(|i| (0..15).map(move |j| (f64::from(i), f64::from(j))));
        let of = |place: fn(f64, f64) -> DVec3| grid().map(move |(i, j)| place(i * 0.2, j * 0.2));
        of(|u, v| DVec3::new(u, v, 0.0))
            .chain(of(|u, v| DVec3::new(u, 0.0, v)))
            .chain(of(|u, v| DVec3::new(0.0, u, v)))
            .collect()
    }

    #[test]
    fn known_pairs_give_the_motion_exactly() {
        let motion = Pose::from_yaw_pitch_roll(2.5, -0.7, 1.1, DVec3::new(3.0, -20.0, 0.5));
        let pairs: Vec<_> = corner().into_iter().map(|p| (p, motion * p)).collect();
        let found = best_rigid(&pairs).unwrap();
        assert!(found.rotation.angle_between(motion.rotation) < 1e-7);
        assert!(found.translation_m.distance(motion.translation_m) < 1e-9);
        assert!(best_rigid(&[]).is_none());
    }

    #[test]
    fn a_small_shift_and_turn_are_found_and_undone() {
        let motion = Pose::from_yaw_pitch_roll(0.02, 0.01, -0.015, DVec3::new(0.05, -0.04, 0.03));
        let moved: Vec<_> = corner().into_iter().map(|p| motion * p).collect();
        let alignment = align(&moved, &KdTree::new(corner()), best_rigid);
        let left = alignment.truth_from_map * motion;
        assert!(left.translation_m.length() < 1e-6, "{left:?}");
        assert!(alignment.iterations > 1);
    }

    #[test]
    fn a_level_alignment_takes_out_shift_and_heading_and_leaves_a_tilt() {
        let level = Pose::from_yaw_pitch_roll(0.03, 0.0, 0.0, DVec3::new(0.06, -0.04, 0.02));
        let (tilt, truth) = (
            Pose::from_yaw_pitch_roll(0.0, 0.05, 0.0, DVec3::ZERO),
            KdTree::new(corner()),
        );
        let left_by = |motion: Pose| {
            let moved: Vec<_> = corner().into_iter().map(|p| motion * p).collect();
            let alignment = align(&moved, &truth, best_level);
            alignment.truth_from_map * motion
        };
        let left = left_by(level);
        assert!(left.translation_m.length() < 1e-6, "{left:?}");
        assert!(left.rotation.angle_between(DQuat::IDENTITY) < 1e-6);
        let left = left_by(tilt);
        assert!(left.rotation.angle_between(DQuat::IDENTITY) > 0.04);
        assert!(best_level(&[]).is_none());
    }

    #[test]
    fn nothing_to_align_is_left_alone() {
        let empty = KdTree::new([]);
        assert_eq!(
            align(&corner(), &empty, best_rigid).truth_from_map,
            Pose::IDENTITY
        );
        assert_eq!(align(&[], &KdTree::new(corner()), best_level).iterations, 0);
    }
}
