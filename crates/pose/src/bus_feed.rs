//! Poses from the bus, of one publisher at a time.

use std::collections::VecDeque;
use std::time::Duration;

use crossbeam_channel::Receiver;
use echosplat_bus::{PoseSubscription, Publisher, ReceivedPose};
use echosplat_join::ArrivedPose;
use echosplat_model::Timestamp;

use crate::now::now;
use crate::senders::{Rank, Rules, Senders};
use crate::status::{PoseSender, PoseSourceStatus, Several};

/// A publisher that was heard and is silent for so long has stopped, seconds: pings wait a little longer for their poses.
const RULES: Rules = Rules {
    silent_s: 1.5,
    settled_s: 0.0,
    // A program that is started again goes on where it was, or the guard finds that it does not.
    new_epoch: false,
};

/// Poses of a key.
#[derive(Debug)]
pub(crate) struct BusFeed {
    poses: PoseSubscription,
    senders: Senders<Publisher>,
    decided: VecDeque<ArrivedPose>,
    out: Vec<ArrivedPose>,
    /// Of publishers that the table has no room for.
    beyond: u64,
}

impl BusFeed {
    pub(crate) fn new(poses: PoseSubscription) -> Self {
        Self {
            poses,
            senders: Senders::new(RULES),
            decided: VecDeque::new(),
            out: Vec::new(),
            beyond: 0,
        }
    }

    pub(crate) fn subscription(&self) -> &PoseSubscription {
        &self.poses
    }

    pub(crate) fn waiting_len(&self) -> usize {
        self.poses.receiver().len() + self.decided.len()
    }

    /// The next pose of the publisher used, waiting no longer than `limit`.
    pub(crate) fn next(&mut self, limit: Option<Duration>) -> Option<ArrivedPose> {
        loop {
            if let Some(pose) = self.decided.pop_front() {
                return Some(pose);
            }
            match receive(self.poses.receiver(), limit) {
                Some(received) => self.take(&received),
                None => {
                    self.senders.settle(now(), &mut self.out);
                    self.decided.extend(self.out.drain(..));
                    return self.decided.pop_front();
                }
            }
        }
    }

    fn take(&mut self, received: &ReceivedPose) {
        let ReceivedPose { pose, arrived, .. } = *received;
        match self
            .senders
            .hear(received.publisher, Rank::Vehicle, arrived)
        {
            None => self.beyond += 1,
            Some((index, _)) => {
                let pose = ArrivedPose { pose, arrived };
                self.senders.pose(index, pose, &mut self.out);
                self.decided.extend(self.out.drain(..));
            }
        }
    }

    pub(crate) fn status(&self) -> PoseSourceStatus {
        let (now, counters) = (now(), self.poses.counters());
        PoseSourceStatus {
            received: counters.received,
            accepted: counters.accepted,
            other_senders: self.senders.left_out() + self.beyond,
            not_finite: counters.not_finite,
            bad_quaternion: counters.bad_quaternion,
            malformed: counters.malformed,
            dropped_full: counters.dropped_full,
            first_fault: self.poses.first_fault(),
            senders: self.told(now),
            several: self.several(now),
            missing: self
                .poses
                .unfit()
                .or_else(|| self.elsewhere(counters.received)),
            ..PoseSourceStatus::default()
        }
    }

    fn name_of(&self, publisher: Publisher) -> String {
        let name = self.poses.name_of(publisher);
        name.unwrap_or_else(|| "a publisher that does not say which it is".to_owned())
    }

    /// Publishers, and topics of ROS that might be meant as well.
    fn told(&self, now: Timestamp) -> Vec<PoseSender> {
        let mut told = self
            .senders
            .told(now, |_, heard| (self.name_of(heard.id), None));
        if told.len() == 1
            && self
                .senders
                .ids()
                .all(|(_, id, _)| id == Publisher::Unknown)
        {
            told.clear();
        }
        let others = self.poses.other_topics().into_iter();
        told.extend(others.map(|other| PoseSender {
            name: format!("node {} on {}", other.node, other.topic),
            kind: Some("another topic".to_owned()),
            ..PoseSender::default()
        }));
        told
    }

    fn several(&self, now: Timestamp) -> Option<Several> {
        let own = self.senders.heard(self.senders.used()?);
        let rival = self.senders.others().find(|other| other.gives_poses(now))?;
        let sentence = format!(
            "a second source sends poses {:.1} m from the first; {} were left out: poses of {} are used, those of {} are not; \
             end one of the two, or give each vehicle a --node or a pose.url of its own",
            self.senders.distance_m(rival),
            self.senders.left_out(),
            self.name_of(own.id),
            self.name_of(rival.id),
        );
        Some(Several {
            sentence,
            leaves_out: true,
        })
    }

    /// Nothing came on the topic, and others have what it should.
    fn elsewhere(&self, received: u64) -> Option<String> {
        let others = self.poses.other_topics();
        let other = others.first().filter(|_| received == 0)?;
        Some(format!(
            "nothing comes on the topic of pose.url; node {} publishes poses on {topic}: ros2://{topic} takes those",
            other.node,
            topic = other.topic
        ))
    }
}

pub(crate) fn receive<T>(queue: &Receiver<T>, limit: Option<Duration>) -> Option<T> {
    match limit {
        None => queue.try_recv().ok(),
        Some(limit) => queue.recv_timeout(limit).ok(),
    }
}
