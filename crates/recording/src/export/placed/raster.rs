//! A map as cells of a grid that lies along the coordinates.

use std::collections::BTreeMap;

use echosplat_georeference::{CrsError, LengthUnit};
use echosplat_model::glam::{DVec2, DVec3};

use super::Placed;
use crate::ply::MapFile;

/// Cells of the finest level; 64 Mi, as 8,192 by 8,192.
const MOST_CELLS: f64 = 67_108_864.0;

/// Metres; length of a degree of latitude, to choose cells by.
const DEGREE_M: f64 = 111_320.0;
/// Without a unit; near a pole cells of degrees get no longer than this allows.
const LEAST_COSINE: f64 = 0.01;

/// What a cell says: height, depth, probability, sigma.
pub(super) type Cell = [f32; 4];

/// The map's cells; those in which nothing is are not held.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// Columns and rows.
    pub(super) width: u32,
    pub(super) height: u32,
    /// West and north edge, in the unit of the coordinates.
    pub(super) corner: DVec2,
    /// Size of a cell, in the unit of the coordinates.
    pub(super) cell: DVec2,
    /// By row from the north, then column from the west.
    pub(super) cells: BTreeMap<(u32, u32), Cell>,
}

/// Why there is no raster.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RasterError {
    /// Nothing to draw.
    #[error("nothing is in it that a raster could show")]
    Empty,
    /// Of the coordinates.
    #[error(transparent)]
    Crs(#[from] CrsError),
    /// Too many cells.
    #[error("{width:.0} by {height:.0} cells are more than {MOST_CELLS:.0}: take larger ones")]
    Large {
        /// Columns.
        width: f64,
        /// Rows.
        height: f64,
    },
}

impl Raster {
    /// The highest Gaussian of each cell of so many metres, as charts show the shoalest: its height over the
    /// georeference's datum, minus that as the depth, its probability and its sigma.
    ///
    /// # Errors
    /// If the projection does not show the map, or the cells are too many.
    pub fn of(map: &MapFile, placed: &Placed, cell_m: f64) -> Result<Self, RasterError> {
        let points = placed.gaussians(map)?;
        let first = points.first().ok_or(RasterError::Empty)?.0;
        let cell = match placed.crs.unit() {
            LengthUnit::Metres(unit_m) => DVec2::splat(cell_m / unit_m),
            LengthUnit::Degrees => {
                let cosine = first.y.to_radians().cos().max(LEAST_COSINE);
                DVec2::new(cell_m / DEGREE_M / cosine, cell_m / DEGREE_M)
            }
        };
        let bounds = |fold: fn(DVec3, DVec3) -> DVec3| {
            points
                .iter()
                .fold(first, |bound, (at, _)| fold(bound, *at))
                .truncate()
        };
        // Edges at whole cells, so that maps of one place lie on one grid.
        let least = (bounds(DVec3::min) / cell).floor();
        let most = (bounds(DVec3::max) / cell).floor() + 1.0;
        let size = most - least;
        if !(size.x * size.y <= MOST_CELLS) {
            return Err(RasterError::Large {
                width: size.x,
                height: size.y,
            });
        }
        let mut raster = Self {
            width: size.x as u32,
            height: size.y as u32,
            corner: DVec2::new(least.x, most.y) * cell,
            cell,
            cells: BTreeMap::new(),
        };
        for (at, gaussian) in points {
            let index = (at.truncate() / cell).floor() - least;
            let row = raster.height - 1 - (index.y as u32).min(raster.height - 1);
            let column = (index.x as u32).min(raster.width - 1);
            let height_m = at.z as f32;
            let told = [height_m, -height_m, gaussian.probability, gaussian.sigma_m];
            raster.take((row, column), told);
        }
        Ok(raster)
    }

    fn take(&mut self, at: (u32, u32), told: Cell) {
        let held = self.cells.entry(at).or_insert(told);
        if told[0] > held[0] {
            *held = told;
        }
    }

    /// The same in cells of twice the edge, each as its highest.
    pub(super) fn halved(&self) -> Self {
        let mut half = Self {
            width: self.width.div_ceil(2),
            height: self.height.div_ceil(2),
            corner: self.corner,
            cell: 2.0 * self.cell,
            cells: BTreeMap::new(),
        };
        for (&(row, column), &told) in &self.cells {
            half.take((row / 2, column / 2), told);
        }
        half
    }

    /// Cells in which something is.
    #[must_use]
    pub fn cell_count(&self) -> usize {
        self.cells.len()
    }

    /// Columns and rows.
    #[must_use]
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }
}
