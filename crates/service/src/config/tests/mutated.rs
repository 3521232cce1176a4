//! Ten thousand configurations that are not quite right, each made from the default one by a seed.

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use toml::Value;

use super::keys::{Key, find, keys_of};
use super::*;

const COUNT: u64 = 10_000;

/// Random numbers of a seed.
struct Random(SplitMix64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0.next_u64()
    }

    fn below(&mut self, most: usize) -> usize {
        (self.next() % most as u64) as usize
    }

    fn of<'a>(&mut self, all: &'a [Key]) -> &'a Key {
        &all[self.below(all.len())]
    }
}

/// Values that no key takes, by kind.
const NO_NUMBER: [&str; 8] = [
    "\"many\"",
    "true",
    "[]",
    "{ a = 1 }",
    "1979-05-27",
    "\"\\u0000\"",
    "[[1]]",
    "\"1\"",
];
const NO_FINITE: [&str; 5] = ["nan", "-nan", "inf", "-inf", "-1e300"];
const NO_TEXT: [&str; 5] = ["3", "1.5", "false", "[\"a\"]", "{ b = 2 }"];
const NO_LIST: [&str; 4] = ["3", "\"a\"", "true", "[{ a = [[]] }]"];
const NO_SWITCH: [&str; 4] = ["1", "\"yes\"", "[true]", "{ a = true }"];
const NO_COUNT: [&str; 5] = ["-32769", "1.5", "1e3", "99999999999999999999", "0x"];

fn wrong_value(key: &Key, random: &mut Random) -> &'static str {
    let kinds: &[&[&str]] = match key.example {
        Value::Integer(_) => &[&NO_NUMBER, &NO_FINITE, &NO_COUNT],
        Value::Float(_) => &[&NO_NUMBER, &NO_FINITE],
        Value::Array(_) => &[&NO_LIST],
        Value::Boolean(_) => &[&NO_SWITCH],
        _ => &[&NO_TEXT],
    };
    let kind: &[&'static str] = kinds[random.below(kinds.len())];
    kind[random.below(kind.len())]
}

/// One key with a value it cannot have, the rest as it is by default.
fn with_wrong_value(random: &mut Random) -> (String, String) {
    let keys = keys_of(DEFAULT_TOML);
    let key = random.of(&keys);
    let (table, leaf) = keys::split(&key.name);
    let text = format!("[{table}]\n{leaf} = {}\n", wrong_value(key, random));
    (key.name.clone(), text)
}

/// One key spelt otherwise.
fn with_wrong_key(random: &mut Random) -> (String, String) {
    let keys = keys_of(DEFAULT_TOML);
    let key = random.of(&keys);
    let (table, leaf) = keys::split(&key.name);
    let mut leaf: Vec<char> = leaf.chars().collect();
    let at = random.below(leaf.len());
    match random.below(3) {
        0 => leaf[at] = 'q',
        1 => leaf.insert(at, 'q'),
        _ => leaf.push('q'),
    }
    let leaf: String = leaf.into_iter().collect();
    let text = format!("[{table}]\n{leaf} = {}\n", key.example);
    (format!("{table}.{leaf}"), text)
}

/// Bytes of the default file changed, lost, doubled or moved: it may still be a configuration.
fn with_damage(random: &mut Random) -> String {
    let mut bytes = DEFAULT_TOML.as_bytes().to_vec();
    for _ in 0..=random.below(8) {
        let at = random.below(bytes.len());
        match random.below(4) {
            0 => bytes[at] = b"09.-_\"[]={}#\nexab"[random.below(17)],
            1 => drop(bytes.remove(at)),
            2 => bytes.insert(at, b"09.-\"[]=#\n"[random.below(10)]),
            _ => {
                let end = (at + random.below(200)).min(bytes.len());
                let piece = bytes[at..end].to_vec();
                let to = random.below(bytes.len());
                drop(bytes.splice(to..to, piece));
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn lines_of(text: &str) -> Vec<String> {
    match Config::parse(Path::new("my.toml"), text) {
        Ok(config) => {
            assert!(config.check().is_ok(), "{text}");
            Vec::new()
        }
        Err(refused) => crate::exit::lines(&refused),
    }
}

/// Each is one line that names the file, and is not longer than a reader's patience.
fn assert_readable(lines: &[String], text: &str) {
    for line in lines {
        assert!(line.starts_with("my.toml"), "{line}\n{text}");
        assert!(!line.contains(['\n', '\u{1b}']), "{line}");
        assert!(line.len() < 1000, "{line}");
    }
}

#[test]
fn ten_thousand_mutated_configurations_are_told_apart() {
    let mut random = Random(SplitMix64::seed_from_u64(7));
    for number in 0..COUNT {
        let (named, text) = match number % 3 {
            0 => with_wrong_value(&mut random),
            1 => with_wrong_key(&mut random),
            _ => (String::new(), with_damage(&mut random)),
        };
        let lines = lines_of(&text);
        assert_readable(&lines, &text);
        if named.is_empty() || find(&named).is_some_and(|_| number % 3 == 1) {
            continue;
        }
        let line = lines.first();
        let line = line.unwrap_or_else(|| panic!("accepted: {text}"));
        let says_what = ["allowed is", "did you mean", " has ", "no TOML", "write ["];
        assert!(says_what.iter().any(|words| line.contains(words)), "{line}");
        let is_syntax = line.contains("no TOML");
        assert!(is_syntax || line.contains(&named), "{line}\n{text}");
    }
}
