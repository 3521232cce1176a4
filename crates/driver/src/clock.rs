//! What time it is on the computer that listens.

use std::time::SystemTime;

use echosplat_model::Timestamp;

/// The host's clock.
pub(crate) fn host_time() -> Timestamp {
    SystemTime::now().into()
}
