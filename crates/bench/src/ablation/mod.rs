//! What each optional feature of the mapper is worth: on, off, and as the mapper chooses by itself.
//!
//! A [`Feature`] is a key of the configuration with a value for each [`State`]; a [`Variant`] sets all
//! of them; a [`Case`] is a dive that every variant maps. [`check`] holds what the mapper chooses
//! against everything fixed. Deliberately absent: making the runs.

mod cases;
mod check;
mod report;

pub(crate) use cases::{
    Case, FEATURES, Feature, State, Variant, cases, omissions, specs, variants,
};
pub(crate) use check::check;
pub(crate) use report::{Row, case_section, check_section, rows, text};
