//! The `timestamp` of a log's session packets.

use echosplat_model::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// Reads `2024-05-01T12:34:56.789Z`; the zone may be `Z`, `±hh:mm`, `±hhmm`, or missing, which is
/// UTC. `None` if it is anything else, or outside the years 1970 to 2200.
pub(crate) fn parse(text: &str) -> Option<Timestamp> {
    let text = text.trim();
    // A date alone would be read as its midnight.
    let (_, clock) = text.split_once(['T', 't', ' '])?;
    let has_zone = clock.contains(['Z', 'z', '+', '-']);
    let time: jiff::Timestamp = match has_zone {
        true => text.parse().ok()?,
        false => {
            let civil: DateTime = text.parse().ok()?;
            civil.to_zoned(TimeZone::UTC).ok()?.timestamp()
        }
    };
    let year = time.to_zoned(TimeZone::UTC).year();
    let nanos = i64::try_from(time.as_nanosecond()).ok()?;
    (1970..=2200)
        .contains(&year)
        .then(|| Timestamp::from_nanos(nanos))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nanos(text: &str) -> Option<i64> {
        parse(text).map(Timestamp::nanos)
    }

    #[test]
    fn known_times() {
        assert_eq!(nanos("1970-01-01T00:00:00Z"), Some(0));
        let base = 1_709_210_096_789_000_000;
        assert_eq!(nanos("2024-02-29T12:34:56.789Z"), Some(base));
        assert_eq!(nanos("2024-02-29T14:34:56.789+02:00"), Some(base));
        assert_eq!(nanos("2024-02-29T05:04:56.789-0730"), Some(base));
        assert_eq!(nanos("2024-02-29 12:34:56.789"), Some(base));
        assert_eq!(nanos("2000-03-01T00:00:00Z"), Some(951_868_800_000_000_000));
    }

    #[test]
    fn what_is_no_time_is_none() {
        let odd = [
            "",
            "T",
            "2024-13-01T00:00:00Z",
            "2024-01-01",
            "2024-01-01T25:00:00Z",
            "2024-01-01T00:00:00+é",
            "2024-01-01T00:00:00.éZ",
            "-024-01-01T00:00:00Z",
            "9999-01-01T00:00:00Z",
            "2024-01-01T00:00:00Zulu",
        ];
        for text in odd {
            assert_eq!(nanos(text), None, "{text}");
        }
    }
}
