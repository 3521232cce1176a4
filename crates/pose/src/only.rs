//! Whose `MAVLink` messages are meant, as a URL says it.

use crate::mavlink::message::Sender;

/// Which senders of `MAVLink` may be used: `?system=N`, `?component=M`, or both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Only {
    /// 1 to 255.
    pub system: Option<u8>,
    /// 1 to 255.
    pub component: Option<u8>,
}

impl Only {
    pub(crate) fn allows(self, sender: Sender) -> bool {
        self.system
            .is_none_or(|system| u32::from(system) == sender.system)
            && self
                .component
                .is_none_or(|component| component == sender.component)
    }

    /// `system 1 component 1`.
    pub(crate) fn in_words(self) -> String {
        let system = self.system.map(|system| format!("system {system}"));
        let component = self
            .component
            .map(|component| format!("component {component}"));
        let both: Vec<String> = system.into_iter().chain(component).collect();
        both.join(" ")
    }

    /// What in a URL names the one, and what the other.
    pub(crate) fn to_tell_apart(one: Sender, other: Sender) -> (String, String) {
        let named = |sender: Sender| match one.system == other.system {
            true => format!("?system={}&component={}", sender.system, sender.component),
            false => format!("?system={}", sender.system),
        };
        (named(one), named(other))
    }

    /// Takes a part of a query; whether it is one of these.
    pub(crate) fn take(&mut self, part: &str) -> Result<bool, String> {
        let Some((key, value)) = part.split_once('=') else {
            return Ok(false);
        };
        let slot = match key {
            "system" => &mut self.system,
            "component" => &mut self.component,
            _ => return Ok(false),
        };
        let number = value.parse().ok().filter(|number| *number > 0);
        let number =
            number.ok_or_else(|| format!("{key} `{value}` must be a number from 1 to 255"))?;
        match slot.replace(number) {
            None => Ok(true),
            Some(_) => Err(format!("`{key}` stands there twice")),
        }
    }

    pub(crate) fn parts(self) -> impl Iterator<Item = String> {
        let system = self.system.map(|system| format!("system={system}"));
        let component = self
            .component
            .map(|component| format!("component={component}"));
        system.into_iter().chain(component)
    }
}
