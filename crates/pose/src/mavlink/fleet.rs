//! Everybody who speaks on a link, and whose poses are taken.
//!
//! A link carries more than one autopilot's messages: ground stations, gimbals with an attitude of their own, companion
//! computers, other vehicles. Each sender is followed for itself, with its own clock, so that none disturbs another.

use echosplat_join::{ArrivedPose, StampClock};
use echosplat_model::Timestamp;

use super::message::{Message, Sender, Station};
use super::told::Told;
use super::vehicle::Vehicle;
use crate::only::Only;
use crate::senders::{Heard, Rank, Rules, Senders};
use crate::status::{PoseSourceStatus, Several};

/// Heartbeats come once a second; who sends none for so long is not known for an autopilot, seconds.
const SETTLED_S: f64 = 1.5;
/// An autopilot that boots is silent for some seconds; one that is silent for longer is gone, seconds.
const SILENT_S: f64 = 5.0;

/// One sender.
#[derive(Debug)]
struct Member {
    vehicle: Vehicle,
    station: Option<Station>,
    /// Whether its poses were ever used: its counters are those of the source.
    was_used: bool,
}

/// All senders of a link.
#[derive(Debug)]
pub(crate) struct Fleet {
    stamps: StampClock,
    only: Only,
    /// Whether velocities are those of a DVL beside the link, and nobody else's.
    has_dvl: bool,
    senders: Senders<Sender>,
    /// In the order of the senders' table.
    members: Vec<Member>,
    /// Messages that poses are made of, from others than the sender used.
    of_others: u64,
    handed_on: u64,
    /// What could not even be read.
    unread: PoseSourceStatus,
    out: Vec<ArrivedPose>,
}

impl Fleet {
    pub(crate) fn new(stamps: StampClock, only: Only, has_dvl: bool) -> Self {
        let rules = Rules {
            silent_s: SILENT_S,
            settled_s: SETTLED_S,
            new_epoch: true,
        };
        Self {
            stamps,
            only,
            has_dvl,
            senders: Senders::new(rules),
            members: Vec::new(),
            of_others: 0,
            handed_on: 0,
            unread: PoseSourceStatus::default(),
            out: Vec::new(),
        }
    }

    /// Takes one message; `take` gets the poses to be used, if it completes or decides any.
    pub(crate) fn take(
        &mut self,
        sender: Sender,
        message: Message,
        arrived: Timestamp,
        mut take: impl FnMut(ArrivedPose),
    ) {
        if message.is_aiding() {
            self.aid(sender, &message, arrived);
            return self.hand_on(&mut take);
        }
        let is_of_pose = message.is_of_pose();
        let rank = self.rank_of(sender, None);
        let Some((index, is_new)) = self.senders.hear(sender, rank, arrived) else {
            self.of_others += u64::from(is_of_pose);
            return;
        };
        if is_new {
            self.begin(index);
        }
        if let Message::Heartbeat(station) = message {
            self.members[index].station = Some(station);
            self.senders
                .learn(index, self.rank_of(sender, Some(station)));
        }
        if !self.only.allows(sender) {
            self.of_others += u64::from(is_of_pose);
            return;
        }
        let is_others = self.senders.used().is_some_and(|used| used != index);
        self.of_others += u64::from(is_of_pose && is_others);
        for pose in self.members[index].vehicle.take(message, arrived) {
            self.senders.pose(index, pose, &mut self.out);
        }
        self.hand_on(&mut take);
    }

    /// What somebody tells autopilots of their velocity: whose system is another vehicle's does not tell this one.
    fn aid(&mut self, sender: Sender, message: &Message, arrived: Timestamp) {
        let systems: Vec<u32> = self.autopilots().map(|id| id.system).collect();
        let ids: Vec<(usize, Sender)> = self
            .senders
            .ids()
            .map(|(index, id, _)| (index, id))
            .collect();
        for (index, id) in ids {
            let is_anothers = id.system != sender.system && systems.contains(&sender.system);
            if self.only.allows(id) && !is_anothers {
                let poses = self.members[index].vehicle.aided(sender, message, arrived);
                let all = poses.into_iter();
                all.for_each(|pose| self.senders.pose(index, pose, &mut self.out));
            }
        }
    }

