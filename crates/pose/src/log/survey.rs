//! What an MCAP file of another program holds, and which of its topics give poses.

use std::collections::BTreeMap;
use std::path::Path;

use echosplat_join::ArrivedPose;
use echosplat_model::Timestamp;
use echosplat_recording::mcap::{Channel, Message, Messages, WrittenBy};

use super::found::{LogPosesError, in_order};
use super::mcap::{Topics, cannot_read, losses};

/// What is known of a file after it was read once.
#[derive(Debug, Clone, PartialEq)]
pub struct McapSurvey {
    /// The program that wrote it.
    pub written_by: WrittenBy,
    /// By their names.
    pub topics: Vec<McapTopic>,
    /// Topics with poses; the one that is taken where none is asked for goes first.
    pub poses: Vec<TopicPoses>,
    /// What the file lacks, a sentence each.
    pub losses: Vec<String>,
}

/// One topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct McapTopic {
    /// Its name.
    pub topic: String,
    /// Of its messages, as in `nav_msgs/msg/Odometry`; empty without one.
    pub schema: String,
    /// How they are encoded, as in `cdr`.
    pub encoding: String,
    /// How many there are.
    pub message_count: u64,
    /// Least and greatest time at which they were logged.
    pub logged: (Timestamp, Timestamp),
    /// What its messages lack where they should have poses.
    pub fault: Option<String>,
}

/// The poses of one topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicPoses {
    /// Its name.
    pub topic: String,
    /// How many there are, each time once.
    pub count: usize,
    /// Least and greatest of their own times.
    pub span: (Timestamp, Timestamp),
    /// The frames from the world to the vehicle, where poses are put together of those.
    pub way: Option<String>,
}

impl TopicPoses {
    /// `None` without poses.
    pub(super) fn of(topic: &str, poses: Vec<ArrivedPose>, way: Option<String>) -> Option<Self> {
        let poses = in_order(poses);
        let span = (poses.first()?.pose.time, poses.last()?.pose.time);
        Some(Self {
            topic: topic.to_owned(),
            count: poses.len(),
            span,
            way,
        })
    }
}

/// Reads an MCAP file once; `None` if it holds the bytes of a sonar or was written by this program, and so
/// is a recording.
///
/// # Errors
/// If it cannot be read as MCAP.
pub fn survey_of_mcap(path: &Path) -> Result<Option<McapSurvey>, LogPosesError> {
    let wrong = |error| cannot_read(path, error);
    let mut messages = Messages::open(path).map_err(wrong)?;
    let mut found = BTreeMap::new();
    let mut topics = Topics::default();
    while let Some(message) = messages.next_message().map_err(wrong)? {
        let channel = messages.channel(message.header.channel_id);
        let is_recording = channel.is_some_and(Channel::is_of_sonar);
        if is_recording || messages.written_by().is_this_program() {
            return Ok(None);
        }
        if let Some(channel) = channel {
            count(&mut found, channel, &message);
            topics.take(channel, &message);
        }
    }
    let written_by = messages.written_by().clone();
    // Cut in its first bytes, it may be anybody's.
    let says_nothing = found.is_empty() && written_by == WrittenBy::default();
    if says_nothing || written_by.is_this_program() {
        return Ok(None);
    }
    let mut topics_found: Vec<McapTopic> = found.into_values().collect();
    let faults = topics.faults();
    for topic in &mut topics_found {
        topic.fault = faults.get(&topic.topic).cloned();
    }
    let (poses, fault_of_frames) = topics.poses();
    if let Some((name, fault)) = fault_of_frames {
        for topic in topics_found.iter_mut().filter(|topic| topic.topic == name) {
            topic.fault = Some(fault.clone());
        }
    }
    Ok(Some(McapSurvey {
        written_by,
        topics: topics_found,
        poses,
        losses: losses(path, messages.condition()),
    }))
}

