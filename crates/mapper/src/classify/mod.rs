//! Classify: what of the map is asserted.

pub(crate) mod assess;
pub(crate) mod certainty;
pub(crate) mod occlusion;
