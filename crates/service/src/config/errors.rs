//! What is wrong with a configuration, as one line: file, line, key, and what is allowed.

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

    /// With file and line, if the key stands in `text`.
    pub(crate) fn located(&self, file: &Path, text: &str) -> String {
        let place = match line_of_key(text, &self.key) {
            Some(line) => format!("{}:{line}", file.display()),
            None => file.display().to_string(),
        };
        format!("{place}: {}: {}", self.key, self.message)
    }
}

/// What TOML or serde say, as one line.
pub(crate) fn parse_error(file: &Path, text: &str, mut error: toml::de::Error) -> String {
    let line = error
        .span()
        .map(|span| 1 + text[..span.start.min(text.len())].matches('\n').count());
    error.set_input(None);
    let said = error.to_string();
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    match line {
        Some(line) => format!("{}:{line}: {said}", file.display()),
        None => format!("{}: {said}", file.display()),
    }
}

/// The line, from 1, where a dotted key is set.
fn line_of_key(text: &str, key: &str) -> Option<usize> {
    let mut table = String::new();
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        if let Some(header) = line.strip_prefix('[').and_then(|l| l.split(']').next()) {
            table = format!("{}.", header.trim());
        } else if let Some((name, _)) = line.split_once('=')
            && format!("{table}{}", name.trim()) == key
        {
            return Some(index + 1);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_in_their_table() {
        let text = "a = 1\n[x]\na = 2\n# b = 0\n[x.y]\nb=3\n";
        assert_eq!(line_of_key(text, "a"), Some(1));
        assert_eq!(line_of_key(text, "x.a"), Some(3));
        assert_eq!(line_of_key(text, "x.y.b"), Some(6));
        assert_eq!(line_of_key(text, "x.b"), None);
    }

    #[test]
    fn a_located_setting_says_where() {
        let bad = BadSetting::new("x.a", "it is 2; allowed is 0 to 1");
        let line = bad.located(Path::new("my.toml"), "[x]\na = 2\n");
        assert_eq!(line, "my.toml:2: x.a: it is 2; allowed is 0 to 1");
    }
}
