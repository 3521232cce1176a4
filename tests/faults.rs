//! The service killed, unplugged and overloaded, a few times each, and soaked for a moment; the benches
//! do it as often and as long as asked.

use std::time::Duration;

use crate::harness::Program;

const LONG: Duration = Duration::from_secs(400);
/// Pings of 0.2 s: so long a busy machine may leave the service without a turn to read what was sent. A
/// recording that is not written at once lacks those of seconds.
const MOST_UNREAD: f64 = 8.0;

#[test]
fn kills_lose_what_was_not_read_and_mapping_goes_on_after_unplugs() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let out = folder.path().display().to_string();
    let families = ["--only", "kills,unplugs"];
    let counts = ["--kills", "20", "--unplugs", "20"];
    let own = ["bench", "faults", "--json", "--out", &out];
    let mut program = Program::echosplat(&[&own[..], &families, &counts].concat());
    let cases = cases_of(&mut program);
    assert_eq!(cases.len(), 3, "{cases:?}");
    for case in &cases {
        assert!(broken(case).is_empty(), "{case}");
    }
    let lost = cases[0]["figures"]["most lost in one"].as_f64();
    assert!(lost.is_some_and(|lost| lost <= MOST_UNREAD), "{cases:?}");
    let is_back = |case: &serde_json::Value| case["back_after_s"].as_f64() > Some(0.0);
    assert!(cases[1..].iter().all(is_back), "{cases:?}");
}

/// What a bench of faults says of each case, whether or not all were as fast as asked for.
fn cases_of(program: &mut Program) -> Vec<serde_json::Value> {
    let status = program.wait_exit(LONG);
    let has_ended = matches!(status.code(), Some(0 | 3));
    assert!(has_ended, "{}", program.account());
    let json = program.only_json();
    json["cases"].as_array().expect("cases are listed").clone()
}

/// What did not hold, but for what a slow machine alone makes of it: times, and what a disk that does
/// not keep up with 50 MB a second leaves out and tells of.
fn broken(case: &serde_json::Value) -> Vec<&str> {
    let lost = case["figures"]["messages lost"].as_f64();
    let of_disk = ["lacks", "not in the log", "the replay's"];
    let is_slow = |line: &str| {
        line.contains("were taken in within")
            || line.contains("until mapping")
            || line.contains("pings are not in the recording")
            || lost != Some(0.0) && of_disk.iter().any(|words| line.contains(words))
    };
    let broken = case["broken"].as_array().expect("a list");
    let broken = broken.iter().filter_map(serde_json::Value::as_str);
    broken.filter(|line| !is_slow(line)).collect()
}

#[test]
fn a_soak_with_overload_leaves_a_whole_log_that_gives_the_map_again() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let out = folder.path().display().to_string();
    let short = ["--live-minutes", "0.1", "--replayed-minutes", "0.5"];
    let own = ["bench", "soak", "--json", "--out", &out];
    let mut program = Program::echosplat(&[&own[..], &short].concat());
    let cases = cases_of(&mut program);
    assert_eq!(cases.len(), 5, "{cases:?}");
    for case in &cases {
        assert!(broken(case).is_empty(), "{case}");
    }
    let of_overload = cases.iter().filter(|case| case["family"] == "overload");
    let most_shed = of_overload.filter_map(|case| case["figures"]["pings shed"].as_f64());
    assert!(most_shed.fold(0.0, f64::max) > 0.0, "{cases:?}");
    let live = &cases[4]["figures"];
    assert!(live["rounds"].as_f64() >= Some(1.0), "{cases:?}");
}
