//! The task that feeds a [`Fleet`] from a mavlink-server on the bus.
//!
//! Since 0.9 (June 2026) the server can put messages as they are on `mavlink_raw/out`, one frame in each `put`; as JSON
//! it puts each on `mavlink/<system>/<component>/<MESSAGE>`. Whoever runs both sends all twice: while raw messages come,
//! JSON is left alone.

use std::sync::Arc;
use std::time::Duration;

use echosplat_bus::{MessageSubscription, ReceivedMessage};
use echosplat_join::StampClock;
use echosplat_model::Timestamp;
use tokio::task::{block_in_place, spawn_blocking};

use super::beside::{Beside, listen_beside};
use super::fleet::Fleet;
use super::frames::Frames;
use super::json;
use super::message::Sender;
use super::run::{SILENT_AFTER_S, up};
use crate::link::Address;
use crate::now::now;
use crate::only::Only;
use crate::outlet::Outlet;

/// How long the bus is waited for before the status is looked at.
const BUS_WAIT: Duration = Duration::from_millis(200);
/// Without raw messages for so long JSON is taken again, seconds.
const RAW_PREFERRED_FOR_S: f64 = 3.0;
/// What the key of raw messages ends in.
const RAW_END: &str = "_raw/out";
/// Names of the messages that are taken as JSON.
const JSON_MESSAGES: [&str; 12] = [
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "HEARTBEAT",
    "LOCAL_POSITION_NED",
    "GPS_GLOBAL_ORIGIN",
    "GLOBAL_POSITION_INT",
    "ODOMETRY",
    "SYSTEM_TIME",
    "VFR_HUD",
    "EKF_STATUS_REPORT",
    "VISION_POSITION_DELTA",
    "VISION_SPEED_ESTIMATE",
];

/// All keys of a server.
pub(crate) fn keys(prefix: &str) -> Vec<String> {
    let json = JSON_MESSAGES.map(|name| format!("{prefix}/*/*/{name}"));
    json.into_iter()
        .chain([format!("{prefix}{RAW_END}")])
        .collect()
}

/// A server on the bus.
#[derive(Debug)]
pub(crate) struct OnBus {
    pub(crate) messages: Arc<MessageSubscription>,
    pub(crate) stamps: StampClock,
    pub(crate) only: Only,
    /// Whose velocities are used, beside the vehicle's attitude and height.
    pub(crate) dvl: Option<Address>,
}

impl OnBus {
    pub(crate) async fn run(&self, outlet: &mut Outlet) {
        listen_beside(self.dvl.as_ref(), |beside| self.listen(beside, outlet)).await;
    }

    async fn listen(&self, mut beside: Option<Beside>, outlet: &mut Outlet) {
        let mut server = Server::new(Fleet::new(self.stamps, self.only, beside.is_some()));
        loop {
            let source = Arc::clone(&self.messages);
            let received = spawn_blocking(move || source.next_within(BUS_WAIT)).await;
            // It does not panic.
            let received = received.ok().flatten();
            let at = now();
            if let Some(beside) = &mut beside {
                beside.feed(&mut server.fleet, outlet);
            }
            if let Some(received) = received {
                server.take(&received, at, outlet);
            }
            server.fleet.settle(at, |pose| outlet.hand_on(pose));
            let link = server.link(at);
            outlet.link(match &beside {
                Some(beside) => beside.beside(link),
                None => link,
            });
            let mut status = server.fleet.status(at);
            status.dropped_full += self.messages.dropped();
            block_in_place(|| outlet.tell(status));
        }
    }
}

/// What was heard of a server.
struct Server {
    fleet: Fleet,
    frames: Frames,
    /// When anything came.
    heard_at: Option<Timestamp>,
    /// When a raw message came.
    raw_at: Option<Timestamp>,
    /// Whether raw messages are used.
    is_raw: bool,
}

impl Server {
    fn new(fleet: Fleet) -> Self {
        Self {
            fleet,
            frames: Frames::new(),
            heard_at: None,
            raw_at: None,
            is_raw: false,
        }
    }

    fn take(&mut self, received: &ReceivedMessage, at: Timestamp, outlet: &mut Outlet) {
        self.heard_at = Some(at);
        match received.key.ends_with(RAW_END) {
            true => self.take_raw(received, at, outlet),
            false if self.has_raw(at) => {}
            false => {
                self.is_raw = false;
                self.take_json(received, outlet);
            }
        }
    }

    fn has_raw(&self, at: Timestamp) -> bool {
        let raw_at = self.raw_at;
        raw_at.is_some_and(|raw_at| at.seconds_since(raw_at).abs() <= RAW_PREFERRED_FOR_S)
    }

    fn take_raw(&mut self, received: &ReceivedMessage, at: Timestamp, outlet: &mut Outlet) {
        let frames_before = self.frames.frame_count();
        let fleet = &mut self.fleet;
        self.frames.feed(&received.payload, |sender, message| {
            fleet.take(sender, message, received.arrived, |pose| {
                outlet.hand_on(pose);
            });
        });
        if self.frames.frame_count() == frames_before {
            return;
        }
        self.raw_at = Some(at);
        if !std::mem::replace(&mut self.is_raw, true) {
            tracing::info!(
                "poses: raw MAVLink on {} is taken, JSON is not",
                received.key
            );
        }
    }

    fn take_json(&mut self, received: &ReceivedMessage, outlet: &mut Outlet) {
        match json::parse(&received.payload) {
            Ok(Some((_, message))) => {
                let sender = sender_of_key(&received.key);
                let hand_on = |pose| outlet.hand_on(pose);
                self.fleet.take(sender, message, received.arrived, hand_on);
            }
            Ok(None) => {}
            // It only says what its sender is.
            Err(what) if received.key.ends_with("/HEARTBEAT") => tracing::debug!("{what}"),
            Err(what) => {
                let key = &received.key;
                self.fleet.refuse(format!("message on {key}: {what}"));
            }
        }
    }

    fn link(&self, at: Timestamp) -> String {
        match self.heard_at {
            Some(heard) if at.seconds_since(heard).abs() <= SILENT_AFTER_S => match self.is_raw {
                true => up("up, raw MAVLink", &self.fleet),
                false => up("up", &self.fleet),
            },
            Some(_) => "waiting for the MAVLink server on zenoh: it fell silent".to_owned(),
            None => "waiting for a MAVLink server on zenoh".to_owned(),
        }
    }
}

/// Of `<prefix>/<system>/<component>/<message>`.
fn sender_of_key(key: &str) -> Sender {
    let mut parts = key.rsplit('/').skip(1);
    let component = parts.next().and_then(|part| part.parse().ok());
    let system = parts.next().and_then(|part| part.parse().ok());
    Sender {
        system: system.unwrap_or(0),
        component: component.unwrap_or(0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_name_their_sender_and_raw_messages_stand_beside() {
        let key = sender_of_key("sea/mavlink/1/191/ATTITUDE");
        assert_eq!((key.system, key.component), (1, 191));
        let all = keys("sea/mavlink");
        assert!(all.contains(&"sea/mavlink/*/*/HEARTBEAT".to_owned()));
        assert_eq!(all.last().map(String::as_str), Some("sea/mavlink_raw/out"));
    }
}
