//! Where a device is served: `tcp://host:port`, `udp://host:port`, `serial://pty`,
//! `serial:///path`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use crate::url::{UrlError, host_and_port, path_and_baudrate};

/// Where a device is served.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ListenUrl {
    /// `host:port`; port 0 takes a free one.
    Tcp(String),
    /// `host:port`; port 0 takes a free one.
    Udp(String),
    /// A new pseudo-terminal, with a link to it at a path if one is given.
    Pty {
        /// Where the link goes.
        link: Option<PathBuf>,
    },
    /// A path: a serial line if there is one, otherwise a link to a new pseudo-terminal.
    Serial {
        /// Of the device file or the link.
        path: PathBuf,
        /// Bits per second, of a line.
        baudrate: u32,
    },
}

impl FromStr for ListenUrl {
    type Err = UrlError;

    fn from_str(text: &str) -> Result<Self, UrlError> {
        parse(text).map_err(|reason| UrlError {
            text: text.to_owned(),
            reason,
        })
    }
}

fn parse(text: &str) -> Result<ListenUrl, String> {
    match text.split_once("://") {
        Some(("tcp", rest)) => Ok(ListenUrl::Tcp(host_and_port(rest)?)),
        Some(("udp", rest)) => Ok(ListenUrl::Udp(host_and_port(rest)?)),
        Some(("serial", "pty")) => Ok(ListenUrl::Pty { link: None }),
        Some(("serial", rest)) => {
            let (path, baudrate) = path_and_baudrate(rest)?;
            Ok(ListenUrl::Serial { path, baudrate })
        }
        _ => Err(
            "a device can be served on tcp://HOST:PORT, udp://HOST:PORT, \
                  serial:///PATH or serial://pty"
                .to_owned(),
        ),
    }
}

impl fmt::Display for ListenUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => write!(f, "tcp://{address}"),
            Self::Udp(address) => write!(f, "udp://{address}"),
            Self::Pty { link: None } => write!(f, "serial://pty"),
            Self::Pty { link: Some(path) } => write!(f, "serial://{}", path.display()),
            Self::Serial { path, baudrate } => {
                write!(f, "serial://{}?baudrate={baudrate}", path.display())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_and_errors() {
        let pty = "serial://pty".parse::<ListenUrl>().unwrap();
        assert_eq!(pty, ListenUrl::Pty { link: None });
        for text in ["tcp://127.0.0.1:0", "udp://127.0.0.1:51200"] {
            assert_eq!(text.parse::<ListenUrl>().unwrap().to_string(), text);
        }
        let error = "sim://fence".parse::<ListenUrl>().unwrap_err().to_string();
        assert!(error.contains("sim://fence") && error.contains("serial://pty"));
    }
}
