//! Who put a message on the bus, as far as the message says.
//!
//! Nodes of ROS sign each message with their publisher's gid, which is made of its liveliness token. Sessions that stamp
//! what they put, as those of this program do, are named in the timestamp. All others cannot be told apart: a router or
//! this session stamps for them.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use echosplat_ros::rmw_zenoh::{Attachment, Endpoint, EndpointKind, Gid};
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use crate::BusError;
use crate::bus::Link;

/// Publishers of a domain that are remembered.
const MOST_ENDPOINTS: usize = 4_096;

/// Who put a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Publisher {
    /// It does not say.
    Unknown,
    /// A session that stamps what it puts, by its zenoh id, or the router that stamps for it.
    Session(u128),
    /// A node of ROS.
    Ros(Gid),
}

impl Publisher {
    /// Of a sample; `own` is the id of the session that took it.
    pub(crate) fn of(sample: &Sample, own: u128) -> Self {
        let attachment = sample.attachment().map(zenoh::bytes::ZBytes::to_bytes);
        if let Some(attachment) = attachment.and_then(|bytes| Attachment::from_bytes(&bytes)) {
            return Self::Ros(attachment.gid);
        }
        let stamped_by = sample.timestamp().map(zenoh::time::Timestamp::get_id);
        match stamped_by.map(|id| u128::from_le_bytes(id.to_le_bytes())) {
            Some(id) if id != own => Self::Session(id),
            _ => Self::Unknown,
        }
    }

    /// Words for it, by what is known of the nodes of ROS; `None` if it does not say who it is.
    pub(crate) fn name(self, ros: Option<&RosPublishers>) -> Option<String> {
        match self {
            Self::Unknown => None,
            Self::Session(id) => Some(format!("zenoh session {id:x}")),
            Self::Ros(gid) => {
                let node = ros.and_then(|ros| ros.node_of(gid));
                let number = u128::from_le_bytes(gid.0);
                let unnamed = || format!("ROS publisher {number:x}");
                Some(node.map_or_else(unnamed, |node| format!("node {node}")))
            }
        }
    }
}

/// The zenoh id of a session, as timestamps bear it.
pub(crate) fn own_id(link: &Link) -> u128 {
    u128::from_le_bytes(link.session.zid().to_le_bytes())
}

/// A topic that somebody publishes.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct PublishedTopic {
    /// Its whole name, slash first.
    pub topic: String,
    /// The whole name of the node.
    pub node: String,
}

/// Publishers of a domain of ROS, by their tokens.
#[derive(Debug)]
pub(crate) struct RosPublishers {
    known: Arc<Mutex<HashMap<[u8; 16], Endpoint>>>,
    _tokens: Subscriber<()>,
}

impl RosPublishers {
    pub(crate) fn watch(link: &Link, domain_id: u32) -> Result<Self, BusError> {
        let known = Arc::new(Mutex::new(HashMap::new()));
        let in_callback = Arc::clone(&known);
        let liveliness = link.session.liveliness();
        let tokens = liveliness
            .declare_subscriber(Endpoint::publishers(domain_id))
            .history(true)
            .callback(move |sample| note(&in_callback, &sample))
            .wait()
            .map_err(BusError::zenoh("watch the nodes of ROS"))?;
        Ok(Self {
            known,
            _tokens: tokens,
        })
    }

    pub(crate) fn node_of(&self, gid: Gid) -> Option<String> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.get(&gid.0).map(|endpoint| endpoint.node.clone())
    }

    /// Topics with messages of one of these types, in order.
    pub(crate) fn of_types(&self, type_names: &[&str]) -> Vec<PublishedTopic> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let of_types = known
            .values()
            .filter(|endpoint| type_names.contains(&endpoint.type_name.as_str()));
        let mut topics: Vec<PublishedTopic> = of_types
            .map(|endpoint| PublishedTopic {
                topic: endpoint.topic.clone(),
                node: endpoint.node.clone(),
            })
            .collect();
        topics.sort();
        topics.dedup();
        topics
    }
}

fn note(known: &Mutex<HashMap<[u8; 16], Endpoint>>, sample: &Sample) {
    let token = sample.key_expr().as_str();
    let Some(endpoint) = Endpoint::of_token(token) else {
        return;
    };
    if endpoint.kind != EndpointKind::Publisher {
        return;
    }
    let gid = Gid::of_token(token).0;
    let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
    match sample.kind() {
        SampleKind::Delete => {
            known.remove(&gid);
        }
        SampleKind::Put if known.len() < MOST_ENDPOINTS => {
            known.insert(gid, endpoint);
        }
        SampleKind::Put => {}
    }
}
