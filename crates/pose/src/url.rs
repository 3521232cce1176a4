//! Names of pose sources.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use echosplat_ros::rmw_zenoh::topic_name;
use serde::{Deserialize, Serialize};

use crate::only::Only;

/// Rate of a serial line unless given.
const DEFAULT_BAUDRATE: u32 = 115_200;
/// Where ground stations and companions listen for `MAVLink`.
const DEFAULT_MAVLINK_PORT: u16 = 14_550;
/// TCP port of autopilots' simulators and of serial lines passed on.
const DEFAULT_MAVLINK_TCP_PORT: u16 = 5_760;
/// TCP port of a Water Linked DVL.
const DEFAULT_DVL_PORT: u16 = 16_171;
/// What mavlink-server's keys begin with.
const DEFAULT_MAVLINK_PREFIX: &str = "mavlink";

/// Where poses come from.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum PoseUrl {
    /// `none`: from nowhere; no ping gets a pose.
    None,
    /// `zenoh://`: the key `<prefix>/<node>/pose` of the bus.
    #[default]
    Zenoh,
    /// `zenoh://KEY`: another key.
    ZenohKey(String),
    /// `ros2:///TOPIC`: `Odometry`, `PoseStamped` or `PoseWithCovarianceStamped` of ROS 2 with
    /// `rmw_zenoh`; the topic's whole name.
    Ros2(String),
    /// `mavlink+udp://HOST:PORT` listens there, `mavlink+udp://HOST:PORT?out` sends there first.
    MavlinkUdp {
        /// `host:port`.
        address: String,
        /// Whether the vehicle waits for us to send first.
        out: bool,
        /// Whose messages.
        only: Only,
    },
    /// `mavlink+tcp://HOST:PORT`: connects there.
    MavlinkTcp {
        /// `host:port`.
        address: String,
        /// Whose messages.
        only: Only,
    },
    /// `mavlink+serial:///dev/ttyX?baudrate=N`.
    MavlinkSerial {
        /// Of the device file.
        path: PathBuf,
        /// Bits per second; ten carry one byte.
        baudrate: u32,
        /// Whose messages.
        only: Only,
    },
    /// `mavlink+zenoh://` or `mavlink+zenoh://PREFIX`: a mavlink-server's messages on the bus, raw at
    /// `<prefix>_raw/out` or as JSON at `<prefix>/<system>/<component>/<MESSAGE>`.
    MavlinkZenoh {
        /// What its keys begin with.
        prefix: String,
        /// Whose messages.
        only: Only,
    },
    /// Any of the four with `?velocity=dvl://HOST[:PORT]`: positions are reckoned of the autopilot's attitude and height and a
    /// Water Linked DVL's velocities, while the autopilot sends none.
    MavlinkWithDvl {
        /// One of the four.
        mavlink: Box<PoseUrl>,
        /// `host:port`.
        dvl: String,
    },
    /// `dvl://HOST[:PORT]`: a Water Linked DVL's dead reckoning.
    Dvl(String),
    /// `log://`: in the log that is replayed; `log://TOPIC` of an MCAP file with several.
    Log(Option<String>),
    /// `tum://PATH`, or a path that ends in `.tum` or `.txt`: a TUM file.
    Tum(PathBuf),
}

/// Every form, for messages and help.
pub const POSE_URL_FORMS: &str = "zenoh://[KEY], ros2:///TOPIC, mavlink+udp://HOST:PORT[?out], \
     mavlink+tcp://HOST:PORT, mavlink+serial:///DEVICE?baudrate=N, mavlink+zenoh://[PREFIX], \
     each of these four with [?system=N&component=M] and [?velocity=dvl://HOST], dvl://HOST, log://, tum://POSES.tum or none";

/// A text that names no pose source.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PoseUrlError {
    /// None of the forms.
    #[error("pose source {0:?} is none of: {POSE_URL_FORMS}, or a path ending in .tum or .txt")]
    Unknown(String),
    /// One of the forms, but not rightly filled in.
    #[error("pose source {text:?}: {reason}")]
    Wrong {
        /// What was given.
        text: String,
        /// What is wrong, and what would be right.
        reason: String,
    },
}

