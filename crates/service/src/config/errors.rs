//! What is wrong with a configuration, one line each: file, line, key, and what is allowed.

use std::path::Path;

/// A setting out of range, before it is known where it stands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct BadSetting {
    /// Dotted, as `sonar.bin_count`.
    pub(crate) key: String,
    /// What is wrong and what is allowed.
    pub(crate) message: String,
}

impl BadSetting {
    pub(crate) fn new(key: impl Into<String>, message: impl std::fmt::Display) -> Self {
        Self {
            key: key.into(),
            message: message.to_string(),
        }
    }

    /// The key without what a check says of a list, as in `session.gain_offset_db (number of
    /// values)`.
    pub(super) fn leaf(&self) -> &str {
        self.key.split(' ').next().unwrap_or_default()
    }
}

/// One thing wrong in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Fault {
    /// From 1; `None` for what stands nowhere in the file.
    pub(super) line: Option<usize>,
    /// Dotted; empty where no key is at fault.
    pub(super) key: String,
    /// What is wrong and what is allowed.
    pub(super) message: String,
}

impl Fault {
    /// `file:line: key: message`.
    pub(super) fn located(&self, file: &Path) -> String {
        let place = match self.line {
            Some(line) => format!("{}:{line}", file.display()),
            None => file.display().to_string(),
        };
        match self.key.as_str() {
            "" => format!("{place}: {}", self.message),
            key => format!("{place}: {key}: {}", self.message),
        }
    }
}

/// Text of a file as part of one line: no control characters, and not more than so many.
pub(super) fn shown(text: &str, most: usize) -> String {
    let one_line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut chars = one_line.chars().filter(|c| !c.is_control());
    let mut start: String = chars.by_ref().take(most).collect();
    if chars.next().is_some() {
        start.push('…');
    }
    start
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_says_where() {
        let fault = Fault {
            line: Some(2),
            key: "x.a".to_owned(),
            message: "is 2; allowed is 0 to 1".to_owned(),
        };
        let line = fault.located(Path::new("my.toml"));
        assert_eq!(line, "my.toml:2: x.a: is 2; allowed is 0 to 1");
    }

    #[test]
    fn what_a_file_says_stays_one_short_line() {
        assert_eq!(shown("a\n\u{1b}[31mb", 20), "a [31mb");
        assert_eq!(shown(&"x".repeat(100), 3), "xxx…");
    }
}
