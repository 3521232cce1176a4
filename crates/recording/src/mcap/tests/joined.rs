//! Several recordings read as one: what stands there twice is taken once, and what is of another dive
//! is left out and told.

use std::path::{Path, PathBuf};

use super::*;

/// The records of a run that began at `start_s`: its first event, then a piece of bytes every 0.1 s.
fn run(start_s: f64, clock: &str, pieces: std::ops::Range<usize>) -> Vec<u8> {
    let at = |s: f64| Timestamp::from_secs_f64(1_700_000_000.0 + start_s + s);
    let begin = json!({"event": "begin", "is_log": false, "session": {"clock": clock},
        "began": start_s});
    let mut writer = writer();
    writer
        .write(at(0.0), &Record::Settings("[a]".to_owned()))
        .unwrap();
    writer.write(at(0.0), &Record::Event(begin)).unwrap();
    writer.write(at(0.0), &Record::LinkUp).unwrap();
    for index in pieces {
        writer.write(at(index as f64 * 0.1), &raw(index)).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// A file that a run wrote after another, without what it said first.
fn later(start_s: f64, pieces: std::ops::Range<usize>) -> Vec<u8> {
    let mut writer = writer();
    for index in pieces {
        let at = Timestamp::from_secs_f64(1_700_000_000.0 + start_s + index as f64 * 0.1);
        writer.write(at, &raw(index)).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Removes them when dropped.
struct Files(#[expect(dead_code, reason = "kept for its end")] tempfile::TempDir);

impl Files {
    fn of(files: &[&[u8]]) -> (Self, Vec<PathBuf>) {
        let folder = tempfile::tempdir().unwrap();
        let path = |index: usize| folder.path().join(format!("{index}.mcap"));
        let paths: Vec<_> = (0..files.len()).map(path).collect();
        for (path, bytes) in paths.iter().zip(files) {
            std::fs::write(path, bytes).unwrap();
        }
        (Self(folder), paths)
    }
}

/// The pieces of bytes in the order they came, and what was told.
fn pieces<P: AsRef<Path>>(paths: &[P]) -> (Vec<usize>, Vec<String>) {
    let mut reader = RecordingReader::open(paths).unwrap();
    let mut found = Vec::new();
    while let Some(recorded) = reader.next_message().unwrap() {
        if let Record::Raw(bytes) = recorded.record {
            found.push(bytes.len() - 40);
        }
    }
    (found, reader.losses(false))
}

fn all(count: usize) -> Vec<usize> {
    (0..count).collect()
}

#[test]
fn what_stands_twice_is_taken_once_in_files_and_in_one() {
    let whole = run(0.0, "host", 0..50);
    let half = &whole[..data_end(&whole) - 1500];
    for parts in [
        [&whole[..], &whole[..]],
        [half, &whole[..]],
        [&whole[..], half],
    ] {
        let (_files, paths) = Files::of(&parts);
        let (found, losses) = pieces(&paths);
        assert_eq!(found, all(50), "{losses:?}");
        assert!(losses.join("; ").contains("repeats"), "{losses:?}");
        let (_files, paths) = Files::of(&[&parts.concat()]);
        let (found, losses) = pieces(&paths);
        assert_eq!(found, all(50), "{losses:?}");
        assert!(losses.join("; ").contains("repeats"), "{losses:?}");
    }
}

#[test]
fn half_a_recording_before_the_whole_costs_nothing_wherever_it_was_cut() {
    let whole = run(0.0, "host", 0..12);
    for cut in (20..data_end(&whole)).step_by(13) {
        let (_files, paths) = Files::of(&[&[&whole[..cut], &whole].concat()]);
        let (found, losses) = pieces(&paths);
        assert_eq!(found, all(12), "cut at {cut}: {losses:?}");
    }
}

#[test]
fn overlapping_parts_are_one_dive() {
    let (_files, paths) = Files::of(&[&later(0.0, 0..30), &later(0.0, 20..50)]);
    let (found, losses) = pieces(&paths);
    assert_eq!(found, all(50));
    assert_eq!(losses.len(), 1, "{losses:?}");
    assert!(
        losses[0].contains("1.mcap repeats 10 records"),
        "{losses:?}"
    );
}

#[test]
fn parts_in_another_order_are_put_in_that_of_their_times() {
    let (_files, mut paths) = Files::of(&[
        &run(0.0, "host", 0..20),
        &later(0.0, 20..40),
        &later(0.0, 40..60),
    ]);
    assert_eq!(pieces(&paths), (all(60), Vec::new()));
    paths.swap(0, 2);
    assert_eq!(pieces(&paths), (all(60), Vec::new()));
}

#[test]
fn a_dive_on_the_devices_clock_is_no_part_of_another() {
    let (first, second) = (run(0.0, "device", 0..20), run(60.0, "device", 20..50));
    for overlap_s in [60.0, 1.0] {
        let other = run(overlap_s, "device", 20..50);
        let (_files, paths) = Files::of(&[&first, &other]);
        let (found, losses) = pieces(&paths);
        assert_eq!(found, all(20));
        let said = losses.join("; ");
        assert!(
            said.contains("1.mcap does not go on") && said.contains("replay it by itself"),
            "{said}"
        );
    }
    let (_files, paths) = Files::of(&[&[first, second].concat()]);
    let (found, losses) = pieces(&paths);
    assert_eq!((found, losses.len()), (all(20), 1), "{losses:?}");
}

#[test]
fn two_sonars_at_the_same_time_are_not_one() {
    let (_files, paths) = Files::of(&[&run(0.0, "host", 0..50), &run(-3.0, "host", 50..80)]);
    let (found, losses) = pieces(&paths);
    assert_eq!(found, all(50));
    assert!(losses.join("; ").contains("does not go on"), "{losses:?}");
}

#[test]
fn a_service_that_was_started_again_goes_on_and_it_is_told() {
    let first = run(0.0, "host", 0..20);
    let Record::Raw(last) = raw(19) else {
        unreachable!()
    };
    let last = first.windows(last.len()).rposition(|w| w == last).unwrap();
    let (_files, paths) = Files::of(&[&first[..last + 5], &run(9.0, "host", 20..40)]);
    let (found, losses) = pieces(&paths);
    assert_eq!(found.len(), 39, "{found:?}");
    let said = losses.join("; ");
    assert!(said.contains("0.mcap ends in the middle"), "{said}");
    assert!(said.contains("1.mcap is of another run"), "{said}");
}

#[test]
fn a_mapper_that_was_killed_and_resumed_has_lost_nothing() {
    let position = |next: u64| Record::Event(json!({"event": "tape", "driver": 7, "next": next}));
    let begin = || {
        Record::Event(json!({"event": "begin", "is_log": false,
        "session": {"clock": "device"}}))
    };
    let at = |index: usize| Timestamp::from_secs_f64(1_700_000_000.0 + index as f64 * 0.1);
    let part = |begin_s: usize, next: u64, pieces: std::ops::Range<usize>| {
        let mut writer = writer();
        writer.write(at(begin_s), &begin()).unwrap();
        writer.write(at(begin_s), &position(next)).unwrap();
        for index in pieces {
            writer.write(at(index), &raw(index)).unwrap();
        }
        writer.finish().unwrap().into_inner()
    };
    let first = part(0, 100, 0..20);
    // Cut behind its last piece: the end and the summary are missing.
    let end = data_end(&first);
    let (_files, paths) = Files::of(&[&first[..end], &part(21, 120, 20..40)]);
    assert_eq!(pieces(&paths), (all(40), Vec::new()));
    // Where records of the driver are missing between, that is told.
    let (_files, paths) = Files::of(&[&first[..end], &part(25, 124, 24..40)]);
    let (_, losses) = pieces(&paths);
    assert!(losses.join("; ").contains("lacks 4 records"), "{losses:?}");
}
