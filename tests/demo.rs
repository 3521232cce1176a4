//! The first command of a newcomer: what it will do is said first, and what comes next is said last.

use std::time::Duration;

use crate::harness::Program;

const LONG: Duration = Duration::from_secs(120);

#[test]
fn the_demo_says_what_will_happen_and_what_comes_next() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("demo").display().to_string();
    let mut demo = Program::echosplat(&["demo", "--duration", "4", "--out", &out]);
    demo.wait_exit_code(0, LONG);
    let said = demo.stdout();
    let lines: Vec<&str> = said.lines().collect();
    let at = |words: &str| {
        let found = lines.iter().position(|line| line.contains(words));
        found.unwrap_or_else(|| panic!("no {words:?}\n{}", demo.account()))
    };
    assert_eq!(at("EchoSplat demo"), 0, "{}", demo.account());
    assert!(at("160 pings, 4 s of a dive at the fence") < at("is published on"));
    assert!(at(&format!("written to {out}")) < at("pings received"));
    let next = lines.iter().rev().take(3);
    let program = env!("CARGO_BIN_EXE_echosplat");
    for (line, command) in next.zip(["config --basic", "probe", "demo --web 8080"]) {
        let begins = format!("  {program} {command}");
        assert!(line.starts_with(&begins), "{}", demo.account());
    }
    for file in ["map.ply", "report.html"] {
        assert!(folder.path().join("demo").join(file).is_file(), "{file}");
    }
}
