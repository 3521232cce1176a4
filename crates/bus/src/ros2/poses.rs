//! Poses from a topic of ROS 2, whichever of three messages it carries.
//!
//! All three are subscribed to. Other nodes are told of the one that somebody publishes there, since
//! their tools take a topic of two messages for a fault, and as long as nobody does of Odometry.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use echosplat_ros::rmw_zenoh::{
    MessageType, ODOMETRY, POSE_STAMPED, POSE_WITH_COVARIANCE_STAMPED, topic_name,
};
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use super::node::{RosNode, topic_of_others};
use crate::BusError;
use crate::bus::Link;
use crate::pose_message;
use crate::publishers::{PublishedTopic, RosPublishers};

/// Messages that poses are taken from, each with the encoding that says so.
const TAKEN: [(MessageType, &str); 3] = [
    (ODOMETRY, pose_message::ODOMETRY),
    (POSE_STAMPED, pose_message::POSE_STAMPED),
    (
        POSE_WITH_COVARIANCE_STAMPED,
        pose_message::POSE_WITH_COVARIANCE,
    ),
];

/// Where the part of a token stands that names a message.
const MESSAGE_AT: usize = 10;

/// A topic that poses are taken from.
#[derive(Debug)]
pub(crate) struct PoseTopic {
    /// Keys of its messages, whatever hash their sender has of their type, and their encodings.
    pub(crate) keys: Vec<(String, &'static str)>,
    graph: Arc<Mutex<Graph>>,
    /// Of the whole domain.
    publishers: RosPublishers,
    /// What this program publishes itself.
    own: String,
    _publishers: Subscriber<()>,
}

/// What others know of it, and what is known of others.
#[derive(Debug)]
struct Graph {
    name: String,
    said: MessageType,
    _token: LivelinessToken,
    /// A message on the topic that holds no pose, as ROS names it.
    other: Option<String>,
}

impl PoseTopic {
    pub(crate) fn open(link: &Link, topic: &str) -> Result<Self, BusError> {
        let name = topic_name(topic).map_err(|error| BusError::RosTopic(error.to_string()))?;
        let node = link.ros.node(link)?;
        let own = node.topics().odometry().name;
        if name == own {
            return Err(BusError::RosTopic(format!(
                "{name} is what this program publishes itself; name the topic of the vehicle's odometry"
            )));
        }
        let topic = |message| topic_of_others(name.clone(), message);
        let domain_id = node.domain_id();
        let keys = TAKEN.map(|(message, encoding)| {
            let key = topic(message).key_of_any_hash(domain_id);
            (key, encoding)
        });
        let tokens = topic(ODOMETRY).tokens_of_publishers(domain_id);
        let of_domain = RosPublishers::watch(link, domain_id)?;
        let graph = Arc::new(Mutex::new(Graph {
            said: ODOMETRY,
            _token: node.subscribes(&topic(ODOMETRY))?,
            name,
            other: None,
        }));
        let in_callback = Arc::clone(&graph);
        let subscriber = link.session.liveliness().declare_subscriber(tokens);
        let publishers = subscriber
            .history(true)
            .callback(move |sample| note(&in_callback, &node, &sample))
            .wait()
            .map_err(BusError::zenoh("watch for publishers of poses in ROS"))?;
        Ok(Self {
            keys: keys.into(),
            graph,
            publishers: of_domain,
            own,
            _publishers: publishers,
        })
    }

    /// Who publishes what in the domain.
    pub(crate) fn publishers(&self) -> &RosPublishers {
        &self.publishers
    }

    /// Other topics with messages that poses are taken from.
    pub(crate) fn others(&self) -> Vec<PublishedTopic> {
        let mut topics = self
            .publishers
            .of_types(&TAKEN.map(|(message, _)| message.name));
        let name = lock(&self.graph).name.clone();
        topics.retain(|found| found.topic != name && found.topic != self.own);
        topics
    }

    /// That the topic carries something else, if it does.
    pub(crate) fn unfit(&self) -> Option<String> {
        let graph = lock(&self.graph);
        let other = graph.other.as_ref()?;
        Some(format!(
            "{} carries {other}, which poses are not taken from: name a topic of nav_msgs/msg/Odometry, \
             geometry_msgs/msg/PoseStamped or geometry_msgs/msg/PoseWithCovarianceStamped",
            graph.name
        ))
    }
}

fn lock(graph: &Mutex<Graph>) -> MutexGuard<'_, Graph> {
    graph.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A publisher has come or gone.
fn note(graph: &Mutex<Graph>, node: &Arc<RosNode>, token: &Sample) {
    let Some(found) = token.key_expr().as_str().split('/').nth(MESSAGE_AT) else {
        return;
    };
    let is_there = token.kind() == SampleKind::Put;
    let mut graph = lock(graph);
    let taken = TAKEN.iter().find(|(message, _)| message.name == found);
    match taken {
        Some(&(message, _)) if is_there => {
            graph.other = None;
            if graph.said != message {
                let topic = topic_of_others(graph.name.clone(), message);
                match node.subscribes(&topic) {
                    Ok(token) => (graph.said, graph._token) = (message, token),
                    Err(error) => tracing::debug!(%error, "zenoh"),
                }
            }
        }
        Some(_) => {}
        None if is_there => graph.other = Some(in_ros(found)),
        None => graph.other = None,
    }
}

/// `tf2_msgs/msg/TFMessage` of `tf2_msgs::msg::dds_::TFMessage_`, at most 80 characters.
fn in_ros(of_dds: &str) -> String {
    let name = of_dds.replace("::dds_::", "/").replace("::", "/");
    name.trim_end_matches('_').chars().take(80).collect()
}
