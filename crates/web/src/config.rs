//! What the page is told.

use serde::{Deserialize, Serialize};

use crate::{AddressError, WebAddress};

/// Longest token, host name and number of these that are read.
const MAX_TEXT_BYTES: usize = 256;

/// Configuration of the page; off by default.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WebConfig {
    /// Where it listens: `HOST:PORT`, or a port of loopback; `None` is off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub address: Option<String>,
    /// What writes from other machines must bear; random at every start if `None`.
    #[serde(skip_serializing)]
    pub token: Option<String>,
    /// Names besides its own under which the page may be asked for, as a proxy has them.
    pub allowed_hosts: Vec<String>,
    /// Whether Cockpit, a page of another origin, may begin and end recordings with the token. It goes where the token
    /// goes: a recording of the settings has neither.
    #[serde(skip_serializing)]
    pub cockpit_actions: bool,
}

impl WebConfig {
    /// The address, if there is one.
    ///
    /// # Errors
    /// If it is none.
    pub fn parsed_address(&self) -> Result<Option<WebAddress>, AddressError> {
        self.address.as_deref().map(str::parse).transpose()
    }

    /// # Errors
    /// The key that is wrong, and what is allowed.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        self.parsed_address()
            .map_err(|error| ("address", error.to_string()))?;
        if let Some(token) = &self.token
            && !(8..=MAX_TEXT_BYTES).contains(&token.len())
        {
            let found = token.len();
            let why = format!("has {found} bytes; allowed is 8 to {MAX_TEXT_BYTES}");
            return Err(("token", why));
        }
        if self.cockpit_actions && self.token.is_none() {
            let why =
                "needs web.token: without, it is another at every start, and Cockpit keeps one";
            return Err(("cockpit_actions", why.to_owned()));
        }
        let is_name = |host: &String| {
            let fits = (1..=MAX_TEXT_BYTES).contains(&host.len());
            fits && !host.contains(|c: char| c == '/' || c.is_whitespace() || c.is_control())
        };
        match self.allowed_hosts.len() <= 64 && self.allowed_hosts.iter().all(is_name) {
            true => Ok(()),
            false => Err((
                "allowed_hosts",
                "is no list of at most 64 host names, as [\"blueos.example\"]".to_owned(),
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_settings_are_named() {
        assert_eq!(WebConfig::default().check(), Ok(()));
        let wrong = [
            WebConfig {
                address: Some("0.0.0.0:many".to_owned()),
                ..WebConfig::default()
            },
            WebConfig {
                token: Some("short".to_owned()),
                ..WebConfig::default()
            },
            WebConfig {
                allowed_hosts: vec!["http://name".to_owned()],
                ..WebConfig::default()
            },
            WebConfig {
                cockpit_actions: true,
                ..WebConfig::default()
            },
        ];
        let keys = wrong.map(|config| config.check().unwrap_err().0);
        assert_eq!(
            keys,
            ["address", "token", "allowed_hosts", "cockpit_actions"]
        );
    }

    #[test]
    fn a_token_is_never_written_out() {
        let config = WebConfig {
            token: Some("a secret of mine".to_owned()),
            ..WebConfig::default()
        };
        assert!(!serde_json::to_string(&config).unwrap().contains("secret"));
    }
}