impl FromStr for PoseUrl {
    type Err = PoseUrlError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let Some((scheme, rest)) = text.split_once("://") else {
            return match text {
                "none" => Ok(Self::None),
                _ if is_trajectory(text) => Ok(Self::Tum(text.into())),
                _ => Err(PoseUrlError::Unknown(text.to_owned())),
            };
        };
        let scheme = scheme.to_ascii_lowercase();
        let parsed = match scheme.starts_with("mavlink+") {
            true => mavlink_with_dvl(&scheme, rest),
            false => of_scheme(&scheme, rest),
        };
        let wrong = |reason| PoseUrlError::Wrong {
            text: text.to_owned(),
            reason,
        };
        parsed
            .ok_or_else(|| PoseUrlError::Unknown(text.to_owned()))?
            .map_err(wrong)
    }
}

/// `None` for an unknown scheme.
fn of_scheme(scheme: &str, rest: &str) -> Option<Result<PoseUrl, String>> {
    Some(match scheme {
        "zenoh" if rest.is_empty() => Ok(PoseUrl::Zenoh),
        "zenoh" => key(rest).map(PoseUrl::ZenohKey),
        "ros2" => topic_name(rest)
            .map(PoseUrl::Ros2)
            .map_err(|error| error.to_string()),
        "mavlink+udp" => mavlink_udp(rest),
        "mavlink+tcp" => mavlink_tcp(rest),
        "mavlink+serial" => mavlink_serial(rest),
        "mavlink+zenoh" => mavlink_zenoh(rest),
        "mavlink" => Err(
            "write how it is reached: mavlink+udp://, mavlink+tcp://, mavlink+serial:// or \
             mavlink+zenoh://"
                .to_owned(),
        ),
        "dvl" => host_and_port(rest, DEFAULT_DVL_PORT).map(PoseUrl::Dvl),
        "log" => Ok(PoseUrl::Log((!rest.is_empty()).then(|| rest.to_owned()))),
        "tum" if rest.is_empty() => Err("it names no file; write tum://PATH".to_owned()),
        "tum" => Ok(PoseUrl::Tum(rest.into())),
        _ => return None,
    })
}

/// What begins a part of a query that names a DVL.
const VELOCITY: &str = "velocity=";

/// With `velocity=` taken out of the query first, since it is all schemes'. `None` for an unknown scheme.
fn mavlink_with_dvl(scheme: &str, rest: &str) -> Option<Result<PoseUrl, String>> {
    let (before, query) = rest.split_once('?').unwrap_or((rest, ""));
    let (dvls, others): (Vec<&str>, Vec<&str>) = query
        .split('&')
        .partition(|part| part.starts_with(VELOCITY));
    let rest = match others.join("&") {
        others if others.is_empty() => before.to_owned(),
        others => format!("{before}?{others}"),
    };
    let parsed = of_scheme(scheme, &rest)?;
    Some(match dvls[..] {
        [] => parsed,
        [dvl] => parsed.and_then(|mavlink| {
            let address = dvl[VELOCITY.len()..].strip_prefix("dvl://").unwrap_or("");
            let dvl = host_and_port(address, DEFAULT_DVL_PORT);
            let dvl = dvl
                .map_err(|why| format!("`velocity=`: {why}, as in velocity=dvl://192.168.2.95"))?;
            let mavlink = Box::new(mavlink);
            Ok(PoseUrl::MavlinkWithDvl { mavlink, dvl })
        }),
        _ => Err("`velocity` stands there twice".to_owned()),
    })
}

fn is_trajectory(path: &str) -> bool {
    let extension = Path::new(path).extension();
    extension.is_some_and(|ext| ext.eq_ignore_ascii_case("tum") || ext.eq_ignore_ascii_case("txt"))
}

