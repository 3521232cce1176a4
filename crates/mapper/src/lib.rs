//! From posed pings to a map of Gaussians: evidence along arcs, Gaussians where evidence asks for
//! them, reflectivity by expectation-maximisation, and what of it the map dares to assert.
//!
//! [`Mapper`] is the face: `insert`, `optimize`, `snapshot`, `finish`. Everything else is inside.
//! This crate deliberately has no sockets, no files, no clock and no randomness: the same pings,
//! configuration and budgets give the same bits at any number of threads.

mod assess;
mod compact;
mod config;
mod evidence;
mod expectation;
mod fan;
mod field;
mod gaussians;
mod history;
mod mapper;
mod multiples;
mod neighbours;
mod parts;
mod profile;
mod seabed;
mod shade;
mod shape;
mod splats;
mod step;
mod tally;
mod visibility;

pub use config::{ConfigError, MapperConfig};
pub use history::look_of;
pub use mapper::{Budget, InsertReport, Mapper, MapperStatus, OptimizeReport};
pub use parts::{LeftOut, Parts};
pub use step::damped_step;
