//! The tasks that feed a [`Vehicle`]: from a link of bytes, or from a server on the bus.

use std::convert::Infallible;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use echosplat_bus::{MessageSubscription, ReceivedMessage};
use echosplat_model::Timestamp;
use mavlink::dialects::ardupilotmega::MavMessage;
use tokio::task::{block_in_place, spawn_blocking};

use super::frames::{Frames, frame};
use super::json;
use super::message::{Message, Sender};
use super::requests::{Requests, timesync_answer};
use super::vehicle::Vehicle;
use crate::link::{Address, BackOff};
use crate::now::now;
use crate::outlet::Outlet;
use echosplat_join::StampClock;

/// Longest read at once; a datagram is never longer.
const PIECE_BYTES: usize = 64 * 1024;
/// Without a frame for so long the link counts as silent.
const SILENT_AFTER_S: f64 = 2.0;
/// How long the bus is waited for before the status is looked at.
const BUS_WAIT: Duration = Duration::from_millis(200);

/// Names of the messages that are taken from a server on the bus.
pub(crate) const JSON_MESSAGES: [&str; 5] = [
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "ODOMETRY",
    "SYSTEM_TIME",
];

/// A vehicle at the other end of a link.
#[derive(Debug)]
pub(crate) struct OverLink {
    pub(crate) address: Address,
    pub(crate) stamps: StampClock,
}

impl OverLink {
    /// Opens the link, feeds the vehicle, opens it again.
    pub(crate) async fn run(&self, outlet: &mut Outlet) {
        let mut vehicle = Vehicle::new(self.stamps);
        let mut back_off = BackOff::default();
        let name = self.address.name();
        loop {
            let Err(error) = self.feed(&mut vehicle, &mut back_off, outlet).await;
            outlet.link(format!("lost: {name}: {error}; trying again"));
            let waiting = outlet.meanwhile(|| vehicle.status(now()), back_off.wait());
            waiting.await;
        }
    }

    /// Until the link is lost.
    async fn feed(
        &self,
        vehicle: &mut Vehicle,
        back_off: &mut BackOff,
        outlet: &mut Outlet,
    ) -> io::Result<Infallible> {
        let opening = outlet.meanwhile(|| vehicle.status(now()), self.address.open());
        let mut link = opening.await?;
        let mut talk = Talk::new(self.address.name());
        let mut buffer = vec![0; PIECE_BYTES];
        loop {
            let count = link.read(&mut buffer).await?;
            let bytes = &buffer[..count];
            let to_say = block_in_place(|| talk.take(bytes, vehicle, back_off, outlet));
            for message in to_say {
                let header = talk.requests.header(vehicle.to_ask());
                link.write(&frame(header, &message)).await?;
            }
        }
    }
}

/// What is said and heard on one link.
struct Talk {
    /// The other end, in words.
    name: String,
    frames: Frames,
    requests: Requests,
    heard_at: Option<Timestamp>,
}

impl Talk {
    fn new(name: String) -> Self {
        Self {
            name,
            frames: Frames::new(),
            requests: Requests::default(),
            heard_at: None,
        }
    }

    /// Takes what came, if anything did; gives what is to be said now.
    fn take(
        &mut self,
        bytes: &[u8],
        vehicle: &mut Vehicle,
        back_off: &mut BackOff,
        outlet: &mut Outlet,
    ) -> Vec<MavMessage> {
        let arrived = now();
        let mut questions = Vec::new();
        let frames_before = self.frames.frame_count();
        self.frames.feed(bytes, |sender, message| {
            questions.extend(question(&message));
            take(vehicle, sender, message, arrived, outlet);
        });
        if self.frames.frame_count() > frames_before {
            self.heard_at = Some(arrived);
            back_off.reset();
        }
        let name = &self.name;
        let silent_s = self.heard_at.map(|at| arrived.seconds_since(at).abs());
        match silent_s {
            Some(silent_s) if silent_s <= SILENT_AFTER_S => outlet.link("up"),
            Some(_) => outlet.link(format!("waiting for the vehicle on {name}: it fell silent")),
            None => outlet.link(format!("waiting for a vehicle on {name}")),
        }
        let answers = questions.into_iter().map(|ts1| timesync_answer(ts1, now()));
        let due = self.requests.due(vehicle, arrived);
        let to_say = answers.chain(due).collect();
        outlet.tell(vehicle.status(arrived));
        to_say
    }
}

/// What a vehicle's question about the time asks with.
fn question(message: &Message) -> Option<i64> {
    match message {
        Message::TimeSync { tc1: 0, ts1 } => Some(*ts1),
        _ => None,
    }
}

fn take(
    vehicle: &mut Vehicle,
    sender: Sender,
    message: Message,
    arrived: Timestamp,
    outlet: &mut Outlet,
) {
    if let Some(pose) = vehicle.take(sender, message, arrived) {
        outlet.hand_on(pose);
    }
}

/// A vehicle whose messages a server puts on the bus as JSON.
pub(crate) async fn over_bus(
    messages: &Arc<MessageSubscription>,
    stamps: StampClock,
    outlet: &mut Outlet,
) {
    let mut vehicle = Vehicle::new(stamps);
    let mut heard_at = None;
    loop {
        let source = Arc::clone(messages);
        let received = spawn_blocking(move || source.next_within(BUS_WAIT)).await;
        // It does not panic.
        let received = received.ok().flatten();
        let at = now();
        if let Some(received) = received {
            heard_at = Some(at);
            take_json(&mut vehicle, &received, outlet);
        }
        match heard_at {
            Some(heard) if at.seconds_since(heard).abs() <= SILENT_AFTER_S => outlet.link("up"),
            Some(_) => outlet.link("waiting for the MAVLink server on zenoh: it fell silent"),
            None => outlet.link("waiting for a MAVLink server on zenoh"),
        }
        let mut status = vehicle.status(at);
        status.dropped_full += messages.dropped();
        block_in_place(|| outlet.tell(status));
    }
}

fn take_json(vehicle: &mut Vehicle, received: &ReceivedMessage, outlet: &mut Outlet) {
    match json::parse(&received.payload) {
        Ok(Some((_, message))) => {
            let sender = sender_of_key(&received.key);
            take(vehicle, sender, message, received.arrived, outlet);
        }
        Ok(None) => {}
        Err(what) => vehicle.refuse(format!("message on {}: {what}", received.key)),
    }
}

/// Of `<prefix>/<system>/<component>/<message>`.
pub(crate) fn sender_of_key(key: &str) -> Sender {
    let mut parts = key.rsplit('/').skip(1);
    let component = parts.next().and_then(|part| part.parse().ok());
    let system = parts.next().and_then(|part| part.parse().ok());
    Sender {
        system: system.unwrap_or(0),
        component: component.unwrap_or(0),
    }
}