/// A key of zenoh that is no pattern.
fn key(text: &str) -> Result<String, String> {
    let is_name = |part: &str| {
        let allowed = |c: char| !c.is_whitespace() && !c.is_control() && !"*$?#".contains(c);
        !part.is_empty() && part.chars().all(allowed)
    };
    match text.split('/').all(is_name) {
        true => Ok(text.to_owned()),
        false => Err(
            "the key must be names between single slashes, without * $ ? # and blanks; where \
             zenoh is reached is set by --zenoh connect/endpoints='[\"tcp/HOST:7447\"]'"
                .to_owned(),
        ),
    }
}

/// What stands before a query, and whose messages that names; `own` takes the parts that are the scheme's own.
fn with_query<'a>(
    rest: &'a str,
    known: &str,
    mut own: impl FnMut(&str) -> Result<bool, String>,
) -> Result<(&'a str, Only), String> {
    let (before, query) = rest.split_once('?').unwrap_or((rest, ""));
    let mut only = Only::default();
    for part in query.split('&').filter(|part| !part.is_empty()) {
        if !own(part)? && !only.take(part)? {
            return Err(format!(
                "`?{part}` is unknown; {known}`?system=1&component=1` names the sender, `?velocity=dvl://HOST` a DVL whose \
                 velocities are used"
            ));
        }
    }
    Ok((before, only))
}

fn mavlink_udp(rest: &str) -> Result<PoseUrl, String> {
    let mut out = false;
    let is_out = |part: &str| {
        out |= part == "out";
        Ok(part == "out")
    };
    let (address, only) = with_query(rest, "`?out` sends first, ", is_out)?;
    let address = host_and_port(address, DEFAULT_MAVLINK_PORT)?;
    Ok(PoseUrl::MavlinkUdp { address, out, only })
}

fn mavlink_tcp(rest: &str) -> Result<PoseUrl, String> {
    let (address, only) = with_query(rest, "", |_| Ok(false))?;
    let address = host_and_port(address, DEFAULT_MAVLINK_TCP_PORT)?;
    Ok(PoseUrl::MavlinkTcp { address, only })
}

fn mavlink_zenoh(rest: &str) -> Result<PoseUrl, String> {
    let (prefix, only) = with_query(rest, "", |_| Ok(false))?;
    let prefix = match prefix.is_empty() {
        true => DEFAULT_MAVLINK_PREFIX.to_owned(),
        false => key(prefix)?,
    };
    Ok(PoseUrl::MavlinkZenoh { prefix, only })
}

fn mavlink_serial(rest: &str) -> Result<PoseUrl, String> {
    let mut rate = DEFAULT_BAUDRATE;
    let is_rate = |part: &str| match part.strip_prefix("baudrate=") {
        None => Ok(false),
        Some(text) => {
            rate = baudrate(text)?;
            Ok(true)
        }
    };
    let (path, only) = with_query(rest, "`?baudrate=115200` sets the rate, ", is_rate)?;
    if path.is_empty() {
        return Err("it names no device; write mavlink+serial:///dev/ttyACM0".to_owned());
    }
    Ok(PoseUrl::MavlinkSerial {
        path: path.into(),
        baudrate: rate,
        only,
    })
}

fn baudrate(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(rate @ 1_200..=4_000_000) => Ok(rate),
        _ => Err(format!(
            "baudrate `{text}` must be a number from 1200 to 4000000"
        )),
    }
}

/// `host:port`, with `port` if none is given.
pub(crate) fn host_and_port(text: &str, port: u16) -> Result<String, String> {
    let text = text.trim_end_matches('/');
    if text.is_empty() {
        return Err(format!("it names no host; write HOST:{port}"));
    }
    if let Some(bad) = text.chars().find(|c| "/?#@ ".contains(*c)) {
        return Err(format!("`{bad}` cannot be in HOST:PORT"));
    }
    let after_brackets = text.rsplit(']').next().unwrap_or(text);
    let Some((host, given)) = after_brackets.rsplit_once(':') else {
        return Ok(format!("{text}:{port}"));
    };
    if host.contains(':') {
        return Err(format!(
            "an IPv6 address must be in brackets, as in [::1]:{port}"
        ));
    }
    if host.is_empty() && !text.starts_with('[') {
        return Err("the host before the colon is missing; 0.0.0.0 listens everywhere".to_owned());
    }
    match given.parse::<u16>() {
        Ok(1..) => Ok(text.to_owned()),
        _ => Err(format!("port `{given}` must be a number from 1 to 65535")),
    }
}

