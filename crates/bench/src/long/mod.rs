//! A dive of hours past several structures, one after the other and back to the first: whether memory
//! and work per ping stay what they were, and whether the first structure's map does.
//!
//! [`Voyage`] makes its pings and poses, [`Found`] holds what was read off on the way and judges it.
//! Deliberately absent: running the mapper, and asking the system for memory and processor time.

mod found;
mod report;
mod voyage;

pub(crate) use found::{Asked, Errors, Found, Reading};
pub(crate) use report::{section, text};
pub(crate) use voyage::{Voyage, VoyagePlan};
