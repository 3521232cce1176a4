//! How far a map is from the truth, and how that falls as a dive goes on.
//!
//! Headline figures are raw: nothing aligned, nothing cropped, no threshold of the evaluator's own.
//! The paper's protocol stands beside them, marked. An empty map has infinite error, which JSON
//! shows as `null`. The same input gives the same bits.
//!
//! Deliberately absent: a clock (times come in as numbers), running anything, words and pictures,
//! and files other than a truth's.

mod alignment;
mod between;
mod certainty;
pub mod curve;
mod map_points;
mod mesh;
mod metrics;
mod neighbors;
pub mod nullable;
mod point_file;
pub mod sample;
mod statistics;
mod truth;

pub use between::distance_between;
pub use certainty::{Certainty, ProbabilityTenth, SigmaTenth, certainty};
pub use map_points::{MapPoint, MapPoints};
pub use mesh::{MeshFigures, MeshMetrics, evaluate_mesh, mesh_places};
pub use metrics::{
    AlignedFigures, FALSE_BEYOND_M, Figures, Metrics, Normals, PaperFigures, distances_to_truth,
    evaluate, evaluate_aligned, evaluate_raw,
};
pub use statistics::Directed;
pub use truth::{Truth, TruthError};
