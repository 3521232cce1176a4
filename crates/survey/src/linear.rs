//! Small systems of equations.

/// Inverse of a symmetric matrix by Gauss and Jordan; `None` if it has none.
pub(crate) fn inverse<const N: usize>(matrix: &[[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let mut left = *matrix;
    let mut right = [[0.0; N]; N];
    for (i, row) in right.iter_mut().enumerate() {
        row[i] = 1.0;
    }
    for column in 0..N {
        let pivot =
            (column..N).max_by(|a, b| left[*a][column].abs().total_cmp(&left[*b][column].abs()))?;
        left.swap(column, pivot);
        right.swap(column, pivot);
        let scale = left[column][column];
        if !(scale.abs() > f64::MIN_POSITIVE) {
            return None;
        }
        left[column] = left[column].map(|x| x / scale);
        right[column] = right[column].map(|x| x / scale);
        for row in (0..N).filter(|row| *row != column) {
            let factor = left[row][column];
            for k in 0..N {
                left[row][k] -= factor * left[column][k];
                right[row][k] -= factor * right[column][k];
            }
        }
    }
    right
        .iter()
        .flatten()
        .all(|x| x.is_finite())
        .then_some(right)
}

/// The matrix times the vector.
pub(crate) fn times<const N: usize>(matrix: &[[f64; N]; N], vector: &[f64; N]) -> [f64; N] {
    let row = |row: &[f64; N]| row.iter().zip(vector).map(|(a, b)| a * b).sum();
    std::array::from_fn(|i| row(&matrix[i]))
}
