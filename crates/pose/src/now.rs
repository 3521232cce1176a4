//! The host's clock.

use std::time::SystemTime;

use echosplat_model::Timestamp;

/// Now, on this host's clock.
pub(crate) fn now() -> Timestamp {
    SystemTime::now().into()
}
