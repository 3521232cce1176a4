//! The host's clock, asked in one place.

use std::time::SystemTime;

use echosplat_model::Timestamp;

/// Host time as Unix time.
pub fn now() -> Timestamp {
    SystemTime::now().into()
}

/// `20260102T030405Z`: a time in the name of a file.
pub(crate) fn compact_utc(time: Timestamp) -> String {
    // The calendar's range holds every i64 of nanoseconds.
    let time = jiff::Timestamp::from_nanosecond(time.nanos().into())
        .unwrap_or(jiff::Timestamp::UNIX_EPOCH);
    time.strftime("%Y%m%dT%H%M%SZ").to_string()
}

/// Days from 1970-01-01 to this one.
pub(crate) fn day_of(date: jiff::civil::Date) -> i64 {
    let begin = jiff::civil::date(1970, 1, 1);
    date.duration_since(begin).as_hours() / 24
}

/// The day of a time in UTC, in days since 1970-01-01.
pub(crate) fn unix_day(time: Timestamp) -> i64 {
    time.nanos().div_euclid(86_400_000_000_000)
}

/// `2026-01-02`, so many days after 1970-01-01.
pub(crate) fn iso_day(unix_day: i64) -> String {
    let nanos = unix_day.saturating_mul(86_400_000_000_000);
    let iso = iso_utc(Timestamp::from_nanos(nanos));
    iso.split('T').next().unwrap_or_default().to_owned()
}

/// `2026-01-02T03:04:05.678Z`: a time for people.
pub(crate) fn iso_utc(time: Timestamp) -> String {
    let time = jiff::Timestamp::from_nanosecond(time.nanos().into())
        .unwrap_or(jiff::Timestamp::UNIX_EPOCH);
    format!("{time:.3}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        let at = |seconds: i64| compact_utc(Timestamp::from_millis(seconds * 1000));
        assert_eq!(at(0), "19700101T000000Z");
        assert_eq!(at(951_782_400), "20000229T000000Z");
        assert_eq!(at(1_767_323_045), "20260102T030405Z");
    }
}
