//! The `timestamp` of a log's session packets.

use echosplat_model::Timestamp;

/// Reads `2024-05-01T12:34:56.789Z`; the zone may be `Z`, `±hh:mm`, `±hhmm`, or missing, which is
/// UTC. `None` if it is anything else, or outside the years 1970 to 2200.
pub(crate) fn parse(text: &str) -> Option<Timestamp> {
    let (date, time) = text.trim().split_once(['T', 't', ' '])?;
    let zone_at = time.find(['Z', 'z', '+', '-']).unwrap_or(time.len());
    let (clock, zone) = time.split_at(zone_at);
    let seconds = days(date)? * 86_400 - zone_seconds(zone)?;
    let (whole_seconds, nanos) = clock_seconds(clock)?;
    let nanos = (seconds + whole_seconds) * 1_000_000_000 + nanos;
    Some(Timestamp::from_nanos(nanos))
}

/// Days from 1970-01-01, by counting years from March so that the leap day comes last.
fn days(date: &str) -> Option<i64> {
    let mut parts = date.split('-');
    let (year, month, day) = (
        number(parts.next()?, 4)?,
        number(parts.next()?, 2)?,
        number(parts.next()?, 2)?,
    );
    let is_date = (1970..=2200).contains(&year) && (1..=12).contains(&month);
    if !(is_date && (1..=31).contains(&day) && parts.next().is_none()) {
        return None;
    }
    let (year, month) = match month {
        1 | 2 => (year - 1, month + 9),
        _ => (year, month - 3),
    };
    let leap_days = year / 4 - year / 100 + year / 400;
    // 719468 days lie between 0000-03-01 and 1970-01-01.
    Some(year * 365 + leap_days + (month * 153 + 2) / 5 + day - 1 - 719_468)
}

/// Seconds and nanoseconds since midnight.
fn clock_seconds(clock: &str) -> Option<(i64, i64)> {
    let mut parts = clock.split(':');
    let hours = number(parts.next()?, 2)?;
    let minutes = number(parts.next()?, 2)?;
    let seconds = parts.next().unwrap_or("00");
    let (seconds, fraction) = seconds.split_once(['.', ',']).unwrap_or((seconds, ""));
    let seconds = number(seconds, 2)?;
    if !(hours <= 24 && minutes < 60 && seconds <= 60 && parts.next().is_none()) {
        return None;
    }
    let digits = fraction.get(..fraction.len().min(9))?;
    let nanos = match digits.len() {
        0 => 0,
        count => number(digits, count)? * 10_i64.pow(9 - count as u32),
    };
    Some((hours * 3600 + minutes * 60 + seconds, nanos))
}

/// Seconds east of Greenwich.
fn zone_seconds(zone: &str) -> Option<i64> {
    let sign = match zone.chars().next() {
        None | Some('Z' | 'z') => return (zone.len() <= 1).then_some(0),
        Some('-') => -1,
        Some(_) => 1,
    };
    let digits: String = zone[1..].split(':').collect();
    let (hours, minutes) = match digits.len() {
        2 => (number(&digits, 2)?, 0),
        4 => (number(digits.get(..2)?, 2)?, number(digits.get(2..)?, 2)?),
        _ => return None,
    };
    (hours <= 14 && minutes < 60).then_some(sign * (hours * 3600 + minutes * 60))
}

/// Exactly `count` digits.
fn number(text: &str, count: usize) -> Option<i64> {
    let is_number = text.len() == count && text.bytes().all(|byte| byte.is_ascii_digit());
    is_number.then(|| text.parse().ok())?
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
