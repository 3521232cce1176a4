//! Whether an optional feature is at work.

use std::fmt;

use serde::de::{Error, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// Whether a feature is at work.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Switch {
    /// Always.
    On,
    /// Never.
    Off,
    /// As what comes in asks for.
    #[default]
    Auto,
}

/// By hand, so that whatever else is written is told which words there are.
impl<'de> Deserialize<'de> for Switch {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Words)
    }
}

struct Words;

impl Visitor<'_> for Words {
    type Value = Switch;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("\"on\", \"off\" or \"auto\"")
    }

    fn visit_str<E: Error>(self, word: &str) -> Result<Switch, E> {
        match word {
            "on" => Ok(Switch::On),
            "off" => Ok(Switch::Off),
            "auto" => Ok(Switch::Auto),
            other => Err(E::invalid_value(Unexpected::Str(other), &self)),
        }
    }
}
