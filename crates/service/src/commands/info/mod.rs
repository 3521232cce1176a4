//! `echosplat info FILE…`: what a log, a recording, a trajectory or a map holds, without mapping.

mod pings;
mod read;

use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use crate::arguments::InfoArguments;
use crate::exit::{Finish, Usage};
use crate::kind::Kind;
use crate::logging;

/// Of a map: what in it is no Gaussian.
const LEFT_OUT: &str = "left_out";

/// # Errors
/// Names the file that is none of these, and says what it is instead.
pub(crate) fn run(arguments: &InfoArguments) -> anyhow::Result<Finish> {
    let facts = facts(&arguments.files)?;
    let finish = match facts.contains_key(LEFT_OUT) {
        true => Finish::Lossy,
        false => Finish::Done,
    };
    match arguments.json {
        true => logging::print(&Value::Object(facts).to_string()),
        false => logging::print(&lines(&facts)),
    }
    Ok(finish)
}

fn facts(files: &[PathBuf]) -> anyhow::Result<Map<String, Value>> {
    let kinds = files.iter().map(|file| Kind::of(file));
    let kinds = kinds.collect::<anyhow::Result<Vec<_>>>()?;
    let kind = kinds[0];
    let is_one = kinds.len() == 1 || kinds.iter().all(|kind| *kind == Kind::Recording);
    if !is_one {
        return Err(Usage::error(
            "several files are read as one only if all are recordings (.mcap) of a dive; \
             give one file",
        ));
    }
    let file = &files[0];
    let found = match kind {
        Kind::Recording => read::recording(files),
        Kind::Log => read::log(file),
        Kind::Map => read::map(file),
        Kind::Trajectory => read::trajectory(file),
    }?;
    let mut facts = Map::new();
    facts.insert("kind".to_owned(), kind.name().into());
    facts.insert("bytes".to_owned(), total_bytes(files).into());
    facts.extend(found);
    Ok(facts)
}

fn total_bytes(files: &[PathBuf]) -> u64 {
    let length = |file: &PathBuf| std::fs::metadata(file).map_or(0, |found| found.len());
    files.iter().map(length).sum()
}

/// One fact a line; those of an object behind its name.
fn lines(facts: &Map<String, Value>) -> String {
    let mut lines = Vec::new();
    // What it is comes first, the rest by name.
    let kind = facts.get_key_value("kind");
    let others = facts.iter().filter(|(name, _)| *name != "kind");
    for (name, value) in kind.into_iter().chain(others) {
        let shown = match value {
            Value::Object(inner) => {
                let inner = inner
                    .iter()
                    .map(|(key, value)| format!("{key} {}", plain(value)));
                inner.collect::<Vec<_>>().join(", ")
            }
            Value::Array(items) => {
                let items = items.iter().map(plain);
                items.collect::<Vec<_>>().join("; ")
            }
            other => plain(other),
        };
        lines.push(format!("{:<24} {shown}", name.replace('_', " ")));
    }
    lines.join("\n")
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
