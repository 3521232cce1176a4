//! What every pass over pings is told beside the Gaussians.

use crate::features::AtWork;

/// How pings are taken.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PassTerms {
    /// Whether pings are as blurred as their poses may be off.
    pub(crate) is_blurred: bool,
    pub(crate) at_work: AtWork,
}
