//! The paper's method whole, in its order and by its equation numbers: the opponent that the online
//! mapper is measured against.
//!
//! Batch, over images: candidates on elevation arcs (11), support from several views (12), the first
//! Gaussians (13), view tags, the renderer (14) to (30) of `echosplat-acoustics`, L1 (31), (32),
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
//! and once backward. A kernel covers some 40 pixels (±3.5 sigma of about 1.5 bins by 0.7 beams). The
//! fence begins with 249 views × 3,000 tagged × 40 pixels = 30 M pairs an epoch and ends, pruned, at
//! a quarter: about 1 G for 100 epochs, and ten times that where candidates lie as densely as they
//! could. The truss, 886 views × 25,000 × 40 = 0.9 G an epoch: 30 G for 100 epochs with pruning, 90 G
//! without.
//!
//! Memory: 4 bytes per pixel of the images (39 MB, 272 MB), per candidate 40 bytes and a bit per view
//! (at most 4,194,304 candidates, beyond which samples are dropped and counted), per Gaussian 210
//! bytes and a bit per view.

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
mod pruning;
mod random;
mod regularisers;
#[cfg(test)]
mod sample;
mod start;
mod tags;

pub use candidates::CandidateCounts;
pub use choices::{ASSERTED_IN_FENCE_FIGURE, ASSERTED_IN_TRUSS_FIGURE, Choice, Choices, Shadowing};
pub use images::{Image, ImageError, Images};
pub use method::{EpochReport, PaperMethod};
pub use pruning::Pruned;
