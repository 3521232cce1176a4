//! Scale and orientation of each Gaussian from the surface its neighbours make.

use echosplat_measurement::SymmetricMat3;
use echosplat_model::glam::{DMat3, DVec3, Mat3, Quat, Vec3};

use crate::spawn::gaussians::{Gaussians, Verdict};
use crate::spawn::neighbours::{Neighbours, Place, Surroundings};

/// Lays every published Gaussian along its neighbours: axes from the scatter of their means,
/// weighted by strength, the shortest across the surface. `voxel_m` is the spacing they were
/// spawned with. Keeps the energy each sends back when seen along its shortest axis.
pub(crate) fn align(gaussians: &mut Gaussians, voxel_m: f32) {
    let published = |slot: usize| matches!(gaussians.verdict[slot], Verdict::Published(_));
    let neighbours = Neighbours::new(gaussians, 2.5 * voxel_m, published);
    let shapes = neighbours.map(
        |_| true,
        |around| {
            let scatter = scatter_of(around, |place| place.strength);
            let (axes, variances_m2) = eigen(scatter);
            let shortest = variances_m2.x.max(0.0).sqrt();
            let middle = variances_m2.y.max(0.0).sqrt();
            let thin = shortest.clamp(0.12 * voxel_m, 0.5 * voxel_m);
            let wide = middle.clamp(thin, 0.6 * voxel_m).max(0.3 * voxel_m);
            let scale = Vec3::new(thin, wide, 0.6 * voxel_m);
            (Quat::from_mat3(&axes), scale)
        },
    );
    for (slot, (rotation, scale)) in shapes {
        let before = gaussians.scale_m[slot];
        let area = |s: Vec3| s.element_product() / s.min_element();
        gaussians.strength[slot].scale(area(before) / area(scale));
        gaussians.set_shape(slot, rotation, scale);
    }
}

/// Scatter of the means around one, each counted with its weight, square metres.
pub(crate) fn scatter_of(around: Surroundings<'_>, weight_of: impl Fn(&Place) -> f32) -> Mat3 {
    let (mut weight, mut sum, mut scatter) = (0.0f32, Vec3::ZERO, Mat3::ZERO);
    for place in around.places() {
        let d = place.mean_m - around.center_m;
        let w = weight_of(place);
        weight += w;
        sum += d * w;
        scatter += Mat3::from_cols(d * d.x, d * d.y, d * d.z) * w;
    }
    if !(weight > 0.0) {
        return Mat3::ZERO;
    }
    let mean = sum / weight;
    scatter * weight.recip() - Mat3::from_cols(mean * mean.x, mean * mean.y, mean * mean.z)
}

/// Least eigenvalue of a symmetric matrix, by the cosine form of its cubic's roots.
pub(crate) fn least_eigenvalue(matrix: &SymmetricMat3) -> f32 {
    let (d, m) = (matrix.diagonal.as_dvec3(), matrix.mixed.as_dvec3());
    let mean = d.element_sum() / 3.0;
    let off = d - mean;
    let spread = ((off.length_squared() + 2.0 * m.length_squared()) / 6.0).sqrt();
    if !(spread > f64::EPSILON * mean.abs()) {
        return mean as f32;
    }
    let columns = [
        DVec3::new(off.x, m.z, m.y),
        DVec3::new(m.z, off.y, m.x),
        DVec3::new(m.y, m.x, off.z),
    ];
    let rest = DMat3::from_cols(columns[0], columns[1], columns[2]) * spread.recip();
    let angle = (0.5 * rest.determinant()).clamp(-1.0, 1.0).acos() / 3.0;
    let third = std::f64::consts::TAU / 3.0;
    (mean + 2.0 * spread * (angle + third).cos()) as f32
}

