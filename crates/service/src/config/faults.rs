//! Everything that is wrong with a configuration, not only the first of it.
//!
//! The document is walked key by key. What is unknown or no value of its key's kind is noted and
//! left out; then ranges are checked, and each setting out of range gives way to its default until
//! nothing is left to say.

use serde::Deserialize;
use toml::de::{DeTable, DeValue, ValueDeserializer};
use toml::{Spanned, Table, Value};

use super::Config;
use super::errors::{BadSetting, Fault, shown};
use super::keys;

/// Faults that are told; a file that is no configuration at all has thousands.
const MOST_TOLD: usize = 24;

/// Reads a configuration from TOML.
///
/// # Errors
/// All that is wrong with it, in the order of the file, at least one.
pub(super) fn read(text: &str) -> Result<Config, Vec<Fault>> {
    if let Ok(config) = toml::from_str::<Config>(text)
        && config.check().is_ok()
    {
        return Ok(config);
    }
    let (document, errors) = DeTable::parse_recoverable(text);
    if !errors.is_empty() {
        let told = errors.iter().take(MOST_TOLD);
        return Err(told.map(|error| syntax(text, error)).collect());
    }
    let mut reading = Reading::of(text);
    reading.table("", document.get_ref());
    let config = reading.settle();
    match reading.faults.is_empty() {
        true => Ok(config),
        false => Err(reading.told()),
    }
}

fn syntax(text: &str, error: &toml::de::Error) -> Fault {
    Fault {
        line: error.span().map(|span| line_at(text, span.start)),
        key: String::new(),
        message: format!("no TOML: {}", shown(error.message(), 200)),
    }
}

struct Reading<'t> {
    text: &'t str,
    /// What each key can hold, so far.
    good: Table,
    /// Where each of them stands, by dotted name.
    lines: Vec<(String, usize)>,
    faults: Vec<Fault>,
}

impl<'t> Reading<'t> {
    fn of(text: &'t str) -> Self {
        Self {
            text,
            good: Table::new(),
            lines: Vec::new(),
            faults: Vec::new(),
        }
    }

    fn table(&mut self, of: &str, table: &DeTable<'_>) {
        for (key, value) in table {
            if self.faults.len() > MOST_TOLD {
                return;
            }
            let line = line_at(self.text, key.span().start);
            let dot = if of.is_empty() { "" } else { "." };
            let name = format!("{of}{dot}{}", key.get_ref());
            if keys::find(&name).is_some() {
                self.value(&name, line, value);
            } else if keys::is_table(&name) {
                self.inner_table(&name, line, value.get_ref());
            } else {
                let message = keys::instead_of(&name, value.get_ref().is_table());
                self.fault(line, &name, message);
            }
        }
    }

    fn inner_table(&mut self, name: &str, line: usize, value: &DeValue<'_>) {
        match value.as_table() {
            Some(table) => self.table(name, table),
            None => self.fault(
                line,
                name,
                format!("is a table of settings: write [{name}]"),
            ),
        }
    }

    fn value(&mut self, name: &str, line: usize, value: &Spanned<DeValue<'_>>) {
        let text = self.text.get(value.span()).unwrap_or_default();
        match single(name, value.get_ref(), text) {
            Ok(value) => {
                set(&mut self.good, name, value);
                self.lines.push((name.to_owned(), line));
            }
            Err(said) => self.fault(line, name, wrong_kind(name, text, &said)),
        }
    }

    fn fault(&mut self, line: usize, key: &str, message: String) {
        self.faults.push(Fault {
            line: Some(line),
            key: shown(key, 80),
            message,
        });
    }

    /// Lets settings out of range give way, each noted.
    fn settle(&mut self) -> Config {
        loop {
            // Each value alone can be what its key holds, so that all together can.
            let config = Config::deserialize(self.good.clone()).unwrap_or_default();
            let Err(bad) = config.check() else {
                return config;
            };
            let changed = self.give_way(&bad);
            if !changed {
                return config;
            }
        }
    }

    /// The setting named, or else the whole table it stands in: it may be out of range only beside
    /// another one.
    fn give_way(&mut self, bad: &BadSetting) -> bool {
        let key = bad.leaf();
        // Its default may not go with another setting either, which says nothing new.
        if !self.faults.iter().any(|fault| fault.key == bad.key) {
            let line = self.lines.iter().find(|(name, _)| name == key);
            self.faults.push(Fault {
                line: line.map(|(_, line)| *line),
                key: bad.key.clone(),
                message: bad.message.clone(),
            });
        }
        remove(&mut self.good, key) || remove(&mut self.good, keys::split(key).0)
    }

    fn told(mut self) -> Vec<Fault> {
        self.faults.sort_by_key(|fault| fault.line);
        if self.faults.len() > MOST_TOLD {
            self.faults.truncate(MOST_TOLD);
            self.faults.push(Fault {
                line: None,
                key: String::new(),
                message: "and more; these first".to_owned(),
            });
        }
        self.faults
    }
}

/// The value, if the key can hold it; else what serde says.
fn single(name: &str, value: &DeValue<'_>, text: &str) -> Result<Value, String> {
    if value.is_table() {
        return Err("it is no table".to_owned());
    }
    let words = |error: toml::de::Error| error.message().to_owned();
    let parsed = ValueDeserializer::parse(text).map_err(words)?;
    let value = Value::deserialize(parsed).map_err(words)?;
    let mut alone = Table::new();
    set(&mut alone, name, value.clone());
    Config::deserialize(alone).map_err(words)?;
    Ok(value)
}

/// What a key may hold: its kind and its meaning, which says the range.
fn wrong_kind(name: &str, found: &str, said: &str) -> String {
    let found = shown(found, 40);
    let Some(key) = keys::find(name) else {
        return format!("is {found}: {said}");
    };
    let example = key.example.to_string();
    let allowed = match &key.example {
        Value::Integer(0..) if found.starts_with('-') => "a whole number of 0 or more".to_owned(),
        Value::Integer(_) => format!("a whole number, such as {example}"),
        Value::Float(_) => format!("a number, such as {example}"),
        Value::Array(_) => format!("a list, such as {example}"),
        Value::Boolean(_) => "true or false".to_owned(),
        _ => format!("a text such as {example} ({})", shown(said, 160)),
    };
    let meaning = key.meaning.trim_end_matches('.');
    format!("is {found}; allowed is {allowed}: {meaning}")
}

/// Sets a dotted name; tables on the way are made.
fn set(table: &mut Table, name: &str, value: Value) {
    let mut table = table;
    let (path, leaf) = keys::split(name);
    for part in path.split('.').filter(|part| !part.is_empty()) {
        let inner = table
            .entry(part)
            .or_insert_with(|| Value::Table(Table::new()));
        match inner.as_table_mut() {
            Some(inner) => table = inner,
            None => return,
        }
    }
    table.insert(leaf.to_owned(), value);
}

/// Whether there was one of this dotted name.
fn remove(table: &mut Table, name: &str) -> bool {
    let mut table = table;
    let (path, leaf) = keys::split(name);
    for part in path.split('.').filter(|part| !part.is_empty()) {
        match table.get_mut(part).and_then(Value::as_table_mut) {
            Some(inner) => table = inner,
            None => return false,
        }
    }
    table.remove(leaf).is_some()
}

/// The line, from 1, of a byte.
fn line_at(text: &str, at: usize) -> usize {
    1 + text.as_bytes()[..at.min(text.len())]
        .iter()
        .filter(|&&byte| byte == b'\n')
        .count()
}
