//! The paper's method whole, in its order and by its equation numbers: the opponent that the online
//! mapper is measured against.
//!
//! Batch, over images: candidates on elevation arcs (11), support from several views (12), the first
//! Gaussians (13), view tags, the renderer (14) to (30) of [`rendering`] beside its plain [`twin`], L1 (31), (32),
//! regularisers (33) to (42), Adam, opacity gradient alignment (43) to (46), pruning (47) to (49).
//! A fair opponent: where the paper is silent, [`Choices`] makes it work well, once for both of its
//! cases, and says why in one table.
//!
//! Deliberately absent: sockets, files, a clock, and any randomness beside the fixed shuffle of the
//! views. The same input gives the same bits at any thread count.
//!
//! # Cost
//!
//! An epoch goes through the pairs Σ over views of tagged Gaussians × pixels under each, once forward
//! and once backward; a kernel, cut at ±3.5 sigma, covers 30 to 60 pixels. Early pruning takes most of
//! it away. The fence (249 views) begins with 15,000 Gaussians and 17 M pairs an epoch and ends at
//! 4 M: 0.5 G for 100 epochs. The truss (886 views) begins with 160,000 and 0.8 G and is down to
//! 0.11 G after 20 epochs: 12.5 G for 100. Were nothing pruned and candidates as dense as pixels, it
//! would be 10 to 20 G and 300 G. The renderer's bands, the elevation rays and the candidates'
//! support run on rayon's pool; steps follow one another, since each starts from the last.
//!
//! Memory: 4 bytes per pixel of the images (38 MB fence, 272 MB truss), per candidate some 60 bytes
//! and a bit per view (at most 4,194,304 candidates, beyond which samples are dropped and counted),
//! per Gaussian some 220 bytes and a bit per view.

mod adam;
mod alignment;
mod asserted;
mod candidates;
mod choices;
mod elevation_ray;
mod grid;
mod images;
mod loss;
mod method;
mod parameters;
mod pruning;
mod random;
mod real;
mod regularisers;
pub mod rendering;
mod retain;
#[cfg(test)]
mod sample;
pub mod scenes;
mod start;
mod support;
mod tags;
pub mod twin;

pub use candidates::CandidateCounts;
pub use choices::{ASSERTED_IN_FENCE_FIGURE, ASSERTED_IN_TRUSS_FIGURE, Choice, Choices, Shadowing};
pub use images::{Image, ImageError, Images};
pub use method::{EpochReport, PaperMethod};
pub use parameters::{
    GaussianArrays, GradientArrays, OPACITY_MAX, PARAMETER_COUNT, Parameters, opacity_of,
    opacity_slope,
};
pub use pruning::Pruned;
pub use real::Real;
pub use support::{Support, support};
