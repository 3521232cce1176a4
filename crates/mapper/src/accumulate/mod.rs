//! Accumulate: what bins say to evidence per place, and the pings that are remembered.

pub(crate) mod common_error;
pub(crate) mod evidence;
pub(crate) mod fan;
pub(crate) mod finding;
pub(crate) mod history;
