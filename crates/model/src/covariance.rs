//! What a source of poses says of their errors.

/// The covariance of a pose as its source says it: nothing of it is judged, and any number may be NaN, negative or
/// beyond all reason.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseCovariance {
    /// Of the position along the world's axes, square metres: xx, xy, xz, yy, yz, zz.
    pub position_m2: [f64; 6],
    /// Of the attitude about x, y and z, square radians: the world's axes or, as roll, pitch and yaw, the vehicle's.
    pub attitude_rad2: [f64; 3],
}

/// Where xx, xy, xz, yy, yz and zz stand in six rows of six.
const POSITION_IN_ROWS: [usize; 6] = [0, 1, 2, 7, 8, 14];
/// Where the variances of the rotations stand there.
const ATTITUDE_IN_ROWS: [usize; 3] = [21, 28, 35];

impl PoseCovariance {
    /// The same along all axes, and about all, from one sigma of each.
    #[must_use]
    pub fn alike(position_m: f64, attitude_rad: f64) -> Self {
        let (position_m2, attitude_rad2) = (position_m.powi(2), attitude_rad.powi(2));
        Self {
            position_m2: [position_m2, 0.0, 0.0, position_m2, 0.0, position_m2],
            attitude_rad2: [attitude_rad2; 3],
        }
    }

    /// Of a matrix row by row over x, y, z and the rotations about them, as ROS has it; `None` if all is zero, which
    /// there means unknown. What goes from position to attitude is left out.
    #[must_use]
    pub fn of_rows(rows: &[f64; 36]) -> Option<Self> {
        let is_told = rows.iter().any(|&value| value != 0.0);
        is_told.then(|| Self {
            position_m2: POSITION_IN_ROWS.map(|index| rows[index]),
            attitude_rad2: ATTITUDE_IN_ROWS.map(|index| rows[index]),
        })
    }

    /// The matrix row by row, its bits as they are.
    #[must_use]
    pub fn rows(&self) -> [f64; 36] {
        let mut rows = [0.0; 36];
        for (index, value) in POSITION_IN_ROWS.into_iter().zip(self.position_m2) {
            rows[index] = value;
            let (row, column) = (index / 6, index % 6);
            rows[6 * column + row] = value;
        }
        for (index, value) in ATTITUDE_IN_ROWS.into_iter().zip(self.attitude_rad2) {
            rows[index] = value;
        }
        rows
    }

    /// Along x, y and z, square metres.
    #[must_use]
    pub fn position_variances_m2(&self) -> [f64; 3] {
        [
            self.position_m2[0],
            self.position_m2[3],
            self.position_m2[5],
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_bit_for_bit_and_all_zeros_are_unknown() {
        assert_eq!(PoseCovariance::of_rows(&[0.0; 36]), None);
        let odd = PoseCovariance {
            position_m2: [1e6, -0.5, 0.25, f64::INFINITY, 3.0, -1.0],
            attitude_rad2: [0.0, 9999.0, 1e-5],
        };
        let rows = odd.rows();
        assert_eq!(PoseCovariance::of_rows(&rows), Some(odd));
        let transposed = |index: usize| rows[6 * (index % 6) + index / 6].to_bits();
        assert!((0..36).all(|index| transposed(index) == rows[index].to_bits()));
        let nan = [f64::NAN; 36];
        let told = PoseCovariance::of_rows(&nan).unwrap();
        assert!(told.position_variances_m2().iter().all(|v| v.is_nan()));
    }
}
