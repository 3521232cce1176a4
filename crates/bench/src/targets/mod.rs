//! The targets: what maps of which dives must reach, and whether they do.
//!
//! A [`Case`] names the [`Spec`](crate::runs::Spec)s of its runs and makes [`Row`]s of their
//! [`Outcome`](crate::runs::Outcome)s. A row passes if its median over the seeds meets what it must,
//! and its worst stays within 1.5 times that, ratios to what is as good within twice what is above 1. Deliberately absent: making the runs.

mod accuracy;
mod cases;
mod limit;
mod live;
mod report;
mod sections;

pub(crate) use cases::{Case, cases};
pub(crate) use limit::{Row, Verdict};
pub(crate) use live::{FEW_TENTHS, LIVE_MOMENTS, case as live_case};
pub(crate) use report::{sections, text};
pub(crate) use sections::Section;
