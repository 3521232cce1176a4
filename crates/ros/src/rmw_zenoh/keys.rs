//! Keys of topics, and the liveliness tokens by which nodes find one another.
//!
//! | key | of |
//! |---|---|
//! | `<domain>/<topic>/<type>/<hash>` | a topic's messages |
//! | `@ros2_lv/<domain>/<zid>/<nid>/<nid>/NN/<enclave>/<namespace>/<node>` | a node |
//! | `@ros2_lv/<domain>/<zid>/<nid>/<id>/MP/<enclave>/<namespace>/<node>/<topic>/<type>/<hash>/<qos>` | a publisher; of a subscription with `MS` |
//!
//! `<zid>` is the session's zenoh id, `<nid>` and `<id>` count nodes and what they have within it.
//! In tokens a slash becomes `%`, and the enclave, which nothing here has, is `%`.

/// What tokens begin with.
pub(super) const ADMIN_SPACE: &str = "@ros2_lv";

/// The first node of a session; there is never another.
const NODE_ID: u32 = 0;

/// Depth of history that `rmw_zenoh` takes for granted and leaves out of tokens.
const DEFAULT_DEPTH: u32 = 42;

/// A message's type as keys name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MessageType {
    /// As DDS has it: `nav_msgs::msg::dds_::Odometry_`.
    pub name: &'static str,
    /// RIHS01 of its definition (REP 2016).
    pub hash: &'static str,
}

// Hashes as rosbags computes them (`Typestore.hash_rihs01`) from the definitions of Humble and of
// Jazzy alike.

/// `sensor_msgs/msg/PointCloud2`.
pub const POINT_CLOUD2: MessageType = MessageType {
    name: "sensor_msgs::msg::dds_::PointCloud2_",
    hash: "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
};
/// `nav_msgs/msg/Odometry`.
pub const ODOMETRY: MessageType = MessageType {
    name: "nav_msgs::msg::dds_::Odometry_",
    hash: "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
};
/// `geometry_msgs/msg/PoseStamped`.
pub const POSE_STAMPED: MessageType = MessageType {
    name: "geometry_msgs::msg::dds_::PoseStamped_",
    hash: "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
};
/// `geometry_msgs/msg/PoseWithCovarianceStamped`.
pub const POSE_WITH_COVARIANCE_STAMPED: MessageType = MessageType {
    name: "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_",
    hash: "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
};
/// `sensor_msgs/msg/NavSatFix`.
pub const NAV_SAT_FIX: MessageType = MessageType {
    name: "sensor_msgs::msg::dds_::NavSatFix_",
    hash: "RIHS01_62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404",
};
/// `tf2_msgs/msg/TFMessage`.
pub const TF_MESSAGE: MessageType = MessageType {
    name: "tf2_msgs::msg::dds_::TFMessage_",
    hash: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
};

/// A topic as publishers and subscriptions of it say.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Its whole name, slash first; see [`super::topic_name`].
    pub name: String,
    /// Of its messages.
    pub message: MessageType,
    /// Messages that are kept for who is slow. Delivery is reliable, durability volatile.
    pub depth: u32,
}

impl Topic {
    /// Where its messages are put in this domain.
    #[must_use]
    pub fn key(&self, domain_id: u32) -> String {
        let MessageType { hash, .. } = self.message;
        format!("{domain_id}/{}/{hash}", self.middle())
    }

    /// Where its messages are taken from, whatever hash their sender has of their type.
    #[must_use]
    pub fn key_of_any_hash(&self, domain_id: u32) -> String {
        format!("{domain_id}/{}/*", self.middle())
    }

    /// The tokens of all that publish on it in this domain, whatever message.
    #[must_use]
    pub fn tokens_of_publishers(&self, domain_id: u32) -> String {
        let name = mangled(&self.name);
        format!("{ADMIN_SPACE}/{domain_id}/*/*/*/MP/*/*/*/{name}/**")
    }

    fn middle(&self) -> String {
        let MessageType { name, .. } = self.message;
        format!("{}/{name}", self.name.trim_matches('/'))
    }

    /// Reliability, durability, history, deadline, lifespan, liveliness; what is as `rmw_zenoh` has
    /// it by default is left out.
    fn quality(&self) -> String {
        match self.depth {
            DEFAULT_DEPTH => "::,:,:,:,,".to_owned(),
            depth => format!("::,{depth}:,:,:,,"),
        }
    }
}

/// What a node does with a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EndpointKind {
    /// It sends.
    Publisher,
    /// It takes.
    Subscription,
}

/// A node of ROS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Node {
    /// `ROS_DOMAIN_ID`.
    pub domain_id: u32,
    /// Of its session, as zenoh writes it.
    pub zenoh_id: String,
    /// Slash first.
    pub namespace: String,
    /// Without slashes.
    pub name: String,
}

impl Node {
    /// Its token.
    #[must_use]
    pub fn token(&self) -> String {
        self.token_of("NN", NODE_ID)
    }

    /// The token of what it has for a topic; `id` is its own in this session.
    #[must_use]
    pub fn endpoint_token(&self, kind: EndpointKind, id: u32, topic: &Topic) -> String {
        let kind = match kind {
            EndpointKind::Publisher => "MP",
            EndpointKind::Subscription => "MS",
        };
        let MessageType { name, hash } = topic.message;
        let (topic_name, quality) = (mangled(&topic.name), topic.quality());
        format!(
            "{}/{topic_name}/{name}/{hash}/{quality}",
            self.token_of(kind, id)
        )
    }

    fn token_of(&self, kind: &str, id: u32) -> String {
        let Self {
            domain_id,
            zenoh_id,
            namespace,
            name,
        } = self;
        let namespace = mangled(namespace);
        format!("{ADMIN_SPACE}/{domain_id}/{zenoh_id}/{NODE_ID}/{id}/{kind}/%/{namespace}/{name}")
    }
}

fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node() -> Node {
        Node {
            domain_id: 7,
            zenoh_id: "a1b2".to_owned(),
            namespace: "/echosplat/rov_1".to_owned(),
            name: "echosplat".to_owned(),
        }
    }

    fn topic(depth: u32) -> Topic {
        Topic {
            name: "/rov_1/odom".to_owned(),
            message: ODOMETRY,
            depth,
        }
    }

    #[test]
    fn messages_are_put_under_domain_topic_type_and_hash() {
        let key = topic(10).key(7);
        assert_eq!(
            key,
            "7/rov_1/odom/nav_msgs::msg::dds_::Odometry_/\
             RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
        );
        let taken = topic(10).key_of_any_hash(7);
        assert_eq!(taken, "7/rov_1/odom/nav_msgs::msg::dds_::Odometry_/*");
    }

    #[test]
    fn tokens_are_those_of_rmw_zenoh() {
        let token = "@ros2_lv/7/a1b2/0/0/NN/%/%echosplat%rov_1/echosplat";
        assert_eq!(node().token(), token);
        let publisher = node().endpoint_token(EndpointKind::Publisher, 3, &topic(10));
        assert_eq!(
            publisher,
            "@ros2_lv/7/a1b2/0/3/MP/%/%echosplat%rov_1/echosplat/%rov_1%odom/\
             nav_msgs::msg::dds_::Odometry_/\
             RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0/::,10:,:,:,,"
        );
        let subscription = node().endpoint_token(EndpointKind::Subscription, 4, &topic(42));
        assert!(
            subscription.starts_with("@ros2_lv/7/a1b2/0/4/MS/%/"),
            "{subscription}"
        );
        assert!(subscription.ends_with("/::,:,:,:,,"), "{subscription}");
    }
}
