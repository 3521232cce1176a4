//! The direction in which points scatter least.

use echosplat_model::glam::{DMat3, DVec3};

/// Unit eigenvector of the smallest eigenvalue of a symmetric matrix, and the eigenvalues in growing
/// order; `None` if no direction stands out. The eigenvalues are the cosine form of the cubic's roots
/// (Smith 1961).
pub(crate) fn least_direction(matrix: DMat3) -> Option<(DVec3, [f64; 3])> {
    let trace = matrix.x_axis.x + matrix.y_axis.y + matrix.z_axis.z;
    let mean = trace / 3.0;
    let off = matrix - DMat3::from_diagonal(DVec3::splat(mean));
    let square: f64 = off.to_cols_array().iter().map(|value| value * value).sum();
    let spread = (square / 6.0).sqrt();
    if !(spread > 1e-9 * mean.abs()) {
        return None;
    }
    let angle = (0.5 * (off * spread.recip()).determinant())
        .clamp(-1.0, 1.0)
        .acos()
        / 3.0;
    let third = std::f64::consts::TAU / 3.0;
    let largest = mean + 2.0 * spread * angle.cos();
    let smallest = mean + 2.0 * spread * (angle + third).cos();
    let middle = trace - largest - smallest;
    let direction = kernel(matrix - DMat3::from_diagonal(DVec3::splat(smallest)))?;
    Some((direction, [smallest, middle, largest]))
}

/// What a matrix of rank two takes to zero: across two of its rows, of which the best pair is taken.
fn kernel(matrix: DMat3) -> Option<DVec3> {
    let (x, y, z) = (matrix.x_axis, matrix.y_axis, matrix.z_axis);
    let crosses = [x.cross(y), y.cross(z), z.cross(x)];
    let best = crosses
        .into_iter()
        .max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))?;
    best.try_normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_model::glam::{DQuat, EulerRot};

    #[test]
    fn the_least_axis_is_found_in_any_attitude() {
        for (roll, least) in [(0.0, 1e-6), (0.3, 1e-4), (2.5, 0.2)] {
            let rotation = DMat3::from_quat(DQuat::from_euler(EulerRot::XYZ, roll, -1.1, 2.0));
            let values = DVec3::new(0.5, least, 0.9);
            let matrix = rotation * DMat3::from_diagonal(values) * rotation.transpose();
            let (direction, found) = least_direction(matrix).unwrap();
            assert!(direction.dot(rotation.y_axis).abs() > 1.0 - 1e-9);
            for (found, expected) in found.into_iter().zip([least, 0.5, 0.9]) {
                assert!((found - expected).abs() < 1e-9, "{found} {expected}");
            }
        }
    }

    #[test]
    fn a_ball_has_no_least_axis() {
        assert_eq!(least_direction(DMat3::IDENTITY), None);
        assert_eq!(least_direction(DMat3::ZERO), None);
        assert_eq!(least_direction(DMat3::IDENTITY * f64::NAN), None);
    }
}
