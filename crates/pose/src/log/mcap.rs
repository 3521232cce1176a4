//! Pose messages in an MCAP file that another program wrote: ROS 2 messages in CDR, or poses as
//! JSON as this program takes them. In chunks or not; compressed chunks are not read.

use std::collections::HashMap;
use std::io::Read;
use std::path::Path;

use ::mcap::records::Record;
use ::mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use echosplat_bus::pose_message;
use echosplat_model::Timestamp;

use super::found::{LogPosesError, in_order};
use crate::fault::quoted;
use echosplat_join::ArrivedPose;

/// Longest record or chunk taken into memory.
const MAX_RECORD_BYTES: usize = 256 << 20;
/// Poses of one topic; two days at 50 Hz.
const MAX_POSES: usize = 8_640_000;
/// A topic of JSON whose first messages are no poses is another's.
const TRIALS: u64 = 10;
/// Topics named in an error.
const NAMED_TOPICS: usize = 8;

/// The poses of `topic`, or else of the topic that holds most of them, with the times at which the
/// file says they were logged.
///
/// # Errors
/// If it cannot be read as MCAP, or there are no poses in it; then which topics there are.
pub fn poses_of_mcap(path: &Path, topic: Option<&str>) -> Result<Vec<ArrivedPose>, LogPosesError> {
    let io = |reason| LogPosesError::Io {
        path: path.to_owned(),
        reason,
    };
    let format = |reason: String| LogPosesError::Format {
        path: path.to_owned(),
        reason,
    };
    let mut file = echosplat_input::open_file(path).map_err(io)?;
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_record_length_limit(MAX_RECORD_BYTES);
    let mut reader = LinearReader::new_with_options(options);
    let mut topics = Topics::default();
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let count = file.read(reader.insert(wanted)).map_err(io)?;
                reader.notify_read(count);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                let record = ::mcap::parse_record(opcode, data);
                topics.take(record.map_err(|error| format(error.to_string()))?);
            }
            // What was read up to a cut stands.
            Err(_) if topics.has_poses() => break,
            Err(error) => return Err(format(in_words(&error))),
        }
    }
    topics.chosen(topic).map_err(|reason| LogPosesError::None {
        path: path.to_owned(),
        reason,
    })
}

fn in_words(error: &::mcap::McapError) -> String {
    match error {
        ::mcap::McapError::UnsupportedCompression(name) => format!(
            "its chunks are compressed with {}, which is not read; `mcap convert --compression \
             none` makes a copy that is",
            quoted(name)
        ),
        other => other.to_string(),
    }
}

/// What the file's channels hold.
#[derive(Default)]
struct Topics {
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
}

/// One channel that may hold poses.
struct Channel {
    topic: String,
    /// As [`pose_message::decode`] takes it.
    encoding: String,
    tried: u64,
    fault: Option<String>,
    poses: Vec<ArrivedPose>,
}

impl Topics {
    fn take(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id);
                let schema = schema.map_or("", String::as_str);
                let encoding = match channel.message_encoding.as_str() {
                    "cdr" => format!("{};{schema}", "application/cdr"),
                    "json" => pose_message::JSON.to_owned(),
                    _ => return,
                };
                self.channels.entry(channel.id).or_insert(Channel {
                    topic: channel.topic,
                    encoding,
                    tried: 0,
                    fault: None,
                    poses: Vec::new(),
                });
            }
            Record::Message { header, data } => {
                if let Some(channel) = self.channels.get_mut(&header.channel_id) {
                    channel.take(&data, header.log_time);
                }
            }
            _ => {}
        }
    }

    fn has_poses(&self) -> bool {
        self.channels
            .values()
            .any(|channel| !channel.poses.is_empty())
    }

    fn chosen(self, topic: Option<&str>) -> Result<Vec<ArrivedPose>, String> {
        let words = self.words(topic);
        let channels = self.channels.into_values();
        let fits = |channel: &Channel| topic.is_none_or(|topic| channel.topic == topic);
        let most = channels
            .filter(fits)
            .max_by_key(|channel| channel.poses.len());
        match most {
            Some(channel) if !channel.poses.is_empty() => Ok(in_order(channel.poses)),
            _ => Err(words),
        }
    }

    fn words(&self, topic: Option<&str>) -> String {
        let mut names: Vec<String> = self.channels.values().map(Channel::words).collect();
        names.sort();
        names.truncate(NAMED_TOPICS);
        let wanted = match topic {
            Some(topic) => format!("on topic {}", quoted(topic)),
            None => "on any topic".to_owned(),
        };
        match names.is_empty() {
            true => "there is no channel of CDR or JSON in it".to_owned(),
            false => format!(
                "no Odometry, PoseStamped or PoseWithCovarianceStamped {wanted}; it has {}",
                names.join(", ")
            ),
        }
    }
}

impl Channel {
    fn take(&mut self, data: &[u8], log_time: u64) {
        let is_hopeless = self.poses.is_empty() && self.tried >= TRIALS;
        if is_hopeless || self.poses.len() >= MAX_POSES {
            return;
        }
        self.tried += 1;
        match pose_message::decode(&self.encoding, data) {
            Ok(message) => self.poses.push(ArrivedPose {
                pose: message.pose,
                arrived: Timestamp::from_nanos(i64::try_from(log_time).unwrap_or(i64::MAX)),
            }),
            Err(error) => {
                self.fault.get_or_insert_with(|| error.to_string());
            }
        }
    }

    fn words(&self) -> String {
        let name = quoted(&self.topic);
        let is_ros_pose = self.encoding.contains("Pose") || self.encoding.contains("Odometry");
        match &self.fault {
            Some(fault) if is_ros_pose => format!("{name} ({fault})"),
            _ => name,
        }
    }
}
