use super::*;

const NO_STD_ROOT: (&str, &str) = ("firmware-protocol/src/lib.rs", "#![no_std]\n");

fn violations_of(files: &[(&str, &str)]) -> Vec<String> {
    let files: Vec<SourceFile> = files
        .iter()
        .map(|(path, text)| SourceFile {
            path: (*path).to_owned(),
            text: (*text).to_owned(),
        })
        .collect();
    violations(&files)
}

fn assert_broken(path: &str, text: &str, line: &str) {
    let broken = violations_of(&[(path, text)]);
    assert_eq!(broken.len(), 1, "{text:?}: {broken:?}");
    assert!(broken[0].starts_with(line), "{text:?}: {broken:?}");
}

fn assert_sound(path: &str, text: &str) {
    assert_eq!(
        violations_of(&[(path, text)]),
        Vec::<String>::new(),
        "{text:?}"
    );
}

#[test]
fn sockets_are_found_however_they_are_named() {
    for text in [
        "use std::net::UdpSocket;",
        "use std::{io, net::UdpSocket};",
        "use std::{collections::{BTreeMap, btree_map}, net};",
        "fn f() { std::net::TcpStream::connect(\"a\"); }",
    ] {
        assert_broken(
            "crates/session/src/lib.rs",
            text,
            "crates/session/src/lib.rs:1: echosplat-session has no sockets",
        );
    }
    assert_sound(
        "crates/session/src/lib.rs",
        "use std::{io, mem};\nuse crate::net::x;\nuse std::network;",
    );
    assert_sound("crates/driver/src/lib.rs", "use std::net::UdpSocket;");
}

#[test]
fn clocks_are_found() {
    for text in [
        "\nlet now = Instant::now();",
        "\nlet now = std::time::SystemTime::now();",
        "\nlet clock: fn() -> _ = Instant::now;",
        "\nuse std::time::Instant as Clock;",
    ] {
        assert_broken(
            "crates/mapper/src/lib.rs",
            text,
            "crates/mapper/src/lib.rs:2: echosplat-mapper has no clock",
        );
    }
    assert_sound(
        "crates/mapper/src/lib.rs",
        "fn f(now: Timestamp) { g(now, Self::nowhere()) }",
    );
    assert_sound("crates/service/src/clock.rs", "Instant::now()");
}

#[test]
fn files_are_opened_only_where_files_are_read() {
    for folder in ["measurement", "mapper", "model", "session"] {
        let path = format!("crates/{folder}/src/lib.rs");
        assert_broken(&path, "use std::fs::File;", &format!("{path}:1: "));
        assert_broken(&path, "use std::{fs, io};", &format!("{path}:1: "));
    }
    for folder in ["recording", "simulator", "metrics", "service"] {
        assert_sound(&format!("crates/{folder}/src/lib.rs"), "use std::{fs, io};");
    }
}

#[test]
fn words_in_comments_literals_and_tests_are_not_code() {
    let text =
        "// std::net\nlet a = \"Instant::now()\";\n#[cfg(test)]\nmod tests { use std::fs; }\n";
    assert_sound("crates/model/src/lib.rs", text);
    assert_sound("crates/model/src/time/tests.rs", "use std::fs;");
}

#[test]
fn the_firmware_protocol_does_without_std() {
    assert_sound(NO_STD_ROOT.0, NO_STD_ROOT.1);
    assert_broken(
        NO_STD_ROOT.0,
        "// #![no_std]\n",
        "firmware-protocol/src/lib.rs:1: ",
    );
    for text in ["use std::vec::Vec;", "use alloc::vec::Vec;"] {
        let broken = violations_of(&[NO_STD_ROOT, ("firmware-protocol/src/frame.rs", text)]);
        assert_eq!(broken.len(), 1, "{text}: {broken:?}");
    }
}

#[test]
fn what_is_not_finished_is_found_in_tests_too() {
    for mark in UNFINISHED {
        let text = format!("#[cfg(test)]\nmod tests {{\n{mark};\n}}");
        assert_broken("tests/main.rs", &text, "tests/main.rs:3: ");
    }
    assert_sound("tests/main.rs", "mytodo!(); // todo!\nf(\"#[ignore]\");");
}

#[test]
fn paths_of_one_machine_are_found_in_any_file() {
    for folder in MACHINE_FOLDERS {
        assert_broken("README.md", &format!("see\n`{folder}x`"), "README.md:2: ");
        assert_sound(
            "README.md",
            &format!("https://example.org{folder}x and ..{folder}"),
        );
    }
}

#[test]
fn what_runs_in_the_service_judges_by_no_truth() {
    let text = "use echosplat_metrics::Truth;";
    assert_broken(
        "crates/service/src/pipeline/worker.rs",
        text,
        "crates/service/src/pipeline/worker.rs:1: echosplat_metrics is for",
    );
    assert_sound("crates/service/src/commands/replay.rs", text);
    assert_sound("crates/service/src/truth.rs", text);
    assert_sound("crates/bench/src/commands/long.rs", text);
}
