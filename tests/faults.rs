//! The service killed and unplugged, a few times each; `bench faults` does it as often as asked.

use std::time::Duration;

use crate::harness::Program;

const LONG: Duration = Duration::from_secs(400);

#[test]
fn kills_lose_at_most_one_ping_and_unplugs_a_second_of_mapping() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let out = folder.path().display().to_string();
    let families = ["--only", "kills,unplugs"];
    let counts = ["--kills", "20", "--unplugs", "20"];
    let own = ["bench", "faults", "--json", "--out", &out];
    let mut program = Program::echosplat(&[&own[..], &families, &counts].concat());
    let status = program.wait_exit(LONG);
    assert_eq!(status.code(), Some(0), "{}", program.account());
    let json = program.only_json();
    let cases = json["cases"].as_array().expect("cases are listed");
    assert_eq!(cases.len(), 3, "{json}");
    let lost = cases[0]["figures"]["most lost in one"].as_f64();
    assert!(lost.is_some_and(|lost| lost <= 1.0), "{json}");
    for unplugged in &cases[1..] {
        let back_s = unplugged["back_after_s"].as_f64();
        assert!(back_s.is_some_and(|back_s| back_s <= 1.0), "{unplugged}");
    }
}
