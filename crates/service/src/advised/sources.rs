//! Every flag, key and command that a string in the sources of the product names is one that there is.

use std::fs;
use std::path::{Path, PathBuf};

use clap::CommandFactory;

use crate::arguments::Arguments;
use crate::config::is_known;

/// Whose sentences an owner reads.
const CRATES: [&str; 14] = [
    "bus",
    "driver",
    "input",
    "join",
    "liveness",
    "mapper",
    "pose",
    "prediction",
    "program",
    "recording",
    "ros",
    "service",
    "session",
    "web",
];

/// A string as it stands in a source, without what is put in as it is shown.
struct Literal {
    file: PathBuf,
    text: String,
}

#[test]
fn every_flag_key_and_command_in_a_sentence_is_one_that_there_is() {
    let literals = literals();
    assert!(literals.len() > 2000, "{} strings are few", literals.len());
    let mut wrong = Vec::new();
    let mut checked = 0;
    for Literal { file, text } in &literals {
        for fault in faults(text, &mut checked) {
            wrong.push(format!("{}: {fault} in {text:?}", file.display()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(checked > 60, "{checked} flags, keys and commands are few");
}

#[test]
fn what_there_is_not_is_found() {
    let faults = |text: &str| faults(text, &mut 0).join("; ");
    assert!(faults("set pose.max_gap_s to 1").contains("pose.max_gap_s"));
    assert!(faults("or give --time-offset 3").contains("--time-offset"));
    assert!(faults("`echosplat calibrat DIVE` finds it").contains("calibrat"));
    assert!(faults("`echosplat probe --poses F`").contains("--poses"));
    let sound = "`echosplat probe --sonar URL`, --poses F.tum, pose.max_pose_gap_s, [pose.vehicle_from_sensor]";
    assert_eq!(faults(sound), "");
    assert_eq!(
        faults("`mcap sort --output b.mcap a.mcap` helps"),
        "",
        "another's command"
    );
}

/// What a text names and there is not.
fn faults(text: &str, checked: &mut usize) -> Vec<String> {
    let mut faults = Vec::new();
    let program = Arguments::command();
    for (index, part) in text.split('`').enumerate() {
        let is_quoted = index % 2 == 1;
        let mut words = part.split_whitespace().peekable();
        let is_ours = words.peek() == Some(&"echosplat");
        let command = match is_quoted && is_ours {
            true => {
                let name = words.nth(1).unwrap_or_default();
                *checked += 1;
                let found = program.find_subcommand(name);
                if found.is_none() && !["bench", "completions", "man"].contains(&name) {
                    faults.push(format!("no command {name}"));
                }
                found
            }
            false => None,
        };
        if is_quoted && !is_ours && words.peek().is_some_and(|first| !first.starts_with('-')) {
            // Another program's command, a word of a file, or a value.
            continue;
        }
        for flag in flags(part) {
            *checked += 1;
            let is_known = match command {
                Some(command) => takes(command, flag),
                None => program
                    .get_subcommands()
                    .any(|command| takes(command, flag)),
            };
            if !is_known && !takes(&program, flag) {
                faults.push(format!("no flag --{flag}"));
            }
        }
        for key in keys(part) {
            *checked += 1;
            if !is_known(key) {
                faults.push(format!("no key {key}"));
            }
        }
    }
    faults
}

fn takes(command: &clap::Command, flag: &str) -> bool {
    ["help", "version"].contains(&flag)
        || command.get_arguments().any(|argument| {
            let aliases = argument.get_all_aliases().unwrap_or_default();
            argument.get_long() == Some(flag) || aliases.contains(&flag)
        })
}

/// Names behind two dashes.
fn flags(text: &str) -> impl Iterator<Item = &str> {
    let begins = text.match_indices("--").filter(|(at, _)| {
        let before = text[..*at].chars().next_back();
        before.is_none_or(|before| !before.is_alphanumeric() && before != '-')
    });
    begins.filter_map(|(at, _)| {
        let name = &text[at + 2..];
        let end = name.find(|c: char| !c.is_ascii_alphanumeric() && c != '-');
        let name = &name[..end.unwrap_or(name.len())];
        let is_name = name.starts_with(|first: char| first.is_ascii_lowercase());
        is_name.then_some(name)
    })
}

/// Dotted names that begin with a table of the configuration. A string of nothing else is a name in another place: a
/// field of a message.
fn keys(text: &str) -> impl Iterator<Item = &str> {
    let is_in_name = |c: char| c.is_ascii_alphanumeric() || "._/".contains(c);
    let is_sentence = text.contains(' ');
    let words = text.split(move |c: char| !is_in_name(c));
    let words = words.map(|word| word.trim_end_matches('.'));
    words.filter(move |word| {
        let tables = [
            "sonar", "session", "pose", "mapper", "pipeline", "output", "bus", "web",
        ];
        let (table, rest) = word.split_once('.').unwrap_or((word, ""));
        is_sentence && tables.contains(&table) && !rest.is_empty() && !word.contains('/')
    })
}

fn literals() -> Vec<Literal> {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut found = Vec::new();
    for name in CRATES {
        in_folder(&crates.join(name).join("src"), &mut found);
    }
    found
}

fn in_folder(folder: &Path, found: &mut Vec<Literal>) {
    for entry in fs::read_dir(folder).expect("the sources are there") {
        let path = entry.expect("it is read").path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let is_test = [
            "tests",
            "tests.rs",
            "documents.rs",
            "end_to_end",
            "end_to_end.rs",
            "advised",
            "advice.rs",
        ]
        .contains(&&*name)
            && !path.ends_with("calibration/advice.rs");
        if is_test {
            continue;
        }
        if path.is_dir() {
            in_folder(&path, found);
        } else if name.ends_with(".rs") {
            let source = fs::read_to_string(&path).expect("it is text");
            let product = source
                .split("#[cfg(test)]\nmod tests {")
                .next()
                .unwrap_or_default();
            let texts = strings(product).into_iter();
            found.extend(texts.map(|text| Literal {
                file: path.clone(),
                text,
            }));
        }
    }
}

/// The strings of a source, comments left out.
fn strings(source: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = source;
    while let Some(first) = rest.chars().next() {
        rest = if rest.starts_with("//") {
            rest.split_once('\n').map_or("", |(_, rest)| rest)
        } else if let Some(raw) = rest.strip_prefix("r#\"") {
            let (text, rest) = raw.split_once("\"#").unwrap_or((raw, ""));
            found.push(text.to_owned());
            rest
        } else if let Some(text) = rest.strip_prefix('"') {
            let (text, rest) = string(text);
            found.push(text);
            rest
        } else if let Some(rest) = rest.strip_prefix("'\\") {
            // An escaped character, which may be a quote.
            rest.char_indices().nth(1).map_or("", |(at, _)| &rest[at..])
        } else if let Some(rest) = rest.strip_prefix("'\"'") {
            rest
        } else {
            &rest[first.len_utf8()..]
        };
    }
    found
}

/// What stands before the closing quote, and what behind it.
fn string(source: &str) -> (String, &str) {
    let mut text = String::new();
    let mut chars = source.char_indices();
    while let Some((at, c)) = chars.next() {
        match c {
            '"' => return (text, &source[at + 1..]),
            '\\' => match chars.next() {
                Some((_, '\n')) => {
                    let blank = chars.as_str();
                    let skipped = blank.len() - blank.trim_start().len();
                    let next = source.len() - blank.len() + skipped;
                    let (more, rest) = string(&source[next..]);
                    return (text + &more, rest);
                }
                Some((_, 'n')) => text.push('\n'),
                Some((_, escaped)) => text.push(escaped),
                None => {}
            },
            _ => text.push(c),
        }
    }
    (text, "")
}
