//! The zenoh configuration: the safe default, what a user puts in its place, what must hold.
//!
//! Order: the file of [`BusConfig::zenoh_config_file`], else that of the environment variable
//! `ZENOH_CONFIG`, else the safe default; then each setting of [`BusConfig::zenoh`]; then what
//! must hold whatever the user said.
//!
//! The safe default keeps to this machine: no multicast, no gossip, connect to and listen on
//! [`LOOPBACK`], neither being an error if it fails. So the first program on a machine listens,
//! and the second connects to it, or both connect to a router. Connecting is tried until it
//! succeeds: with a time limit of 0 zenoh would try once, and a router that starts later, or a
//! first try that fails, would leave the program alone for good. So it is with a file of the user's:
//! that nobody is there, or that a port is taken, ends no dive.

use std::path::{Path, PathBuf};

use serde_json::Value;
use zenoh::Config;

use crate::endpoints::{self, Endpoints};
use crate::{BusConfig, BusError};

/// Longest configuration file read.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Where programs on one machine meet.
pub const LOOPBACK: &str = "tcp/127.0.0.1:7447";

const SAFE_DEFAULT: [(&str, &str); 9] = [
    ("mode", "\"peer\""),
    ("scouting/multicast/enabled", "false"),
    ("scouting/gossip/enabled", "false"),
    ("connect/endpoints", "[\"tcp/127.0.0.1:7447\"]"),
    ("connect/timeout_ms", "-1"),
    ("connect/exit_on_failure", "false"),
    ("listen/endpoints", "[\"tcp/127.0.0.1:7447\"]"),
    ("listen/timeout_ms", "0"),
    ("listen/exit_on_failure", "false"),
];

/// Bytes that the system may keep for a link, unless set. Linux gives twice as many, and of its own
/// accord ten times as many, which are 6 s of a link of 1 Mbit/s: deltas would be that old when they
/// come. With 10 ms to the other end and back 50 Mbit/s still fit.
const SEND_BUFFER: &str = "65536";
const SEND_BUFFERS: [&str; 2] = [
    "transport/link/tcp/so_sndbuf",
    "transport/link/tls/so_sndbuf",
];

const MAX_MESSAGE_SIZE: &str = "transport/link/rx/max_message_size";

/// A configuration to open a session with, and where it leads.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) config: Config,
    pub(crate) endpoints: Endpoints,
    /// A peer that learns of others only by being connected to them.
    pub(crate) is_lone_peer: bool,
}

impl Plan {
    /// Whether it only connects, and relies on a router.
    pub(crate) fn is_client(&self) -> bool {
        setting(&self.config, "mode") == "client"
    }

    /// Whether it looks for others by multicast.
    pub(crate) fn scouts(&self) -> bool {
        setting(&self.config, "scouting/multicast/enabled") != Value::Bool(false)
    }
}

impl Plan {
    /// `environment` is what `ZENOH_CONFIG` holds, if it holds something.
    pub(crate) fn new(config: &BusConfig, environment: Option<PathBuf>) -> Result<Self, BusError> {
        config.check()?;
        let mut plan = match (&config.zenoh_config_file, environment) {
            (Some(path), _) => from_file(path, "--zenoh-config")?,
            (None, Some(path)) => from_file(&path, "ZENOH_CONFIG")?,
            (None, None) => safe_default()?,
        };
        for (key, value) in &config.zenoh {
            insert(&mut plan, key, value)?;
        }
        apply_what_must_hold(&mut plan, config)?;
        let mut endpoints = endpoints::effective(|key| setting(&plan, key));
        if config.ros_domain_id.is_some() {
            endpoints.warn_of_nodes_out_of_reach(|key| setting(&plan, key));
        }
        endpoints::check(&endpoints)?;
        Ok(Self {
            endpoints,
            is_lone_peer: is_lone_peer(&plan),
            config: plan,
        })
    }
}

fn is_lone_peer(config: &Config) -> bool {
    let is_off = |key| setting(config, key) == Value::Bool(false);
    let mode = setting(config, "mode");
    let is_peer = mode != "client" && mode != "router";
    is_peer && is_off("scouting/gossip/enabled") && is_off("scouting/multicast/enabled")
}

