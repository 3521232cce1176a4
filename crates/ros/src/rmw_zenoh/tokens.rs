//! What others' liveliness tokens say.
//!
//! `@ros2_lv/<domain>/<zid>/<nid>/<id>/MP/<enclave>/<namespace>/<node>/<topic>/<type>/<hash>/<qos>`, and whatever newer
//! releases add behind it: since July 2026 (0.10.5 of Lyrical, 0.12 of Rolling) `backends:<name>,…` of messages whose
//! buffers may stay in a device's memory.

use super::EndpointKind;
use super::keys::ADMIN_SPACE;

/// A publisher or a subscription of some node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// What it does.
    pub kind: EndpointKind,
    /// The node's whole name, `/rov/ekf`.
    pub node: String,
    /// The topic's whole name, slash first.
    pub topic: String,
    /// The messages' type as DDS has it, `nav_msgs::msg::dds_::Odometry_`.
    pub type_name: String,
}

impl Endpoint {
    /// Reads a token; `None` if it is none of a publisher or subscription.
    #[must_use]
    pub fn of_token(token: &str) -> Option<Self> {
        let mut parts = token.split('/');
        if parts.next() != Some(ADMIN_SPACE) {
            return None;
        }
        // Domain, session, node and endpoint by number.
        let kind = match parts.nth(4)? {
            "MP" => EndpointKind::Publisher,
            "MS" => EndpointKind::Subscription,
            _ => return None,
        };
        let (_enclave, namespace) = (parts.next()?, demangled(parts.next()?));
        let node = parts.next()?;
        let (topic, type_name) = (demangled(parts.next()?), demangled(parts.next()?));
        let (_hash, _quality) = (parts.next()?, parts.next()?);
        let is_named = !node.is_empty() && topic.starts_with('/') && !type_name.is_empty();
        is_named.then(|| Self {
            kind,
            node: format!("{}/{node}", namespace.trim_end_matches('/')),
            topic,
            type_name,
        })
    }

    /// Tokens of every publisher in a domain, as a pattern.
    #[must_use]
    pub fn publishers(domain_id: u32) -> String {
        format!("{ADMIN_SPACE}/{domain_id}/*/*/*/MP/**")
    }
}

fn demangled(name: &str) -> String {
    name.replace('%', "/")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rmw_zenoh::{Node, ODOMETRY, Topic};

    const TOKEN: &str = "@ros2_lv/7/a1b2/0/3/MP/%/%rov/ekf/%rov%odom/nav_msgs::msg::dds_::Odometry_/RIHS01_3c/::,10:,:,:,,";

    #[test]
    fn tokens_are_read_with_fields_behind_them_and_without() {
        let expected = Endpoint {
            kind: EndpointKind::Publisher,
            node: "/rov/ekf".to_owned(),
            topic: "/rov/odom".to_owned(),
            type_name: ODOMETRY.name.to_owned(),
        };
        for more in ["", "/backends:cuda,cpu", "/backends:cpu/whatever:1/2"] {
            let token = format!("{TOKEN}{more}");
            assert_eq!(Endpoint::of_token(&token), Some(expected.clone()), "{more}");
        }
        let at_root = TOKEN.replace("%rov/ekf", "%/ekf");
        assert_eq!(Endpoint::of_token(&at_root).unwrap().node, "/ekf");
    }

    #[test]
    fn our_own_tokens_are_read_back() {
        let node = Node {
            domain_id: 7,
            zenoh_id: "a1b2".to_owned(),
            namespace: "/echosplat/rov_1".to_owned(),
            name: "echosplat".to_owned(),
        };
        let topic = Topic {
            name: "/tf".to_owned(),
            message: ODOMETRY,
            depth: 10,
        };
        for kind in [EndpointKind::Publisher, EndpointKind::Subscription] {
            let read = Endpoint::of_token(&node.endpoint_token(kind, 1, &topic)).unwrap();
            assert_eq!((read.kind, read.topic.as_str()), (kind, "/tf"));
            assert_eq!(read.node, "/echosplat/rov_1/echosplat");
        }
        assert_eq!(Endpoint::of_token(&node.token()), None);
    }

    #[test]
    fn other_texts_are_none() {
        let parts: Vec<&str> = TOKEN.split('/').collect();
        for length in 0..parts.len() {
            assert_eq!(
                Endpoint::of_token(&parts[..length].join("/")),
                None,
                "{length}"
            );
        }
        for other in ["", "/", "@ros2_lv", "a/b/c/d/e/MP/f/g/h/i/j/k/l"] {
            assert_eq!(Endpoint::of_token(other), None, "{other}");
        }
    }
}
