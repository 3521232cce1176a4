//! The surface that a map asserts, as one open sheet of triangles.
//!
//! A map says where surface is, not which side of it is water: it holds no view directions. So the
//! surface is not the border of a volume but the ridge of the Gaussians' density, a point-set surface
//! (Amenta and Kil 2004). At a place x, with weights that fall off with the distance from x, a(x) is
//! the mean of the Gaussians' centres and n(x) the direction in which they scatter least. The surface
//! is where
//!
//! ```text
//! f(x) = n(x) · (x − a(x)) = 0                                   (Adamson and Alexa 2003)
//! ```
//!
//! n has no sign, and needs none: the two ends of an edge of the grid are compared in a common sign,
//! and where f changes it, the surface crosses the edge. Surface nets (Gibson 1998) make a vertex of
//! each cell with crossings and a quad of each crossing. A sheet stays one sheet, two stay two, and
//! both end where Gaussians do: on a straight border of an even sheet the mean a is moved sideways by
//! √(2/π) of the weight's width, and what is moved further is outside.
//!
//! What it costs, with N Gaussians, A their area and c the edge of a cell:
//!
//! | step | work | memory |
//! |---|---|---|
//! | widths of the weights | N searches of a grid | 40 bytes a Gaussian |
//! | sums at the grid's corners | N · 50 to 500 corners of 12 sums | 13 MB |
//! | n and f | one eigenvector a corner | 1.3 kB a block of 4³ corners, 4 to 6 blocks per 16 c² of A |
//! | quads | three edges a corner | 80 bytes per c² of A |
//!
//! Blocks exist only near Gaussians, and [`MOST_BLOCKS`] of them at most.
//!
//! Deliberately absent: files, which side is water, and anything about what is ambiguous.

mod error;
mod field;
mod nets;
mod normal;
mod points;
mod sheets;

use echosplat_model::glam::Vec3;
use echosplat_model::{Gaussian, Standing};

pub use error::SurfaceError;

/// Edge of a cell unless asked for otherwise, metres.
pub const CELL_M: f32 = 0.035;

/// Smallest and largest edge of a cell, metres.
pub const CELL_LIMITS_M: (f32, f32) = (0.005, 5.0);

/// Most blocks of 4³ corners: 0.7 GB, or about 2,000 m² with cells of [`CELL_M`].
pub const MOST_BLOCKS: usize = 500_000;

/// One corner of triangles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertex {
    /// Relative to the map's origin, world axes.
    pub position_m: Vec3,
    /// Unit, across the sheet; which of the two sides it points to is the sheet's, see [`Surface`].
    pub normal: Vec3,
    /// Mean of the sigmas of the Gaussians around, by their weights; infinite if one of note is.
    ///
    /// Neighbours are seen by the same pings from the same poses and err alike, so that many
    /// together are not known better than one.
    pub sigma_m: f32,
}

/// Open sheets of triangles.
///
/// All triangles of a sheet turn the same way where it has two sides: outward if it bulges, else with
/// its front up. No normal knows which side is water.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Surface {
    /// Each is a corner of at least one triangle.
    pub vertices: Vec<Vertex>,
    /// Numbers of vertices, counter-clockwise as seen from the front.
    pub triangles: Vec<[u32; 3]>,
}

/// The surface of what is confident among `gaussians`; empty if there is nothing, or less than a
/// handful of Gaussians that are neighbours. `cell_m` is the edge of a cell of the grid: details below
/// twice of it are lost, sheets nearer to each other than that run together. The same input gives the
/// same bits.
///
/// # Errors
/// If the cell's edge is out of its limits, a Gaussian is not sound, or the surface takes more than
/// [`MOST_BLOCKS`].
pub fn surface_of(gaussians: &[Gaussian], cell_m: f32) -> Result<Surface, SurfaceError> {
    let (least_m, most_m) = CELL_LIMITS_M;
    if !(cell_m >= least_m && cell_m <= most_m) {
        return Err(SurfaceError::Cell { cell_m });
    }
    let confident = gaussians
        .iter()
        .filter(|gaussian| gaussian.standing == Standing::Confident);
    let points = points::points_of(confident, cell_m)?;
    let field = field::Field::of(&points, cell_m)?;
    let quads = nets::Quads::of(&field);
    Ok(sheets::surface_of(quads, cell_m))
}

#[cfg(test)]
mod tests;
