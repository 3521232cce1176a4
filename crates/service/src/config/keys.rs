//! The keys there are, with what `config/default.toml` says of each.

use std::sync::LazyLock;

use toml::Value;

use super::DEFAULT_TOML;

/// A key longer than this was never meant to be one of ours.
const LONGEST_COMPARED: usize = 64;

/// One setting.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Key {
    /// Dotted, as `sonar.url`.
    pub(super) name: String,
    /// The comment above it: what it means, and its range.
    pub(super) meaning: String,
    /// Its default, or what the file shows where there is none.
    pub(super) example: Value,
}

static ALL: LazyLock<Vec<Key>> = LazyLock::new(|| keys_of(DEFAULT_TOML));

/// The key with this dotted name.
pub(super) fn find(name: &str) -> Option<&'static Key> {
    ALL.iter().find(|key| key.name == name)
}

/// Whether keys stand in a table of this dotted name.
pub(super) fn is_table(name: &str) -> bool {
    tables().any(|table| table == name)
}

fn tables() -> impl Iterator<Item = &'static str> {
    let of_key = |key: &'static Key| key.name.match_indices('.').map(|(at, _)| &key.name[..at]);
    ALL.iter().flat_map(of_key)
}

fn keys_in(table: &str) -> impl Iterator<Item = &'static str> {
    ALL.iter().filter_map(move |key| {
        let (of, leaf) = split(&key.name);
        (of == table).then_some(leaf)
    })
}

/// Whether there is such a key or table.
#[cfg(test)]
pub(crate) fn is_known(name: &str) -> bool {
    find(name).is_some() || is_table(name)
}

/// Table and last word of a dotted name.
pub(super) fn split(name: &str) -> (&str, &str) {
    name.rsplit_once('.').unwrap_or(("", name))
}

/// What to write in place of a name that there is not.
pub(super) fn instead_of(name: &str, is_table: bool) -> String {
    if is_table {
        return match nearest(name, tables()) {
            Some(meant) => format!("no such table; did you mean [{meant}]?"),
            None => format!("no such table; there are {}", joined(tables())),
        };
    }
    let (table, leaf) = split(name);
    if let Some(meant) = nearest(leaf, keys_in(table)) {
        return format!("no such key; did you mean `{meant}`?");
    }
    let elsewhere = ALL.iter().find(|key| split(&key.name).1 == leaf);
    let near = || nearest_elsewhere(leaf);
    if let Some(meant) = elsewhere.map(|key| key.name.as_str()).or_else(near) {
        return format!("no such key; did you mean `{meant}`?");
    }
    match keys_in(table).next() {
        Some(_) => format!("no such key; [{table}] has {}", joined(keys_in(table))),
        None => format!("no such key; the tables are {}", joined(tables())),
    }
}

fn nearest_elsewhere(leaf: &str) -> Option<&'static str> {
    let meant = nearest(leaf, ALL.iter().map(|key| split(&key.name).1))?;
    let key = ALL.iter().find(|key| split(&key.name).1 == meant)?;
    Some(&key.name)
}

/// The candidate with the fewest letters added, lost, changed or swapped, if a third of them at
/// most is.
fn nearest<'a>(word: &str, candidates: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    if word.len() > LONGEST_COMPARED {
        return None;
    }
    let most = (word.chars().count() / 3).max(1);
    let steps = |candidate: &&str| strsim::damerau_levenshtein(word, candidate);
    let best = candidates.min_by_key(steps)?;
    (steps(&best) <= most).then_some(best)
}

fn joined(words: impl Iterator<Item = &'static str>) -> String {
    let mut once: Vec<&str> = Vec::new();
    for word in words {
        if !once.contains(&word) {
            once.push(word);
        }
    }
    once.join(", ")
}

/// The keys of a TOML file as this project writes them: comments above each key, one line a value.
/// A key that is commented out is one too.
pub(super) fn keys_of(text: &str) -> Vec<Key> {
    let (mut table, mut keys) = (String::new(), Vec::new());
    let mut comment: Vec<&str> = Vec::new();
    for line in text.lines() {
        if let Some(header) = line.strip_prefix('[').and_then(|l| l.split(']').next()) {
            table = format!("{header}.");
            comment.clear();
        } else if let Some((name, example)) = setting(line) {
            keys.push(Key {
                name: format!("{table}{name}"),
                meaning: comment.join(" "),
                example,
            });
            comment.clear();
        } else if let Some(words) = line.strip_prefix('#') {
            comment.push(words.trim());
        } else {
            comment.clear();
        }
    }
    keys
}

/// `name = value`, or the same behind a `#`.
fn setting(line: &str) -> Option<(&str, Value)> {
    let bare = line.trim_start_matches("# ");
    let (name, _) = bare.split_once(" = ")?;
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if name.is_empty() || !name.chars().all(is_name) {
        return None;
    }
    let table: toml::Table = bare.parse().ok()?;
    Some((name, table.get(name)?.clone()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_has_a_meaning_and_an_example() {
        assert!(ALL.len() > 60, "{}", ALL.len());
        for key in ALL.iter() {
            assert!(!key.meaning.is_empty(), "{} has no comment", key.name);
        }
        let bins = find("session.bin_count").unwrap();
        assert_eq!(bins.example, Value::Integer(600));
        assert!(bins.meaning.contains("200 to 1200"));
        assert_eq!(find("output.map").unwrap().example, Value::from("map.ply"));
        assert!(is_table("pose.vehicle_from_sensor") && !is_table("pose.url"));
    }

    #[test]
    fn what_was_meant_is_found() {
        for (name, meant) in [
            ("pose.urll", "`url`"),
            ("pose.rul", "`url`"),
            ("session.bincount", "`bin_count`"),
            ("sonar.bin_count", "`session.bin_count`"),
            ("mapper.beam.azimut_width_deg", "`azimuth_width_deg`"),
            ("bus.resolution", "`mapper.resolution_m`"),
            ("bin_counts", "`session.bin_count`"),
            ("pose.whatever", "[pose] has url, time_offset_s"),
            ("whatever", "the tables are sonar"),
        ] {
            let said = instead_of(name, false);
            assert!(said.contains(meant), "{name}: {said}");
        }
        assert!(instead_of("sesion", true).contains("[session]"));
        assert!(instead_of("pose.vehicle_from_senor", true).contains("[pose.vehicle_from_sensor]"));
        let tables = instead_of(&"x".repeat(1 << 20), false);
        let named = |table: &str| {
            tables
                .split([' ', ','])
                .filter(|word| *word == table)
                .count()
        };
        assert_eq!((named("mapper"), named("mapper.parts")), (1, 1), "{tables}");
    }
}
