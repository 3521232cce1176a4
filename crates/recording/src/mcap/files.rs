//! The files of a dive: in which order they are read, and in which order what stands in each.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use echosplat_model::Timestamp;

use super::message::time_of;
use super::messages::{Condition, Item, Message, Messages, regular_file};
use super::topic::Topic;
use super::{RecordingError, Source};

/// Records of several threads stand in a recording in disorder by less, seconds.
const DISORDER_S: f64 = 1.0;

/// The messages of a file that are this program's.
pub(super) enum FileMessages<'a> {
    /// As they stand there.
    AsTheyStand(Box<Messages<Source<'a>>>),
    /// Each topic stands in the file for itself: each is read for itself, and the oldest goes first.
    OfTopics(Vec<Lane<'a>>),
}

/// One topic of a file.
pub(super) struct Lane<'a> {
    messages: Messages<Source<'a>>,
    topic: Topic,
    next: Option<Message>,
}

/// What comes next in a file.
pub(super) enum Next {
    Begin(Condition),
    Message(Topic, Message),
    End(Condition),
}

impl<'a> FileMessages<'a> {
    /// Of a stream, as they stand there.
    ///
    /// # Errors
    /// If it is no MCAP, or cannot be read.
    pub(super) fn new(source: Source<'a>) -> Result<Self, RecordingError> {
        Ok(Self::AsTheyStand(Box::new(Messages::new(source)?)))
    }

    /// Of the file at `path`, in an order that a dive can have had.
    ///
    /// # Errors
    /// If it is no regular file, no MCAP, cannot be read, or its messages are in no such order.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        match order_of(path)? {
            Order::AsRecorded => return Self::new(opened(path)?),
            Order::None => return Err(RecordingError::OutOfOrder),
            Order::TopicByTopic => {}
        }
        let lane = |topic| {
            let messages = Messages::new(opened(path)?)?;
            let mut lane = Lane {
                messages,
                topic,
                next: None,
            };
            lane.read_on()?;
            Ok(lane)
        };
        // Of one time an event goes first: it may say the epoch of a pose.
        let mut topics = Topic::ALL;
        topics.sort_by_key(|topic| *topic != Topic::Events);
        let lanes: Result<Vec<_>, RecordingError> = topics.into_iter().map(lane).collect();
        Ok(Self::OfTopics(lanes?))
    }

    pub(super) fn next(&mut self) -> Result<Next, RecordingError> {
        match self {
            Self::AsTheyStand(messages) => loop {
                match messages.next_item()? {
                    Item::Begin(before) => return Ok(Next::Begin(before)),
                    Item::End => return Ok(Next::End(messages.condition())),
                    Item::Message(message) => {
                        let channel = messages.channel(message.header.channel_id);
                        let topic = channel.and_then(|channel| channel.own);
                        // What makes a delta whole is not said in ROS.
                        let is_half = |topic| topic == Topic::Delta && messages.is_for_ros();
                        if let Some(topic) = topic.filter(|topic| !is_half(*topic)) {
                            return Ok(Next::Message(topic, message));
                        }
                    }
                }
            },
            Self::OfTopics(lanes) => {
                let oldest = lanes.iter_mut().filter(|lane| lane.next.is_some());
                let oldest = oldest.min_by_key(|lane| time_in(lane.next.as_ref()));
                let Some(lane) = oldest else {
                    let condition = lanes.first().map(|lane| lane.messages.condition());
                    return Ok(Next::End(condition.unwrap_or_default()));
                };
                let message = lane.next.take();
                lane.read_on()?;
                Ok(match message {
                    Some(message) => Next::Message(lane.topic, message),
                    None => Next::End(Condition::default()),
                })
            }
        }
    }

    fn first(&self) -> Option<&Messages<Source<'a>>> {
        match self {
            Self::AsTheyStand(messages) => Some(messages),
            Self::OfTopics(lanes) => lanes.first().map(|lane| &lane.messages),
        }
    }

    /// Whether messages have the sequences that this program gave them.
    pub(super) fn keeps_sequences(&self) -> bool {
        self.first().is_some_and(Messages::keeps_sequences)
    }

    /// Whether this program wrote the file as it is.
    pub(super) fn is_own(&self) -> bool {
        self.first().is_none_or(Messages::is_own)
    }

    pub(super) fn lost_byte_count(&self) -> u64 {
        self.first().map_or(0, Messages::lost_byte_count)
    }
}