fn from_file(path: &Path, source_name: &'static str) -> Result<Config, BusError> {
    let refused = |reason: String| BusError::ConfigFile {
        path: path.to_owned(),
        source_name,
        reason,
    };
    let bytes = echosplat_input::read(path, MAX_FILE_BYTES);
    let bytes = bytes.map_err(|error| refused(error.to_string()))?;
    // By its name zenoh knows more formats, and a pipe, which is gone once it is read, has none.
    let read = match path.is_file() {
        true => Config::from_file(path),
        false => Config::from_json5(&String::from_utf8_lossy(&bytes)),
    };
    read.map_err(|reason| refused(reason.to_string()))
}

fn safe_default() -> Result<Config, BusError> {
    let mut config = Config::default();
    for (key, value) in SAFE_DEFAULT {
        insert(&mut config, key, value)?;
    }
    Ok(config)
}

/// Timestamps order what comes from several machines; a message no larger than needed is all
/// that a stranger can make this process hold; and what is under way for seconds is old.
fn apply_what_must_hold(config: &mut Config, ours: &BusConfig) -> Result<(), BusError> {
    insert(config, "timestamping/enabled", "true")?;
    keep_trying(config)?;
    leave_the_port_to_the_router(config)?;
    for key in SEND_BUFFERS {
        if setting(config, key).is_null() {
            insert(config, key, SEND_BUFFER)?;
        }
    }
    let theirs = setting(config, MAX_MESSAGE_SIZE)
        .as_u64()
        .unwrap_or(u64::MAX);
    let least = theirs.min(ours.max_received_bytes as u64);
    insert(config, MAX_MESSAGE_SIZE, &least.to_string())
}

/// A client that is there before its router would else listen where that is to.
fn leave_the_port_to_the_router(config: &mut Config) -> Result<(), BusError> {
    if setting(config, "mode") != "client" {
        return Ok(());
    }
    let Endpoints {
        connect, listen, ..
    } = endpoints::effective(|key| setting(config, key));
    let others: Vec<&String> = listen.iter().filter(|to| !connect.contains(to)).collect();
    match others.len() < listen.len() {
        true => insert(
            config,
            "listen/endpoints",
            &Value::from_iter(others.into_iter().cloned()).to_string(),
        ),
        false => Ok(()),
    }
}

/// Nobody to connect to, or no port to listen on, is no reason to end: zenoh tries again.
fn keep_trying(config: &mut Config) -> Result<(), BusError> {
    insert(config, "connect/timeout_ms", "-1")?;
    insert(config, "connect/exit_on_failure", "false")?;
    insert(config, "listen/exit_on_failure", "false")?;
    for key in ["connect/endpoints", "listen/endpoints"] {
        let endpoints = setting(config, key).to_string();
        let mild = endpoints.replace("exit_on_failure=true", "exit_on_failure=false");
        if mild != endpoints {
            insert(config, key, &mild)?;
        }
    }
    Ok(())
}

fn insert(config: &mut Config, key: &str, value: &str) -> Result<(), BusError> {
    config
        .insert_json5(key, value)
        .map_err(|reason| BusError::ZenohSetting {
            key: key.to_owned(),
            value: value.to_owned(),
            reason: reason.to_string(),
        })
}

