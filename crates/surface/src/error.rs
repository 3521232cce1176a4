//! Why there is no surface.

use echosplat_model::glam::Vec3;

use crate::{CELL_LIMITS_M, FURTHEST_M, MOST_BLOCKS};

/// Why a map was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SurfaceError {
    /// The grid's edge.
    #[error(
        "a cell's edge of {cell_m} m; allowed is {} to {} m",
        CELL_LIMITS_M.0,
        CELL_LIMITS_M.1
    )]
    Cell {
        /// As it was asked for.
        cell_m: f32,
    },
    /// A number that cannot be.
    #[error(
        "Gaussian {id} is not sound: place, rotation, scale, opacity and reflectivity have to be \
         finite, scales positive and sigma not negative"
    )]
    Unsound {
        /// Its name in the map; in a map that was read, its row, counted from 0.
        id: u32,
    },
    /// Too far for single precision.
    #[error(
        "Gaussian {id} lies at {place_m} m from the map's origin; allowed is {FURTHEST_M} m along each axis"
    )]
    Far {
        /// Its name in the map; in a map that was read, its row, counted from 0.
        id: u32,
        /// Relative to the map's origin.
        place_m: Vec3,
    },
    /// More than memory is meant for.
    #[error(
        "with cells of {cell_m} m it takes more than {MOST_BLOCKS} blocks of 4 × 4 × 4 cells; larger \
         cells take fewer"
    )]
    Large {
        /// Edge of a cell.
        cell_m: f32,
    },
}
