//! Poses, pings and status as they come in: bounded, checked, counted.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, SystemTime};

use crossbeam_channel::{Receiver, Sender, bounded};
use echosplat_liveness::Heartbeat;
use echosplat_model::{StampedPose, Timestamp};
use serde::Serialize;
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

use crate::BusError;
use crate::bus::Link;
use crate::pose_message::{self, MAX_POSE_BYTES, PoseMessage, PoseMessageError};
use crate::publishers::{self, PublishedTopic, Publisher};
use crate::ros2::{FixTopic, PoseTopic};

/// Largest frame that the Ping protocol's lengths allow, header and checksum included.
const MAX_FRAME_BYTES: usize = 65_535 + 10;

/// Longest status that is sent or read.
pub(crate) const MAX_STATUS_BYTES: usize = 256 * 1024;
const MAX_PING_ATTACHMENT_BYTES: usize = 1024;

/// What became of the poses that came.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct PoseCounters {
    /// Messages that came.
    pub received: u64,
    /// Poses handed on.
    pub accepted: u64,
    /// With a number that is NaN or infinite.
    pub not_finite: u64,
    /// With a quaternion of the wrong length.
    pub bad_quaternion: u64,
    /// Of a wrong size, encoding, layout, frame, or too far off.
    pub malformed: u64,
    /// Newest dropped because the queue was full.
    pub dropped_full: u64,
}

/// A pose from the bus.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReceivedPose {
    /// Its stamp is the sender's, as it is.
    pub pose: StampedPose,
    /// When it came to this host, Unix time.
    pub arrived: Timestamp,
    /// Who put it.
    pub publisher: Publisher,
}

#[derive(Debug, Default)]
struct PoseTally {
    own_id: u128,
    first_fault: OnceLock<String>,
    received: AtomicU64,
    accepted: AtomicU64,
    not_finite: AtomicU64,
    bad_quaternion: AtomicU64,
    malformed: AtomicU64,
    dropped_full: AtomicU64,
}

fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

/// Now, on this host's clock.
pub(crate) fn now() -> Timestamp {
    SystemTime::now().into()
}

/// Poses in the order they came, in a bounded queue; when it is full the newest is dropped.
#[derive(Debug)]
pub struct PoseSubscription {
    poses: Receiver<ReceivedPose>,
    tally: Arc<PoseTally>,
    heartbeat: Heartbeat,
    topic: Option<PoseTopic>,
    _subscribers: Vec<Subscriber<()>>,
}

impl PoseSubscription {
    /// On a key whose messages say themselves what they are.
    pub(crate) fn start(link: &Arc<Link>, key: &str) -> Result<Self, BusError> {
        Self::on_keys(link, &[(key.to_owned(), None)])
    }

    /// On the keys of a topic of ROS, each with its message.
    pub(crate) fn on_topic(link: &Arc<Link>, topic: PoseTopic) -> Result<Self, BusError> {
        let keys = topic.keys.iter();
        let keys = keys.map(|(key, encoding)| (key.clone(), Some(*encoding)));
        let keys: Vec<_> = keys.collect();
        let poses = Self::on_keys(link, &keys)?;
        Ok(Self {
            topic: Some(topic),
            ..poses
        })
    }

