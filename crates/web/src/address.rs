//! Where the page listens: loopback unless another host is named.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

/// A host and a port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WebAddress {
    /// A name or an address, IPv6 without brackets.
    pub host: String,
    /// 0 takes a free one.
    pub port: u16,
}

/// A text that is no such address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no address: write HOST:PORT, or a PORT of this machine alone, like 8080")]
pub struct AddressError(String);

const LOOPBACK: &str = "127.0.0.1";

impl FromStr for WebAddress {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || AddressError(text.chars().take(80).collect());
        let (host, port) = text.rsplit_once(':').unwrap_or(("", text));
        let port = port.parse().map_err(|_| error())?;
        let bare = host
            .strip_prefix('[')
            .and_then(|rest| rest.strip_suffix(']'));
        let host = match bare {
            Some(inner) if inner.parse::<std::net::Ipv6Addr>().is_ok() => inner,
            Some(_) => return Err(error()),
            None if host.is_empty() => LOOPBACK,
            None => host,
        };
        let is_name = |c: char| c.is_ascii_alphanumeric() || "-._".contains(c);
        let fits = bare.is_some() || (host.len() <= 255 && host.chars().all(is_name));
        match fits {
            true => Ok(Self {
                host: host.to_owned(),
                port,
            }),
            false => Err(error()),
        }
    }
}

impl fmt::Display for WebAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.host.contains(':') {
            true => write!(f, "[{}]:{}", self.host, self.port),
            false => write!(f, "{}:{}", self.host, self.port),
        }
    }
}

/// Whether only this machine reaches it.
pub(crate) fn is_loopback(ip: IpAddr) -> bool {
    match ip {
        IpAddr::V4(ip) => ip.is_loopback(),
        IpAddr::V6(ip) => {
            ip.is_loopback() || ip.to_ipv4_mapped().is_some_and(|ip| ip.is_loopback())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_is_meant_unless_a_host_is_named() {
        let read = |text: &str| text.parse::<WebAddress>().unwrap().to_string();
        assert_eq!(read("8080"), "127.0.0.1:8080");
        assert_eq!(read(":8080"), "127.0.0.1:8080");
        assert_eq!(read("0.0.0.0:0"), "0.0.0.0:0");
        assert_eq!(read("[::1]:80"), "[::1]:80");
        assert_eq!(read("rov-1.local:8080"), "rov-1.local:8080");
        for bad in ["", "host", "1:2:3", "[::1", "[x]:1", "a b:1", "h:70000"] {
            assert!(bad.parse::<WebAddress>().is_err(), "{bad}");
        }
    }
}
