//! Benches as users run them, quickly.

use std::time::Duration;

use crate::harness::Program;

const LONG: Duration = Duration::from_secs(300);

/// The JSON object that is all of standard output; both files are written.
fn bench(name: &str, more: &[&str]) -> serde_json::Value {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let out = folder.path().display().to_string();
    let mut arguments = vec!["bench", name, "--quick", "--json", "--out", &out];
    arguments.extend(more);
    let mut program = Program::echosplat(&arguments);
    program.wait_exit_code(0, LONG);
    let json = program.only_json();
    let path = |extension: &str| folder.path().join(format!("{name}.{extension}"));
    let written = std::fs::read(path("json")).expect("JSON is written");
    let written: serde_json::Value = serde_json::from_slice(&written).expect("it is JSON");
    assert_eq!(written, json);
    let html = std::fs::read_to_string(path("html")).expect("HTML is written");
    assert!(
        html.ends_with("</html>\n") && !html.contains("http"),
        "{name}"
    );
    for field in ["processor", "cores", "simd", "version", "commit"] {
        assert!(!json["machine"][field].is_null(), "{field}");
    }
    json
}

#[test]
fn every_stiff_and_extreme_case_passes() {
    let json = bench("stability", &[]);
    let rows = json["rows"].as_array().unwrap();
    assert!(rows.len() > 60, "{} rows", rows.len());
    for row in rows {
        assert_eq!(row["passed"], true, "{row}");
        let error = row["error"].as_f64().unwrap();
        assert!(error <= row["limit"].as_f64().unwrap(), "{row}");
    }
}

#[test]
fn every_kernel_is_measured_and_says_its_pairs() {
    let json = bench("kernels", &[]);
    let kernels = json["kernels"].as_array().unwrap();
    // Where there is AVX2, the mapper's kernels are measured at that level too.
    assert!(matches!(kernels.len(), 5 | 7), "{}", kernels.len());
    for kernel in kernels {
        assert!(kernel["forward_per_s"].as_f64().unwrap() > 0.0, "{kernel}");
        assert!(kernel["pairs"].as_u64().unwrap() > 10_000, "{kernel}");
    }
}

#[test]
fn the_papers_method_runs_on_its_case() {
    let json = bench("paper", &["--case", "fence", "--epochs", "2"]);
    let case = &json["cases"][0];
    assert_eq!(case["printed"]["candidates"], 50_940);
    assert_eq!(case["epochs"].as_array().unwrap().len(), 2);
    assert!(case["candidates"]["kept"].as_u64().unwrap() > 0);
    let choices = json["choices"].as_array().unwrap();
    assert!(choices.iter().all(|choice| choice["why"].is_string()));
}

#[test]
fn a_target_is_run_judged_and_not_run_again() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let out = folder.path().display().to_string();
    let run = || {
        let only = ["--quick", "--only", "empty", "--json", "--out", &out];
        let arguments = [&["bench", "targets"], &only[..]].concat();
        let mut program = Program::echosplat(&arguments);
        program.wait_exit_code(0, LONG);
        let json = program.only_json();
        assert_eq!(json["passed"], true, "{json}");
        assert_eq!(json["left_out"].as_array().unwrap().len(), 0);
        let row = &json["rows"][0];
        assert_eq!(
            (&row["verdict"], &row["median"]),
            (&"passed".into(), &0.0.into())
        );
        assert_eq!(json["runs"][0]["outcome"]["pings"], 9600);
        program.stderr()
    };
    assert!(run().contains("[1/1] empty survey nominal, seed 1"));
    assert!(run().contains("1 of 1 runs are done already"));
}

/// Work and error of the quick form, kept to tell when a change moves them:
/// `echosplat bench all --quick --write-table docs/quick.json` renews it.
const KEPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/quick.json");

#[test]
fn work_and_error_of_the_quick_form_are_those_of_the_kept_table() {
    let json = bench("all", &["--against", KEPT, "--seeds", "1"]);
    assert_eq!(json["differences"].as_array().unwrap().len(), 0, "{json}");
    assert!(json["table"].as_object().unwrap().len() >= 9, "{json}");
}

#[test]
fn a_bench_of_many_parts_ends_when_it_is_asked_to() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let out = folder.path().display().to_string();
    let mut program = Program::echosplat(&["bench", "all", "--quick", "--out", &out]);
    program.wait_for_text("INFO [1/", LONG);
    program.terminate();
    program.wait_exit_code(1, LONG);
    assert!(
        program.stderr().contains("stopped; asked again"),
        "{}",
        program.account()
    );
    assert!(!folder.path().join("stability.json").exists());
}

