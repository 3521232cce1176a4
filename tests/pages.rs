//! Commands of the pages in `docs/` that take seconds, run as they stand there, on the sample dive.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::time::Duration;

use crate::readme::{blocks, start};

const LONG: Duration = Duration::from_secs(300);
const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
/// Subcommands that need no sonar, no network and less than 10 s.
const QUICK: [&str; 12] = [
    "--version",
    "check",
    "completions",
    "config",
    "evaluate",
    "export",
    "georeference",
    "info",
    "measure",
    "report",
    "recover",
    "render",
];

/// Pages and their lines that are run, without comments.
fn quick_lines() -> Vec<(String, String)> {
    let mut lines = Vec::new();
    for folder in ["docs", "docs/develop", "examples/sample-dive"] {
        let entries = fs::read_dir(Path::new(ROOT).join(folder)).expect("the folder can be read");
        let names = entries.map(|entry| entry.expect("it can be read").file_name());
        let mut names: Vec<String> = names.filter_map(|name| name.into_string().ok()).collect();
        names.retain(|name| name.ends_with(".md"));
        names.sort();
        for page in names.iter().map(|name| format!("{folder}/{name}")) {
            let text = fs::read_to_string(Path::new(ROOT).join(&page)).expect("a page is text");
            for line in blocks(&text).concat().iter().filter(|line| is_quick(line)) {
                let (line, _comment) = line.split_once(" # ").unwrap_or((line, ""));
                lines.push((page.clone(), line.trim().to_owned()));
            }
        }
    }
    lines
}

/// Whether a line is run: lines that write to `/etc` are for a vehicle's computer.
fn is_quick(line: &str) -> bool {
    let mut words = line.split_whitespace();
    match (words.next(), words.next()) {
        (Some("echosplat"), Some(word)) => QUICK.contains(&word) && !line.contains("/etc/"),
        (Some("mkdir"), Some("-p")) => line.contains("~/"),
        _ => false,
    }
}

/// Makes the files that pages speak of: a dive, its recording, whole and cut, and a map that some pings were kept from.
fn fill(folder: &Path) {
    let dive = folder.join("dive");
    fs::create_dir(&dive).expect("the folder is new");
    symlink(Path::new(ROOT).join("examples"), folder.join("examples")).expect("the folder is new");
    let sample = folder.join("examples/sample-dive");
    for (name, of_sample) in [
        ("dive.svlog", "dive.svlog"),
        ("dive.tum", "poses.tum"),
        ("truth", "truth"),
    ] {
        symlink(sample.join(of_sample), dive.join(name)).expect("the folder is new");
    }
    let run = |line: &str| start(line, folder).wait_exit_code(0, LONG);
    run("echosplat config --basic > my.toml");
    let measures = "--profile -3,0,0 3,0,0  # across\n";
    fs::write(folder.join("measures.txt"), measures).expect("there is room");
    run(
        "echosplat replay dive/dive.svlog --poses dive/dive.tum --rate 0 --no-publish --finished-only \
         --hold-out 20 --map map.ply --record recordings",
    );
    let mut recorded = fs::read_dir(folder.join("recordings")).expect("the replay made it");
    let recorded = recorded.next().expect("a recording").expect("its name");
    let recording = fs::read(recorded.path()).expect("it can be read");
    let half = &recording[..recording.len() / 2];
    fs::write(folder.join("dive.mcap"), &recording).expect("there is room");
    fs::write(folder.join("cut.mcap"), half).expect("there is room");
}

/// What went wrong with a line, if anything did.
fn fault(folder: &Path, page: &str, line: &str) -> Option<String> {
    let mut program = start(line, folder);
    let code = program.wait_exit(LONG).code();
    // What a cut recording lacks is told by the code.
    let is_fine = code == Some(0) || code == Some(3) && line.contains("cut.mcap");
    (!is_fine).then(|| format!("{page}: {}", program.account()))
}

#[test]
fn quick_commands_of_the_pages_run_as_they_stand() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fill(folder);
    let lines = quick_lines();
    assert!(lines.len() > 15, "{lines:#?}");
    let found = lines.iter();
    let found = found.filter_map(|(page, line)| fault(folder, page, line));
    let found: Vec<String> = found.collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}
