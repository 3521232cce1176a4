//! Advice in the sentences of this program, taken literally by tests: read out of the words, and given to the real command
//! line and configuration.

mod sources;

use std::collections::BTreeMap;

use crate::arguments::{self, Command};
use crate::commands::run_configuration;
use crate::config::Config;

/// The settings that a sentence advises: `--flag VALUE`, `key = value`, `key to value`.
pub(crate) fn advised(sentence: &str) -> (Vec<String>, BTreeMap<String, String>) {
    let words: Vec<&str> = sentence.split_whitespace().collect();
    let value = |text: &str| text.trim_end_matches([',', ';', '.', ':']).to_owned();
    let mut flags = Vec::new();
    for pair in words.windows(2).filter(|pair| pair[0].starts_with("--")) {
        flags.extend([pair[0].to_owned(), value(pair[1])]);
    }
    let mut settings = BTreeMap::new();
    for (at, word) in words.iter().enumerate() {
        let is_set = matches!(words.get(at + 1), Some(&"=" | &"to"));
        let is_key = word.contains('.') && word.starts_with(|c: char| c.is_ascii_lowercase());
        if !is_set || !is_key {
            continue;
        }
        let rest = words[at + 2..].join(" ");
        let found = match rest.starts_with('[') {
            true => rest
                .split_inclusive(']')
                .next()
                .unwrap_or_default()
                .to_owned(),
            false => value(words[at + 2]),
        };
        settings.insert((*word).to_owned(), found);
    }
    (flags, settings)
}

/// What the program runs with once the advice is taken, on top of the settings before.
pub(crate) fn taken(
    sentence: &str,
    before: &BTreeMap<String, String>,
) -> (Config, BTreeMap<String, String>) {
    let (flags, mut settings) = advised(sentence);
    assert!(
        !flags.is_empty() || !settings.is_empty(),
        "no advice in: {sentence}"
    );
    let words = ["run".to_owned()].into_iter().chain(flags.clone());
    let Ok(Command::Run(run)) = arguments::parsed(words) else {
        panic!("not taken by the command line: {sentence}");
    };
    // Refuses what is out of range.
    let of_flags = run_configuration(&run).unwrap_or_else(|error| panic!("{sentence}: {error}"));
    for (key, value) in before {
        settings.entry(key.clone()).or_insert_with(|| value.clone());
    }
    if !flags.is_empty() {
        settings.insert(
            "pose.time_offset_s".to_owned(),
            format!("{:?}", of_flags.pose.time_offset_s),
        );
    }
    (configured(&settings), settings)
}

/// The defaults with these settings.
pub(crate) fn configured(settings: &BTreeMap<String, String>) -> Config {
    Config::of_settings(settings).unwrap_or_else(|error| panic!("{settings:?}: {error}"))
}
