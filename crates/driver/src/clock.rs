//! What time it is on the computer that listens.

use std::time::{SystemTime, UNIX_EPOCH};

use echosplat_model::Timestamp;

/// The host's clock.
pub(crate) fn host_time() -> Timestamp {
    let nanos = match SystemTime::now().duration_since(UNIX_EPOCH) {
        Ok(since) => i64::try_from(since.as_nanos()).unwrap_or(i64::MAX),
        Err(before) => i64::try_from(before.duration().as_nanos()).map_or(i64::MIN, |n| -n),
    };
    Timestamp::from_nanos(nanos)
}
