//! `echosplat info FILE…`: what a log, a recording, a trajectory or a map holds, without mapping.

mod foreign;
mod pings;
mod read;
mod why;

use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use crate::arguments::InfoArguments;
use crate::exit::{Finish, Usage};
use crate::kind::Kind;
use crate::logging;

/// Of a map: what in it is no Gaussian.
const LEFT_OUT: &str = "left_out";
/// What is printed before all other facts.
const FIRST: [&str; 2] = ["name", "kind"];

/// What was found in a file, or in the files of one dive.
#[derive(Debug)]
struct Found {
    files: Vec<PathBuf>,
    facts: Map<String, Value>,
}

/// # Errors
/// Names the file that is none of these, and says what it is instead.
pub(crate) fn run(arguments: &InfoArguments) -> anyhow::Result<Finish> {
    let ask = |at_m| {
        // Given twice a map is told of once.
        let files: Vec<&PathBuf> = arguments.files.iter().collect();
        let is_first = |(index, file): &(usize, &&PathBuf)| !files[..*index].contains(*file);
        let once = files.iter().enumerate().filter(is_first);
        let answers = once.map(|(_, file)| why::ask(file, at_m));
        answers.collect::<anyhow::Result<Vec<_>>>()
    };
    let answers = arguments.why.map(ask).transpose()?.unwrap_or_default();
    let mut found = all_facts(&arguments.files)?;
    let finish = match found.iter().any(|facts| facts.contains_key(LEFT_OUT)) {
        true => Finish::Lossy,
        false => Finish::Done,
    };
    match arguments.json {
        true => {
            for (facts, answer) in found.iter_mut().zip(&answers) {
                facts.insert("why".to_owned(), answer.in_json());
            }
            logging::print(&in_json(found).to_string());
        }
        false => {
            let mut texts: Vec<String> = found.iter().map(lines).collect();
            for (text, answer) in texts.iter_mut().zip(&answers) {
                *text = format!("{text}\n{}", answer.lines());
            }
            logging::print(&texts.join("\n\n"));
        }
    }
    Ok(finish)
}

/// One object of what is one; of several one that has them all.
fn in_json(mut found: Vec<Map<String, Value>>) -> Value {
    match found.len() {
        1 => Value::Object(found.remove(0)),
        _ => json!({ "found": found }),
    }
}

/// In the order of the files; those of one dive where the first of them stands.
fn all_facts(files: &[PathBuf]) -> anyhow::Result<Vec<Map<String, Value>>> {
    let mut asked: Vec<(PathBuf, Kind)> = Vec::new();
    for file in files {
        let kind = Kind::of(file)?;
        // A file given twice is a fault of its dive alone.
        if kind == Kind::Recording || !asked.iter().any(|(other, _)| other == file) {
            asked.push((file.clone(), kind));
        }
    }
    let mut found: Vec<(&str, Found)> = Vec::new();
    let mut recordings = Vec::new();
    for (file, kind) in asked {
        let (name, facts) = match kind {
            Kind::Recording => match echosplat_pose::survey_of_mcap(&file) {
                Ok(Some(survey)) => (FOREIGN, foreign::facts(&file, &survey)),
                // What is wrong with it is said where it is read as a recording.
                Ok(None) | Err(_) => {
                    recordings.push(file);
                    continue;
                }
            },
            Kind::Log => (kind.name(), read::log(&file)?),
            Kind::Map => (kind.name(), read::map(&file)?),
            Kind::Trajectory => (kind.name(), read::trajectory(&file)?),
        };
        let files = vec![file];
        found.push((name, Found { files, facts }));
    }
    let dives = read::recordings(&recordings)?.into_iter();
    found.extend(dives.map(|dive| (Kind::Recording.name(), dive)));
    found.sort_by_key(|(_, found)| files.iter().position(|file| *file == found.files[0]));
    let whole = found.into_iter();
    Ok(whole.map(|(kind, found)| with_names(kind, found)).collect())
}

/// What an MCAP file is that is no recording of a dive.
const FOREIGN: &str = "bag of another program (mcap)";

fn with_names(kind: &str, found: Found) -> Map<String, Value> {
    let names = found.files.iter().map(|file| file.display().to_string());
    let mut names: Vec<String> = names.collect();
    names.dedup();
    let mut facts = Map::new();
    facts.insert(
        "name".to_owned(),
        match &names[..] {
            [name] => name.as_str().into(),
            _ => names.into(),
        },
    );
    facts.insert("kind".to_owned(), kind.into());
    facts.insert("bytes".to_owned(), total_bytes(&found.files).into());
    facts.extend(found.facts);
    facts
}

fn total_bytes(files: &[PathBuf]) -> u64 {
    let length = |file: &PathBuf| std::fs::metadata(file).map_or(0, |found| found.len());
    files.iter().map(length).sum()
}

/// One fact a line; those of an object behind its name, and objects of a list on a line each.
fn lines(facts: &Map<String, Value>) -> String {
    let mut lines = Vec::new();
    let first = FIRST.iter().filter_map(|name| facts.get_key_value(*name));
    let others = facts
        .iter()
        .filter(|(name, _)| !FIRST.contains(&name.as_str()));
    for (name, value) in first.chain(others) {
        let shown = match value {
            Value::Object(inner) => vec![inner_facts(inner)],
            Value::Array(items) if items.iter().any(Value::is_object) => {
                items.iter().map(item).collect()
            }
            Value::Array(items) => {
                let items = items.iter().map(plain);
                vec![items.collect::<Vec<_>>().join("; ")]
            }
            other => vec![plain(other)],
        };
        let name = name.replace('_', " ");
        let names = std::iter::once(name.as_str()).chain(std::iter::repeat(""));
        lines.extend(
            names
                .zip(shown)
                .map(|(name, shown)| format!("{name:<24} {shown}")),
        );
    }
    lines.join("\n")
}

fn item(value: &Value) -> String {
    match value {
        Value::Object(inner) => inner_facts(inner),
        other => plain(other),
    }
}

fn inner_facts(inner: &Map<String, Value>) -> String {
    let is_name = |key: &str| key == "topic";
    let first = inner.iter().filter(|(key, _)| is_name(key));
    let others = inner.iter().filter(|(key, _)| !is_name(key));
    let inner = first.chain(others);
    let inner = inner.map(|(key, value)| format!("{key} {}", plain(value)));
    inner.collect::<Vec<_>>().join(", ")
}

fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "none".to_owned(),
        Value::Bool(true) => "yes".to_owned(),
        Value::Bool(false) => "no".to_owned(),
        Value::Array(items) => items.iter().map(plain).collect::<Vec<_>>().join(" "),
        Value::Number(number) => match number.as_f64().filter(|_| number.is_f64()) {
            Some(number) => format!("{}", (number * 1e4).round() / 1e4),
            None => number.to_string(),
        },
        Value::Object(_) => value.to_string(),
    }
}

/// A file that is not what it should be is the user's to change.
fn refused(file: &Path, error: &dyn std::fmt::Display) -> anyhow::Error {
    Usage::error(format!("{}: {error}", file.display()))
}

#[cfg(test)]
mod tests;
