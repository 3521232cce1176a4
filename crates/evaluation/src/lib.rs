//! How good a map is: distances to the truth, error against run time, and reports of both.
//!
//! Headline figures are raw: nothing aligned, nothing cropped, no threshold of the evaluator's own.
//! The paper's protocol stands beside them, marked. An empty map has infinite error, which JSON
//! shows as `null` and reports say in words. The same input gives the same bits.
//!
//! [`stability`] is another question: what the program's numerics make of stiff and extreme cases.
//! [`runs`] names single runs and what came out of them; [`targets`] says what maps of which dives
//! must reach; [`noise_sweep`] hears one dive under more and more noise; [`long`] makes a dive of hours past many structures, and says what it must not cost.
//! [`frame_check`] tells from a dive's pings whether its poses can be what they are read
//! as.
//!
//! Deliberately absent: a clock (times come in as numbers), running the mapper on dives (only the
//! small ones of [`stability`] go through it), and files other than a truth's.

pub mod ablation;
mod alignment;
pub mod baselines;
mod between;
pub mod curve;
pub mod error_time;
pub mod frame_check;
pub mod front;
pub mod held_back;
pub mod long;
mod map_points;
mod mesh;
mod metrics;
mod neighbors;
pub mod noise_sweep;
mod nullable;
mod point_file;
mod rendering;
pub mod report;
pub mod runs;
pub mod stability;
mod statistics;
pub mod table;
pub mod targets;
mod truth;

pub use between::distance_between;
pub use map_points::{MapPoint, MapPoints};
pub use mesh::{MeshFigures, MeshMetrics, evaluate_mesh, mesh_places};
pub use metrics::{Figures, Metrics, Normals, PaperFigures, evaluate, evaluate_raw};
pub use rendering::MapRenderer;
pub use statistics::Directed;
pub use truth::{Truth, TruthError};
