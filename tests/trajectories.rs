//! Trajectories as others write them: of another clock, of another unit, with rows that hold nothing.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use crate::dive::{PING_COUNT, file};
use crate::harness::Program;

const LONG: Duration = Duration::from_secs(120);

/// The dive's poses, each row changed.
fn changed(name: &str, change: impl Fn(usize, &mut Vec<String>)) -> String {
    let text = fs::read_to_string(file("dive.tum")).expect("the dive has poses");
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    let row = |(index, line): (usize, &str)| {
        let mut fields = line.split(' ').map(str::to_owned).collect();
        change(index, &mut fields);
        fields.join(" ") + "\n"
    };
    let rows: String = rows.enumerate().map(row).collect();
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&path, rows).expect("the folder is writable");
    path.display().to_string()
}

fn replay(poses: &str, more: &[&str]) -> Program {
    let log = file("dive.svlog");
    let own = [
        "replay",
        &log,
        "--poses",
        poses,
        "--finished-only",
        "--json",
    ];
    Program::echosplat(&[&own[..], more].concat())
}

/// A stamp moved by whole seconds, to the last digit.
fn moved(stamp: &str, seconds: i64) -> String {
    let (whole, fraction) = stamp.split_once('.').expect("stamps have fractions");
    let whole: i64 = whole.parse().expect("stamps are numbers");
    format!("{}.{fraction}", whole + seconds)
}

#[test]
fn the_offset_that_is_advised_joins_poses_of_another_epoch() {
    for seconds in [1_700_000_000_i64, 1_893_456_000, 4_102_444_800] {
        let poses = changed(&format!("epoch-{seconds}.tum"), |_, fields| {
            fields[0] = moved(&fields[0], seconds);
        });
        let mut refused = replay(&poses, &[]);
        refused.wait_exit_code(2, LONG);
        let said = refused.stderr();
        let advice = said
            .split_once("--time-offset-s ")
            .expect("an offset is advised")
            .1;
        let offset = advice.split(' ').next().expect("a number");
        let mut advised = replay(&poses, &["--time-offset-s", offset]);
        advised.wait_exit_code(0, LONG);
        let mapped = advised.only_json()["pings_mapped"].as_u64();
        assert!(
            mapped > Some(PING_COUNT * 98 / 100),
            "{}",
            advised.account()
        );
    }
}

#[test]
fn rows_that_hold_no_number_are_left_out_counted_and_told() {
    let odd = ["nan", "-nan", "inf", "NaN"];
    let poses = changed("nan.tum", |index, fields| {
        if index < 5 || index % 50 == 7 {
            for field in &mut fields[1..4] {
                *field = odd[index % odd.len()].to_owned();
            }
        }
    });
    let mut program = replay(&poses, &[]);
    program.wait_exit_code(0, LONG);
    let left_out = &program.only_json()["poses"]["source"]["not_finite"];
    let count = left_out.as_u64().expect("it is counted");
    assert!(count > 20, "{count}");
    let told = format!("{count} rows left out that hold NaN or infinity; line 1");
    assert!(program.stderr().contains(&told), "{}", program.account());
    let mut info = Program::echosplat(&["info", &poses, "--json"]);
    info.wait_exit_code(0, LONG);
    assert!(
        info.stdout()
            .contains(&format!("\"rows_not_finite\":{count}")),
        "{}",
        info.account()
    );
}

#[test]
fn stamps_that_are_no_seconds_are_named_as_what_they_are() {
    let in_unit = |digits: usize, epoch_s: i64| {
        changed(&format!("unit-{digits}-{epoch_s}.tum"), |_, fields| {
            let stamp = moved(&fields[0], epoch_s);
            let (whole, fraction) = stamp.split_once('.').expect("it has a fraction");
            let whole = format!("{whole}{}", &fraction[..digits]);
            fields[0] = whole.trim_start_matches('0').to_owned();
            if fields[0].is_empty() {
                fields[0] = "0".to_owned();
            }
        })
    };
    for (digits, unit) in [(3, "milliseconds"), (6, "microseconds"), (9, "nanoseconds")] {
        for epoch_s in [1_700_000_000, 0] {
            let mut program = replay(&in_unit(digits, epoch_s), &[]);
            program.wait_exit_code(2, LONG);
            let said = program.stderr();
            assert!(
                said.contains(unit) && said.contains("write seconds"),
                "{said}"
            );
            assert!(!said.contains("--time-offset-s"), "{said}");
        }
    }
    let mut zero = replay(
        &changed("zero.tum", |_, fields| fields[0] = "0.0".to_owned()),
        &[],
    );
    zero.wait_exit_code(2, LONG);
    assert!(
        zero.stderr().contains("rows have the timestamp 0;"),
        "{}",
        zero.account()
    );
}

#[test]
fn the_way_of_a_map_is_written_and_where_poses_do_not_drift_it_is_as_it_came() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name).display().to_string();
    let poses = file("dive.tum");
    for kind in ["tum", "csv"] {
        let way = at(&format!("made/way.{kind}"));
        let mut program = replay(&poses, &["--track", &way]);
        program.wait_exit_code(0, LONG);
        let mapped = program.only_json()["pings_mapped"].as_u64();
        let text = fs::read_to_string(&way).expect("the way is written");
        let rows = text.lines().skip(1).count() as u64;
        assert_eq!(Some(rows), mapped, "{}", program.account());
    }
    let numbers = |path: &str| -> Vec<Vec<f64>> {
        let text = fs::read_to_string(path).expect("it is there");
        let rows = text.lines().filter(|line| !line.starts_with('#'));
        let number = |field: &str| field.parse().expect("a number");
        rows.map(|line| line.split(' ').map(number).collect())
            .collect()
    };
    let (came, way) = (numbers(&poses), numbers(&at("made/way.tum")));
    let (mut off_m2, mut count) = (0.0, 0.0);
    for row in &way {
        let next = came
            .partition_point(|pose| pose[0] < row[0])
            .clamp(1, came.len() - 1);
        let (a, b) = (&came[next - 1], &came[next]);
        let share = (row[0] - a[0]) / (b[0] - a[0]);
        for axis in 1..4 {
            let off_m = row[axis] - (a[axis] + share * (b[axis] - a[axis]));
            assert!(off_m.abs() < 0.1, "{row:?}");
            off_m2 += off_m * off_m;
            count += 1.0;
        }
    }
    // Of its jitter of 2 cm most is taken away.
    let off_m = f64::sqrt(off_m2 / count);
    assert!(off_m < 0.025, "{off_m}");
    let mut again = replay(&at("made/way.tum"), &[]);
    again.wait_exit_code(0, LONG);
    let mut refused = replay(&poses, &["--track", &at("way.txt")]);
    refused.wait_exit_code(2, LONG);
    let said = refused.stderr();
    assert!(
        said.contains("output.track") && said.contains(".tum"),
        "{said}"
    );
    assert!(!folder.path().join("way.txt").exists());
}
