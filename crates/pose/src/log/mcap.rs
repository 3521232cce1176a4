//! Pose messages in an MCAP file that another program wrote: in chunks or not, compressed or not, in
//! any order, also cut or damaged.

use std::cmp::Reverse;
use std::collections::HashMap;
use std::path::Path;

use echosplat_join::ArrivedPose;
use echosplat_model::Timestamp;
use echosplat_recording::mcap::{Channel, Condition, Message, Messages, RecordingError};

use super::found::{LogPosesError, in_order};
use super::frames::Frames;
use super::message::{Kind, transforms};
use super::survey::TopicPoses;
use crate::fault::quoted;

/// Poses of one topic; two days at 50 Hz.
const MAX_POSES: usize = 8_640_000;
/// A topic of JSON whose first messages are no poses is another's.
const TRIALS: u64 = 10;
/// Topics named in an error.
const NAMED_TOPICS: usize = 8;

/// Poses of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct LogPoses {
    /// In order of time, with the times at which the file says they were logged.
    pub poses: Vec<ArrivedPose>,
    /// What the file lacks, a sentence each.
    pub losses: Vec<String>,
}

/// The poses of `topic`, or else of the topic that holds most of them, or those that `/tf` leads to.
///
/// # Errors
/// If it cannot be read as MCAP, or there are no poses in it; then which topics there are.
pub fn poses_of_mcap(path: &Path, topic: Option<&str>) -> Result<LogPoses, LogPosesError> {
    let wrong = |error| cannot_read(path, error);
    let mut messages = Messages::open(path).map_err(wrong)?;
    let mut topics = Topics::default();
    while let Some(message) = messages.next_message().map_err(wrong)? {
        if let Some(channel) = messages.channel(message.header.channel_id) {
            topics.take(channel, &message);
        }
    }
    let losses = losses(path, messages.condition());
    match topics.chosen(topic) {
        Ok(poses) => Ok(LogPoses { poses, losses }),
        Err(reason) => Err(LogPosesError::None {
            path: path.to_owned(),
            reason: [&losses[..], &[reason]].concat().join("; "),
        }),
    }
}

pub(crate) fn cannot_read(path: &Path, error: RecordingError) -> LogPosesError {
    match error {
        RecordingError::Io(reason) => LogPosesError::Io {
            path: path.to_owned(),
            reason,
        },
        other => LogPosesError::Format {
            path: path.to_owned(),
            reason: other.to_string(),
        },
    }
}

pub(super) fn losses(path: &Path, condition: Condition) -> Vec<String> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut losses = Vec::new();
    if condition.is_cut {
        losses.push(format!(
            "the poses' file {name} ends in the middle: those after are missing"
        ));
    }
    let bytes = condition.damaged_byte_count;
    if bytes > 0 || condition.is_checksum_wrong {
        losses.push(format!(
            "the poses' file {name} is damaged: {bytes} bytes in it make no record, and poses may be \
             missing"
        ));
    }
    losses
}

/// What the file's channels hold.
#[derive(Default)]
pub(super) struct Topics {
    channels: HashMap<u16, Taken>,
    frames: Frames,
    fault_of_frames: Option<String>,
}

/// One channel that may hold poses.
struct Taken {
    topic: String,
    kind: Option<Kind>,
    tried: u64,
    fault: Option<String>,
    poses: Vec<ArrivedPose>,
}

impl Topics {
    pub(super) fn take(&mut self, channel: &Channel, message: &Message) {
        let arrived = i64::try_from(message.header.log_time).unwrap_or(i64::MAX);
        let arrived = Timestamp::from_nanos(arrived);
        let taken = self.channels.entry(message.header.channel_id);
        let taken = taken.or_insert_with(|| Taken {
            topic: channel.topic.clone(),
            kind: Kind::of(channel),
            tried: 0,
            fault: None,
            poses: Vec::new(),
        });
        let Some(Kind::Transforms(encoding)) = taken.kind else {
            return taken.take(&message.data, arrived);
        };
        let is_static = taken.is_static();
        match transforms(encoding, &message.data) {
            Ok(found) => {
                for transform in found {
                    self.frames.take(transform, is_static, arrived);
                }
            }
            Err(fault) => {
                self.fault_of_frames.get_or_insert(fault);
            }
        }
    }

