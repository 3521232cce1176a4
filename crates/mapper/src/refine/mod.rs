//! Refine: strengths, places and shapes of some tiles' Gaussians from the pings that see them.

pub(crate) mod expectation;
pub(crate) mod field;
pub(crate) mod inherit;
pub(crate) mod places;
pub(crate) mod refill;
pub(crate) mod shape;
pub(crate) mod step;
pub(crate) mod tally;
pub(crate) mod terms;
pub(crate) mod visibility;
