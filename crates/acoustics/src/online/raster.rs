//! The raster of directions on which Gaussians hide one another.

use super::constants::{RASTER_HALF_HEIGHT, RASTER_HALF_WIDTH_SIGMAS, RASTER_ROW_DEG};
use crate::PingGeometry;
use crate::lanes::LANES;

/// Rows all around; layout.
const MOST_ROWS: f64 = 360.0 / RASTER_ROW_DEG;

/// Columns of azimuth; layout: one a lane.
pub(crate) const COLUMNS: usize = LANES;

/// Cells of azimuth × elevation around the beam's axis, in the beam's frame, row after row.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Raster {
    /// Centres of the columns.
    pub(crate) azimuth_rad: [f32; COLUMNS],
    /// Centre of the lowest row.
    pub(crate) lowest_rad: f32,
    /// Height of a row.
    pub(crate) row_rad: f32,
    /// Variances of azimuth and elevation that stand for a cell's extent, C: `(½δ)²`.
    pub(crate) cell_variance_rad2: [f32; 2],
    /// Sensitivity in each cell, shape `[rows]` of columns.
    pub(crate) weights: Vec<[f32; COLUMNS]>,
}

/// Sizes of a cell in azimuth and elevation.
pub(crate) fn cell_rad(geometry: &PingGeometry) -> [f64; 2] {
    let column_rad = 2.0 * RASTER_HALF_WIDTH_SIGMAS * sigma_rad(geometry) / COLUMNS as f64;
    [column_rad, RASTER_ROW_DEG.to_radians()]
}

/// One sigma of beam and attitude in azimuth.
fn sigma_rad(geometry: &PingGeometry) -> f64 {
    let sigma = f64::from(geometry.beam.azimuth_sigma_rad());
    (sigma * sigma + f64::from(geometry.azimuth_variance_rad2)).sqrt()
}

impl Raster {
    /// The raster of one ping geometry.
    #[must_use]
    pub(crate) fn new(geometry: &PingGeometry) -> Self {
        let mut raster = Self::default();
        raster.fit(geometry);
        raster
    }

    /// Becomes the raster of `geometry`.
    pub(crate) fn fit(&mut self, geometry: &PingGeometry) {
        let sigma = sigma_rad(geometry);
        let [column_rad, row_rad] = cell_rad(geometry);
        let half_rad = f64::from(geometry.beam.elevation_half_width_rad());
        // More than the whole circle is no fan, whatever the geometry says. A whole number of rows
        // stays that number, whatever an f32 angle's last bit says.
        let rows = (2.0 * RASTER_HALF_HEIGHT * half_rad / row_rad - 1e-3)
            .ceil()
            .clamp(1.0, MOST_ROWS);
        let column = |c: usize| (c as f64 - 0.5 * (COLUMNS - 1) as f64) * column_rad;
        let lowest_rad = -0.5 * (rows - 1.0) * row_rad;
        let row = |r: usize| lowest_rad + r as f64 * row_rad;
        self.azimuth_rad = std::array::from_fn(|c| column(c) as f32);
        self.lowest_rad = lowest_rad as f32;
        self.row_rad = row_rad as f32;
        self.cell_variance_rad2 = [column_rad, row_rad].map(|size| (0.25 * size * size) as f32);
        let across = |c: usize| (-0.5 * (column(c) / sigma).powi(2)).exp();
        let up = |r: usize| (-(row(r) / half_rad).powi(8)).exp2();
        self.weights.clear();
        self.weights.extend(
            (0..rows as usize).map(|r| std::array::from_fn(|c| (across(c) * up(r)) as f32)),
        );
    }

    /// Number of rows.
    pub(crate) fn row_count(&self) -> usize {
        self.weights.len()
    }

    /// Number of cells.
    pub(crate) fn cell_count(&self) -> usize {
        self.row_count() * COLUMNS
    }

    /// Centre of a row.
    pub(crate) fn elevation_rad(&self, row: usize) -> f32 {
        self.lowest_rad + self.row_rad * row as f32
    }

    /// Azimuth and elevation of a cell's centre.
    pub(crate) fn centre_rad(&self, cell: usize) -> [f32; 2] {
        [
            self.azimuth_rad[cell % COLUMNS],
            self.elevation_rad(cell / COLUMNS),
        ]
    }

    /// Sensitivity in a cell.
    pub(crate) fn weight(&self, cell: usize) -> f32 {
        self.weights[cell / COLUMNS][cell % COLUMNS]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    #[test]
    fn it_is_symmetric_and_covers_beam_and_fan() {
        let (geometry, _) = sample::bench_scene(0);
        let raster = Raster::new(&geometry);
        let last = raster.cell_count() - 1;
        let ([a, b], [c, d]) = (raster.centre_rad(0), raster.centre_rad(last));
        assert!((a + c).abs() < 1e-7 && (b + d).abs() < 1e-5);
        assert!(d > 1.28 * geometry.beam.elevation_half_width_rad());
        assert!(c > 2.4 * geometry.beam.azimuth_sigma_rad());
        assert!(raster.weight(last) < 1e-3 && raster.weight(last / 2 / 8 * 8 + 4) > 0.9);
    }
}
