//! Spawn: Gaussians where evidence asks for them.

pub(crate) mod births;
pub(crate) mod gaussians;
pub(crate) mod kept;
pub(crate) mod lobes;
pub(crate) mod neighbours;
pub(crate) mod split;