/// Eigenvectors (right-handed, as columns) and eigenvalues in growing order, by Jacobi rotations.
pub(crate) fn eigen(matrix: Mat3) -> (Mat3, Vec3) {
    let mut a = matrix.to_cols_array_2d();
    let mut v = Mat3::IDENTITY.to_cols_array_2d();
    for _ in 0..12 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            rotate(&mut a, &mut v, p, q);
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| a[i][i].total_cmp(&a[j][j]));
    let column = |i: usize| Vec3::from_array(v[order[i]]);
    let (first, second) = (column(0), column(1));
    let axes = Mat3::from_cols(first, second, first.cross(second));
    let values = order.map(|i| a[i][i]);
    (axes, Vec3::from_array(values))
}

/// One Jacobi rotation that makes `a[p][q]` zero; `v` holds eigenvectors as rows of columns.
fn rotate(a: &mut [[f32; 3]; 3], v: &mut [[f32; 3]; 3], p: usize, q: usize) {
    if a[p][q].abs() <= 1e-12 * (a[p][p].abs() + a[q][q].abs()) {
        return;
    }
    let theta = 0.5 * (a[q][q] - a[p][p]) / a[p][q];
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = (t * t + 1.0).sqrt().recip();
    let s = t * c;
    let turn = |row: &mut [f32; 3]| {
        let (at_p, at_q) = (row[p], row[q]);
        row[p] = c * at_p - s * at_q;
        row[q] = s * at_p + c * at_q;
    };
    a.iter_mut().for_each(turn);
    turn_rows(a, p, q, c, s);
    turn_rows(v, p, q, c, s);
}

fn turn_rows(m: &mut [[f32; 3]; 3], p: usize, q: usize, c: f32, s: f32) {
    let (at_p, at_q) = (m[p], m[q]);
    m[p] = std::array::from_fn(|k| c * at_p[k] - s * at_q[k]);
    m[q] = std::array::from_fn(|k| s * at_p[k] + c * at_q[k]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvectors_rebuild_the_matrix() {
        let rotation = Mat3::from_quat(Quat::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 2.0));
        let values = Vec3::new(0.01, 0.2, 3.0);
        let matrix = rotation * Mat3::from_diagonal(values) * rotation.transpose();
        let (axes, found) = eigen(matrix);
        assert!((found - values).length() < 1e-5, "{found}");
        let rebuilt = axes * Mat3::from_diagonal(found) * axes.transpose();
        assert!(rebuilt.abs_diff_eq(matrix, 1e-5));
        assert!((axes.determinant() - 1.0).abs() < 1e-5);
    }

    #[test]
    fn the_least_eigenvalue_is_that_of_the_rotations() {
        for (x, y, z) in [(0.01, 0.2, 3.0), (1e-3, 1.0, 1.0), (2.0, 2.0, 2.0)] {
            let turn = Mat3::from_quat(Quat::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 2.0));
            let matrix = turn * Mat3::from_diagonal(Vec3::new(x, y, z)) * turn.transpose();
            let packed = SymmetricMat3 {
                diagonal: Vec3::new(matrix.x_axis.x, matrix.y_axis.y, matrix.z_axis.z),
                mixed: Vec3::new(matrix.z_axis.y, matrix.z_axis.x, matrix.y_axis.x),
            };
            let least = least_eigenvalue(&packed);
            assert!((least - x).abs() < 1e-6, "{least} is not {x}");
        }
        assert!(least_eigenvalue(&SymmetricMat3::default()).abs() < f32::MIN_POSITIVE);
    }

    #[test]
    fn gaussians_on_a_plane_lie_in_it() {
        let mut gaussians = Gaussians::default();
        for i in 0..25 {
            let (x, z) = ((i % 5) as f32 * 0.05, (i / 5) as f32 * 0.05);
            gaussians.spawn(Vec3::new(x, 0.0, z), (0, 0), 0.025, 1.0);
        }
        align(&mut gaussians, 0.05);
        let normal = gaussians.rotation[12] * Vec3::X;
        assert!(normal.y.abs() > 0.99, "{normal}");
        assert!(gaussians.scale_m[12].x < 0.01 && gaussians.scale_m[12].z > 0.02);
    }
}
