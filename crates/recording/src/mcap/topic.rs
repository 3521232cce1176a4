//! The channels of a recording: name, encoding and schema of each.

use echosplat_ros::definitions;

/// What a recording keeps apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Topic {
    Raw,
    Link,
    Pose,
    Settings,
    Events,
    Status,
    Delta,
    DeltaInfo,
    StaticTransform,
}

/// How messages of a channel are read: by other programs too.
pub(super) struct Schema {
    pub(super) name: &'static str,
    /// `ros2msg` or `jsonschema`.
    pub(super) encoding: &'static str,
    pub(super) text: &'static str,
    /// `cdr` or `json`.
    pub(super) message_encoding: &'static str,
}

const RECEIVED_BYTES: &str = "\
# Bytes as they came from the sonar, before anything looked into them: a stream of frames of the
# Blue Robotics Ping protocol, cut anywhere. The log time is when the host had them.
uint8[] data
";

const LINK: &str = r#"{"title": "Link to the sonar", "type": "object", "required": ["link"],
"properties": {"link": {"type": "string", "enum": ["up", "down", "half_frame_expired"],
"description": "after `down` and `half_frame_expired` a frame begins anew in /sonar/raw"}}}"#;

const SETTINGS: &str = r#"{"title": "Configuration in force", "type": "object",
"required": ["toml"], "properties": {"toml": {"type": "string",
"description": "text of the whole configuration, as `echosplat check` reads it"}}}"#;

const EVENT: &str = r#"{"title": "What happened", "type": "object", "properties": {
"event": {"type": "string"}, "epoch": {"type": "integer",
"description": "of `pose_epoch`: that of the poses that follow"}}}"#;

const STATUS: &str = r#"{"title": "Status of the service, once a second", "type": "object"}"#;

const DELTA_INFO: &str = r#"{"title": "Of the /map/delta before", "type": "object",
"properties": {"epoch": {"type": "integer"}, "sequence": {"type": "integer"},
"chunk": {"type": "integer"}, "chunks": {"type": "integer"},
"removed": {"type": "array", "description": "ids of Gaussians that are gone"}}}"#;

impl Topic {
    pub(super) const ALL: [Self; 9] = [
        Self::Raw,
        Self::Link,
        Self::Pose,
        Self::Settings,
        Self::Events,
        Self::Status,
        Self::Delta,
        Self::DeltaInfo,
        Self::StaticTransform,
    ];

    /// Its name in the file.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Raw => "/sonar/raw",
            Self::Link => "/sonar/link",
            Self::Pose => "/pose",
            Self::Settings => "/settings",
            Self::Events => "/events",
            Self::Status => "/status",
            Self::Delta => "/map/delta",
            Self::DeltaInfo => "/map/delta_info",
            Self::StaticTransform => "/tf_static",
        }
    }

    pub(super) fn schema(self) -> Schema {
        match self {
            Self::Raw => ros("echosplat_msgs/msg/ReceivedBytes", RECEIVED_BYTES),
            Self::Link => json("echosplat.Link", LINK),
            Self::Pose => ros("nav_msgs/msg/Odometry", definitions::ODOMETRY),
            Self::Settings => json("echosplat.Settings", SETTINGS),
            Self::Events => json("echosplat.Event", EVENT),
            Self::Status => json("echosplat.Status", STATUS),
            Self::Delta => ros("sensor_msgs/msg/PointCloud2", definitions::POINT_CLOUD2),
            Self::DeltaInfo => json("echosplat.DeltaInfo", DELTA_INFO),
            Self::StaticTransform => ros("tf2_msgs/msg/TFMessage", definitions::TF_MESSAGE),
        }
    }

    /// Of channel and schema: fixed, so that a message can be told even if its channel's record is
    /// damaged.
    pub(super) fn id(self) -> u16 {
        self as u16 + 1
    }

    pub(super) fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }
}

fn ros(name: &'static str, text: &'static str) -> Schema {
    Schema {
        name,
        encoding: "ros2msg",
        text,
        message_encoding: "cdr",
    }
}

fn json(name: &'static str, text: &'static str) -> Schema {
    Schema {
        name,
        encoding: "jsonschema",
        text,
        message_encoding: "json",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_schemas_are_objects_in_json() {
        for topic in Topic::ALL {
            let schema = topic.schema();
            if schema.encoding == "jsonschema" {
                let value: serde_json::Value = serde_json::from_str(schema.text).unwrap();
                assert_eq!(value["type"], "object", "{}", topic.name());
            }
        }
    }

    #[test]
    fn ids_count_from_one_in_order() {
        let ids = Topic::ALL.map(Topic::id);
        assert_eq!(ids, [1, 2, 3, 4, 5, 6, 7, 8, 9]);
    }
}
