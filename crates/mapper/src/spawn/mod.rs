//! Spawn: Gaussians where evidence asks for them.

pub(crate) mod directional_reflectivity;
pub(crate) mod from_evidence;
pub(crate) mod gaussians;
pub(crate) mod kept;
pub(crate) mod neighbours;
pub(crate) mod split;
