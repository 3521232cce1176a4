//! Why there is no surface.

use echosplat_model::Unsound;

use crate::{CELL_LIMITS_M, MOST_BLOCKS};

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
    #[error("Gaussian {id} is none: {why}")]
    Unsound {
        /// Its name in the map; in a map that was read, its row, counted from 0.
        id: u32,
        /// What cannot be.
        why: Unsound,
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