/// Channels of one topic, schema and encoding are counted together.
fn count(found: &mut BTreeMap<[String; 3], McapTopic>, channel: &Channel, message: &Message) {
    let time = message.header.log_time;
    let time = Timestamp::from_nanos(i64::try_from(time).unwrap_or(i64::MAX));
    let Channel {
        topic,
        schema,
        encoding,
        ..
    } = channel;
    let name = [topic, schema, encoding].map(String::clone);
    let counted = found.entry(name).or_insert_with(|| McapTopic {
        topic: topic.clone(),
        schema: schema.clone(),
        encoding: encoding.clone(),
        message_count: 0,
        logged: (time, time),
        fault: None,
    });
    counted.message_count += 1;
    let (first, last) = counted.logged;
    counted.logged = (first.min(time), last.max(time));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::poses_of_mcap;

    const MAGIC: &[u8] = b"\x89MCAP0\r\n";

    fn text(text: &str) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
    }

    fn record(kind: u8, parts: &[&[u8]]) -> Vec<u8> {
        let body = parts.concat();
        [&[kind][..], &(body.len() as u64).to_le_bytes(), &body].concat()
    }

    /// A channel of JSON messages and its schema, both of this id.
    fn channel(id: u8, topic: &str, schema: &str) -> Vec<u8> {
        let id = [id, 0];
        let schema = [text(schema), text("jsonschema"), text("{}")].concat();
        let ends = [text("json"), text("")].concat();
        [
            record(3, &[&id, &schema]),
            record(4, &[&id, &id, &text(topic), &ends]),
        ]
        .concat()
    }

    fn message(id: u8, seconds: u64, data: &str) -> Vec<u8> {
        let time = (seconds * 1_000_000_000).to_le_bytes();
        record(5, &[&[id, 0], &[0; 4], &time, &time, data.as_bytes()])
    }

    fn pose(seconds: u64) -> String {
        format!(
            r#"{{"stamp_ns": {seconds}000000000, "frame_id": "map", "child_frame_id": "rov",
            "position": [1, 2, 3], "orientation_xyzw": [0, 0, 0, 1]}}"#
        )
    }

    fn file(library: &str, records: &[Vec<u8>]) -> tempfile::NamedTempFile {
        let head = record(1, &[&text("robot"), &text(library)]);
        let file = tempfile::NamedTempFile::new().unwrap();
        let bytes = [MAGIC, &head, &records.concat(), &record(15, &[&[0; 4]])].concat();
        std::fs::write(file.path(), bytes).unwrap();
        file
    }

    fn records() -> Vec<Vec<u8>> {
        let poses = (10..14).map(|second| message(1, second, &pose(second - 5)));
        let others = [
            message(2, 20, r#"{"volts": 15.9}"#),
            message(3, 21, &pose(16)),
            message(4, 22, r#"{"pose": 1}"#),
        ];
        [
            channel(1, "/slam/pose", "Pose"),
            channel(2, "/battery", "Battery"),
            channel(3, "/a/pose", "Pose"),
            channel(4, "/frame/pose", "foxglove.PoseInFrame"),
        ]
        .into_iter()
        .chain(poses)
        .chain(others)
        .collect()
    }

    #[test]
    fn topics_are_counted_and_those_with_poses_are_told_best_first() {
        let file = file("somebody's logger 2", &records());
        let survey = survey_of_mcap(file.path()).unwrap().unwrap();
        assert_eq!(survey.written_by.library, "somebody's logger 2");
        assert_eq!(survey.written_by.profile, "robot");
        let second = |seconds: i64| Timestamp::from_nanos(seconds * 1_000_000_000);
        let names = survey.topics.iter().map(|topic| topic.topic.as_str());
        let names: Vec<_> = names.collect();
        assert_eq!(names, ["/a/pose", "/battery", "/frame/pose", "/slam/pose"]);
        let of_slam = &survey.topics[3];
        assert_eq!(
            (of_slam.message_count, of_slam.schema.as_str()),
            (4, "Pose")
        );
        assert_eq!(of_slam.logged, (second(10), second(13)));
        assert!(survey.topics[2].fault.is_some() && of_slam.fault.is_none());
        let told = |topic: &str, count, span| TopicPoses {
            topic: topic.to_owned(),
            count,
            span,
            way: None,
        };
        let slam = told("/slam/pose", 4, (second(5), second(8)));
        let other = told("/a/pose", 1, (second(16), second(16)));
        assert_eq!(survey.poses, [slam, other]);
        // Each is what is read when it is asked for.
        for (asked, count) in [(None, 4), (Some("/slam/pose"), 4), (Some("/a/pose"), 1)] {
            let poses = poses_of_mcap(file.path(), asked).unwrap().poses;
            assert_eq!(poses.len(), count, "{asked:?}");
        }
    }

    #[test]
    fn recordings_are_no_bags_of_others() {
        for library in ["echosplat recording 2", "go; echosplat recording 2"] {
            let file = file(library, &records());
            assert_eq!(survey_of_mcap(file.path()).unwrap(), None, "{library}");
        }
        let sonar = [channel(7, "/sonar/raw", "any"), message(7, 1, "bytes")];
        let file = file("somebody's logger 2", &[records(), sonar.to_vec()].concat());
        assert_eq!(survey_of_mcap(file.path()).unwrap(), None);
    }
}
