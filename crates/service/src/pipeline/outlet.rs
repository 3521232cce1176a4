//! Where pings and maps go from the mapper's thread: nothing here waits for anyone.

use std::sync::{Arc, MutexGuard, OnceLock, PoisonError};
use std::time::Instant;

use bytes::Bytes;
use echosplat_bus::{Bus, MapPublisher, RosPublisher, Sent};
use echosplat_model::{Ping, PosedPing, Snapshot, Timestamp};
use echosplat_web::{Feed, Track, TrackPoint};

use super::Way;
use super::prediction::{Predicted, Prediction};
use crate::clock;

/// When in the dive a map was made, and what had been spent on it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moment {
    /// Since the first ping, on the pings' clock.
    pub dive_s: f64,
    /// Processor seconds of mapping so far.
    pub compute_s: f64,
    /// Gaussian–bin pairs so far.
    pub pairs: u64,
    /// Voxel observations so far.
    pub voxel_observations: u64,
    /// Pings so far.
    pub pings: u64,
}

/// A map to be judged, with what it had cost.
#[derive(Debug, Clone)]
pub struct Observed {
    /// The map.
    pub snapshot: Arc<Snapshot>,
    /// When it was, and what it had taken.
    pub moment: Moment,
}

/// When maps are wanted, in seconds on the pings' clock since the first ping.
#[derive(Debug, Clone, PartialEq)]
pub enum Schedule {
    /// At the first ping, and so long after each map.
    Every(f64),
    /// At these times, in order.
    At(Vec<f64>),
    /// At each multiple of an interval but 0.
    Multiples(f64),
}

impl Schedule {
    /// The first time after `dive_s`; infinite if there is none.
    fn after(&self, dive_s: f64) -> f64 {
        match self {
            Self::Every(interval_s) => dive_s + interval_s,
            Self::Multiples(interval_s) => ((dive_s / interval_s).floor() + 1.0) * interval_s,
            Self::At(times_s) => {
                let later = times_s.iter().copied().find(|time_s| *time_s > dive_s);
                later.unwrap_or(f64::INFINITY)
            }
        }
    }

    fn first(&self) -> f64 {
        match self {
            Self::Every(_) => 0.0,
            Self::Multiples(interval_s) => *interval_s,
            Self::At(times_s) => times_s.first().copied().unwrap_or(f64::INFINITY),
        }
    }
}

/// Takes maps at some moments of the dive; on the mapper's thread, so it must be quick.
pub struct Observer {
    /// When maps are wanted.
    pub schedule: Schedule,
    /// Called with each, on the mapper's thread.
    pub take: Box<dyn FnMut(Observed) + Send>,
}

/// Where pings and maps go.
pub(crate) struct Outlet {
    bus: Option<Arc<Bus>>,
    publisher: Option<Arc<MapPublisher>>,
    ros: Option<Arc<RosPublisher>>,
    /// Each with the time of the dive at which it is due.
    observers: Vec<(Observer, f64)>,
    /// Names this run's map; put on every snapshot.
    epoch: u64,
    made: Option<Sent>,
    prediction: Option<Prediction>,
    page: Option<Feed>,
    way: Option<Way>,
    first_time: OnceLock<Timestamp>,
}

impl Outlet {
    pub(crate) fn new(
        bus: Option<Arc<Bus>>,
        publisher: Option<Arc<MapPublisher>>,
        observers: impl IntoIterator<Item = Observer>,
    ) -> Self {
        let with_first = |observer: Observer| {
            let first_s = observer.schedule.first();
            (observer, first_s)
        };
        Self {
            bus,
            publisher,
            ros: None,
            observers: observers.into_iter().map(with_first).collect(),
            epoch: 0,
            made: None,
            prediction: None,
            page: None,
            way: None,
            first_time: OnceLock::new(),
        }
    }

    /// The same, naming another run's map.
    pub(crate) fn of_epoch(self, epoch: u64) -> Self {
        Self { epoch, ..self }
    }

    /// Of the snapshots of the map at hand.
    pub(crate) fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Maps from now on are of another world than those before.
    pub(crate) fn begin_epoch(&mut self) {
        self.epoch += 1;
        if let Some(way) = &self.way {
            *lock(way) = Track::default();
        }
        if let Some(page) = &self.page {
            page.begin_epoch();
        }
    }

