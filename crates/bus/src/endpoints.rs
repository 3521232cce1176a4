//! Which endpoints a zenoh configuration amounts to, and whether they are safe.

use std::fmt;

use serde_json::Value;

use crate::BusError;

/// Kinds of endpoint that this program's zenoh is built with.
const BUILT_IN: &[&str] = match cfg!(feature = "tls") {
    true => &["tcp", "tls"],
    false => &["tcp"],
};

/// Where the session connects to and listens, after everything is applied.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Endpoints {
    /// Endpoints it connects to, now or as soon as somebody is there.
    pub connect: Vec<String>,
    /// Endpoints it listens on: those that are open.
    pub listen: Vec<String>,
    /// Endpoints that it was told to listen on and does not.
    pub not_listening: Vec<NotListening>,
    /// Other zenoh programs that were connected once it was open.
    pub connected_count: usize,
    /// What whoever starts the program should know; one sentence each.
    pub warnings: Vec<String>,
}

/// An endpoint that did not open.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NotListening {
    /// As it was given.
    pub endpoint: String,
    /// What is in the way.
    pub reason: String,
}

impl fmt::Display for Endpoints {
    /// "listening on …; could not listen on … (why); connected to 1 other, by …".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut clauses = Vec::new();
        if !self.listen.is_empty() {
            clauses.push(format!("listening on {}", self.listen.join(", ")));
        }
        for NotListening { endpoint, reason } in &self.not_listening {
            clauses.push(format!("could not listen on {endpoint} ({reason})"));
        }
        let elsewhere = self.connects_elsewhere().join(", ");
        match (self.connected_count, elsewhere.as_str()) {
            (0, "") if clauses.is_empty() => {
                clauses.push("neither listening nor connecting".into());
            }
            (0, "") => {}
            (0, to) => clauses.push(format!("not connected yet, trying {to}")),
            (1, _) => clauses.push("connected to 1 other program".to_owned()),
            (count, _) => clauses.push(format!("connected to {count} other programs")),
        }
        f.write_str(&clauses.join("; "))
    }
}

impl Endpoints {
    /// Endpoints it connects to that are not its own.
    pub(crate) fn connects_elsewhere(&self) -> Vec<&str> {
        let connect = self.connect.iter().filter(|to| !self.listen.contains(to));
        connect.map(String::as_str).collect()
    }

    /// A warning if nodes of ROS 2 would not be found: each talks to the others without a router
    /// between, and learns by gossip where they are.
    pub(crate) fn warn_of_nodes_out_of_reach(&mut self, setting: impl Fn(&str) -> Value) {
        let mode = setting("mode");
        let is_peer = mode != "client" && mode != "router";
        if is_peer && setting("scouting/gossip/enabled") == Value::Bool(false) {
            self.warnings.push(
                "bus.ros_domain_id is set, but nodes of ROS 2 behind its router are not found \
                 without gossip: use config/zenoh-ros2.json5, or set mode=\"client\""
                    .to_owned(),
            );
        }
    }

    /// A warning for a peer at a router, which is not told of other peers there.
    pub(crate) fn warn_of_peers_out_of_reach(&mut self) {
        self.warnings.push(
            "connected to a router as a peer: programs that are peers there too are not reached \
             through it; give each of them --zenoh 'mode=\"client\"'"
                .to_owned(),
        );
    }

    /// A warning for a client without endpoints that found no router: zenoh looks for one only as it
    /// opens.
    pub(crate) fn warn_of_no_router_found(&mut self) {
        self.warnings.push(
            "no router answered the call by multicast, and a client calls only as it starts: nobody is \
             reached until it is started again; set connect/endpoints to the router's address"
                .to_owned(),
        );
    }

    /// Warnings of what was asked for and did not open; a port in use by another zenoh is none,
    /// since programs of one machine meet there.
    pub(crate) fn warn_of_what_did_not_open(&mut self) {
        let is_grave = |not: &&NotListening| !not.reason.starts_with("in use");
        for NotListening { endpoint, reason } in self.not_listening.iter().filter(is_grave) {
            self.warnings.push(format!(
                "could not listen on {endpoint} ({reason}): nobody reaches this program there; set \
                 listen/endpoints to an address that `ip addr` shows"
            ));
        }
    }
}

