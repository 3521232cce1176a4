//! Single runs: which dive, by what method, with which settings, and what came out.
//!
//! A [`Spec`] says all that its run depends on beside the program itself; its name is unique.
//! Deliberately absent: making the runs.

mod expected;
mod outcome;
mod spec;

#[cfg(test)]
pub(crate) use outcome::tests::outcome as sample_outcome;
pub(crate) use outcome::{Ending, LeftOut, Outcome, Outcomes, Work, run_line};
pub(crate) use spec::dive_name;
pub(crate) use spec::{Method, Placement, Spacing, Spec};
