//! The threads that feed a [`Vehicle`]: from a link of bytes, or from a server on the bus.

use std::io;
use std::time::Duration;

use echosplat_bus::{MessageSubscription, ReceivedMessage};

use super::frames::{Frames, frame};
use super::json;
use super::message::{Message, Sender};
use super::requests::{Requests, timesync_answer};
use super::vehicle::Vehicle;
use crate::link::{Address, BackOff, Link};
use crate::now::now;
use crate::outlet::Outlet;
use crate::stop::Stop;
use echosplat_join::StampClock;

/// Longest read at once; a datagram is never longer.
const PIECE_BYTES: usize = 64 * 1024;
/// Without a frame for so long the link counts as silent.
const SILENT_AFTER_S: f64 = 2.0;
/// How long the bus is waited for before the stop and the status are looked at.
const BUS_WAIT: Duration = Duration::from_millis(50);

/// Names of the messages that are taken from a server on the bus.
pub(crate) const JSON_MESSAGES: [&str; 5] = [
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "ODOMETRY",
    "SYSTEM_TIME",
];

/// A vehicle at the other end of a link.
pub(crate) struct OverLink {
    pub(crate) address: Address,
    pub(crate) stamps: StampClock,
}

impl OverLink {
    /// Until the stop: opens the link, feeds the vehicle, opens it again.
    pub(crate) fn run(&self, outlet: &mut Outlet, stop: &Stop) {
        let mut vehicle = Vehicle::new(self.stamps);
        let mut back_off = BackOff::default();
        let name = self.address.name();
        while !stop.is_set() {
            outlet.connecting();
            let failure = match self.address.open() {
                Ok(link) => self.feed(link, &mut vehicle, &mut back_off, outlet, stop),
                Err(error) => Err(error),
            };
            if let Err(error) = failure {
                outlet.link(format!("lost: {name}: {error}; trying again"));
            }
            outlet.heartbeat.rest();
            if back_off.wait(stop) {
                return;
            }
        }
    }

    fn feed(
        &self,
        mut link: Link,
        vehicle: &mut Vehicle,
        back_off: &mut BackOff,
        outlet: &mut Outlet,
        stop: &Stop,
    ) -> io::Result<()> {
        let name = self.address.name();
        let mut frames = Frames::new();
        let mut requests = Requests::default();
        let mut heard_at = None;
        let mut buffer = vec![0; PIECE_BYTES];
        while !stop.is_set() {
            let count = link.read(&mut buffer)?;
            let arrived = now();
            let mut questions = Vec::new();
            let frames_before = frames.frame_count();
            frames.feed(&buffer[..count], |sender, message| {
                questions.extend(question(&message));
                take(vehicle, sender, message, arrived, outlet);
            });
            if frames.frame_count() > frames_before {
                heard_at = Some(arrived);
                back_off.reset();
            }
            let silent_s = heard_at.map(|at| arrived.seconds_since(at).abs());
            match silent_s {
                Some(silent_s) if silent_s <= SILENT_AFTER_S => outlet.link("up"),
                Some(_) => {
                    outlet.link(format!("waiting for the vehicle on {name}: it fell silent"));
                }
                None => outlet.link(format!("waiting for a vehicle on {name}")),
            }
            let to = vehicle.to_ask();
            let answers = questions.into_iter().map(|ts1| timesync_answer(ts1, now()));
            let due = requests.due(vehicle, arrived);
            for message in answers.chain(due).collect::<Vec<_>>() {
                let header = requests.header(to);
                link.write(&frame(header, &message))?;
            }
            outlet.tell(vehicle.status(arrived));
        }
        Ok(())
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
    arrived: echosplat_model::Timestamp,
    outlet: &mut Outlet,
) {
    if let Some(pose) = vehicle.take(sender, message, arrived) {
        outlet.hand_on(pose);
    }
}

/// A vehicle whose messages a server puts on the bus as JSON.
pub(crate) fn over_bus(
    messages: &MessageSubscription,
    stamps: StampClock,
    outlet: &mut Outlet,
    stop: &Stop,
) {
    let mut vehicle = Vehicle::new(stamps);
    let mut heard_at = None;
    while !stop.is_set() {
        let received = messages.next_within(BUS_WAIT);
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
        outlet.tell(status);
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
