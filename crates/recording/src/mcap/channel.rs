//! What the channels of a file are, as the file says or as this program has them.

use std::collections::HashMap;

use super::topic::Topic;

/// A channel of any MCAP file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Its name.
    pub topic: String,
    /// Name of its schema, as in `nav_msgs/msg/Odometry`; empty without one.
    pub schema: String,
    /// How its messages are encoded, as in `cdr`.
    pub encoding: String,
    /// What it is in a recording of this program.
    pub(super) own: Option<Topic>,
}

impl Channel {
    /// Its messages are bytes of a sonar, as recordings of this program have them.
    #[must_use]
    pub fn is_of_sonar(&self) -> bool {
        self.own == Some(Topic::Raw)
    }

    pub(super) fn new(topic: String, schema: String, encoding: String) -> Self {
        Self {
            own: Topic::of_name(&topic),
            topic,
            schema,
            encoding,
        }
    }

    fn of_topic(topic: Topic) -> Self {
        let schema = topic.schema();
        Self {
            topic: topic.name().to_owned(),
            schema: schema.name.to_owned(),
            encoding: schema.message_encoding.to_owned(),
            own: Some(topic),
        }
    }
}

/// Those of this program's own recordings, by their fixed ids.
pub(super) fn own_channels() -> HashMap<u16, Channel> {
    let channel = |topic: Topic| (topic.id(), Channel::of_topic(topic));
    Topic::ALL.map(channel).into()
}