    fn chosen(self, topic: Option<&str>) -> Result<Vec<ArrivedPose>, String> {
        let words = self.words(topic);
        let asks_for_frames = topic.is_some_and(|topic| {
            let mut channels = self.channels.values();
            channels.any(|taken| taken.topic == topic && taken.is_of_frames())
        });
        let fits = |taken: &Taken| topic.is_none_or(|topic| taken.topic == topic);
        let channels = self.channels.into_values();
        let most = channels
            .filter(fits)
            // Of two with as many, the same at each run.
            .max_by_key(|taken| (taken.poses.len(), Reverse(taken.topic.clone())))
            .filter(|taken| !taken.poses.is_empty());
        match most {
            Some(taken) => Ok(in_order(taken.poses)),
            None if !self.frames.is_empty() && (topic.is_none() || asks_for_frames) => {
                let found = self.frames.poses();
                let (poses, way) = found.map_err(|why| format!("/tf: {why}"))?;
                tracing::info!("poses of /tf, {way}");
                Ok(in_order(poses))
            }
            None => Err(words),
        }
    }

    /// Why messages of a topic that its schema says has poses give none, by the topic.
    pub(super) fn faults(&self) -> HashMap<String, String> {
        let told = self.channels.values().filter(|taken| taken.is_by_schema());
        let told = told.filter(|taken| taken.poses.is_empty());
        told.filter_map(|taken| Some((taken.topic.clone(), taken.fault.clone()?)))
            .collect()
    }

    /// The poses of each topic that has some, in the order in which [`poses_of_mcap`] prefers them; and where there
    /// are frames that give none, their topic and why.
    pub(super) fn poses(self) -> (Vec<TopicPoses>, Option<(String, String)>) {
        let moving = |taken: &&Taken| taken.is_of_frames() && !taken.is_static();
        let frames = self.channels.values().find(moving);
        let frames = frames.map(|taken| taken.topic.clone());
        let channels = self.channels.into_values();
        let mut found: Vec<TopicPoses> = channels
            .filter_map(|taken| TopicPoses::of(&taken.topic, taken.poses, None))
            .collect();
        found.sort_by_key(|poses| (Reverse(poses.count), poses.topic.clone()));
        let Some(topic) = frames.filter(|_| !self.frames.is_empty()) else {
            return (found, None);
        };
        let fault = match self.frames.poses() {
            Ok((poses, way)) => {
                found.extend(TopicPoses::of(&topic, poses, Some(way)));
                None
            }
            Err(why) => Some((topic, why)),
        };
        (found, fault)
    }

    fn words(&self, topic: Option<&str>) -> String {
        let mut names: Vec<String> = self.channels.values().map(Taken::words).collect();
        names.extend(
            self.fault_of_frames
                .as_ref()
                .map(|fault| format!("/tf ({fault})")),
        );
        names.sort();
        names.truncate(NAMED_TOPICS);
        let wanted = match topic {
            Some(topic) => format!("on topic {}", quoted(topic)),
            None => "on any topic".to_owned(),
        };
        match names.is_empty() {
            true => "there are no messages in it".to_owned(),
            false => format!(
                "no Odometry, PoseStamped, PoseWithCovarianceStamped, TFMessage or PoseInFrame {wanted}; \
                 it has {}",
                names.join(", ")
            ),
        }
    }
}

impl Taken {
    fn is_of_frames(&self) -> bool {
        matches!(self.kind, Some(Kind::Transforms(_)))
    }

    fn is_static(&self) -> bool {
        self.topic.ends_with("tf_static")
    }

    fn is_by_schema(&self) -> bool {
        self.kind.as_ref().is_some_and(Kind::is_by_schema)
    }

    fn take(&mut self, data: &[u8], arrived: Timestamp) {
        let is_hopeless = self.poses.is_empty() && self.tried >= TRIALS;
        if is_hopeless || self.poses.len() >= MAX_POSES {
            return;
        }
        let Some(kind) = &self.kind else { return };
        self.tried += 1;
        match kind.pose(data) {
            Ok(message) => self.poses.push(ArrivedPose {
                pose: message.pose,
                arrived,
            }),
            Err(fault) => {
                self.fault.get_or_insert(fault);
            }
        }
    }

    fn words(&self) -> String {
        let name = quoted(&self.topic);
        match &self.fault {
            Some(fault) if self.is_by_schema() => format!("{name} ({fault})"),
            _ => name,
        }
    }
}