fn query(own: Option<String>, only: Only) -> String {
    let parts: Vec<String> = own.into_iter().chain(only.parts()).collect();
    match parts.is_empty() {
        true => String::new(),
        false => format!("?{}", parts.join("&")),
    }
}

impl fmt::Display for PoseUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => write!(f, "none"),
            Self::Zenoh => write!(f, "zenoh://"),
            Self::ZenohKey(key) => write!(f, "zenoh://{key}"),
            Self::Ros2(topic) => write!(f, "ros2://{topic}"),
            Self::MavlinkUdp { address, out, only } => {
                let out = out.then(|| "out".to_owned());
                write!(f, "mavlink+udp://{address}{}", query(out, *only))
            }
            Self::MavlinkTcp { address, only } => {
                write!(f, "mavlink+tcp://{address}{}", query(None, *only))
            }
            Self::MavlinkSerial {
                path,
                baudrate,
                only,
            } => {
                let query = query(Some(format!("baudrate={baudrate}")), *only);
                write!(f, "mavlink+serial://{}{query}", path.display())
            }
            Self::MavlinkZenoh { prefix, only } => {
                write!(f, "mavlink+zenoh://{prefix}{}", query(None, *only))
            }
            Self::MavlinkWithDvl { mavlink, dvl } => {
                let mavlink = mavlink.to_string();
                let and = if mavlink.contains('?') { '&' } else { '?' };
                write!(f, "{mavlink}{and}{VELOCITY}dvl://{dvl}")
            }
            Self::Dvl(address) => write!(f, "dvl://{address}"),
            Self::Log(topic) => write!(f, "log://{}", topic.as_deref().unwrap_or("")),
            Self::Tum(path) => write!(f, "tum://{}", path.display()),
        }
    }
}