/// # Errors
/// Names the first endpoint of a kind that is not built in, or without a port, which zenoh would try for ever.
pub(crate) fn check(endpoints: &Endpoints) -> Result<(), BusError> {
    let listen = endpoints.listen.iter().map(|to| ("listen/endpoints", to));
    let connect = endpoints.connect.iter().map(|to| ("connect/endpoints", to));
    for (setting, endpoint) in listen.chain(connect) {
        let kind = endpoint.split_once('/').map(|(kind, _)| kind);
        if !kind.is_some_and(|kind| BUILT_IN.contains(&kind)) {
            return Err(BusError::Endpoint {
                setting,
                endpoint: endpoint.clone(),
                built_in: BUILT_IN.join(", "),
            });
        }
        if !has_port(endpoint) {
            return Err(BusError::NoPort {
                setting,
                endpoint: endpoint.clone(),
            });
        }
    }
    Ok(())
}

fn has_port(endpoint: &str) -> bool {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, rest)| rest);
    let address = address.split(['#', '?']).next().unwrap_or_default();
    let port = address.rsplit_once(':').map(|(_, port)| port);
    port.is_some_and(|port| port.parse::<u16>().is_ok())
}

/// What zenoh assumes for a peer that was not told where to listen.
const PEER_DEFAULT_LISTEN: &str = "tcp/[::]:0";

/// Reads them from the configuration as JSON, `setting` giving the value at a path or null.
pub(crate) fn effective(setting: impl Fn(&str) -> Value) -> Endpoints {
    let mode = match setting("mode") {
        Value::String(mode) => mode,
        _ => "peer".to_owned(),
    };
    let connect = of_mode(&setting("connect/endpoints"), &mode);
    let mut listen = of_mode(&setting("listen/endpoints"), &mode);
    if listen.is_empty() && mode != "client" && setting("listen/endpoints").is_null() {
        listen.push(PEER_DEFAULT_LISTEN.to_owned());
    }
    let asks = asks_for_credentials(&setting);
    let has = asks || shows_credentials(&setting);
    let mut warnings = Vec::new();
    for endpoint in listen
        .iter()
        .filter(|endpoint| !asks && !is_local(endpoint))
    {
        warnings.push(format!(
            "listening on {endpoint} beyond this machine without authentication: anyone who \
             reaches it reads the map and can send poses; set \
             transport/auth/usrpwd/dictionary_file or listen on tcp/127.0.0.1:7447"
        ));
    }
    for endpoint in connect
        .iter()
        .filter(|endpoint| !has && !is_local(endpoint))
    {
        warnings.push(format!(
            "connecting to {endpoint} beyond this machine without authentication; set \
             transport/auth/usrpwd/user and password if its router asks for them"
        ));
    }
    if mode != "client" && setting("scouting/multicast/enabled") != Value::Bool(false) {
        warnings.push(
            "multicast scouting is on: peers on the network are found and connected to; set \
             scouting/multicast/enabled=false to keep to the endpoints given"
                .to_owned(),
        );
    }
    Endpoints {
        connect,
        listen,
        warnings,
        ..Endpoints::default()
    }
}

/// What to say of `taken` endpoints if no zenoh answered there or elsewhere.
pub(crate) fn held_by_a_stranger(taken: &[String]) -> String {
    format!(
        "{} is held by a program that is no zenoh: nobody can subscribe; end it, or set \
         listen/endpoints and connect/endpoints to another port here and in subscribers",
        taken.join(", ")
    )
}

/// zenoh gives endpoints as a list, or as one list for each mode; an entry may be an object with
/// several locators.
fn of_mode(endpoints: &Value, mode: &str) -> Vec<String> {
    match endpoints {
        Value::String(endpoint) => vec![endpoint.clone()],
        Value::Array(list) => list.iter().flat_map(|item| of_mode(item, mode)).collect(),
        Value::Object(members) => {
            let inner = members.get("locators").or_else(|| members.get(mode));
            inner.map_or_else(Vec::new, |inner| of_mode(inner, mode))
        }
        _ => Vec::new(),
    }
}

/// Whether whoever connects must say who they are: by name and password, or by certificate.
fn asks_for_credentials(setting: &impl Fn(&str) -> Value) -> bool {
    is_text(&setting("transport/auth/usrpwd/dictionary_file"))
        || is_text(&setting("transport/auth/pubkey/known_keys_file"))
        || setting("transport/link/tls/enable_mtls") == Value::Bool(true)
}

/// Whether this side says who it is when it connects.
fn shows_credentials(setting: &impl Fn(&str) -> Value) -> bool {
    is_text(&setting("transport/auth/usrpwd/user"))
        && is_text(&setting("transport/auth/usrpwd/password"))
}

fn is_text(value: &Value) -> bool {
    value.as_str().is_some_and(|text| !text.is_empty())
}