#[test]
fn curves_say_what_each_moment_took_and_what_is_left_out() {
    let json = bench("error-time", &["--only", "fence/survey"]);
    let curves = json["cases"][0]["curves"].as_array().unwrap();
    let methods: Vec<&str> = curves
        .iter()
        .map(|c| c["method"].as_str().unwrap())
        .collect();
    let expected = [
        "support from M views",
        "hit-ratio carving",
        "online",
        "online finished",
    ];
    assert_eq!(methods, expected);
    for curve in curves {
        let samples = curve["samples"].as_array().unwrap();
        assert!(
            samples.len()
                >= if curve["method"] == "online finished" {
                    1
                } else {
                    6
                }
        );
        let work = |sample: &serde_json::Value| sample["voxel_looks"].as_u64().unwrap();
        assert!(samples.is_sorted_by_key(work), "{curve}");
    }
    let omissions = json["omissions"].as_array().unwrap();
    let is_listed = |what: &str| omissions.iter().any(|o| o["what"] == what);
    assert!(is_listed("fence, pan, nominal, 30 s"), "{omissions:?}");
}

#[test]
fn the_sweep_of_noise_says_what_became_of_each_level() {
    let json = bench("noise", &[]);
    let levels = json["levels"].as_array().unwrap();
    let of = |pings: &str| -> Vec<f64> {
        let own = levels.iter().filter(|row| row["level"]["pings"] == pings);
        own.map(|row| row["confident_count"]["median"].as_f64().unwrap())
            .collect()
    };
    for pings in ["field", "nominal"] {
        let asserted = of(pings);
        assert_eq!(asserted.len(), 3, "{json}");
        // At 30 dB more of a fence is asserted than at 6 dB.
        assert!(asserted[0] > asserted[2], "{pings}: {asserted:?}");
    }
    // Nothing is asked of a short dive.
    assert!(levels.iter().all(|row| row["verdict"] == "shown"), "{json}");
}

#[test]
fn features_are_compared_and_those_that_are_not_settings_are_listed() {
    let parts = [
        "--only",
        "fence",
        "--part",
        "mapper.work_pairs_per_ping=600000,20000,60000",
        "--part",
        "mapper.no_such_part=1,2,3",
    ];
    let json = bench("ablation", &parts);
    let rows = json["rows"].as_array().unwrap();
    let variants: Vec<&str> = rows
        .iter()
        .map(|r| r["variant"].as_str().unwrap())
        .collect();
    assert_eq!(
        variants,
        ["everything auto", "everything on", "everything off"]
    );
    let work = |row: &serde_json::Value| row["pairs"]["median"].as_f64().unwrap();
    assert!(work(&rows[1]) > work(&rows[0]) && work(&rows[0]) > work(&rows[2]));
    assert_eq!(json["omissions"][0]["what"], "mapper.no_such_part");
}

#[test]
fn the_report_goes_on_where_it_was_and_gives_its_page() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let out = path("docs/results.json");
    let report = |more: &[&str]| {
        let own = ["bench", "report", "--quick", "--out", &out];
        let mut program = Program::echosplat(&[&own, more].concat());
        program.wait_exit_code(0, LONG);
        program.stderr()
    };
    let first = report(&["--only", "length"]);
    assert!(first.contains("runs left, about"), "{first}");
    let read =
        || -> serde_json::Value { serde_json::from_slice(&std::fs::read(&out).unwrap()).unwrap() };
    let part = read();
    assert_eq!(part["length"][0]["runs"].as_array().unwrap().len(), 2);
    assert!(!part["left_out"].as_array().unwrap().is_empty());
    // What is done of another part stays.
    let all = report(&[]);
    assert!(
        all.contains("2 of ") && all.contains("runs are done already"),
        "{all}"
    );
    let whole = read();
    assert_eq!(whole["length"], part["length"]);
    assert_eq!(whole["left_out"].as_array().unwrap().len(), 0);
    assert_eq!(whole["live"].as_array().unwrap().len(), 10);
    let methods = whole["error_time"][0]["curves"].as_array().unwrap();
    assert!(
        methods
            .iter()
            .any(|curve| curve["method"] == "online finished")
    );
    let page = path("docs/results.md");
    let arguments = ["bench", "report", "--write-page", &page, "--from", &out];
    Program::echosplat(&arguments).wait_exit_code(0, LONG);
    let text = std::fs::read_to_string(&page).unwrap();
    assert!(text.contains("|fence, survey, nominal|1|"), "{text}");
    for line in text.lines().filter(|line| line.starts_with("![")) {
        let (_, chart) = line.split_once("](").expect("a chart has its file");
        let chart = folder.path().join("docs").join(chart.trim_end_matches(')'));
        assert!(chart.is_file(), "{}", chart.display());
    }
}

/// The page in the repository is what the file in the repository gives.
#[test]
fn the_kept_page_is_that_of_the_kept_results() {
    let docs = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let kept = docs.join("results.json");
    if !kept.is_file() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder can be made");
    let page = folder.path().join("results.md");
    let (page_text, kept_text) = (page.display().to_string(), kept.display().to_string());
    let arguments = [
        "bench",
        "report",
        "--write-page",
        &page_text,
        "--from",
        &kept_text,
    ];
    Program::echosplat(&arguments).wait_exit_code(0, LONG);
    let made = std::fs::read_to_string(&page).unwrap();
    assert_eq!(
        made,
        std::fs::read_to_string(docs.join("results.md")).unwrap()
    );
}
