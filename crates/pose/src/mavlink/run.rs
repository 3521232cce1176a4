//! The task that feeds a [`Fleet`] from a link of bytes.

use std::convert::Infallible;
use std::io;

use echosplat_model::Timestamp;
use mavlink::dialects::ardupilotmega::MavMessage;
use tokio::task::block_in_place;

use super::beside::{Beside, listen_beside};
use super::fleet::Fleet;
use super::frames::{Frames, frame};
use super::message::Message;
use super::requests::{Requests, timesync_answer};
use crate::link::{Address, BackOff};
use crate::now::now;
use crate::only::Only;
use crate::outlet::Outlet;
use echosplat_join::StampClock;

/// Longest read at once; a datagram is never longer.
const PIECE_BYTES: usize = 64 * 1024;
/// Without a frame for so long the link counts as silent.
pub(super) const SILENT_AFTER_S: f64 = 2.0;
/// A vehicle at the other end of a link.
#[derive(Debug)]
pub(crate) struct OverLink {
    pub(crate) address: Address,
    pub(crate) stamps: StampClock,
    pub(crate) only: Only,
    /// Whose velocities are used, beside the vehicle's attitude and height.
    pub(crate) dvl: Option<Address>,
}

impl OverLink {
    /// Opens the link, feeds the fleet, opens it again.
    pub(crate) async fn run(&self, outlet: &mut Outlet) {
        listen_beside(self.dvl.as_ref(), |beside| self.listen(beside, outlet)).await;
    }

    async fn listen(&self, mut beside: Option<Beside>, outlet: &mut Outlet) {
        let mut fleet = Fleet::new(self.stamps, self.only, beside.is_some());
        let mut back_off = BackOff::default();
        let name = self.address.name();
        loop {
            let Err(error) = self
                .feed(&mut fleet, &mut beside, &mut back_off, outlet)
                .await;
            outlet.link(format!("lost: {name}: {error}; trying again"));
            let waiting = outlet.meanwhile(|| fleet.status(now()), back_off.wait());
            waiting.await;
        }
    }

    /// Until the link is lost.
    async fn feed(
        &self,
        fleet: &mut Fleet,
        beside: &mut Option<Beside>,
        back_off: &mut BackOff,
        outlet: &mut Outlet,
    ) -> io::Result<Infallible> {
        let opening = outlet.meanwhile(|| fleet.status(now()), self.address.open());
        let mut link = opening.await?;
        let mut talk = Talk::new(self.address.name());
        let mut buffer = vec![0; PIECE_BYTES];
        loop {
            let count = link.read(&mut buffer).await?;
            let bytes = &buffer[..count];
            let to_say = block_in_place(|| {
                if let Some(beside) = beside {
                    beside.feed(fleet, outlet);
                }
                talk.take(bytes, fleet, beside.as_ref(), back_off, outlet)
            });
            for message in to_say {
                let header = talk.requests.header(fleet.to_ask());
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
        fleet: &mut Fleet,
        beside: Option<&Beside>,
        back_off: &mut BackOff,
        outlet: &mut Outlet,
    ) -> Vec<MavMessage> {
        let arrived = now();
        let mut questions = Vec::new();
        let frames_before = self.frames.frame_count();
        self.frames.feed(bytes, |sender, message| {
            questions.extend(question(&message));
            fleet.take(sender, message, arrived, |pose| outlet.hand_on(pose));
        });
        fleet.settle(arrived, |pose| outlet.hand_on(pose));
        if self.frames.frame_count() > frames_before {
            self.heard_at = Some(arrived);
            back_off.reset();
        }
        let name = &self.name;
        let silent_s = self.heard_at.map(|at| arrived.seconds_since(at).abs());
        let link = match silent_s {
            Some(silent_s) if silent_s <= SILENT_AFTER_S => up("up", fleet),
            Some(_) => format!("waiting for the vehicle on {name}: it fell silent"),
            None => format!("waiting for a vehicle on {name}"),
        };
        outlet.link(match beside {
            Some(beside) => beside.beside(link),
            None => link,
        });
        let answers = questions.into_iter().map(|ts1| timesync_answer(ts1, now()));
        let due = self.requests.due(fleet, arrived);
        let to_say = answers.chain(due).collect();
        outlet.tell(fleet.status(arrived));
        to_say
    }
}

/// What a link that is up is told as: also that positions are reckoned.
pub(super) fn up(up: &str, fleet: &Fleet) -> String {
    match fleet.reckons() {
        Some(how) => format!("{up}; {how}"),
        None => up.to_owned(),
    }
}

/// What a vehicle's question about the time asks with.
fn question(message: &Message) -> Option<i64> {
    match message {
        Message::TimeSync { tc1: 0, ts1 } => Some(*ts1),
        _ => None,
    }
}