    fn on_keys(
        link: &Arc<Link>,
        keys: &[(String, Option<&'static str>)],
    ) -> Result<Self, BusError> {
        let (sender, poses) = bounded(link.config.pose_queue_len);
        let tally = Arc::new(PoseTally {
            own_id: publishers::own_id(link),
            ..PoseTally::default()
        });
        let heartbeat = Heartbeat::new("poses");
        let subscribe = |(key, encoding): &(String, Option<&'static str>)| {
            let (in_callback, beats) = (Arc::clone(&tally), heartbeat.clone());
            let (sender, encoding) = (sender.clone(), *encoding);
            link.session
                .declare_subscriber(key.clone())
                .callback(move |sample| {
                    // The thread is zenoh's, and its link would go with a panic.
                    let _ = beats.survive(|| {
                        beats.beat();
                        in_callback.take(&sample, encoding, &sender);
                    });
                    beats.rest();
                })
                .wait()
                .map_err(BusError::zenoh(format!("subscribe to poses on {key}")))
        };
        let subscribers = keys.iter().map(subscribe).collect::<Result<_, _>>()?;
        Ok(Self {
            poses,
            tally,
            heartbeat,
            topic: None,
            _subscribers: subscribers,
        })
    }

    /// Of a topic of ROS: that what is published there holds no poses, in words.
    #[must_use]
    pub fn unfit(&self) -> Option<String> {
        self.topic.as_ref().and_then(PoseTopic::unfit)
    }

    /// Words for a publisher; `None` for those that cannot be told apart.
    #[must_use]
    pub fn name_of(&self, publisher: Publisher) -> Option<String> {
        publisher.name(self.topic.as_ref().map(PoseTopic::publishers))
    }

    /// Of a topic of ROS: others with messages that poses can be taken from.
    #[must_use]
    pub fn other_topics(&self) -> Vec<PublishedTopic> {
        let topics = self.topic.as_ref().map(PoseTopic::others);
        topics.unwrap_or_default()
    }

    /// The next pose, if one waits.
    #[must_use]
    pub fn try_next(&self) -> Option<ReceivedPose> {
        self.poses.try_recv().ok()
    }

    /// The next pose, waiting for it no longer than `limit`.
    #[must_use]
    pub fn next_within(&self, limit: Duration) -> Option<ReceivedPose> {
        self.poses.recv_timeout(limit).ok()
    }

    /// The queue itself, to select on.
    #[must_use]
    pub fn receiver(&self) -> &Receiver<ReceivedPose> {
        &self.poses
    }

    /// Whether whoever takes the messages is alive. A message that panics is left out.
    #[must_use]
    pub fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// What was wrong with the first message that was no pose, in words.
    #[must_use]
    pub fn first_fault(&self) -> Option<String> {
        self.tally.first_fault.get().cloned()
    }

    /// What became of the poses that came.
    #[must_use]
    pub fn counters(&self) -> PoseCounters {
        let tally = &self.tally;
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        PoseCounters {
            received: read(&tally.received),
            accepted: read(&tally.accepted),
            not_finite: read(&tally.not_finite),
            bad_quaternion: read(&tally.bad_quaternion),
            malformed: read(&tally.malformed),
            dropped_full: read(&tally.dropped_full),
        }
    }
}

impl PoseTally {
    fn take(&self, sample: &Sample, encoding: Option<&'static str>, poses: &Sender<ReceivedPose>) {
        let arrived = now();
        count(&self.received);
        match decode_pose(sample, encoding) {
            Ok(message) => {
                let publisher = Publisher::of(sample, self.own_id);
                self.hand_on(message, arrived, publisher, poses);
            }
            Err(error) => {
                tracing::debug!("pose left out: {error}");
                count(self.counter_of(&error));
                self.first_fault.get_or_init(|| error.to_string());
            }
        }
    }

    fn hand_on(
        &self,
        message: PoseMessage,
        arrived: Timestamp,
        publisher: Publisher,
        poses: &Sender<ReceivedPose>,
    ) {
        let pose = message.pose;
        let received = ReceivedPose {
            pose,
            arrived,
            publisher,
        };
        match poses.try_send(received) {
            Ok(()) => count(&self.accepted),
            Err(_) => count(&self.dropped_full),
        }
    }

    fn counter_of(&self, error: &PoseMessageError) -> &AtomicU64 {
        match error {
            PoseMessageError::NotFinite(_) => &self.not_finite,
            PoseMessageError::Quaternion(_) => &self.bad_quaternion,
            _ => &self.malformed,
        }
    }
}

/// `encoding`, where its key says it, goes before the message's own.
fn decode_pose(sample: &Sample, encoding: Option<&str>) -> Result<PoseMessage, PoseMessageError> {
    let payload = sample.payload();
    if payload.len() > MAX_POSE_BYTES {
        return Err(PoseMessageError::Size(payload.len()));
    }
    let bytes = payload.to_bytes();
    match encoding {
        Some(encoding) => pose_message::decode(encoding, &bytes),
        None => pose_message::decode(&sample.encoding().to_string(), &bytes),
    }
}

/// Longest message that [`MessageSubscription`] hands on.
const MAX_MESSAGE_BYTES: usize = 16 * 1024;

/// A message of another program, not decoded, not judged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReceivedMessage {
    /// The whole key it was sent on.
    pub key: String,
    /// Its bytes.
    pub payload: Vec<u8>,
    /// When it came to this host, Unix time.
    pub arrived: Timestamp,
}

/// Messages of other programs, in the order they came, in a bounded queue; when it is full the
/// newest is dropped. The callback returns at once: some publishers wait for slow subscribers.
#[derive(Debug)]
pub struct MessageSubscription {
    messages: Receiver<ReceivedMessage>,
    dropped: Arc<AtomicU64>,
    /// Of a topic of ROS.
    _topic: Option<FixTopic>,
    _subscribers: Vec<Subscriber<()>>,
}

impl MessageSubscription {
    pub(crate) fn on_topic(link: &Arc<Link>, topic: FixTopic) -> Result<Self, BusError> {
        let messages = Self::start(link, std::slice::from_ref(&topic.key))?;
        Ok(Self {
            _topic: Some(topic),
            ..messages
        })
    }