    fn autopilots(&self) -> impl Iterator<Item = Sender> {
        let all = self.senders.ids();
        all.filter(|(_, _, rank)| *rank == Rank::Vehicle)
            .map(|(_, id, _)| id)
    }

    /// A velocity over ground of the vehicle by a source beside the link; `take` gets the poses that it completes.
    pub(crate) fn moves(
        &mut self,
        told: &Told,
        arrived: Timestamp,
        mut take: impl FnMut(ArrivedPose),
    ) {
        let ids: Vec<(usize, Sender)> = self
            .senders
            .ids()
            .map(|(index, id, _)| (index, id))
            .collect();
        for (index, _) in ids.into_iter().filter(|(_, id)| self.only.allows(*id)) {
            let poses = self.members[index].vehicle.moves(told, arrived);
            let all = poses.into_iter();
            all.for_each(|pose| self.senders.pose(index, pose, &mut self.out));
        }
        self.hand_on(&mut take);
    }

    /// What positions of the sender used are reckoned of, in words; `None` where they are not.
    pub(crate) fn reckons(&self) -> Option<String> {
        self.members[self.senders.used()?].vehicle.reckons()
    }

    /// To be called now and then: what waited to be decided may be.
    pub(crate) fn settle(&mut self, now: Timestamp, mut take: impl FnMut(ArrivedPose)) {
        self.senders.settle(now, &mut self.out);
        self.hand_on(&mut take);
    }

    fn hand_on(&mut self, take: &mut impl FnMut(ArrivedPose)) {
        if let Some(used) = self.senders.used()
            && !std::mem::replace(&mut self.members[used].was_used, true)
        {
            tracing::info!("poses: taken from {}", self.name(used));
        }
        self.handed_on += self.out.len() as u64;
        self.out.drain(..).for_each(take);
    }

    fn begin(&mut self, index: usize) {
        let mut vehicle = Vehicle::new(self.stamps);
        if self.has_dvl {
            vehicle.keep_to_dvl();
        }
        let member = Member {
            vehicle,
            station: None,
            was_used: false,
        };
        match self.members.get_mut(index) {
            Some(place) => *place = member,
            None => self.members.push(member),
        }
    }

    fn rank_of(&self, sender: Sender, station: Option<Station>) -> Rank {
        match station {
            Some(Station::Autopilot) => Rank::Vehicle,
            // Named in the URL, it is what is wanted, whatever it is.
            _ if self.only.component.is_some() && self.only.allows(sender) => Rank::Vehicle,
            Some(_) => Rank::Other,
            None => Rank::Unknown,
        }
    }

    /// A message that could not even be read.
    pub(crate) fn refuse(&mut self, what: String) {
        self.unread.received += 1;
        self.unread.refuse(&crate::fault::Fault::Malformed(what));
    }

    /// Whom to ask for messages: the sender used, or else the first autopilot heard.
    pub(crate) fn to_ask(&self) -> Option<Sender> {
        self.asked().map(|index| self.senders.heard(index).id)
    }

    fn asked(&self) -> Option<usize> {
        let autopilot = || {
            let allowed = self
                .senders
                .ids()
                .filter(|(_, id, _)| self.only.allows(*id));
            let mut meant = allowed.filter(|(_, _, rank)| *rank == Rank::Vehicle);
            meant.next().map(|(index, _, _)| index)
        };
        self.senders.used().or_else(autopilot)
    }

    /// Whether the messages of this id come from whom they are asked of.
    pub(crate) fn comes(&self, message_id: u32, now: Timestamp) -> bool {
        let asked = self.asked();
        asked.is_some_and(|index| self.members[index].vehicle.comes(message_id, now))
    }

    /// A question to all clocks, to be sent now: `ts1`.
    pub(crate) fn ask_time(&mut self, now: Timestamp) -> i64 {
        for member in &mut self.members {
            member.vehicle.clock.ask(now);
        }
        now.nanos()
    }

