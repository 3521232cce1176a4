//! What every pass over pings starts from.

use crate::accumulate::evidence::Evidence;
use crate::features::AtWork;
use crate::spawn::gaussians::Gaussians;

/// What a pass reads.
#[derive(Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub(crate) evidence: &'a Evidence,
    pub(crate) gaussians: &'a Gaussians,
    /// Whether pings are as blurred as their poses may be off.
    pub(crate) is_blurred: bool,
    pub(crate) at_work: AtWork,
}