    pub(crate) fn start(link: &Arc<Link>, keys: &[String]) -> Result<Self, BusError> {
        let (sender, messages) = bounded(link.config.pose_queue_len);
        let dropped = Arc::new(AtomicU64::new(0));
        let subscribe = |key: &String| {
            let (sender, dropped) = (sender.clone(), Arc::clone(&dropped));
            link.session
                .declare_subscriber(key.clone())
                .callback(move |sample| hand_on_message(&sample, &sender, &dropped))
                .wait()
                .map_err(BusError::zenoh(format!("subscribe to {key}")))
        };
        let subscribers = keys.iter().map(subscribe).collect::<Result<_, _>>()?;
        Ok(Self {
            messages,
            dropped,
            _topic: None,
            _subscribers: subscribers,
        })
    }

    /// The next message, if one waits.
    #[must_use]
    pub fn try_next(&self) -> Option<ReceivedMessage> {
        self.messages.try_recv().ok()
    }

    /// The next message, waiting for it no longer than `limit`.
    #[must_use]
    pub fn next_within(&self, limit: Duration) -> Option<ReceivedMessage> {
        self.messages.recv_timeout(limit).ok()
    }

    /// Messages lost to a full queue, or because they were longer than 16 KiB.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

fn hand_on_message(sample: &Sample, messages: &Sender<ReceivedMessage>, dropped: &AtomicU64) {
    if sample.payload().len() > MAX_MESSAGE_BYTES {
        return count(dropped);
    }
    let message = ReceivedMessage {
        key: sample.key_expr().as_str().to_owned(),
        payload: sample.payload().to_bytes().into_owned(),
        arrived: now(),
    };
    if messages.try_send(message).is_err() {
        count(dropped);
    }
}

/// A raw Ping frame from the bus; not decoded, not judged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReceivedPing {
    /// When the host beside the sonar received it.
    pub host_time: Timestamp,
    /// The whole frame.
    pub frame: Vec<u8>,
}

/// What became of the pings that came.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct PingCounters {
    /// Messages that came.
    pub received: u64,
    /// Without host time, or of a wrong size.
    pub malformed: u64,
    /// Newest dropped because the queue was full.
    pub dropped_full: u64,
}

#[derive(Debug, Default)]
struct PingTally {
    received: AtomicU64,
    malformed: AtomicU64,
    dropped_full: AtomicU64,
}

