//! What is sent straight from the session: poses, pings and statuses.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;
use crossbeam_channel::{Sender, TrySendError, bounded};
use echosplat_liveness::Heartbeat;
use echosplat_model::{StampedPose, Timestamp};
use serde::Serialize;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};

use super::threads::spawn;
use super::{Bus, Link, VEHICLE_FRAME_ID};
use crate::keys::Keys;
use crate::streams::MAX_STATUS_BYTES;
use crate::{BusError, pose_message};

/// What was sent outside the map, and what was not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct BusCounters {
    /// Pings given to zenoh. What it drops under congestion it does not tell.
    pub pings_sent: u64,
    /// Newest pings dropped because the queue was full.
    pub pings_dropped: u64,
    /// Pings that zenoh refused.
    pub pings_failed: u64,
    /// Statuses given to zenoh.
    pub statuses_sent: u64,
    /// Statuses longer than any subscriber takes, or that zenoh refused.
    pub statuses_failed: u64,
}

#[derive(Debug, Default)]
pub(super) struct Tally {
    pings_sent: AtomicU64,
    pings_dropped: AtomicU64,
    pings_failed: AtomicU64,
    statuses_sent: AtomicU64,
    statuses_failed: AtomicU64,
}

#[derive(Debug)]
pub(super) struct OutgoingPing {
    frame: Bytes,
    host_time: Timestamp,
}

impl Bus {
    /// Sends a pose as JSON. Waits while the link is congested, up to zenoh's 5 s.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn publish_pose(&self, pose: &StampedPose) -> Result<(), BusError> {
        let frame_id = &self.link.config.frame_id;
        let json = pose_message::encode_json(pose, frame_id, VEHICLE_FRAME_ID);
        let put = self.pose_publisher.put(json).wait();
        put.map_err(BusError::zenoh("publish a pose"))
    }

    /// Whether somebody, in this process or beyond, takes poses.
    #[must_use]
    pub fn has_pose_subscriber(&self) -> bool {
        let status = self.pose_publisher.matching_status().wait();
        status.is_ok_and(|status| status.matching())
    }

    /// Hands a raw Ping frame over to be sent; never blocks. With the queue full the
    /// frame, being the newest, is dropped and counted.
    pub fn publish_ping(&self, frame: Bytes, host_time: Timestamp) {
        let sent = self.pings.try_send(OutgoingPing { frame, host_time });
        if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) = sent {
            count(&self.tally.pings_dropped);
        }
    }

    /// Pings that [`Bus::publish_ping`] took and that were not sent.
    #[must_use]
    pub fn pings_dropped(&self) -> u64 {
        let counters = self.counters();
        counters.pings_dropped + counters.pings_failed
    }

    /// What was sent outside the map, and what was not.
    #[must_use]
    pub fn counters(&self) -> BusCounters {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        BusCounters {
            pings_sent: read(&self.tally.pings_sent),
            pings_dropped: read(&self.tally.pings_dropped),
            pings_failed: read(&self.tally.pings_failed),
            statuses_sent: read(&self.tally.statuses_sent),
            statuses_failed: read(&self.tally.statuses_failed),
        }
    }

    /// Sends the service's status; lost if the link is congested. Never waits long: zenoh drops it
    /// after a millisecond, one of several fragments after 50 ms.
    ///
    /// # Errors
    /// If it is longer than a subscriber takes, 256 KiB, or the session is closed.
    pub fn publish_status(&self, status: &serde_json::Value) -> Result<(), BusError> {
        self.publish_status_on(self.link.keys.status(), status)
    }

    /// The same for a driver that runs apart from its mapper.
    ///
    /// # Errors
    /// As [`Bus::publish_status`].
    pub fn publish_driver_status(&self, status: &serde_json::Value) -> Result<(), BusError> {
        self.publish_status_on(self.link.keys.driver_status(), status)
    }

    fn publish_status_on(&self, key: String, status: &serde_json::Value) -> Result<(), BusError> {
        let sent = self.put_status(key, status.to_string());
        count(match sent {
            Ok(()) => &self.tally.statuses_sent,
            Err(_) => &self.tally.statuses_failed,
        });
        sent
    }

    fn put_status(&self, key: String, json: String) -> Result<(), BusError> {
        if json.len() > MAX_STATUS_BYTES {
            return Err(BusError::TooLong {
                what: "status",
                found: json.len(),
                limit: MAX_STATUS_BYTES,
            });
        }
        let put = self.link.session.put(key, json);
        put.encoding(Encoding::APPLICATION_JSON)
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map_err(BusError::zenoh("publish the status"))
    }
}

fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

pub(super) fn declare_pose_publisher(
    session: &zenoh::Session,
    keys: &Keys,
) -> Result<Publisher<'static>, BusError> {
    let publisher = session.declare_publisher(keys.pose());
    publisher
        .encoding(Encoding::APPLICATION_JSON)
        .congestion_control(CongestionControl::Block)
        .wait()
        .map_err(BusError::zenoh("declare the publisher of poses"))
}

/// Sending may wait a millisecond for a congested link; the ping path must not.
pub(super) fn start_ping_thread(
    link: &Arc<Link>,
    tally: &Arc<Tally>,
    heartbeat: Heartbeat,
) -> Result<Sender<OutgoingPing>, BusError> {
    let (sender, receiver) = bounded(link.config.ping_queue_len);
    let (session, key) = (link.session.clone(), link.keys.ping());
    let tally = Arc::clone(tally);
    spawn("bus-pings", move || {
        heartbeat.run_again(|| {
            heartbeat.rest();
            for ping in &receiver {
                heartbeat.beat();
                send_ping(&session, &key, ping, &tally);
                heartbeat.rest();
            }
        });
    })?;
    Ok(sender)
}

fn send_ping(session: &zenoh::Session, key: &str, ping: OutgoingPing, tally: &Tally) {
    let attachment = serde_json::json!({ "host_time_ns": ping.host_time.nanos() });
    let sent = session
        .put(key, ping.frame)
        .encoding(Encoding::APPLICATION_OCTET_STREAM)
        .attachment(attachment.to_string())
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::DataHigh)
        .wait();
    count(match sent {
        Ok(()) => &tally.pings_sent,
        Err(_) => &tally.pings_failed,
    });
}