fn opened<'a>(path: &Path) -> Result<Source<'a>, RecordingError> {
    Ok(Box::new(regular_file(path)?))
}

fn time_in(message: Option<&Message>) -> u64 {
    message.map_or(u64::MAX, |message| message.header.log_time)
}

impl Lane<'_> {
    fn read_on(&mut self) -> Result<(), RecordingError> {
        self.next = loop {
            let Some(message) = self.messages.next_message()? else {
                break None;
            };
            let channel = self.messages.channel(message.header.channel_id);
            if channel.and_then(|channel| channel.own) == Some(self.topic) {
                break Some(message);
            }
        };
        Ok(())
    }
}

/// In which order the messages of a file stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Order {
    /// As they were recorded; times may go back where a clock was set.
    AsRecorded,
    /// Another program has put them together by their topics: times go back from one topic to another.
    TopicByTopic,
    /// Times and sequences of one topic go back.
    None,
}

fn order_of(path: &Path) -> Result<Order, RecordingError> {
    let mut messages = Messages::open(path)?;
    let mut newest: Option<Timestamp> = None;
    let mut of_topics: HashMap<u16, (Timestamp, u32)> = HashMap::new();
    let (mut goes_back, mut clock_was_set) = (false, false);
    while let Some(message) = messages.next_message()? {
        if messages.is_own() {
            return Ok(Order::AsRecorded);
        }
        let header = &message.header;
        let channel = messages.channel(header.channel_id);
        let Some(topic) = channel.and_then(|channel| channel.own) else {
            continue;
        };
        let time = time_of(header.log_time);
        let is_before = |other: Timestamp| other.seconds_since(time) > DISORDER_S;
        let here = (time, header.sequence);
        let ahead = of_topics.entry(header.channel_id).or_insert(here);
        if is_before(ahead.0) {
            // That of a pose is its epoch.
            if topic != Topic::Pose && header.sequence < ahead.1 {
                return Ok(Order::None);
            }
            clock_was_set = true;
            *ahead = here;
        } else if time > ahead.0 {
            *ahead = here;
        }
        goes_back |= newest.is_some_and(is_before);
        newest = newest.max(Some(time));
    }
    Ok(match goes_back && !clock_was_set {
        true => Order::TopicByTopic,
        false => Order::AsRecorded,
    })
}

/// The files in the order of a dive: as they were given, unless one begins before the one ahead of it
/// has ended and another order is better.
pub(super) fn in_order(mut paths: Vec<PathBuf>) -> Vec<PathBuf> {
    let first = |path: &PathBuf| span_of(path, true).map(|(first, _)| first);
    let firsts: Vec<_> = paths.iter().filter_map(first).collect();
    if paths.len() < 2 || firsts.is_sorted() {
        return paths;
    }
    let spans: Vec<_> = paths
        .iter()
        .filter_map(|path| span_of(path, false))
        .collect();
    let goes_on = |pair: &[(Timestamp, Timestamp)]| pair[0].1 <= pair[1].0;
    if !spans.windows(2).all(goes_on) {
        // A clock may have been set back within a file: then they were in order as given.
        paths.sort_by_cached_key(|path| first(path));
    }
    paths
}

/// Host times of the first and the last piece of bytes in a file, as they stand there; of a
/// file that cannot be read `None`: whoever reads it says why.
fn span_of(path: &Path, only_first: bool) -> Option<(Timestamp, Timestamp)> {
    let mut messages = Messages::open(path).ok()?;
    let mut span: Option<(Timestamp, Timestamp)> = None;
    while let Some(message) = messages.next_message().ok()? {
        let channel = messages.channel(message.header.channel_id)?;
        if channel.own == Some(Topic::Raw) {
            let time = time_of(message.header.log_time);
            span = Some((span.map_or(time, |(first, _)| first), time));
            if only_first {
                break;
            }
        }
    }
    span
}