    /// The same, asking the map for pings that are kept from it.
    pub(crate) fn predicting(self, prediction: Option<Prediction>) -> Self {
        Self { prediction, ..self }
    }

    /// The same, told to nodes of ROS too.
    pub(crate) fn told_to_ros(self, ros: Option<Arc<RosPublisher>>) -> Self {
        Self { ros, ..self }
    }

    /// The same, showing all of it on a page too.
    pub(crate) fn shown_on(self, page: Option<Feed>) -> Self {
        Self { page, ..self }
    }

    /// The same, keeping where the sonar was.
    pub(crate) fn with_way(self, way: Option<Way>) -> Self {
        Self { way, ..self }
    }

    /// A ping with its pose, whether or not it goes into the map.
    pub(crate) fn posed(&self, posed: &PosedPing) {
        if let Some(way) = &self.way {
            let time = posed.ping.transmit_time();
            let first = self.first_time.get_or_init(|| time);
            lock(way).push(TrackPoint {
                dive_s: time.seconds_since(*first),
                place_m: posed.world_from_sensor.translation_m,
            });
        }
        if let Some(page) = &self.page {
            page.posed(posed);
        }
        if let Some(ros) = &self.ros {
            ros.posed(posed);
        }
        if let Some(prediction) = &self.prediction {
            prediction.ping(posed);
        }
    }

    /// What the newest map asked says of pings that are kept from it.
    pub(crate) fn predicted(&self) -> Option<Predicted> {
        self.prediction.as_ref().and_then(Prediction::newest)
    }

    /// Asks the last map too.
    pub(crate) fn finish(&mut self, last: &Arc<Snapshot>, dive_s: f64) -> Option<Predicted> {
        self.prediction.take()?.finish(last, dive_s)
    }

    /// Publishes a ping as it came, and shows it.
    pub(crate) fn ping(&self, ping: &Arc<Ping>, frame: Bytes) {
        if let Some(page) = &self.page {
            page.ping(ping);
        }
        if let Some(bus) = &self.bus {
            bus.publish_ping(frame, clock::now());
        }
    }

    /// Whether an observer wants to see the map of this moment.
    pub(crate) fn is_observation_due(&self, dive_s: f64) -> bool {
        self.observers.iter().any(|(_, next_s)| dive_s >= *next_s)
    }

    /// The newest map on its way to subscribers; where there are none, the newest made.
    pub(crate) fn sent(&self) -> Option<Sent> {
        match &self.publisher {
            Some(publisher) => publisher.sent(),
            None => self.made,
        }
    }

    /// Publishes a map, and shows it to the observers for whom it is time.
    pub(crate) fn map(&mut self, snapshot: &Arc<Snapshot>, moment: Moment) {
        if let Some(publisher) = &self.publisher {
            publisher.offer(Arc::clone(snapshot));
        }
        if let Some(ros) = &self.ros {
            ros.offer(Arc::clone(snapshot));
        }
        if let Some(page) = &self.page {
            page.map(snapshot);
        }
        self.made = Some(Sent {
            sequence: snapshot.sequence,
            at: Instant::now(),
        });
        if let Some(prediction) = &mut self.prediction {
            prediction.map(snapshot, moment.dive_s);
        }
        for (observer, next_s) in &mut self.observers {
            if moment.dive_s >= *next_s {
                *next_s = observer.schedule.after(moment.dive_s);
                (observer.take)(Observed {
                    snapshot: Arc::clone(snapshot),
                    moment,
                });
            }
        }
    }
}

fn lock(way: &Way) -> MutexGuard<'_, Track> {
    way.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_schedule_skips_what_has_passed_and_ends() {
        let at = Schedule::At(vec![1.0, 2.0, 4.0]);
        let times = [at.first(), at.after(1.0), at.after(3.0), at.after(4.0)];
        let expected = [1.0, 2.0, 4.0, f64::INFINITY];
        assert_eq!(times.map(f64::to_bits), expected.map(f64::to_bits));
        let multiples = Schedule::Multiples(2.0);
        let times = [
            multiples.first(),
            multiples.after(2.1),
            multiples.after(7.0),
        ];
        assert_eq!(times.map(f64::to_bits), [2.0, 4.0, 8.0].map(f64::to_bits));
        let every = Schedule::Every(2.0);
        let times = [every.first(), every.after(3.0)];
        assert_eq!(times.map(f64::to_bits), [0.0, 5.0].map(f64::to_bits));
    }
}
