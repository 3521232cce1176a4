//! Rules over the text of the tracked files.

use crate::code::{is_word, without_comments_and_literals, without_tests};
use crate::crates::{FIRMWARE_PROTOCOL, Kind, crate_of_source};

/// A tracked text file.
#[derive(Debug)]
pub(crate) struct SourceFile {
    /// Relative to the workspace, parts separated by `/`.
    pub(crate) path: String,
    pub(crate) text: String,
}

/// Something found, by its byte offset in the text searched, and what is wrong with it.
type Finding = (usize, String);

/// What is left in code that is not finished, or in tests that do not run or do not test.
const UNFINISHED: [&str; 5] = [
    "todo!",
    "unimplemented!",
    "dbg!",
    "#[ignore",
    "assert!(true)",
];

/// Where one machine keeps its files. Split, since this file is looked at too.
const MACHINE_FOLDERS: [&str; 4] = [
    concat!("/wo", "rk/"),
    concat!("/ro", "ot/"),
    concat!("/ho", "me/"),
    concat!("/Us", "ers/"),
];

/// Other names under which a clock can be asked.
const RENAMED_CLOCKS: [&str; 3] = ["Instant as", "SystemTime as", "UNIX_EPOCH.elapsed"];

/// The broken rules of the files, one line each, with path and line number.
pub(crate) fn violations(files: &[SourceFile]) -> Vec<String> {
    let mut broken: Vec<String> = files.iter().flat_map(of_file).collect();
    broken.extend(firmware_protocol_needs_no_std(files));
    broken
}

fn of_file(file: &SourceFile) -> Vec<String> {
    let mut broken = located(file, &file.text, machine_paths(&file.text));
    if file.path.ends_with(".rs") {
        let code = without_comments_and_literals(&file.text);
        broken.extend(located(file, &code, unfinished(&code)));
        if let Some((name, Kind::Pure { files })) = crate_of_source(&file.path) {
            let code = without_tests(&code);
            broken.extend(located(file, &code, impure(name, files, &code)));
        }
        if runs_without_a_truth(&file.path) {
            broken.extend(located(file, &code, judging(&code)));
        }
    }
    broken
}

/// Whether it is of the service and no command: what runs has no truth to compare with.
fn runs_without_a_truth(path: &str) -> bool {
    let of_service = path.strip_prefix("crates/service/src/");
    of_service.is_some_and(|path| !path.starts_with("commands/") && path != "truth.rs")
}

/// Invariant: only commands that are given a truth judge by it.
fn judging(code: &str) -> Vec<Finding> {
    let crates = ["echosplat_metrics", "echosplat_report"].into_iter();
    let found = crates.flat_map(|name| {
        complaints(code, name, move || {
            format!("{name} is for the service's commands alone")
        })
    });
    found.collect()
}

fn located(file: &SourceFile, searched: &str, findings: Vec<Finding>) -> Vec<String> {
    let line_of = |at: usize| searched[..at].matches('\n').count() + 1;
    let lines = findings
        .into_iter()
        .map(|(at, what)| format!("{}:{}: {what}", file.path, line_of(at)));
    lines.collect()
}

fn machine_paths(text: &str) -> Vec<Finding> {
    let found = MACHINE_FOLDERS.iter().flat_map(|folder| {
        let places = text.match_indices(folder).map(|(at, _)| at);
        places
            .filter(|&at| !text[..at].ends_with(continues_path))
            .map(move |at| (at, format!("a path of one machine ({folder}…)")))
    });
    found.collect()
}

/// After such a character `/…/` is the middle of a path or of an address, not its start.
fn continues_path(c: char) -> bool {
    is_word(c) || "-.~)}>]*".contains(c)
}

fn unfinished(code: &str) -> Vec<Finding> {
    let found = UNFINISHED
        .iter()
        .flat_map(|mark| complaints(code, mark, move || format!("{mark} is left in the code")));
    found.collect()
}

/// Invariant: bytes and time come in as arguments.
fn impure(name: &str, may_open_files: bool, code: &str) -> Vec<Finding> {
    let mut found = std_module(code, "net", || format!("{name} has no sockets: std::net"));
    if !may_open_files {
        found.extend(std_module(code, "fs", || {
            format!("{name} opens no files: std::fs")
        }));
    }
    found.extend(complaints(code, "::now", || {
        format!("{name} has no clock: time comes in as an argument")
    }));
    for clock in RENAMED_CLOCKS {
        found.extend(complaints(code, clock, || {
            format!("{name} has no clock: {clock}")
        }));
    }
    if name == FIRMWARE_PROTOCOL {
        for library in ["std::", "alloc::"] {
            found.extend(complaints(code, library, || {
                format!("{name} does without {library}")
            }));
        }
    }
    found
}

fn firmware_protocol_needs_no_std(files: &[SourceFile]) -> Option<String> {
    const ROOT: &str = "firmware-protocol/src/lib.rs";
    let root = files.iter().find(|file| file.path == ROOT)?;
    let code = without_comments_and_literals(&root.text);
    let declared = ["#![no_std]", "#![cfg_attr(not(test), no_std)]"]
        .iter()
        .any(|attribute| code.contains(attribute));
    (!declared).then(|| format!("{ROOT}:1: {FIRMWARE_PROTOCOL} does not declare #![no_std]"))
}

/// Where `std::<module>` is named, alone or in a group such as `use std::{fs, io}`.
fn std_module(code: &str, module: &str, what: impl Fn() -> String) -> Vec<Finding> {
    const GROUP: &str = "std::{";
    let groups = occurrences(code, GROUP).filter(|at| {
        let parts = top_level_parts(&code[at + GROUP.len()..]);
        parts.iter().any(|part| first_segment(part) == module)
    });
    let alone = format!("std::{module}");
    let alone: Vec<usize> = occurrences(code, &alone).collect();
    let all = alone.into_iter().chain(groups);
    all.map(|at| (at, what())).collect()
}

/// The parts of a `use` group, up to its closing brace.
fn top_level_parts(group: &str) -> Vec<&str> {
    let (mut depth, mut start, mut parts) = (0_i32, 0, Vec::new());
    for (at, c) in group.char_indices() {
        depth += i32::from(c == '{') - i32::from(c == '}');
        let ends_group = depth < 0;
        if ends_group || (c == ',' && depth == 0) {
            parts.push(&group[start..at]);
            start = at + 1;
        }
        if ends_group {
            break;
        }
    }
    parts
}

fn first_segment(part: &str) -> &str {
    let part = part.trim();
    part.split(|c| !is_word(c)).next().unwrap_or(part)
}

fn complaints<'a>(
    code: &'a str,
    words: &'a str,
    what: impl Fn() -> String + 'a,
) -> impl Iterator<Item = Finding> + 'a {
    occurrences(code, words).map(move |at| (at, what()))
}

/// Where the words stand, not as the part of a longer one.
fn occurrences<'a>(code: &'a str, words: &'a str) -> impl Iterator<Item = usize> + 'a {
    let (starts_word, ends_word) = (words.starts_with(is_word), words.ends_with(is_word));
    let stand_alone = move |at: usize| {
        let before = code[..at].ends_with(is_word);
        let after = code[at + words.len()..].starts_with(is_word);
        !(starts_word && before || ends_word && after)
    };
    let places = code.match_indices(words).map(|(at, _)| at);
    places.filter(move |&at| stand_alone(at))
}

#[cfg(test)]
mod tests;
