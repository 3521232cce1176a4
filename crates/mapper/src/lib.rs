//! From posed pings to a map of Gaussians: evidence along arcs, Gaussians where evidence asks for
//! them, reflectivity by expectation-maximisation, and what of it the map dares to assert.
//!
//! A ping goes through five rooms in order: `detect`, `accumulate`, `spawn`, `refine`, `classify`; the method is
//! in `docs/algorithm.md`. [`Mapper`] is the face: `insert`, `snapshot`, `finish`. Everything else is inside.
//! This crate deliberately has no sockets, no files, no clock and no randomness: the same pings,
//! configuration and budgets give the same bits at any number of threads.

mod accumulate;
mod classify;
mod config;
mod detect;
mod mapper;
mod parts;
mod refine;
mod seabed;
mod spawn;
mod world;

pub use accumulate::history::look_of;
pub use config::{ConfigError, MapperConfig};
pub use mapper::{InsertReport, Mapper, MapperStatus};
pub use parts::{LeftOut, Parts};
pub use refine::step::damped_step;