/// The value at a path, or null.
pub(crate) fn setting(config: &Config, key: &str) -> Value {
    let json = config.get_json(key).ok();
    let value = json.and_then(|json| serde_json::from_str(&json).ok());
    value.unwrap_or(Value::Null)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn plan(config: &BusConfig) -> Plan {
        Plan::new(config, None).unwrap()
    }

    fn with(settings: &[(&str, &str)]) -> BusConfig {
        let owned = |(key, value): &(&str, &str)| ((*key).to_owned(), (*value).to_owned());
        BusConfig {
            zenoh: settings.iter().map(owned).collect(),
            ..BusConfig::default()
        }
    }

    fn file(text: &str) -> tempfile::NamedTempFile {
        let mut file = tempfile::Builder::new()
            .suffix(".json5")
            .tempfile()
            .unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file
    }

    #[test]
    fn the_default_keeps_to_this_machine() {
        let plan = plan(&BusConfig::default());
        assert_eq!(plan.endpoints.connect, [LOOPBACK]);
        assert_eq!(plan.endpoints.listen, [LOOPBACK]);
        assert_eq!(plan.endpoints.warnings, Vec::<String>::new());
        for (key, value) in SAFE_DEFAULT {
            let expected: Value = serde_json::from_str(value).unwrap();
            assert_eq!(setting(&plan.config, key), expected, "{key}");
        }
        assert_eq!(
            setting(&plan.config, "timestamping/enabled"),
            Value::Bool(true)
        );
        assert_eq!(
            setting(&plan.config, MAX_MESSAGE_SIZE),
            Value::from(1 << 20)
        );
    }

    #[test]
    fn listening_beyond_this_machine_is_warned_about_unless_it_asks_for_a_password() {
        let open = ("listen/endpoints", "['tcp/0.0.0.0:7447']");
        let warnings = plan(&with(&[open])).endpoints.warnings;
        assert_eq!(warnings.len(), 1);
        assert!(warnings[0].contains("tcp/0.0.0.0:7447"), "{warnings:?}");
        let own_name = ("transport/auth/usrpwd/user", "'rov'");
        let own_word = ("transport/auth/usrpwd/password", "'secret'");
        let warnings = plan(&with(&[open, own_name, own_word])).endpoints.warnings;
        assert_eq!(warnings.len(), 1, "its own password keeps nobody out");
        let asks = ("transport/auth/usrpwd/dictionary_file", "'/etc/users'");
        assert!(plan(&with(&[open, asks])).endpoints.warnings.is_empty());

        let out = ("connect/endpoints", "['tcp/192.168.2.2:7447']");
        assert_eq!(plan(&with(&[out])).endpoints.warnings.len(), 1);
        assert!(
            plan(&with(&[out, own_name, own_word]))
                .endpoints
                .warnings
                .is_empty()
        );
    }

    #[test]
    fn a_users_file_that_says_nothing_listens_everywhere_and_is_told_so() {
        let file = file("{ timestamping: { enabled: false } }");
        let config = BusConfig {
            zenoh_config_file: Some(file.path().to_owned()),
            ..BusConfig::default()
        };
        let plan = plan(&config);
        assert_eq!(plan.endpoints.listen, ["tcp/[::]:0"]);
        assert_eq!(plan.endpoints.warnings.len(), 2);
        assert_eq!(
            setting(&plan.config, "timestamping/enabled"),
            Value::Bool(true)
        );
    }

    #[test]
    fn who_asks_for_ros_is_told_where_its_nodes_are_out_of_reach() {
        let ros = |config: BusConfig| {
            let config = BusConfig {
                ros_domain_id: Some(0),
                ..config
            };
            plan(&config).endpoints.warnings
        };
        let warnings = ros(BusConfig::default());
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains("zenoh-ros2.json5"), "{warnings:?}");
        assert!(ros(with(&[("mode", "'client'")])).is_empty());
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/zenoh-ros2.json5");
        let found = BusConfig {
            zenoh_config_file: Some(file.into()),
            ..BusConfig::default()
        };
        assert_eq!(ros(found), Vec::<String>::new());
    }

    #[test]
    fn the_option_goes_before_the_environment_and_settings_before_both() {
        let first = file("{ mode: 'client', connect: { endpoints: ['tcp/127.0.0.1:1'] } }");
        let second = file("{ mode: 'client', connect: { endpoints: ['tcp/127.0.0.1:2'] } }");
        let mut config = BusConfig::default();
        let from_environment = Plan::new(&config, Some(second.path().to_owned())).unwrap();
        assert_eq!(from_environment.endpoints.connect, ["tcp/127.0.0.1:2"]);
        config.zenoh_config_file = Some(first.path().to_owned());
        let both = Plan::new(&config, Some(second.path().to_owned())).unwrap();
        assert_eq!(both.endpoints.connect, ["tcp/127.0.0.1:1"]);
        config.zenoh = with(&[("connect/endpoints", "['tcp/127.0.0.1:3']")]).zenoh;
        let all = Plan::new(&config, Some(second.path().to_owned())).unwrap();
        assert_eq!(all.endpoints.connect, ["tcp/127.0.0.1:3"]);
        assert!(all.endpoints.listen.is_empty());
    }

    #[test]
    #[cfg(not(feature = "tls"))]
    fn a_users_file_that_asks_for_tls_is_refused_before_anything_opens() {
        let file = file("{ mode: 'client', connect: { endpoints: ['tls/vehicle.local:7447'] } }");
        let refused = Plan::new(&BusConfig::default(), Some(file.path().to_owned())).unwrap_err();
        assert!(matches!(refused, BusError::Endpoint { .. }), "{refused}");
        assert!(
            refused.to_string().contains("tls/vehicle.local:7447"),
            "{refused}"
        );
    }

    #[test]
    fn no_file_of_the_users_ends_a_dive_because_nobody_is_there() {
        let file = file(
            "{ mode: 'peer', connect: { endpoints: { peer: ['tcp/127.0.0.1:1#exit_on_failure=true'] }, \
             timeout_ms: { router: -1, peer: 0, client: 0 }, exit_on_failure: { peer: true, client: true } }, \
             listen: { endpoints: ['tcp/127.0.0.1:2'], exit_on_failure: true } }",
        );
        let config = BusConfig {
            zenoh_config_file: Some(file.path().to_owned()),
            ..BusConfig::default()
        };
        let plan = plan(&config);
        for key in ["connect/exit_on_failure", "listen/exit_on_failure"] {
            assert_eq!(setting(&plan.config, key), Value::Bool(false), "{key}");
        }
        assert_eq!(setting(&plan.config, "connect/timeout_ms"), Value::from(-1));
        assert_eq!(
            plan.endpoints.connect,
            ["tcp/127.0.0.1:1#exit_on_failure=false"]
        );
    }

    #[test]
    fn a_client_leaves_the_port_of_its_router_alone() {
        let client = plan(&with(&[("mode", "'client'")])).endpoints;
        assert_eq!(client.connect, [LOOPBACK]);
        assert_eq!(client.listen, Vec::<String>::new());
        let own = (
            "listen/endpoints",
            "['tcp/127.0.0.1:7500', 'tcp/127.0.0.1:7447']",
        );
        let client = plan(&with(&[("mode", "'client'"), own])).endpoints;
        assert_eq!(client.listen, ["tcp/127.0.0.1:7500"]);
    }

    #[test]
    fn a_smaller_message_size_of_the_user_stays() {
        let plan = plan(&with(&[(MAX_MESSAGE_SIZE, "300000")]));
        assert_eq!(
            setting(&plan.config, MAX_MESSAGE_SIZE),
            Value::from(300_000)
        );
    }

    #[test]
    fn a_send_buffer_of_the_users_stays() {
        let size =
            |settings: &[(&str, &str)]| setting(&plan(&with(settings)).config, SEND_BUFFERS[0]);
        assert_eq!(size(&[]), Value::from(65_536));
        assert_eq!(
            size(&[(SEND_BUFFERS[0], "1000000")]),
            Value::from(1_000_000)
        );
    }

    #[test]
    fn what_zenoh_does_not_take_is_named() {
        let refused = Plan::new(&with(&[("no/such/key", "1")]), None).unwrap_err();
        assert!(refused.to_string().contains("no/such/key=1"), "{refused}");
        let refused = Plan::new(&with(&[("mode", "'nonsense'")]), None).unwrap_err();
        assert!(refused.to_string().contains("mode="), "{refused}");
        let config = BusConfig {
            zenoh_config_file: Some("/no/such/file.json5".into()),
            ..BusConfig::default()
        };
        let refused = Plan::new(&config, None).unwrap_err();
        assert!(
            refused.to_string().contains("/no/such/file.json5"),
            "{refused}"
        );
    }
}