/// Raw Ping frames in the order they came, in a bounded queue; when full the newest is dropped.
#[derive(Debug)]
pub struct PingSubscription {
    pings: Receiver<ReceivedPing>,
    tally: Arc<PingTally>,
    _subscriber: Subscriber<()>,
}

impl PingSubscription {
    pub(crate) fn start(link: &Arc<Link>) -> Result<Self, BusError> {
        let (sender, pings) = bounded(link.config.ping_queue_len);
        let tally = Arc::new(PingTally::default());
        let in_callback = Arc::clone(&tally);
        let subscriber = link
            .session
            .declare_subscriber(link.keys.ping())
            .callback(move |sample| in_callback.take(&sample, &sender))
            .wait()
            .map_err(BusError::zenoh("subscribe to pings"))?;
        Ok(Self {
            pings,
            tally,
            _subscriber: subscriber,
        })
    }

    /// The next ping, waiting for it no longer than `limit`.
    #[must_use]
    pub fn next_within(&self, limit: Duration) -> Option<ReceivedPing> {
        self.pings.recv_timeout(limit).ok()
    }

    /// The queue itself, to select on.
    #[must_use]
    pub fn receiver(&self) -> &Receiver<ReceivedPing> {
        &self.pings
    }

    /// What became of the pings that came.
    #[must_use]
    pub fn counters(&self) -> PingCounters {
        PingCounters {
            received: self.tally.received.load(Ordering::Relaxed),
            malformed: self.tally.malformed.load(Ordering::Relaxed),
            dropped_full: self.tally.dropped_full.load(Ordering::Relaxed),
        }
    }
}

impl PingTally {
    fn take(&self, sample: &Sample, pings: &Sender<ReceivedPing>) {
        count(&self.received);
        let Some(ping) = read_ping(sample) else {
            count(&self.malformed);
            return;
        };
        if pings.try_send(ping).is_err() {
            count(&self.dropped_full);
        }
    }
}

fn read_ping(sample: &Sample) -> Option<ReceivedPing> {
    let attachment = sample.attachment()?;
    let sizes_fit =
        sample.payload().len() <= MAX_FRAME_BYTES && attachment.len() <= MAX_PING_ATTACHMENT_BYTES;
    if !sizes_fit {
        return None;
    }
    let json: serde_json::Value = serde_json::from_slice(&attachment.to_bytes()).ok()?;
    Some(ReceivedPing {
        host_time: Timestamp::from_nanos(json.get("host_time_ns")?.as_i64()?),
        frame: sample.payload().to_bytes().into_owned(),
    })
}

/// The service's newest status.
#[derive(Debug)]
pub struct StatusSubscription {
    newest: Arc<Mutex<Option<serde_json::Value>>>,
    _subscriber: Subscriber<()>,
}

impl StatusSubscription {
    pub(crate) fn start(link: &Arc<Link>) -> Result<Self, BusError> {
        let newest = Arc::new(Mutex::new(None));
        let in_callback = Arc::clone(&newest);
        let subscriber = link
            .session
            .declare_subscriber(link.keys.status())
            .callback(move |sample| {
                if let Some(status) = read_status(&sample) {
                    *in_callback.lock().unwrap_or_else(PoisonError::into_inner) = Some(status);
                }
            })
            .wait()
            .map_err(BusError::zenoh("subscribe to the status"))?;
        Ok(Self {
            newest,
            _subscriber: subscriber,
        })
    }

    /// The newest status, once: a second call gives `None` until another came.
    #[must_use]
    pub fn take_newest(&self) -> Option<serde_json::Value> {
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        newest.take()
    }
}

fn read_status(sample: &Sample) -> Option<serde_json::Value> {
    let payload = sample.payload();
    if payload.len() > MAX_STATUS_BYTES {
        return None;
    }
    serde_json::from_slice(&payload.to_bytes()).ok()
}
