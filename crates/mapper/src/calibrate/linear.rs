//! Small symmetric systems of equations.

/// Shape `[N][N]`, both triangles filled.
pub(crate) type Square<const N: usize> = [[f64; N]; N];

/// Lower Cholesky factor; `None` unless positive definite and finite.
pub(crate) fn cholesky<const N: usize>(a: &Square<N>) -> Option<Square<N>> {
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let sum: f64 = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i != j {
                l[i][j] = sum / l[j][j];
            } else if sum > 1e-12 * a[i][i] && sum.is_finite() {
                l[i][i] = sum.sqrt();
            } else {
                return None;
            }
        }
    }
    Some(l)
}

/// Solves `L Lᵀ x = b`.
pub(crate) fn solve<const N: usize>(l: &Square<N>, b: &[f64; N]) -> [f64; N] {
    let mut x = *b;
    for i in 0..N {
        let sum: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i][i];
    }
    for i in (0..N).rev() {
        let sum: f64 = (i + 1..N).map(|k| l[k][i] * x[k]).sum();
        x[i] = (x[i] - sum) / l[i][i];
    }
    x
}

/// `(L Lᵀ)⁻¹ M`.
pub(crate) fn inverse_times<const N: usize>(l: &Square<N>, m: &Square<N>) -> Square<N> {
    let columns: Square<N> = std::array::from_fn(|j| {
        let column = std::array::from_fn(|i| m[i][j]);
        solve(l, &column)
    });
    std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: Square<3> = [[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];

    #[test]
    fn a_system_is_solved_and_an_inverse_undoes_its_matrix() {
        let factor = cholesky(&A).unwrap();
        let x = [1.0, -2.0, 3.0];
        let b = A.map(|row| row.iter().zip(&x).map(|(a, x)| a * x).sum());
        let found = solve(&factor, &b);
        assert!(found.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-12));
        let one = inverse_times(&factor, &A);
        for (i, row) in one.iter().enumerate() {
            for (j, value) in row.iter().enumerate() {
                assert!((value - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn what_is_not_positive_definite_has_no_factor() {
        assert!(cholesky(&[[1.0, 2.0], [2.0, 1.0]]).is_none());
        assert!(cholesky(&[[f64::NAN]]).is_none());
    }
}
