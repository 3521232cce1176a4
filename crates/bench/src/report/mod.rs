//! What one version reaches, in one file that fits 90 minutes on two cores: a choice from the cases of the
//! other benches.
//!
//! [`Plan`] says which runs, [`results`] makes figures of their outcomes. Speed and what is missed are read
//! off the same runs. Deliberately absent: making the runs, and the page, which the report crate makes.

mod figures;
mod plan;

pub(crate) use figures::{Made, results};
pub(crate) use plan::Plan;
