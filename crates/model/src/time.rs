//! Points in time on one base, chosen by whoever stamps them.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

/// A point in time: nanoseconds since the epoch of its clock (Unix for host clocks, power-up or
/// the log's start for device clocks). Which clock is a property of the stream, not of the value.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
#[serde(transparent)]
pub struct Timestamp {
    nanos: i64,
}

impl Timestamp {
    /// The epoch of the clock.
    pub const ZERO: Self = Self { nanos: 0 };

    /// From nanoseconds since the epoch.
    #[must_use]
    pub const fn from_nanos(nanos: i64) -> Self {
        Self { nanos }
    }

    /// From milliseconds since the epoch, saturating.
    #[must_use]
    pub const fn from_millis(millis: i64) -> Self {
        Self {
            nanos: millis.saturating_mul(1_000_000),
        }
    }

    /// From seconds since the epoch; saturates outside ±292 years, NaN becomes the epoch.
    #[must_use]
    pub fn from_secs_f64(seconds: f64) -> Self {
        Self {
            nanos: nanos_of(seconds),
        }
    }

    /// Nanoseconds since the epoch.
    #[must_use]
    pub const fn nanos(self) -> i64 {
        self.nanos
    }

    /// Seconds since the epoch; 0.1 µs of rounding at today's Unix time.
    #[must_use]
    pub fn as_secs_f64(self) -> f64 {
        self.nanos as f64 * 1e-9
    }

    /// Seconds from `earlier` to `self`, negative if `self` is the earlier one.
    #[must_use]
    pub fn seconds_since(self, earlier: Self) -> f64 {
        self.nanos.saturating_sub(earlier.nanos) as f64 * 1e-9
    }

    /// This time moved by `seconds`, saturating.
    #[must_use]
    pub fn offset_by(self, seconds: f64) -> Self {
        Self {
            nanos: self.nanos.saturating_add(nanos_of(seconds)),
        }
    }

    /// This time moved by `nanos`, saturating.
    #[must_use]
    pub const fn offset_by_nanos(self, nanos: i64) -> Self {
        Self {
            nanos: self.nanos.saturating_add(nanos),
        }
    }
}

impl From<SystemTime> for Timestamp {
    /// Unix time, negative before 1970, saturating after ±292 years.
    fn from(time: SystemTime) -> Self {
        let nanos = match time.duration_since(UNIX_EPOCH) {
            Ok(since) => i64::try_from(since.as_nanos()).unwrap_or(i64::MAX),
            Err(before) => i64::try_from(before.duration().as_nanos()).map_or(i64::MIN, |n| -n),
        };
        Self { nanos }
    }
}

/// `as` from a float saturates and takes NaN to zero, which is what both callers promise.
fn nanos_of(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn differences_keep_nanoseconds_at_unix_time() {
        let a = Timestamp::from_nanos(1_700_000_000_000_000_001);
        let b = a.offset_by_nanos(250);
        assert!((b.seconds_since(a) - 250e-9).abs() < 1e-15);
    }

    #[test]
    fn a_hosts_time_is_unix_time_on_both_sides_of_1970() {
        let second = Duration::from_secs(1);
        assert_eq!(
            Timestamp::from(UNIX_EPOCH + second),
            Timestamp::from_millis(1000)
        );
        assert_eq!(
            Timestamp::from(UNIX_EPOCH - second),
            Timestamp::from_millis(-1000)
        );
        let far = Duration::from_secs(400 * 365 * 86_400);
        assert_eq!(Timestamp::from(UNIX_EPOCH + far).nanos(), i64::MAX);
        assert_eq!(Timestamp::from(UNIX_EPOCH - far).nanos(), i64::MIN);
    }

    #[test]
    fn extremes_saturate_and_nan_is_the_epoch() {
        assert_eq!(Timestamp::from_secs_f64(f64::INFINITY).nanos(), i64::MAX);
        assert_eq!(Timestamp::from_secs_f64(f64::NAN), Timestamp::ZERO);
        let late = Timestamp::from_nanos(i64::MAX).offset_by(10.0);
        assert_eq!(late.nanos(), i64::MAX);
    }
}
