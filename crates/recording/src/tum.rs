//! TUM trajectories: lines of `timestamp tx ty tz qx qy qz qw`, seconds and metres.
//!
//! Times are read and written as decimal text, never through a float, so nanoseconds survive
//! Unix time; other numbers are written with as many digits as bring back the same bits.

use std::io::{self, BufRead, Write};

use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Pose, StampedPose, Timestamp};

/// Longest line taken; eight numbers written in full stay below 300 bytes.
const MAX_LINE_BYTES: u64 = 4096;

/// Two days at 50 Hz; a pipe need never end.
const MAX_POSES: usize = 8_640_000;

/// What a trajectory file held.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TumFile {
    /// Poses in strictly increasing time, without uncertainty, all of epoch 0.
    pub poses: Vec<StampedPose>,
    /// Poses that stood after a later one; they were put in their place.
    pub out_of_order_count: usize,
    /// Poses left out because another one of the same time says the same.
    pub duplicate_count: usize,
    /// Poses left out because an earlier line of the same time says something else.
    pub contradicting_count: usize,
    /// Rows left out because a number in them is NaN or infinite.
    pub not_finite_count: usize,
    /// The first of these rows, counted from 1.
    pub first_not_finite: Option<usize>,
}

/// Why a trajectory was refused.
#[derive(Debug, thiserror::Error)]
pub enum TumError {
    /// A line says something a pose cannot be.
    #[error("line {line}: {what}")]
    Line {
        /// Counted from 1.
        line: usize,
        /// What was wrong and what would be right.
        what: String,
    },
    /// The file could not be read.
    #[error("reading the trajectory: {0}")]
    Io(#[from] io::Error),
}

/// Reads poses; blank lines and lines starting with `#` are skipped, commas count as spaces. Rows with
/// NaN or infinity, as estimators write them before they have begun, are left out and counted.
///
/// # Errors
/// Names the first line that is not a pose, or the read error.
pub fn read(mut reader: impl BufRead) -> Result<TumFile, TumError> {
    let mut file = TumFile::default();
    let mut bytes = Vec::new();
    for line in 1.. {
        bytes.clear();
        let mut limited = io::Read::take(&mut reader, MAX_LINE_BYTES);
        if limited.read_until(b'\n', &mut bytes)? == 0 {
            break;
        }
        match parse_line(&bytes).map_err(|what| TumError::Line { line, what })? {
            Row::Nothing => {}
            Row::Pose(pose) => file.poses.push(pose),
            Row::NotFinite => {
                file.not_finite_count += 1;
                file.first_not_finite.get_or_insert(line);
            }
        }
        if file.poses.len() > MAX_POSES {
            let what = format!("more than {MAX_POSES} poses; give those of one dive");
            return Err(TumError::Line { line, what });
        }
    }
    put_in_order(&mut file);
    Ok(file)
}

/// By time; of several poses of one time the first in the file stays.
fn put_in_order(file: &mut TumFile) {
    let later = |pair: &&[StampedPose]| pair[1].time < pair[0].time;
    file.out_of_order_count = file.poses.windows(2).filter(later).count();
    file.poses.sort_by_key(|pose| pose.time);
    let (duplicates, contradicting) = (&mut file.duplicate_count, &mut file.contradicting_count);
    file.poses.dedup_by(|pose, kept| {
        let same_time = pose.time == kept.time;
        if same_time && pose.world_from_vehicle == kept.world_from_vehicle {
            *duplicates += 1;
        } else if same_time {
            *contradicting += 1;
        }
        same_time
    });
}

/// Writes poses so that [`read`] gives back the same bits; uncertainty and epoch are not kept.
///
/// # Errors
/// Of the writer.
pub fn write(poses: &[StampedPose], mut writer: impl Write) -> io::Result<()> {
    writeln!(writer, "# timestamp tx ty tz qx qy qz qw")?;
    for pose in poses {
        let nanos = pose.time.nanos();
        let sign = if nanos < 0 { "-" } else { "" };
        let (secs, rest) = (nanos.unsigned_abs() / NANOS, nanos.unsigned_abs() % NANOS);
        let t = pose.world_from_vehicle.translation_m;
        let q = pose.world_from_vehicle.rotation;
        writeln!(
            writer,
            "{sign}{secs}.{rest:09} {:?} {:?} {:?} {:?} {:?} {:?} {:?}",
            t.x, t.y, t.z, q.x, q.y, q.z, q.w
        )?;
    }
    writer.flush()
}

const NANOS: u64 = 1_000_000_000;

/// What a line holds.
enum Row {
    /// It is blank or a comment.
    Nothing,
    Pose(StampedPose),
    /// A number of it is NaN or infinite.
    NotFinite,
}

fn parse_line(bytes: &[u8]) -> Result<Row, String> {
    if bytes.len() as u64 == MAX_LINE_BYTES {
        return Err(format!(
            "longer than {MAX_LINE_BYTES} bytes; not a trajectory"
        ));
    }
    let text = std::str::from_utf8(bytes)
        .map_err(|_| "not text; expected `timestamp tx ty tz qx qy qz qw`".to_owned())?;
    let text = text.trim_start_matches('\u{feff}').trim();
    if text.is_empty() || text.starts_with('#') {
        return Ok(Row::Nothing);
    }
    let fields: Vec<&str> = text
        .split(|c: char| c.is_whitespace() || c == ',')
        .filter(|field| !field.is_empty())
        .collect();
    if fields.len() != 8 {
        return Err(format!(
            "{} fields, expected 8: timestamp tx ty tz qx qy qz qw",
            fields.len()
        ));
    }
    let mut numbers = [0.0; 7];
    for (number, field) in numbers.iter_mut().zip(&fields[1..]) {
        *number = number_of(field)?;
    }
    let is_stamp_finite = number_of(fields[0]).map_or(true, f64::is_finite);
    if !is_stamp_finite || !numbers.iter().all(|number| number.is_finite()) {
        return Ok(Row::NotFinite);
    }
    let time = nanos_of_decimal(fields[0]).ok_or_else(|| no_time(fields[0]))?;
    let [x, y, z, qx, qy, qz, qw] = numbers;
    let pose = pose_of(DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(x, y, z))
        .ok_or("the quaternion has no length; expected qx qy qz qw of length 1")?;
    Ok(Row::Pose(StampedPose {
        time: Timestamp::from_nanos(time),
        world_from_vehicle: pose,
        uncertainty: None,
        epoch: 0,
    }))
}

/// As Rust, C and Microsoft's C write numbers; these two have `-nan(ind)` and `1.#INF` besides.
fn number_of(field: &str) -> Result<f64, String> {
    let bare = field.trim_start_matches(['-', '+']).to_ascii_lowercase();
    if bare.starts_with("nan(") || bare.starts_with("1.#") {
        return Ok(f64::NAN);
    }
    let number = field.parse::<f64>();
    number.map_err(|_| format!("`{field}` is not a number"))
}

/// Units that stamps are in by mistake, and how many of each make a second.
const SMALLER_UNITS: [(&str, f64); 3] = [
    ("milliseconds", 1e3),
    ("microseconds", 1e6),
    ("nanoseconds", 1e9),
];
/// Unix times of 1973 to 2286, seconds.
const UNIX_S: std::ops::Range<f64> = 1e8..1e10;

/// Why a stamp is none: text, or a number beyond what seconds reach to.
fn no_time(field: &str) -> String {
    let Ok(stamp) = field.parse::<f64>() else {
        return format!("timestamp `{field}` is not a time in seconds");
    };
    let is_of = |per_second: f64| UNIX_S.contains(&(stamp / per_second).abs());
    let unit = SMALLER_UNITS.iter().find(|(_, count)| is_of(*count));
    unit.map_or_else(
        || {
            format!(
                "timestamp `{field}` is no time in seconds, which reach to 9.2e9: write seconds, by \
                 dividing all of them by 1e3, 1e6 or 1e9 if they are milliseconds, microseconds or nanoseconds"
            )
        },
        |(unit, per_second)| {
            let seconds = in_seconds(field, *per_second);
            format!("timestamp `{field}` is in {unit}; write seconds, here {seconds}")
        },
    )
}

/// The same time in seconds; of whole numbers to the last digit.
fn in_seconds(field: &str, per_second: f64) -> String {
    let digits = per_second.log10() as usize;
    let is_whole = field.bytes().all(|byte| byte.is_ascii_digit());
    match field.len().checked_sub(digits) {
        Some(at) if is_whole => format!("{}.{}", &field[..at], &field[at..]),
        _ => format!("{:.3}", field.parse().unwrap_or(0.0) / per_second),
    }
}

/// Normalises, but leaves a quaternion alone that is already a unit one to rounding.
fn pose_of(rotation: DQuat, translation_m: DVec3) -> Option<Pose> {
    if (rotation.length_squared() - 1.0).abs() < 1e-14 {
        return Some(Pose {
            rotation,
            translation_m,
        });
    }
    Pose::checked(rotation, translation_m)
}

/// Nanoseconds of a decimal number of seconds with optional sign, fraction and exponent,
/// rounded half away from zero below the nanosecond.
fn nanos_of_decimal(text: &str) -> Option<i64> {
    let (mantissa, exponent) = match text.find(['e', 'E']) {
        Some(at) => (&text[..at], text[at + 1..].parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (negative, digits) = match mantissa.as_bytes().first()? {
        b'-' => (true, &mantissa[1..]),
        b'+' => (false, &mantissa[1..]),
        _ => (false, mantissa),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    if whole.len() + fraction.len() == 0 {
        return None;
    }
    // The value is the digits times 10^shift nanoseconds.
    let shift = exponent
        .checked_add(9)?
        .checked_sub(i32::try_from(fraction.len()).ok()?)?;
    let magnitude = shifted(whole.bytes().chain(fraction.bytes()), shift)?;
    let nanos = i64::try_from(magnitude).ok()?;
    Some(if negative { -nanos } else { nanos })
}

/// Decimal digits times 10^shift; `None` for what is no digit or does not fit.
fn shifted(digits: impl Iterator<Item = u8> + Clone, shift: i32) -> Option<u64> {
    let count = i32::try_from(digits.clone().count()).ok()?;
    let kept = count.saturating_add(shift.min(0));
    let mut value: u64 = 0;
    let mut first_dropped = b'0';
    for (index, digit) in (0..).zip(digits) {
        if !digit.is_ascii_digit() {
            return None;
        }
        if index < kept {
            value = value
                .checked_mul(10)?
                .checked_add(u64::from(digit - b'0'))?;
        } else if index == kept {
            first_dropped = digit;
        }
    }
    for _ in 0..shift.max(0) {
        if value == 0 {
            break;
        }
        value = value.checked_mul(10)?;
    }
    value.checked_add(u64::from(first_dropped >= b'5'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read_str(text: &str) -> Result<TumFile, TumError> {
        read(text.as_bytes())
    }

    fn error(text: &str) -> String {
        read_str(text).unwrap_err().to_string()
    }

    #[test]
    fn comments_blanks_and_commas_are_fine() {
        let file = read_str("\u{feff}# head\n\n1.5 1 2 3 0 0 0 1\r\n2.5,4,5,6,0,0,0,2\n").unwrap();
        assert_eq!(file.poses.len(), 2);
        assert_eq!(file.poses[0].time.nanos(), 1_500_000_000);
        assert_eq!(file.poses[1].world_from_vehicle.rotation, DQuat::IDENTITY);
        let second = file.poses[1].world_from_vehicle;
        assert_eq!(second.translation_m, DVec3::new(4.0, 5.0, 6.0));
    }

    #[test]
    fn errors_name_the_line_and_what_would_be_right() {
        assert!(error("# a\n1 2 3\n").starts_with("line 2: 3 fields, expected 8"));
        assert!(error("1 0 0 0 0 0 0 0").contains("quaternion has no length"));
        assert!(error("x 0 0 0 0 0 0 1").contains("`x` is not a time"));
        assert!(error(&"9".repeat(10_000)).contains("longer than"));
        assert!(read(&[0xff_u8, 0xfe, 0x00][..]).is_err());
    }

    #[test]
    fn rows_that_are_not_finite_are_left_out_whoever_wrote_them() {
        let odd = [
            "nan",
            "NaN",
            "-nan",
            "-nan(ind)",
            "nan(snan)",
            "1.#QNAN",
            "-1.#IND",
            "inf",
            "-Infinity",
            "1.#INF",
            "1e999",
        ];
        for odd in odd {
            for column in 0..8 {
                let mut fields = ["2.5", "0", "0", "0", "0", "0", "0", "1"];
                fields[column] = odd;
                let rows = format!(
                    "1 0 0 0 0 0 0 1\n# c\n{}\n3 0 0 0 0 0 0 1\n",
                    fields.join(" ")
                );
                let file = read_str(&rows).unwrap_or_else(|error| panic!("{odd}: {error}"));
                let found = (
                    file.poses.len(),
                    file.not_finite_count,
                    file.first_not_finite,
                );
                assert_eq!(found, (2, 1, Some(3)), "{odd} in column {column}");
            }
        }
        assert!(error("1 x 0 0 0 0 0 nan").contains("`x` is not a number"));
    }

    #[test]
    fn stamps_in_smaller_units_are_named_with_what_to_write() {
        let refused = |stamp: &str| error(&format!("{stamp} 0 0 0 0 0 0 1"));
        for (stamp, unit, seconds) in [
            ("1700000000123456789", "nanoseconds", "1700000000.123456789"),
            ("1.7e18", "nanoseconds", "1700000000.000"),
            ("1700000000123456", "microseconds", "1700000000.123456"),
            ("1700000000123456.7", "microseconds", "1700000000.123"),
            ("1700000000123", "milliseconds", "1700000000.123"),
            ("1893456000000000000", "nanoseconds", "1893456000.000000000"),
            ("123456789012", "milliseconds", "123456789.012"),
        ] {
            let said = refused(stamp);
            let wanted = format!("`{stamp}` is in {unit}; write seconds, here {seconds}");
            assert!(said.ends_with(&wanted), "{said}");
            assert!(read_str(&format!("{seconds} 0 0 0 0 0 0 1")).is_ok());
        }
        assert!(refused("50000000000").contains("dividing all of them by"));
        assert!(refused("9e99").contains("dividing all of them by"));
    }

    #[test]
    fn any_order_is_put_right_and_what_is_left_out_is_counted() {
        let line = |(t, x): (f64, i32)| format!("{t} {x} 0 0 0 0 0 1\n");
        let lines = [(1.0, 1), (2.0, 2), (2.0, 2), (1.5, 3), (3.0, 4), (3.0, 5)];
        let file = read_str(&lines.map(line).concat()).unwrap();
        let found = file.poses.iter().map(|pose| {
            let place = pose.world_from_vehicle.translation_m.x;
            (pose.time.as_secs_f64(), place as i32)
        });
        let expected = vec![(1.0, 1), (1.5, 3), (2.0, 2), (3.0, 4)];
        assert_eq!(found.collect::<Vec<_>>(), expected);
        assert_eq!(file.out_of_order_count, 1);
        assert_eq!((file.duplicate_count, file.contradicting_count), (1, 1));
    }

    #[test]
    fn decimal_times_are_exact() {
        let nanos = nanos_of_decimal;
        assert_eq!(
            nanos("1700000000.123456789"),
            Some(1_700_000_000_123_456_789)
        );
        assert_eq!(nanos("1.7e9"), Some(1_700_000_000_000_000_000));
        assert_eq!(
            nanos("1.700000000000000000e+09"),
            Some(1_700_000_000_000_000_000)
        );
        assert_eq!(nanos("-0.0000000005"), Some(-1));
        assert_eq!(nanos("0.00000000049"), Some(0));
        assert_eq!(nanos(".5"), Some(500_000_000));
        assert_eq!(nanos("0e999999999"), Some(0));
        for bad in [
            "",
            ".",
            "-",
            "1e",
            "1e99",
            "9e999999999",
            "1.2.3",
            "0x1",
            "nan",
            "1e-3e",
        ] {
            assert_eq!(nanos(bad), None, "{bad}");
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back_to_the_last_bit(
            nanos in proptest::collection::btree_set(-i64::MAX..i64::MAX, 1..20),
            x in -1e12..1e12f64, y in -1e-12..1e-12f64, angle in -3.0..3.0f64,
        ) {
            let rotation = DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(y + angle);
            let poses: Vec<_> = nanos.into_iter().map(|nanos| StampedPose {
                time: Timestamp::from_nanos(nanos),
                world_from_vehicle: Pose { rotation, translation_m: DVec3::new(x, y, angle) },
                uncertainty: None,
                epoch: 0,
            }).collect();
            let mut bytes = Vec::new();
            write(&poses, &mut bytes).unwrap();
            prop_assert_eq!(read(&bytes[..]).unwrap().poses, poses);
        }

        #[test]
        fn no_text_makes_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = read(&bytes[..]);
        }
    }
}
