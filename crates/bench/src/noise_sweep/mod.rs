//! Error against noise: one survey heard under more and more noise, down to echoes that hardly stand
//! above it. What is lost must be ambiguous or absent, and never false.
//!
//! [`levels`] names the [`Spec`](crate::runs::Spec)s of its runs and [`rows`] judges their outcomes.
//! Deliberately absent: making the runs.

mod levels;
mod report;

pub(crate) use levels::{Level, levels};
pub(crate) use report::{Row, failures, rows, section, text};