    /// Of the sender used, or of the most likely one; rate and link are the caller's.
    pub(crate) fn status(&self, now: Timestamp) -> PoseSourceStatus {
        let mut status = self.unread.clone();
        if let Some(index) = self.senders.used().or_else(|| self.likeliest()) {
            let of_it = self.members[index].vehicle.status(now);
            status.first_fault = status.first_fault.or(of_it.first_fault);
            status.clock_offset_s = of_it.clock_offset_s;
            status.clock_method = of_it.clock_method;
            status.missing = of_it.missing;
            status.origin = of_it.origin;
            status.lacks_north = of_it.lacks_north;
        }
        let likeliest = self.likeliest();
        for (index, member) in self.members.iter().enumerate() {
            if member.was_used || self.senders.used().is_none() && likeliest == Some(index) {
                status.add(&member.vehicle.status(now));
            }
        }
        status.accepted = self.handed_on;
        status.epoch = self.senders.epoch();
        status.other_senders = self.of_others;
        status.senders = self.senders.told(now, |index, heard| {
            let kind = self.members[index].station.map(Station::name);
            (heard.id.to_string(), kind.map(str::to_owned))
        });
        status.missing = status.missing.or_else(|| self.nobody(now));
        status.several = self.several(now);
        status
    }

    /// Of those allowed the best known, and of equals the first to send what poses are made of.
    fn likeliest(&self) -> Option<usize> {
        let allowed = self
            .senders
            .ids()
            .filter(|(_, id, _)| self.only.allows(*id));
        let of_poses = |index: usize| self.members[index].vehicle.received() > 0;
        allowed
            .max_by_key(|(index, _, rank)| (*rank, of_poses(*index), std::cmp::Reverse(*index)))
            .map(|(index, _, _)| index)
    }

    /// The sender that the URL names is not heard, others are.
    fn nobody(&self, now: Timestamp) -> Option<String> {
        let mut all = self.senders.ids();
        if all.any(|(_, id, _)| self.only.allows(id)) {
            return None;
        }
        let there = self.senders.others().filter(|heard| heard.is_there(now));
        let others: Vec<String> = there.map(|heard| heard.id.to_string()).collect();
        (!others.is_empty()).then(|| {
            format!(
                "nothing comes from {}, which pose.url names; heard are {}",
                self.only.in_words(),
                others.join(", ")
            )
        })
    }

    /// Where it is not clear who is meant.
    fn several(&self, now: Timestamp) -> Option<Several> {
        let index = self.asked()?;
        let own = self.senders.heard(index);
        let name = self.name(index);
        let stands_in_for = self.senders.stands_in_for();
        if let Some(first) = stands_in_for.filter(|first| !first.gives_poses(now)) {
            let (of_first, of_own) = Only::to_tell_apart(first.id, own.id);
            let sentence = format!(
                "poses are taken from {name} since {} fell silent; {of_first} in pose.url keeps to the one, {of_own} to \
                 the other",
                first.id,
            );
            return Some(Several {
                sentence,
                leaves_out: true,
            });
        }
        let is_rival = |heard: &&Heard<Sender>| {
            self.only.allows(heard.id)
                && heard.id != own.id
                && heard.is_there(now)
                && heard.rank >= own.rank
                && (heard.rank == Rank::Vehicle || heard.gives_poses(now))
        };
        let rival = self.senders.others().find(is_rival)?;
        let what = match rival.rank {
            Rank::Vehicle => "a second autopilot",
            _ => "a second sender of poses",
        };
        let is_used = self.senders.used().is_some();
        let apart = match rival.gives_poses(now) && is_used {
            true => format!(
                ", whose poses lie {:.1} m apart",
                self.senders.distance_m(rival)
            ),
            false => String::new(),
        };
        let own_part = match is_used {
            true => "is the one used",
            false => "is asked for poses",
        };
        let (of_rival, of_own) = Only::to_tell_apart(rival.id, own.id);
        let sentence = format!(
            "{what} is heard on the same link, {}{apart}; {name} {own_part}: if the sonar is on the other, add \
             {of_rival} to pose.url, else {of_own}",
            rival.id,
        );
        Some(Several {
            sentence,
            leaves_out: rival.gives_poses(now),
        })
    }

    fn name(&self, index: usize) -> String {
        let id = self.senders.heard(index).id;
        match self.members[index].station {
            Some(station) => format!("{id} ({})", station.name()),
            None => id.to_string(),
        }
    }
}