/// Whether only this machine reaches `proto/address#options`. A name other than localhost is
/// taken as not: what it means may change.
fn is_local(endpoint: &str) -> bool {
    let Some((protocol, rest)) = endpoint.split_once('/') else {
        return false;
    };
    if protocol.starts_with("unix") {
        return true;
    }
    let address = rest.split(['?', '#']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let loopback = host.parse::<std::net::IpAddr>();
    host == "localhost" || loopback.is_ok_and(|ip| ip.to_canonical().is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machine_is_local() {
        for local in [
            "tcp/127.0.0.1:7447",
            "tcp/[::1]:7447#so_sndbuf=65000",
            "tcp/localhost:7447?rel=1",
            "tcp/127.8.9.1:0",
            "tcp/[::ffff:127.0.0.1]:7447",
            "unixsock-stream//tmp/z.sock",
        ] {
            assert!(is_local(local), "{local}");
        }
        for remote in [
            "tcp/0.0.0.0:7447",
            "tcp/[::]:0",
            "tcp/192.168.2.1:7447#iface=lo",
            "tcp/vehicle.local:7447",
            "tcp/127.0.0.1.example.com:7447",
            "nonsense",
        ] {
            assert!(!is_local(remote), "{remote}");
        }
    }

    #[test]
    fn an_endpoint_without_a_port_is_refused() {
        let connecting = |endpoint: &str| {
            check(&Endpoints {
                connect: vec![endpoint.to_owned()],
                ..Endpoints::default()
            })
        };
        for fine in [
            "tcp/127.0.0.1:7447",
            "tcp/[::1]:0#iface=lo",
            "tcp/rov.local:7447?rel=1",
        ] {
            assert!(connecting(fine).is_ok(), "{fine}");
        }
        for wrong in [
            "tcp/127.0.0.1",
            "tcp/[::1]",
            "tcp/rov.local:",
            "tcp/rov.local:70000",
        ] {
            let said = connecting(wrong).unwrap_err().to_string();
            assert!(said.contains(wrong) && said.contains("7447"), "{said}");
        }
    }

    #[test]
    fn what_is_said_is_what_is_open() {
        let list = |endpoints: &[&str]| endpoints.iter().map(|e| (*e).to_owned()).collect();
        let mut endpoints = Endpoints {
            connect: list(&["tcp/127.0.0.1:7447"]),
            listen: list(&["tcp/127.0.0.1:7447"]),
            ..Endpoints::default()
        };
        assert_eq!(endpoints.to_string(), "listening on tcp/127.0.0.1:7447");
        endpoints.not_listening.push(NotListening {
            endpoint: endpoints.listen.remove(0),
            reason: "in use by another program".to_owned(),
        });
        endpoints.connected_count = 1;
        assert_eq!(
            endpoints.to_string(),
            "could not listen on tcp/127.0.0.1:7447 (in use by another program); connected to 1 \
             other program"
        );
        endpoints.not_listening.clear();
        endpoints.connected_count = 0;
        let words = "not connected yet, trying tcp/127.0.0.1:7447";
        assert_eq!(endpoints.to_string(), words);
        let nothing = Endpoints::default().to_string();
        assert_eq!(nothing, "neither listening nor connecting");
    }

    #[test]
    fn kinds_that_are_not_built_in_are_named() {
        let of = |setting: &str, endpoint: &str| {
            let given = serde_json::json!([endpoint]);
            check(&effective(|path| match path == setting {
                true => given.clone(),
                false => Value::Null,
            }))
        };
        assert!(of("connect/endpoints", "tcp/[::1]:7447#iface=lo").is_ok());
        for setting in ["connect/endpoints", "listen/endpoints"] {
            for kind in ["quic", "udp", "ws", "TCP", "127.0.0.1:7447"] {
                let endpoint = format!("{kind}/127.0.0.1:7447");
                let refused = of(setting, &endpoint).unwrap_err().to_string();
                assert!(refused.contains(&endpoint), "{refused}");
                assert!(refused.contains(setting), "{refused}");
                assert!(refused.contains("built in is tcp"), "{refused}");
            }
        }
    }

    #[test]
    fn lists_for_each_mode_and_groups_of_locators_are_read() {
        let by_mode = serde_json::json!({
            "router": ["tcp/0.0.0.0:1"],
            "peer": ["tcp/127.0.0.1:2", {"strategy": "allOf", "locators": ["tcp/127.0.0.1:3"]}],
        });
        assert_eq!(
            of_mode(&by_mode, "peer"),
            ["tcp/127.0.0.1:2", "tcp/127.0.0.1:3"]
        );
        assert!(of_mode(&by_mode, "client").is_empty());
    }
}
