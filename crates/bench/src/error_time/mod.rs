//! Error against run time, of several methods on the same dives; and what each knob trades.
//!
//! A [`Case`] names the [`Spec`](crate::runs::Spec)s of its runs and makes curves of their outcomes;
//! a [`Sweep`] does so for settings of the mapper on one scene. What is not run is listed by
//! [`omissions`]. Deliberately absent: making the runs.

mod cases;
mod omission;
mod report;
mod sweeps;

pub(crate) use cases::{Case, Line, cases, omissions};
pub(crate) use omission::Omission;
pub(crate) use report::{Endings, case_section, endings, omissions_section, sweep_section, text};
pub(crate) use sweeps::{Sweep, sweeps};
