//! Where the sonar is: `tcp://host:port`, `udp://host:port`, `serial:///dev/…?baudrate=N`,
//! `sim://scene`, `file://log`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// Baud rate of a real unit.
pub(crate) const DEFAULT_BAUDRATE: u32 = 115_200;
/// Port of a real unit, TCP and UDP alike.
const DEFAULT_PORT: u16 = 51_200;

/// Where the sonar is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SonarUrl {
    /// `host:port`.
    Tcp(String),
    /// `host:port`.
    Udp(String),
    /// A serial line or pseudo-terminal.
    Serial {
        /// Of the device file.
        path: PathBuf,
        /// Bits per second; ten carry one byte.
        baudrate: u32,
    },
    /// A scene's name or TOML file; resolved by the caller.
    Sim(String),
    /// A log (`.svlog`).
    File(PathBuf),
}

/// Why a text is no address of a sonar.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no sonar: {reason}")]
pub struct UrlError {
    /// What was given.
    pub text: String,
    /// What is wrong, and what would be right.
    pub reason: String,
}

impl FromStr for SonarUrl {
    type Err = UrlError;

    fn from_str(text: &str) -> Result<Self, UrlError> {
        parse(text).map_err(|reason| UrlError {
            text: text.to_owned(),
            reason,
        })
    }
}

const FORMS: &str = "it must be tcp://HOST:PORT, udp://HOST:PORT, \
     serial:///DEVICE?baudrate=N, sim://SCENE or file://LOG.svlog";

fn parse(text: &str) -> Result<SonarUrl, String> {
    let Some((scheme, rest)) = text.split_once("://") else {
        return Err(FORMS.to_owned());
    };
    match scheme.to_ascii_lowercase().as_str() {
        "tcp" => Ok(SonarUrl::Tcp(host_and_port(rest)?)),
        "udp" => Ok(SonarUrl::Udp(host_and_port(rest)?)),
        "serial" => {
            let (path, baudrate) = path_and_baudrate(rest)?;
            Ok(SonarUrl::Serial { path, baudrate })
        }
        "sim" => Ok(SonarUrl::Sim(not_empty(rest, "a scene")?)),
        "file" => Ok(SonarUrl::File(not_empty(rest, "a path")?.into())),
        other => Err(format!("`{other}` is no known scheme; {FORMS}")),
    }
}

/// `host:port`, with the device's own port if none is given.
pub(crate) fn host_and_port(text: &str) -> Result<String, String> {
    let text = not_empty(text.trim_end_matches('/'), "a host and a port")?;
    if let Some(bad) = text.chars().find(|c| "/?#@ ".contains(*c)) {
        return Err(format!("`{bad}` cannot be in HOST:PORT"));
    }
    let after_brackets = text.rsplit(']').next().unwrap_or(&text);
    let Some((host, port)) = after_brackets.rsplit_once(':') else {
        return Ok(format!("{text}:{DEFAULT_PORT}"));
    };
    if host.contains(':') {
        return Err("an IPv6 address must be in brackets, as in [::1]:51200".to_owned());
    }
    if host.is_empty() && !text.starts_with('[') {
        return Err("the host before the colon is missing".to_owned());
    }
    match port.parse::<u16>() {
        Ok(_) => Ok(text.clone()),
        Err(_) => Err(format!("port `{port}` must be a number from 0 to 65535")),
    }
}

/// A path and, after `?baudrate=`, a baud rate.
pub(crate) fn path_and_baudrate(text: &str) -> Result<(PathBuf, u32), String> {
    let (path, query) = text.split_once('?').unwrap_or((text, ""));
    let path = not_empty(path, "a device, as in serial:///dev/ttyUSB0")?;
    let mut baudrate = DEFAULT_BAUDRATE;
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
        if key != "baudrate" {
            return Err(format!(
                "`{key}` is no setting of a line; allowed is baudrate"
            ));
        }
        baudrate = value
            .parse()
            .ok()
            .filter(|baudrate| (300..=4_000_000).contains(baudrate))
            .ok_or_else(|| format!("baudrate `{value}` must be from 300 to 4000000"))?;
    }
    Ok((path.into(), baudrate))
}

fn not_empty(text: &str, what: &str) -> Result<String, String> {
    match text.is_empty() {
        true => Err(format!("{what} must follow the ://")),
        false => Ok(text.to_owned()),
    }
}

impl fmt::Display for SonarUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => write!(f, "tcp://{address}"),
            Self::Udp(address) => write!(f, "udp://{address}"),
            Self::Serial { path, baudrate } => {
                write!(f, "serial://{}?baudrate={baudrate}", path.display())
            }
            Self::Sim(scene) => write!(f, "sim://{scene}"),
            Self::File(path) => write!(f, "file://{}", path.display()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_is_read_and_written() {
        for text in [
            "tcp://192.168.2.92:51200",
            "tcp://[::1]:0",
            "udp://sonar.local:51200",
            "serial:///dev/ttyUSB0?baudrate=921600",
            "sim://fence",
            "file://dives/one.svlog",
        ] {
            assert_eq!(text.parse::<SonarUrl>().unwrap().to_string(), text);
        }
        let default = "tcp://192.168.2.92".parse::<SonarUrl>().unwrap();
        assert_eq!(default.to_string(), "tcp://192.168.2.92:51200");
        let line = "serial:///dev/ttyS0".parse::<SonarUrl>().unwrap();
        assert_eq!(line.to_string(), "serial:///dev/ttyS0?baudrate=115200");
    }

    #[test]
    fn errors_say_what_would_be_right() {
        for (text, reason) in [
            ("192.168.2.92:51200", "tcp://HOST:PORT"),
            ("http://x", "no known scheme"),
            ("tcp://", "must follow"),
            ("tcp://host:99999", "0 to 65535"),
            ("tcp://:51200", "host before the colon"),
            ("tcp://::1:51200", "brackets"),
            ("tcp://host/path:1", "cannot be"),
            ("serial:///dev/x?baud=9600", "allowed is baudrate"),
            ("serial:///dev/x?baudrate=fast", "300 to 4000000"),
            ("file://", "a path"),
        ] {
            let error = text.parse::<SonarUrl>().unwrap_err().to_string();
            assert!(error.contains(text) && error.contains(reason), "{error}");
        }
    }
}
