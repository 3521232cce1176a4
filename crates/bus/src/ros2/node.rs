//! This session as a node of ROS: its tokens, and what it puts on topics.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use echosplat_model::Timestamp;
use echosplat_ros::rmw_zenoh::{
    Attachment, EndpointKind, Gid, MessageType, Node, ODOMETRY, POINT_CLOUD2, TF_MESSAGE, Topic,
    namespace,
};
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};

use crate::bus::Link;
use crate::{BusConfig, BusError};

/// Name of the node, in the namespace `/<prefix>/<node>`.
const NODE_NAME: &str = "echosplat";

/// Depth of history of topics, and of `/tf` as tf2 has it.
const DEPTH: u32 = 10;
const TRANSFORMS_DEPTH: u32 = 100;

/// The topics of a vehicle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Topics {
    namespace: String,
}

impl Topics {
    /// # Errors
    /// Names the key of the configuration of which ROS takes no name.
    pub(super) fn new(config: &BusConfig) -> Result<Self, BusError> {
        let refused = |key, found: &str| BusError::Config {
            key,
            found: format!("{found:?}"),
            allowed: "with bus.ros_domain_id names that begin with a letter from a to z, at most 200 \
                      bytes in all; what else ROS forbids becomes an underscore",
        };
        if namespace(&config.prefix, "node").is_err() {
            return Err(refused("prefix", &config.prefix));
        }
        match namespace(&config.prefix, &config.node) {
            Ok(namespace) => Ok(Self { namespace }),
            Err(_) => Err(refused("node", &config.node)),
        }
    }

    pub(super) fn points(&self) -> Topic {
        self.topic("points", POINT_CLOUD2)
    }

    pub(super) fn odometry(&self) -> Topic {
        self.topic("odometry", ODOMETRY)
    }

    pub(super) fn transforms() -> Topic {
        Topic {
            name: "/tf".to_owned(),
            message: TF_MESSAGE,
            depth: TRANSFORMS_DEPTH,
        }
    }

    fn topic(&self, leaf: &str, message: MessageType) -> Topic {
        of_name(format!("{}/{leaf}", self.namespace), message)
    }
}

fn of_name(name: String, message: MessageType) -> Topic {
    Topic {
        name,
        message,
        depth: DEPTH,
    }
}

/// A topic of others, by its whole name.
pub(super) fn topic_of_others(name: String, message: MessageType) -> Topic {
    of_name(name, message)
}

/// The node while it is there; what it has for topics holds it.
#[derive(Debug)]
pub(super) struct RosNode {
    node: Node,
    topics: Topics,
    session: zenoh::Session,
    next_id: AtomicU32,
    _token: LivelinessToken,
}

/// The session's node, once something needs it; a session that only follows a map is none.
#[derive(Debug, Default)]
pub(crate) struct NodeSlot(Mutex<Option<Arc<RosNode>>>);

impl NodeSlot {
    /// # Errors
    /// If no domain is configured, a name is none for ROS, or the session is closed.
    pub(super) fn node(&self, link: &Link) -> Result<Arc<RosNode>, BusError> {
        let mut slot = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(node) = &*slot {
            return Ok(Arc::clone(node));
        }
        let node = Arc::new(RosNode::start(link)?);
        Ok(Arc::clone(slot.insert(node)))
    }
}

impl RosNode {
    fn start(link: &Link) -> Result<Self, BusError> {
        let topics = Topics::new(&link.config)?;
        let domain_id = link.config.ros_domain_id.ok_or(BusError::NoRosDomain)?;
        let node = Node {
            domain_id,
            zenoh_id: link.session.zid().to_string(),
            namespace: topics.namespace.clone(),
            name: NODE_NAME.to_owned(),
        };
        let token = declare(&link.session, node.token())?;
        tracing::info!(
            "ROS 2: node {}/{NODE_NAME} in domain {domain_id}",
            node.namespace
        );
        Ok(Self {
            node,
            topics,
            session: link.session.clone(),
            next_id: AtomicU32::new(1),
            _token: token,
        })
    }

    pub(super) fn topics(&self) -> &Topics {
        &self.topics
    }

    pub(super) fn domain_id(&self) -> u32 {
        self.node.domain_id
    }

    /// Tells others that it takes `topic`, until the token is dropped.
    pub(super) fn subscribes(&self, topic: &Topic) -> Result<LivelinessToken, BusError> {
        let token = self.token(EndpointKind::Subscription, topic);
        declare(&self.session, token)
    }

    /// Begins to publish on `topic`.
    pub(super) fn publisher(
        self: &Arc<Self>,
        topic: &Topic,
        priority: Priority,
    ) -> Result<TopicPublisher, BusError> {
        let token = self.token(EndpointKind::Publisher, topic);
        let gid = Gid::of_token(&token);
        let publisher = self.session.declare_publisher(topic.key(self.domain_id()));
        let publisher = publisher
            .congestion_control(CongestionControl::Drop)
            .priority(priority)
            .wait()
            .map_err(BusError::zenoh(format!("publish on {}", topic.name)))?;
        Ok(TopicPublisher {
            publisher,
            gid,
            sequence: 0,
            _token: declare(&self.session, token)?,
            _node: Arc::clone(self),
        })
    }

    fn token(&self, kind: EndpointKind, topic: &Topic) -> String {
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        self.node.endpoint_token(kind, id, topic)
    }
}

fn declare(session: &zenoh::Session, token: String) -> Result<LivelinessToken, BusError> {
    let declared = session.liveliness().declare_token(token).wait();
    declared.map_err(BusError::zenoh("declare a liveliness token of ROS"))
}

/// Puts messages on a topic, each with its attachment.
#[derive(Debug)]
pub(super) struct TopicPublisher {
    publisher: Publisher<'static>,
    gid: Gid,
    sequence: i64,
    _token: LivelinessToken,
    _node: Arc<RosNode>,
}

impl TopicPublisher {
    /// Says whether zenoh took it; what is dropped under congestion nobody tells.
    pub(super) fn put(&mut self, message: Vec<u8>, now: Timestamp) -> bool {
        self.sequence += 1;
        let attachment = Attachment {
            sequence: self.sequence,
            source_time_ns: now.nanos(),
            gid: self.gid,
        };
        let put = self.publisher.put(message);
        put.attachment(attachment.to_bytes()).wait().is_ok()
    }
}