impl TryFrom<String> for PoseUrl {
    type Error = PoseUrlError;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<PoseUrl> for String {
    fn from(url: PoseUrl) -> Self {
        url.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn udp(address: &str, out: bool) -> PoseUrl {
        PoseUrl::MavlinkUdp {
            address: address.to_owned(),
            out,
            only: Only::default(),
        }
    }

    fn only(system: u8, component: u8) -> Only {
        let named = |number| (number > 0).then_some(number);
        Only {
            system: named(system),
            component: named(component),
        }
    }

    fn tcp(address: &str, only: Only) -> PoseUrl {
        let address = address.to_owned();
        PoseUrl::MavlinkTcp { address, only }
    }

    fn zenoh(prefix: &str, only: Only) -> PoseUrl {
        let prefix = prefix.to_owned();
        PoseUrl::MavlinkZenoh { prefix, only }
    }

    #[test]
    fn every_form_is_read_and_written() {
        let serial = |path: &str, baudrate| PoseUrl::MavlinkSerial {
            path: path.into(),
            baudrate,
            only: Only::default(),
        };
        for (text, url) in [
            ("none", PoseUrl::None),
            ("zenoh://", PoseUrl::Zenoh),
            ("zenoh://rov/pose", PoseUrl::ZenohKey("rov/pose".into())),
            ("ros2:///rov/odom", PoseUrl::Ros2("/rov/odom".into())),
            ("ros2://odom", PoseUrl::Ros2("/odom".into())),
            ("mavlink+udp://0.0.0.0:14550", udp("0.0.0.0:14550", false)),
            ("mavlink+udp://rov", udp("rov:14550", false)),
            ("mavlink+udp://rov:9000?out", udp("rov:9000", true)),
            ("MAVLINK+TCP://rov", tcp("rov:5760", only(0, 0))),
            ("mavlink+tcp://rov?component=1", tcp("rov:5760", only(0, 1))),
            (
                "mavlink+udp://rov:9000?system=2&out",
                PoseUrl::MavlinkUdp {
                    address: "rov:9000".into(),
                    out: true,
                    only: only(2, 0),
                },
            ),
            (
                "mavlink+serial:///dev/a?system=255&component=190&baudrate=57600",
                PoseUrl::MavlinkSerial {
                    path: "/dev/a".into(),
                    baudrate: 57_600,
                    only: only(255, 190),
                },
            ),
            ("mavlink+zenoh://?system=3", zenoh("mavlink", only(3, 0))),
            ("mavlink+serial:///dev/a", serial("/dev/a", 115_200)),
            (
                "mavlink+serial:///dev/a?baudrate=57600",
                serial("/dev/a", 57_600),
            ),
            ("mavlink+zenoh://", zenoh("mavlink", only(0, 0))),
            ("mavlink+zenoh://sea/m", zenoh("sea/m", only(0, 0))),
            (
                "mavlink+tcp://rov?velocity=dvl://192.168.2.95&system=2",
                PoseUrl::MavlinkWithDvl {
                    mavlink: Box::new(tcp("rov:5760", only(2, 0))),
                    dvl: "192.168.2.95:16171".into(),
                },
            ),
            (
                "mavlink+zenoh://?velocity=dvl://[::1]:9",
                PoseUrl::MavlinkWithDvl {
                    mavlink: Box::new(zenoh("mavlink", only(0, 0))),
                    dvl: "[::1]:9".into(),
                },
            ),
            (
                "dvl://192.168.2.95",
                PoseUrl::Dvl("192.168.2.95:16171".into()),
            ),
            ("dvl://[::1]:9", PoseUrl::Dvl("[::1]:9".into())),
            ("log://", PoseUrl::Log(None)),
            ("log:///odom", PoseUrl::Log(Some("/odom".into()))),
            ("tum:///a/b", PoseUrl::Tum("/a/b".into())),
            ("dive one.tum", PoseUrl::Tum("dive one.tum".into())),
            ("poses.TXT", PoseUrl::Tum("poses.TXT".into())),
        ] {
            assert_eq!(text.parse(), Ok(url.clone()), "{text}");
            assert_eq!(url.to_string().parse(), Ok(url), "{text}");
        }
    }

    #[test]
    fn other_texts_are_refused_with_what_would_do() {
        for (bad, told) in [
            ("", "zenoh://"),
            ("tum://", "tum://PATH"),
            ("zenoh", "zenoh://"),
            ("zenoh://a/*/b", "without *"),
            ("zenoh://tcp//b", "connect/endpoints"),
            ("ros2://", "/rov/odom"),
            ("ros2:///rov-1/odom", "letters, digits and underscores"),
            ("mavlink://", "mavlink+udp://"),
            ("mavlink+udp://:14550", "0.0.0.0"),
            ("mavlink+udp://a?in", "?out"),
            ("mavlink+tcp://a:0", "1 to 65535"),
            ("mavlink+serial://", "/dev/ttyACM0"),
            ("mavlink+serial:///dev/a?baud=1", "?baudrate=115200"),
            ("mavlink+serial:///dev/a?baudrate=0", "1200"),
            ("mavlink+udp://a?system=0", "1 to 255"),
            ("mavlink+tcp://a?component=256", "1 to 255"),
            ("mavlink+zenoh://?system=1&system=2", "twice"),
            ("mavlink+zenoh://m?sysid=1", "?system=1&component=1"),
            ("mavlink+udp://a?velocity=192.168.2.95", "velocity=dvl://"),
            ("mavlink+udp://a?velocity=dvl://", "velocity=dvl://"),
            ("mavlink+udp://a?velocity=dvl://b&velocity=dvl://c", "twice"),
            ("mavlink+usb://a?velocity=dvl://b", "none of"),
            ("dvl://", "HOST:16171"),
            ("dvl://::1", "[::1]"),
            ("http://rov", "dvl://HOST"),
            ("poses.csv", "tum://"),
            ("None", "none"),
        ] {
            let refused = bad.parse::<PoseUrl>().unwrap_err().to_string();
            assert!(refused.contains(told), "{bad}: {refused}");
        }
    }
}
