//! What became of the poses of a source, for the status.

use std::collections::VecDeque;

use echosplat_model::Timestamp;
use serde::Serialize;

use crate::fault::Fault;
use crate::mavlink::origin::ToldOrigin;

/// What became of the poses of a source.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PoseSourceStatus {
    /// The URL.
    pub source: String,
    /// Messages that came and should have led to a pose.
    pub received: u64,
    /// Poses handed on.
    pub accepted: u64,
    /// With a number that is NaN or infinite.
    pub not_finite: u64,
    /// With a quaternion of the wrong length.
    pub bad_quaternion: u64,
    /// Of a wrong size, layout or frame, too far off, or called invalid by their sender.
    pub malformed: u64,
    /// Newest dropped because the queue was full.
    pub dropped_full: u64,
    /// Poses, and messages that poses are made of, from others than the sender used, left out.
    pub other_senders: u64,
    /// Messages left out since they came a second time, after newer ones of their kind, or before they can have been sent.
    pub late: u64,
    /// Everybody heard who may send poses, the one used first. Empty where senders cannot be told apart.
    pub senders: Vec<PoseSender>,
    /// Where it is not clear whose poses are meant.
    pub several: Option<Several>,
    /// What was wrong with the first message refused.
    pub first_fault: Option<String>,
    /// Of accepted poses, over the last seconds.
    pub rate_hz: f64,
    /// Since the newest pose arrived, on this host's clock.
    pub age_s: Option<f64>,
    /// Resets of the source that it told of itself.
    pub epoch: u32,
    /// What is added to the source's clock to give the host's, where known.
    pub clock_offset_s: Option<f64>,
    /// How that is known: `timesync`, `system_time`, `arrival`, `unix` (the source keeps Unix
    /// time), `data` (stamps as they are).
    pub clock_method: Option<String>,
    /// Of a source with a link: `up`, `waiting for …`, `lost: …`; behind `up` also how positions are reckoned, and what became
    /// of a DVL beside it.
    pub link: Option<String>,
    /// Where on Earth its poses count from, if it says so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub origin: Option<ToldOrigin>,
    /// Whether x of its world points somewhere else than east, as of a dead reckoning.
    #[serde(skip)]
    pub lacks_north: bool,
    /// What the source lacks for poses, and what would give it.
    pub missing: Option<String>,
}

/// More than one sender whose poses may be meant.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Several {
    /// Who is used, who else is heard, and what to do.
    pub sentence: String,
    /// Whether poses are left out that may be the ones meant.
    pub leaves_out: bool,
}

/// Somebody who sends poses, or could.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PoseSender {
    /// As the source tells senders apart: `system 1 component 1`, a node of ROS.
    pub name: String,
    /// By its own word: `autopilot`, `gimbal`, `ground station`.
    pub kind: Option<String>,
    /// Whether its poses are taken.
    pub is_used: bool,
    /// Poses that came from it.
    pub poses: u64,
    /// Since it was last heard, on this host's clock.
    pub age_s: f64,
}

impl PoseSourceStatus {
    /// Adds what was counted of another sender of the same source.
    pub(crate) fn add(&mut self, other: &Self) {
        for (sum, of_other) in [
            (&mut self.received, other.received),
            (&mut self.not_finite, other.not_finite),
            (&mut self.bad_quaternion, other.bad_quaternion),
            (&mut self.malformed, other.malformed),
            (&mut self.late, other.late),
        ] {
            *sum += of_other;
        }
    }

    /// Counts a message refused; the first one's words are kept.
    pub(crate) fn refuse(&mut self, fault: &Fault) {
        match fault {
            Fault::NotFinite(_) => self.not_finite += 1,
            Fault::Quaternion(_) => self.bad_quaternion += 1,
            Fault::Malformed(_) => self.malformed += 1,
        }
        self.first_fault.get_or_insert_with(|| fault.to_string());
    }
}

/// Over how long the rate is taken, seconds.
const RATE_WINDOW_S: f64 = 3.0;
/// Most arrivals remembered: rates beyond some 700 Hz are told as such.
const RATE_CAPACITY: usize = 2_048;

/// Arrivals of the last seconds.
#[derive(Debug, Default)]
pub(crate) struct Rate {
    arrivals: VecDeque<Timestamp>,
}

impl Rate {
    pub(crate) fn count(&mut self, arrived: Timestamp) {
        if self.arrivals.len() == RATE_CAPACITY {
            self.arrivals.pop_front();
        }
        self.arrivals.push_back(arrived);
    }

    /// Poses a second, and seconds since the newest.
    pub(crate) fn read(&self, now: Timestamp) -> (f64, Option<f64>) {
        let is_recent = |at: &&Timestamp| now.seconds_since(**at).abs() <= RATE_WINDOW_S;
        let recent: Vec<_> = self.arrivals.iter().filter(is_recent).collect();
        let rate_hz = match (recent.first(), recent.len()) {
            (Some(first), count) if count > 1 => {
                let span_s = now.seconds_since(**first).max(0.1);
                count as f64 / span_s
            }
            _ => 0.0,
        };
        let newest = self.arrivals.back();
        (rate_hz, newest.map(|at| now.seconds_since(*at)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_of_the_last_seconds_and_the_age_of_the_newest() {
        let mut rate = Rate::default();
        assert_eq!(rate.read(Timestamp::ZERO), (0.0, None));
        for i in 0..100 {
            rate.count(Timestamp::from_millis(i * 20));
        }
        let (rate_hz, age_s) = rate.read(Timestamp::from_millis(2_000));
        assert!((rate_hz - 50.0).abs() < 1.0, "{rate_hz}");
        assert!((age_s.unwrap() - 0.02).abs() < 1e-9);
        let (rate_hz, age_s) = rate.read(Timestamp::from_millis(10_000));
        assert!(rate_hz < 1e-9 && age_s.unwrap() > 8.0);
    }

    #[test]
    fn the_first_fault_stays() {
        let mut status = PoseSourceStatus::default();
        status.refuse(&Fault::NotFinite("position".to_owned()));
        status.refuse(&Fault::Quaternion(0.5));
        status.refuse(&Fault::Malformed("odd".to_owned()));
        let counts = (status.not_finite, status.bad_quaternion, status.malformed);
        assert_eq!(counts, (1, 1, 1));
        assert!(status.first_fault.unwrap().contains("position"));
    }
}
